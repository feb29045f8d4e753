"""glTF files: the container (.glb or .gltf), and the bytes of its buffers, wherever they are."""

from __future__ import annotations

import base64
import binascii
import os
import re
import struct
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import unquote, unquote_to_bytes

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.machine.file_content import is_file, read_content
from slepian_prt.machine.memory import check_memory
from slepian_prt.scene.formats.gltf_json import Entry, parse_json
from slepian_prt.scene.formats.parts import Texture

# Bytes between two looks at how much memory there is, each some 50 µs.
_CHECKED = 1 << 26


@dataclass(frozen=True, eq=False)
class Document:
    """A glTF file.

    Attributes
    ----------
    root : Entry
        Its JSON.
    chunk : bytes or None
        The binary buffer of a .glb.
    tables : dict of lists of Entry
        The lists of ``root``, read when they are needed first.
    buffers, views : dict of arrays of bytes
        Likewise, by index.
    textures : dict of Texture
        Likewise; None where the image cannot be read. One object each, so that its image is decoded once.
    images : dict of bytes or Path
        Likewise, encoded, by the places of their entries.
    taken : Counter
        ``bytes`` of arrays that were made so far, and how many when memory was ``checked`` last.
    """

    root: Entry
    chunk: bytes | None = None
    tables: dict[str, list[Entry]] = field(default_factory=dict)
    buffers: dict[int, NDArray[np.uint8]] = field(default_factory=dict)
    views: dict[int, NDArray[np.uint8]] = field(default_factory=dict)
    textures: dict[int, Texture | None] = field(default_factory=dict)
    images: dict[str, bytes | Path | None] = field(default_factory=dict)
    taken: Counter[str] = field(default_factory=Counter)

    def take(self, size: int) -> None:
        """Raise UserError if so many bytes, and those before, do not fit: a file can repeat all that it has."""
        self.taken["bytes"] += size
        if self.taken["bytes"] - self.taken["checked"] >= _CHECKED:
            self.taken["checked"] = self.taken["bytes"]
            check_memory(self.taken["bytes"], f"{self.path}: its geometry", "export fewer triangles or instances")

    @property
    def path(self) -> Path:
        return self.root.path

    def table(self, key: str) -> list[Entry]:
        """All ``meshes``, ``nodes``, …; empty if there are none."""
        if key not in self.tables:
            self.tables[key] = self.root.entries(key)
        return self.tables[key]

    def find(self, key: str, user: Entry, name: str) -> Entry:
        """The entry of a table whose index stands in ``user`` under ``name``."""
        return self.at(key, user.integer(name), user)

    def at(self, key: str, index: int, user: Entry) -> Entry:
        """Entry ``index`` of a table, which ``user`` names."""
        table = self.table(key)
        if index >= len(table):
            raise user.fault(f"names entry {index} of {key}, of which there are {len(table)}")
        return table[index]


def open_gltf(path: Path) -> Document:
    """Take a file apart into JSON and binary chunk; its content decides which kind it is.

    Raises
    ------
    UserError
        Not a glTF file, cut off, of glTF 1.0, JSON that cannot be read.
    """
    content = read_content(path)
    chunk = None
    if content[:4] == b"glTF":
        content, chunk = _split_chunks(path, content)
    elif path.suffix.lower() == ".glb" and not content.lstrip().startswith(b"{"):
        raise UserError(f"{path}: is not a binary glTF file; export it as .glb")
    root = parse_json(path, content)
    _check_version(root)
    return Document(root, chunk)


def _split_chunks(path: Path, content: bytes) -> tuple[bytes, bytes | None]:
    """JSON and binary chunk of a .glb."""
    if len(content) < 20:
        raise UserError(f"{path}: is cut off after {len(content)} bytes; copy or export it again")
    version, length = struct.unpack_from("<II", content, 4)
    if version != 2:
        raise UserError(f"{path}: is binary glTF {version}, and only glTF 2.0 is read; export it as glTF 2.0")
    if length > len(content):
        raise UserError(f"{path}: is cut off: it has {len(content)} of its {length} bytes; copy or export it again")
    chunks: list[tuple[bytes, bytes]] = []
    at = 12
    while at + 8 <= length:
        size, kind = struct.unpack_from("<I4s", content, at)
        at += 8
        if at + size > length:
            raise UserError(
                f"{path}: its chunk {len(chunks)} of {size} bytes reaches beyond its end at {length}; export it again"
            )
        chunks.append((kind, content[at : at + size]))
        at += size
    if not chunks or chunks[0][0] != b"JSON":
        raise UserError(f"{path}: its first chunk is not JSON; export it again")
    return chunks[0][1], next((data for kind, data in chunks[1:] if kind == b"BIN\0"), None)


