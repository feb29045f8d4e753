"""JSON that every reader takes: of finite numbers, and of characters that have an encoding."""

from __future__ import annotations

import json
import math
import re
from typing import Any

from slepian_prt.scene.view import View
from slepian_prt.transport.effects import Effect

# Of a name, a path or a note.
LONGEST_TEXT = 1 << 16

# Of a camera's clipping planes, which renderers have in float32.
_FURTHEST = 1e38

# Escapes as a reader meets them one after the other: pairs of surrogates are characters, one alone is none.
_ESCAPE = re.compile(rb"\\(?:u[dD][89abAB]..\\u[dD][c-fC-F]..|(u[dD][89a-fA-F]..)|.)", re.DOTALL)
_UNKNOWN = rb"\ufffd"


def write_json(value: Any, indent: int | None = None) -> str:
    """As `json.dumps`; texts longer than readers take end in an ellipsis, and have U+FFFD for what is no character.

    Raises
    ------
    ValueError
        A number that is not finite.
    """
    return json.dumps(_mended(value), indent=indent, allow_nan=False)


def with_characters(content: bytes) -> bytes:
    """JSON with U+FFFD for half characters, which names of files have where they are not UTF-8."""
    if b"\\ud" not in content and b"\\uD" not in content:
        return content
    return _ESCAPE.sub(lambda found: _UNKNOWN if found[1] else found[0], content)


def finite_only(numbers: dict[str, Any]) -> dict[str, Any]:
    """Those that a file can tell."""
    return {name: number for name, number in numbers.items() if finite_or_none(number) is not None}


def finite_or_none(number: Any) -> Any:
    """A number, or None for what is not finite."""
    return number if number is not None and math.isfinite(number) else None


def effect_as_json(effect: Effect) -> dict[str, Any]:
    """A row of the plan."""
    told = effect.as_dict()
    return told | {name: finite_or_none(told[name]) for name in ("contribution", "confidence")}


def view_as_json(view: View) -> dict[str, Any]:
    """A camera; what it clips at infinity is beyond all that there is."""
    return view.as_dict() | {name: max(-_FURTHEST, min(getattr(view, name), _FURTHEST)) for name in ("near", "far")}


def _mended(value: Any) -> Any:
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, dict):
        return {_mended(key): _mended(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_mended(part) for part in value]
    return value


def _text(text: str) -> str:
    if not text.isascii():
        text = text.encode("utf-16", "surrogatepass").decode("utf-16", "replace")
    return text if len(text) <= LONGEST_TEXT else text[: LONGEST_TEXT - 1] + "…"
