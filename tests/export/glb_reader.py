"""A reader of .glb by the specification alone, that checks the container as it goes."""

from __future__ import annotations

import io
import json
import struct
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

from tests.numerics import assert_exact

DTYPES = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
ALLOWED = {
    "POSITION": [("VEC3", 5126)],
    "NORMAL": [("VEC3", 5126)],
    "TEXCOORD": [("VEC2", 5126)],
    "COLOR": [("VEC3", 5126), ("VEC4", 5123)],
}


class Glb(NamedTuple):
    root: dict[str, Any]
    binary: bytes

    def view(self, number: int) -> bytes:
        view = self.root["bufferViews"][number]
        return self.binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]

    def accessor(self, number: int) -> np.ndarray:
        entry = self.root["accessors"][number]
        values = np.frombuffer(self.view(entry["bufferView"]), DTYPES[entry["componentType"]])
        values = values.reshape(-1, WIDTHS[entry["type"]])
        assert len(values) == entry["count"]
        if entry.get("normalized"):
            return values / np.iinfo(values.dtype).max
        return values

    def array(self, told: dict[str, Any]) -> np.ndarray:
        """As `extras` tell of it."""
        values = np.frombuffer(self.view(told["bufferView"]), np.dtype(told["dtype"]).newbyteorder("<"))
        return values.reshape(told["shape"])

    def image(self, texture: int) -> np.ndarray:
        source = self.root["textures"][texture]["source"]
        with Image.open(io.BytesIO(self.view(self.root["images"][source]["bufferView"]))) as image:
            assert image.mode == "RGB"
            assert not {"gamma", "icc_profile", "srgb"} & set(image.info)
            return np.asarray(image)

    def primitives(self) -> list[dict[str, Any]]:
        return [primitive for mesh in self.root["meshes"] for primitive in mesh["primitives"]]


def read_glb(path: Path) -> Glb:
    """Read a file; every requirement of the container and of its accessors that can be checked is."""
    content = path.read_bytes()
    assert struct.unpack_from("<4sII", content) == (b"glTF", 2, len(content))
    size, kind = struct.unpack_from("<I4s", content, 12)
    assert (kind, size % 4) == (b"JSON", 0)
    root = json.loads(content[20 : 20 + size])
    length, kind = struct.unpack_from("<I4s", content, 20 + size)
    assert (kind, length % 4, 28 + size + length) == (b"BIN\0", 0, len(content))
    glb = Glb(root, content[28 + size :])
    assert 0 <= length - root["buffers"][0]["byteLength"] <= 3
    end = 0
    for view in root["bufferViews"]:
        assert view["byteOffset"] % 4 == 0
        assert view["byteOffset"] >= end
        end = view["byteOffset"] + view["byteLength"]
    assert end <= root["buffers"][0]["byteLength"]
    for number, entry in enumerate(root["accessors"]):
        raw = np.frombuffer(glb.view(entry["bufferView"]), DTYPES[entry["componentType"]])
        raw = raw.reshape(-1, WIDTHS[entry["type"]])
        assert raw.dtype.itemsize * raw.shape[1] % 4 == 0
        assert_exact(entry["min"], raw.min(axis=0), "bounds are of the very numbers")
        assert_exact(entry["max"], raw.max(axis=0), "bounds are of the very numbers")
        assert np.isfinite(glb.accessor(number)).all()
    for primitive in glb.primitives():
        _check_primitive(glb, primitive)
    reached = {child for node in root["nodes"] for child in node.get("children", ())} | set(root["scenes"][0]["nodes"])
    assert reached == set(range(len(root["nodes"])))
    return glb


def _check_primitive(glb: Glb, primitive: dict[str, Any]) -> None:
    attributes = primitive["attributes"]
    assert {len(glb.accessor(number)) for number in attributes.values()} == {len(glb.accessor(attributes["POSITION"]))}
    assert glb.accessor(primitive["indices"]).max() < len(glb.accessor(attributes["POSITION"]))
    assert primitive["material"] < len(glb.root["materials"])
    for name, number in attributes.items():
        entry = glb.root["accessors"][number]
        assert glb.root["bufferViews"][entry["bufferView"]]["target"] == 34962
        if not name.startswith("_"):
            semantic = name.split("_")[0]
            assert (entry["type"], entry["componentType"]) in ALLOWED[semantic]
    for semantic in ("TEXCOORD", "COLOR"):
        sets = sorted(int(name.split("_")[1]) for name in attributes if name.startswith(semantic))
        assert sets == list(range(len(sets)))
