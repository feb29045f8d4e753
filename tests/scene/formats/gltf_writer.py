"""A small writer of glTF 2.0 files, for tests: arrays go into one buffer, the JSON is a dictionary to add to."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}

TETRAHEDRON = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])  # seen from outside, counter-clockwise


class Writer:
    """A file in the making: ``json`` and ``blob``."""

    def __init__(self) -> None:
        self.json: dict[str, Any] = {"asset": {"version": "2.0"}, "scenes": [{"nodes": []}], "scene": 0}
        self.blob = bytearray()

    def add(self, key: str, **values: Any) -> int:
        """Append to a list of the JSON."""
        entries = self.json.setdefault(key, [])
        entries.append(values)
        return len(entries) - 1

    def view(self, data: bytes, **more: Any) -> int:
        self.blob += bytes(-len(self.blob) % 4)
        self.blob += data
        begin = len(self.blob) - len(data)
        return self.add("bufferViews", buffer=0, byteOffset=begin, byteLength=len(data), **more)

    def accessor(self, values: np.ndarray, **more: Any) -> int:
        """Packed as it is; ``more`` overrules what the accessor says."""
        values = np.asarray(values)
        values = values[:, None] if values.ndim == 1 else values
        entry = {
            "bufferView": None if "bufferView" in more else self.view(np.ascontiguousarray(values).tobytes()),
            "componentType": COMPONENTS[values.dtype.str[1:]],
            "count": len(values),
            "type": KINDS[values.shape[1]],
        }
        return self.add("accessors", **{**entry, **more})

    def mesh(self, positions: Any = TETRAHEDRON, faces: Any = FACES, *, name: str = "", **attributes: Any) -> int:
        """A mesh of one primitive; attributes are arrays, or indices of accessors."""
        given = {"POSITION": positions, **attributes}
        found = {
            key: value if isinstance(value, int) else self.accessor(_float32(value)) for key, value in given.items()
        }
        primitive: dict[str, Any] = {"attributes": found}
        if faces is not None:
            primitive["indices"] = self.accessor(np.asarray(faces, dtype=np.uint32).ravel())
        return self.add("meshes", primitives=[primitive], **({"name": name} if name else {}))

    def node(self, *, root: bool = True, **values: Any) -> int:
        index = self.add("nodes", **values)
        if root:
            self.json["scenes"][0]["nodes"].append(index)
        return index

    def primitive(self, mesh: int = 0) -> dict[str, Any]:
        """The first primitive of a mesh."""
        return self.json["meshes"][mesh]["primitives"][0]

    def glb(self) -> bytes:
        content = {**self.json, "buffers": [{"byteLength": len(self.blob)}, *self.json.get("buffers", [])]}
        return pack(json.dumps(content).encode(), bytes(self.blob))

    def write(self, folder: Path, name: str = "a.glb") -> Path:
        path = folder / name
        path.write_bytes(self.glb())
        return path


def pack(text: bytes, blob: bytes | None = None) -> bytes:
    """A .glb of JSON and a binary chunk."""
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    if blob is not None:
        blob += bytes(-len(blob) % 4)
        chunks += struct.pack("<I4s", len(blob), b"BIN\0") + blob
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def _float32(values: Any) -> np.ndarray:
    array = np.asarray(values)
    return array.astype(np.float32) if array.dtype.kind == "f" or array.dtype == np.int64 else array
