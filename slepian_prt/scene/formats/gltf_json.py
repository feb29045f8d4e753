"""The JSON of a glTF file: every value is asked for with its type, and messages know its place."""

from __future__ import annotations

import json
import math
import reprlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from slepian_prt.errors import UserError

# JSON numbers are exact integers up to here.
_LARGEST = 2**53

# Larger numbers are none that can be calculated with. Python would compute the power at each use.
_HUGE = 10**300

_KINDS = {
    "accessors": "accessor",
    "buffers": "buffer",
    "bufferViews": "buffer view",
    "images": "image",
    "materials": "material",
    "meshes": "mesh",
    "nodes": "node",
    "samplers": "sampler",
    "scenes": "scene",
    "skins": "skin",
    "textures": "texture",
}


def parse_json(path: Path, content: bytes) -> Entry:
    """The object that is the whole of a glTF file; zeros behind it, with which some exporters pad it, do not matter.

    Raises
    ------
    UserError
        Not UTF-8, not JSON, not an object.
    """
    try:
        values = json.loads(content.rstrip(b"\0").decode("utf-8-sig"), parse_constant=_refuse_constant)
    except UnicodeDecodeError:
        reason = "it is not UTF-8"
    except RecursionError:
        reason = "it is nested too deeply"
    except ValueError as error:
        reason = str(error).partition(";")[0]  # Python's advice on very long numbers
    else:
        if isinstance(values, dict):
            return Entry(path, "", values)
        reason = f"it is {reprlib.repr(values)}, not an object"
    raise UserError(f"{path}: its glTF JSON cannot be read ({reason}); export it again")


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is no number in JSON")


@dataclass(frozen=True, eq=False)
class Entry:
    """An object of the JSON.

    Attributes
    ----------
    path : Path
        Of the file.
    place : str
        What it is, for messages: ``accessor 3``; empty for the whole file.
    values : dict
    """

    path: Path
    place: str
    values: dict[str, Any]

    def fault(self, reason: str) -> UserError:
        """What to raise: ``reason`` continues a sentence that begins with the place."""
        words = " ".join(f"{self.place} {reason}".split())
        return UserError(f"{self.path}: its glTF is malformed ({words}); export it again")

    def integer(self, key: str, default: int | None = None) -> int:
        """A whole number that is not negative; required if there is no default."""
        value = self._get(key, default)
        if isinstance(value, float) and value.is_integer():
            value = int(value)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= _LARGEST:
            raise self._mistyped(key, value, "a whole number")
        return value

    def number(self, key: str, default: float | None = None) -> float:
        """A finite number; required if there is no default."""
        value = self._get(key, default)
        if not _is_number(value):
            raise self._mistyped(key, value, "a number")
        return float(value)

    def numbers(self, key: str, default: tuple[float, ...], size: int | None = None) -> tuple[float, ...]:
        """A list of finite numbers, as many as those by default unless ``size`` says otherwise (0: any)."""
        if key not in self.values and size is None:
            return default
        value = self._get(key, list(default))
        size = len(default) if size is None else size
        if not isinstance(value, list) or not all(map(_is_number, value)) or (size and len(value) != size):
            raise self._mistyped(key, value, f"a list of {size or ''} numbers")
        return tuple(map(float, value))

    def indices(self, key: str) -> list[int]:
        """A list of whole numbers that are not negative; empty if it is not there."""
        if key not in self.values:
            return []
        value = self._get(key, [])
        if not isinstance(value, list) or not all(isinstance(i, int) and type(i) is not bool and i >= 0 for i in value):
            raise self._mistyped(key, value, "a list of indices")
        return value

    def flag(self, key: str, default: bool = False) -> bool:
        """True or false."""
        value = self._get(key, default)
        if not isinstance(value, bool):
            raise self._mistyped(key, value, "true or false")
        return value

    def text(self, key: str, default: str | None = None) -> str:
        """A string, without half characters, which no file can hold; required if there is no default."""
        value = self._get(key, default)
        if not isinstance(value, str):
            raise self._mistyped(key, value, "a string")
        return value.encode("utf-8", "replace").decode("utf-8")

    def texts(self, key: str) -> list[str]:
        """A list of strings; empty if it is not there."""
        value = self._get(key, [])
        if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
            raise self._mistyped(key, value, "a list of names")
        return value

    def entry(self, key: str) -> Entry | None:
        """An object inside this one; None if it is not there."""
        value = self.values.get(key)
        if value is None:
            return None
        if not isinstance(value, dict):
            raise self._mistyped(key, value, "an object")
        return Entry(self.path, f"{self.place}, {key}" if self.place else key, value)

    def entries(self, key: str) -> list[Entry]:
        """A list of objects; empty if it is not there."""
        value = self._get(key, [])
        if not isinstance(value, list):
            raise self._mistyped(key, value, "a list")
        kind = _KINDS.get(key, key.removesuffix("s"))
        places = [f"{self.place}, {kind} {i}" if self.place else f"{kind} {i}" for i in range(len(value))]
        for place, item in zip(places, value, strict=True):
            if not isinstance(item, dict):
                raise Entry(self.path, place, {}).fault(f"is {reprlib.repr(item)}, not an object")
        return [Entry(self.path, place, item) for place, item in zip(places, value, strict=True)]

    def extension(self, name: str) -> Entry | None:
        """The object of an extension; None if this entry has none of that name."""
        extensions = self.entry("extensions")
        return extensions.entry(name) if extensions else None

    def _get(self, key: str, default: object) -> Any:
        value = self.values.get(key, default)
        if value is None:
            raise self.fault(f"has no {key}")
        return value

    def _mistyped(self, key: str, value: object, wanted: str) -> UserError:
        return self.fault(f"has {key} {reprlib.repr(value)}, not {wanted}")


def _is_number(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return False
    return -_HUGE < value < _HUGE and math.isfinite(value)
