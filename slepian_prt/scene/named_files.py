"""Files that a model or scene names, without reading it as one: what its results depend on, and must not replace."""

from __future__ import annotations

import html
import os
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from slepian_prt.errors import UserError
from slepian_prt.files import check_other, check_writable
from slepian_prt.scene.formats.files import decode, find_beside

# Where files name others. Of materials (.mtl) each line may, of a scene (.xml) each value.
_LIBRARIES = re.compile(rb"^[ \t]*mtllib[ \t]+(.+?)[ \t\r]*$", re.MULTILINE)
_URIS = re.compile(rb'"uri"\s*:\s*"([^"]+)"')
_VALUES = re.compile(rb"""["']([^"'<>\n]+)["']""")
_TEXTURES = re.compile(rb"^comment[ \t]+TextureFile[ \t]+(.+?)[ \t\r]*$", re.MULTILINE | re.IGNORECASE)
_NAMES = {".obj": _LIBRARIES, ".glb": _URIS, ".gltf": _URIS, ".xml": _VALUES, ".ply": _TEXTURES}

# Longer values are no names.
_LONGEST = 1000

# Of a .ply file only this much may name something: its header.
_HEADER = 1 << 16


def files_behind(path: Path) -> list[Path]:
    """A file, and those that it names, that these name, …, as far as they are there."""
    found: dict[Path, None] = {}
    waiting = [path]
    while waiting:
        file = waiting.pop(0)
        if file.is_file() and file not in found:
            found[file] = None
            beside = (path, file) if file.suffix.lower() == ".xml" else (file,)  # Mitsuba: beside the outermost
            waiting += [
                other for name in _names_in(file) for base in beside if (other := find_beside(base, name)).is_file()
            ]
    return list(found)


def check_output_file(output: str | Path, *sources: str | Path, parameters: Mapping[str, Any] | None = None) -> None:
    """Raise UserError if an output cannot be written, or would replace a source or a file that one names.

    Links and other names of the same file are that file. ``parameters`` of the first source may name files, too.
    """
    check_writable(output, *sources)
    if Path(output).exists():  # else there is nothing to look for, in files that may be large
        check_other(output, all_behind(sources, parameters))


def check_output_files(
    folder: str | Path,
    is_written: Callable[[str], bool],
    *sources: str | Path,
    parameters: Mapping[str, Any] | None = None,
) -> None:
    """Raise UserError if a file that is written into a folder would replace a source or a file that one names.

    Parameters
    ----------
    folder : path
    is_written : of the name of a file
    sources, parameters : as of `check_output_file`
    """
    folder = Path(folder)
    there = [name for name in os.listdir(folder) if is_written(name)] if folder.is_dir() else []
    if not there:
        return
    inputs = {_identity(path): path for path in all_behind(sources, parameters)}
    for name in there:
        source = inputs.get(_identity(folder / name))
        if source is not None:
            raise UserError(f"{source}: is an input, and a file of the report has this name; choose another folder")


def all_behind(sources: Sequence[str | Path], parameters: Mapping[str, Any] | None) -> list[Path]:
    """The sources, the files that parameters of the first name, and all that these name, as far as they are there."""
    named = [find_beside(Path(sources[0]), str(value)) for value in (parameters or {}).values()]
    return [path for source in dict.fromkeys([*sources, *named]) for path in files_behind(Path(source))]


def _identity(path: Path) -> tuple[int, int] | None:
    """Of a file under whatever name; of none that is not there."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_dev, status.st_ino


def _names_in(file: Path) -> list[str]:
    """Names of files in a file, and other words that are none."""
    kind = file.suffix.lower()
    if kind == ".mtl":
        lines = [line.split() for line in decode(file.read_bytes()).splitlines()]
        named = [words for words in lines if len(words) > 1 and words[0].lower().startswith(("map_", "bump", "norm"))]
        return [name for words in named for name in (" ".join(words[1:]), words[-1])]
    if kind not in _NAMES:
        return []
    with file.open("rb") as content:
        raw = content.read(_HEADER if kind == ".ply" else -1)
    names = [decode(name) for name in _NAMES[kind].findall(raw)]
    if kind == ".obj":
        names += [word for name in names for word in name.split()]
    elif kind == ".xml":
        names = [html.unescape(name) for name in names]
    elif kind in (".glb", ".gltf"):
        names += [unquote(name) for name in names]
    return list(dict.fromkeys(name for name in names if not name.startswith("data:") and len(name) < _LONGEST))
