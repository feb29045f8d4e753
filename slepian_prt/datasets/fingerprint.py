"""What the outputs of a scan depend on, as one digest, without reading it as a scene."""

from __future__ import annotations

import hashlib
import json
import os
import re
from dataclasses import fields, is_dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from slepian_prt.scene.formats.files import decode, find_beside

# Where files name others. Of materials (.mtl) each line may, of a scene (.xml) each value.
_LIBRARIES = re.compile(rb"^[ \t]*mtllib[ \t]+(.+?)[ \t\r]*$", re.MULTILINE)
_URIS = re.compile(rb'"uri"\s*:\s*"([^"]+)"')
_VALUES = re.compile(rb'"([^"<>\n]+)"')
_NAMES = {".obj": _LIBRARIES, ".glb": _URIS, ".gltf": _URIS, ".xml": _VALUES}


def settings_digest(settings: Any) -> str:
    """Of the package's version and settings: a dataclass of plain values, arrays and other dataclasses."""
    text = json.dumps([version("slepian_prt"), _plain(settings)], sort_keys=True)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def fingerprint(source: str | Path, settings: str) -> str:
    """Of the digest of settings, and the content of a file and of all files that it names."""
    digest = hashlib.blake2b(settings.encode(), digest_size=16)
    for path in files_behind(Path(source)):
        digest.update(b"\0".join([b"", os.fsencode(path.name), digest_of(path).encode()]))
    return digest.hexdigest()


def digest_of(path: Path) -> str:
    """Of the content of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=16)).hexdigest()


def files_behind(path: Path) -> list[Path]:
    """A file, and those that it names, that these name, …, as far as they are there."""
    found: dict[Path, None] = {}
    waiting = [path]
    while waiting:
        file = waiting.pop(0)
        if file.is_file() and file not in found:
            found[file] = None
            waiting += [other for name in _names_in(file) if (other := find_beside(file, name)).is_file()]
    return list(found)


def _names_in(file: Path) -> list[str]:
    """Names of files in a file, and other words that are none."""
    kind = file.suffix.lower()
    if kind == ".mtl":
        lines = [line.split() for line in decode(file.read_bytes()).splitlines()]
        named = [words for words in lines if len(words) > 1 and words[0].lower().startswith(("map_", "bump", "norm"))]
        return [name for words in named for name in (" ".join(words[1:]), words[-1])]
    if kind not in _NAMES:
        return []
    names = [decode(name) for name in _NAMES[kind].findall(file.read_bytes())]
    if kind == ".obj":
        names += [word for name in names for word in name.split()]
    return list(dict.fromkeys(name for name in names if not name.startswith("data:") and len(name) < 1000))


def _plain(value: Any) -> Any:
    """As JSON has it; arrays by a digest of their content."""
    if is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, np.ndarray):
        return [value.shape, str(value.dtype), hashlib.blake2b(value.tobytes()).hexdigest()]
    if isinstance(value, dict):
        return {str(key): _plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    return value if value is None or isinstance(value, bool | int | float | str) else repr(value)