def _check_version(root: Entry) -> None:
    asset = root.entry("asset")
    if asset is None:
        raise UserError(f"{root.path}: its JSON has no glTF version (asset.version); export it as glTF 2.0")
    said = asset.values.get("version")
    is_number = type(said) in (int, float) and said in (1, 2)  # as writers of early glTF 1.0 have it
    needed = asset.text("minVersion", "") or (f"{said:.1f}" if is_number else asset.text("version"))
    if not re.fullmatch(r"2\.\d+", needed) or (needed != "2.0" and "minVersion" in asset.values):
        shown = needed if re.fullmatch(r"[\w.]{1,9}", needed) else repr(needed[:9])
        raise UserError(f"{root.path}: is glTF {shown}, and only glTF 2.0 is read; export it as glTF 2.0")


def read_buffer(document: Document, index: int, user: Entry) -> NDArray[np.uint8]:
    """All bytes of a buffer.

    Raises
    ------
    UserError
        It has no data, or too few.
    """
    if index in document.buffers:
        return document.buffers[index]
    entry = document.at("buffers", index, user)
    length = entry.integer("byteLength")
    if "uri" in entry.values:
        source = resolve_uri(entry, entry.text("uri"))
        data = source if isinstance(source, bytes) else _read_file(entry, source, length)
    elif index == 0 and document.chunk is not None:
        data = document.chunk
    else:
        raise entry.fault("has no data: neither a uri nor the binary chunk of a .glb")
    if len(data) < length:
        raise entry.fault(f"has {len(data)} of its {length} bytes")
    document.buffers[index] = np.frombuffer(data, dtype=np.uint8, count=length)
    return document.buffers[index]


def _read_file(entry: Entry, source: Path, length: int) -> bytes:
    """Bytes of a file in the folder of the model or below it.

    Whatever is in it becomes positions, so that a model from elsewhere could bring any file of its user to light.
    """
    there = "put it there or export a .glb"
    if not is_file(source):
        raise UserError(f"{entry.path}: the file {str(source)!r} with its {entry.place} is not there; {there}")
    if not Path(os.path.abspath(source)).is_relative_to(os.path.abspath(entry.path.parent)):
        raise UserError(
            f"{entry.path}: the file {str(source)!r} with its {entry.place} is outside of the model's folder; {there}"
        )
    return read_content(source, length)


def resolve_uri(entry: Entry, uri: str) -> bytes | Path:
    """Data that stand in the URI itself, or the file that it names, which may be missing.

    Raises
    ------
    UserError
        Data that cannot be decoded; an address elsewhere, which is not fetched.
    """
    if uri[:5].lower() == "data:":
        header, comma, payload = uri[5:].partition(",")
        if not comma:
            raise entry.fault("has a data: URI without data")
        if not header.rstrip().lower().endswith(";base64"):
            return unquote_to_bytes(payload)
        packed = re.sub(rb"\s", b"", unquote_to_bytes(payload))
        try:
            return base64.b64decode(packed + b"=" * (-len(packed) % 4), validate=True)
        except (binascii.Error, ValueError):
            raise entry.fault("has a data: URI that is not base64") from None
    # Two slashes begin the name of another computer.
    if re.match(r"[a-zA-Z][a-zA-Z0-9+.-]+:|[/\\]{2}", uri) or re.match(r"[/\\]{2}", unquote(uri)):
        raise UserError(
            f"{entry.path}: its {entry.place} is at {uri[:80]!r}, which is not fetched; download it and export a .glb"
        )
    folder = entry.path.parent
    # Some exporters write names as they are, per cent signs, backslashes and all.
    candidates = [folder / name for name in (unquote(uri), uri, unquote(uri).replace("\\", "/"))]
    return next((candidate for candidate in candidates if is_file(candidate)), candidates[0])
