"""What an object holds, at a glance: a line for the prompt, a table for notebooks."""

from __future__ import annotations

import html
from collections.abc import Mapping


def summary_line(name: str, entries: Mapping[str, object]) -> str:
    """``Name(key=value, …)`` of all entries that are not None.

    Parameters
    ----------
    name : of the class
    entries : mapping of str to str, int, float or bool
    """
    shown = (f"{key}={value:.4g}" if isinstance(value, float) else f"{key}={value!r}" for key, value in _known(entries))
    return f"{name}({', '.join(shown)})"


def summary_table(name: str, entries: Mapping[str, object]) -> str:
    """The same as an HTML table, a row for each entry, large numbers grouped by thousands."""
    rows = "".join(
        f'<tr><th style="text-align:left">{html.escape(key.replace("_", " "))}</th>'
        f'<td style="text-align:left">{html.escape(_cell(value))}</td></tr>'
        for key, value in _known(entries)
    )
    return f"<table><caption>{html.escape(name)}</caption><tbody>{rows}</tbody></table>"


class Summarised:
    """A result that prints as its `_summary`; for dataclasses with ``repr=False``."""

    def _summary(self) -> Mapping[str, object]:
        raise NotImplementedError

    def __repr__(self) -> str:
        return summary_line(type(self).__name__, self._summary())

    def _repr_html_(self) -> str:
        return summary_table(type(self).__name__, self._summary())


def _known(entries: Mapping[str, object]) -> list[tuple[str, object]]:
    return [(key, value) for key, value in entries.items() if value is not None]


def _cell(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
