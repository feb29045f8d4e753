"""Text files in any encoding, the files that they name, and names in any encoding."""

from __future__ import annotations

import codecs
from pathlib import Path

from slepian_prt.machine.file_content import is_file

_UTF16 = {codecs.BOM_UTF16_LE: "utf-16-le", codecs.BOM_UTF16_BE: "utf-16-be"}


def find_beside(path: Path, name: str) -> Path:
    """The file that a mesh file names, which may be missing.

    The name may have the separators of Windows, be one of the computer where the mesh was exported, or have letters
    of another case: then the file of that name in the folder of the mesh is meant. Shares of other computers are not
    asked: to look whether a file is there would tell them who the user is.
    """
    name = name.replace("\\", "/")
    last = name.rsplit("/", 1)[-1]
    wanted = path.parent / (last if name.startswith("//") else name)
    if is_file(wanted):
        return wanted
    last = last.lower()
    try:
        found = sorted(other for other in path.parent.iterdir() if other.name.lower() == last and is_file(other))
    except OSError:  # a folder whose files may be read and not listed
        return wanted
    return found[0] if found else wanted


def decode(raw: bytes) -> str:
    """UTF-8, or Latin-1 where it is none."""
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError:
        return raw.decode("latin-1")


def to_utf8(raw: bytes) -> bytes:
    """Text in UTF-16, as Windows redirects it into files, as UTF-8; anything else as it is."""
    encoding = _UTF16.get(raw[:2])
    return raw if encoding is None else raw[2:].decode(encoding, errors="replace").encode()
