"""Paragraphs and tables of pages that scripts write."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence


def prose(text: str) -> list[str]:
    """A paragraph in lines of the docs' length, and an empty line."""
    return [*textwrap.wrap(" ".join(text.split()), 118, break_long_words=False, break_on_hyphens=False), ""]


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """A table of Markdown, and an empty line."""
    return [f"| {' | '.join(head)} |", "| --- " * len(head) + "|", *(f"| {' | '.join(row)} |" for row in rows), ""]


def listed(values: Iterable[float]) -> str:
    return "{" + ", ".join(f"{x:g}" for x in values) + "}"
