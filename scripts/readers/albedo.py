"""The mean albedo of a glTF file, from its bytes by other code than ours: points at random, textures in float64.

Only what most files have: triangles, uncompressed, without skins; anything else is told apart and left alone.
"""

from __future__ import annotations

import base64
import io
import json
import struct
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

POINTS = 200_000

_TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_SIZES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_WRAPS = {10497: "repeat", 33071: "clamp", 33648: "mirror"}


class _File:
    def __init__(self, path: Path) -> None:
        data = path.read_bytes()
        self.folder, self.chunk = path.parent, b""
        if data[:4] == b"glTF":
            size = struct.unpack_from("<I", data, 12)[0]
            self.chunk, data = data[28 + size :], data[20 : 20 + size]
        self.json: dict[str, Any] = json.loads(data)
        self.images: dict[tuple[int, bool], NDArray[np.float64]] = {}

    def bytes_at(self, uri: str) -> bytes:
        if uri.startswith("data:"):
            return base64.b64decode(uri.split(",", 1)[1])
        return (self.folder / unquote(uri)).read_bytes()

    def view(self, index: int) -> bytes:
        view = self.json["bufferViews"][index]
        buffer = self.json["buffers"][view["buffer"]]
        data = self.bytes_at(buffer["uri"]) if "uri" in buffer else self.chunk
        begin = view.get("byteOffset", 0)
        return data[begin : begin + view["byteLength"]]

    def numbers(self, index: int) -> NDArray[np.float64]:
        accessor = self.json["accessors"][index]
        dtype, size = np.dtype(_TYPES[accessor["componentType"]]), _SIZES[accessor["type"]]
        view = self.json["bufferViews"][accessor["bufferView"]]
        stride = view.get("byteStride", dtype.itemsize * size)
        shape, strides = (accessor["count"], size), (stride, dtype.itemsize)
        raw = np.ndarray(shape, dtype, self.view(accessor["bufferView"]), accessor.get("byteOffset", 0), strides)
        whole = dtype.kind != "f" and accessor.get("normalized", False)
        return raw.astype(np.float64) / (np.iinfo(dtype).max if whole else 1.0)

    def image(self, index: int, is_srgb: bool) -> NDArray[np.float64]:
        """(H, W, 3) linear."""
        from PIL import Image

        if (index, is_srgb) not in self.images:
            image = self.json["images"][index]
            data = self.bytes_at(image["uri"]) if "uri" in image else self.view(image["bufferView"])
            codes = np.asarray(Image.open(io.BytesIO(data)).convert("RGBA"))[..., :3] / 255.0
            linear = np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)
            self.images[index, is_srgb] = linear if is_srgb else codes
        return self.images[index, is_srgb]


def mean_albedo(path: Path) -> NDArray[np.float64] | None:
    """(3,) mean over the surface of colour times what is no metal; None for a file without textures, or not simple."""
    file = _File(path)
    unread = {"KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression"}
    unread |= {"KHR_mesh_quantization", "EXT_mesh_gpu_instancing", "KHR_materials_pbrSpecularGlossiness"}
    if unread & set(file.json.get("extensionsUsed", ())) or "skins" in file.json:
        return None
    if not any("baseColorTexture" in m.get("pbrMetallicRoughness", {}) for m in file.json.get("materials", ())):
        return None
    rng = np.random.default_rng(0)
    pieces = list(_place(file))
    if not pieces or any(p.get("mode", 4) != 4 or "targets" in p for p, _ in pieces):
        return None
    meshes = [_triangles(file, primitive, matrix) for primitive, matrix in pieces]
    total = sum(float(areas.sum()) for _, areas in meshes)
    mean = np.zeros(3)
    for (primitive, _), (corners, areas) in zip(pieces, meshes, strict=True):
        share = float(areas.sum()) / total
        if share > 0.0:
            points = max(1000, int(POINTS * share))
            mean += share * _mean_of(file, primitive, corners, areas, points, rng)
    return mean


def _place(file: _File) -> Any:
    """Primitives with the matrices of their nodes."""
    nodes = file.json.get("nodes", [])
    scene = file.json["scenes"][file.json.get("scene", 0)]
    waiting = [(index, np.eye(4)) for index in scene.get("nodes", ())]
    while waiting:
        index, above = waiting.pop()
        node = nodes[index]
        if "matrix" in node:
            own = np.reshape(node["matrix"], (4, 4)).T
        else:
            from scipy.spatial.transform import Rotation

            own = np.eye(4)
            own[:3, :3] = Rotation.from_quat(node.get("rotation", (0, 0, 0, 1))).as_matrix()
            own[:3, :3] *= np.asarray(node.get("scale", (1, 1, 1)), dtype=float)
            own[:3, 3] = node.get("translation", (0, 0, 0))
        waiting += [(child, above @ own) for child in node.get("children", ())]
        if "mesh" in node:
            for primitive in file.json["meshes"][node["mesh"]]["primitives"]:
                yield primitive, above @ own


def _triangles(file: _File, primitive: dict[str, Any], matrix: NDArray) -> tuple[NDArray[np.int64], NDArray]:
    """Vertices of the triangles (T, 3), and their areas."""
    positions = file.numbers(primitive["attributes"]["POSITION"]) @ matrix[:3, :3].T
    if "indices" in primitive:
        corners = file.numbers(primitive["indices"])[:, 0].astype(np.int64)
    else:
        corners = np.arange(len(positions))
    corners = corners.reshape(-1, 3)
    a, b, c = (positions[corners[:, k]] for k in range(3))
    return corners, 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def _mean_of(
    file: _File, primitive: dict[str, Any], corners: NDArray, areas: NDArray, points: int, rng: np.random.Generator
) -> NDArray:
    chosen = corners[rng.choice(len(corners), points, p=areas / areas.sum())]
    u, v = rng.random((2, points))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    weights = np.stack([1 - u - v, u, v], axis=1)

    def interpolate(name: str) -> NDArray:
        return np.einsum("pk,pkc->pc", weights, file.numbers(primitive["attributes"][name])[chosen])

    material = file.json["materials"][primitive["material"]] if "material" in primitive else {}
    rough = material.get("pbrMetallicRoughness")
    value = np.ones((points, 3))
    if rough is not None:
        value = value * rough.get("baseColorFactor", [1.0] * 4)[:3]
        if "baseColorTexture" in rough:
            value = value * _look_up(file, rough["baseColorTexture"], interpolate, True)
        metallic = np.full(points, rough.get("metallicFactor", 1.0))
        if "metallicRoughnessTexture" in rough:
            metallic = metallic * _look_up(file, rough["metallicRoughnessTexture"], interpolate, False)[:, 2]
        if "KHR_materials_unlit" not in material.get("extensions", {}):
            value = value * (1 - metallic)[:, None]
    if "COLOR_0" in primitive["attributes"]:
        value = value * interpolate("COLOR_0")[:, :3]
    return value.mean(axis=0)


def _look_up(file: _File, info: dict[str, Any], interpolate: Any, is_srgb: bool) -> NDArray:
    """(P, 3) a texture at the points, bilinear."""
    transform = info.get("extensions", {}).get("KHR_texture_transform", {})
    uv = interpolate(f"TEXCOORD_{transform.get('texCoord', info.get('texCoord', 0))}")
    uv = uv * transform.get("scale", (1, 1))
    angle = transform.get("rotation", 0.0)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    uv = uv @ turn.T + transform.get("offset", (0, 0))
    texture = file.json["textures"][info["index"]]
    image = file.image(texture["source"], is_srgb)
    sampler = file.json["samplers"][texture["sampler"]] if "sampler" in texture else {}
    place = uv * [image.shape[1], image.shape[0]] - 0.5
    low = np.floor(place).astype(np.int64)
    part = place - low
    found = np.zeros((len(uv), 3))
    for right in (0, 1):
        for down in (0, 1):
            column = _wrap(low[:, 0] + right, image.shape[1], _WRAPS[sampler.get("wrapS", 10497)])
            row = _wrap(low[:, 1] + down, image.shape[0], _WRAPS[sampler.get("wrapT", 10497)])
            weight = np.abs(1 - right - part[:, 0]) * np.abs(1 - down - part[:, 1])
            found += weight[:, None] * image[row, column]
    return found


def _wrap(index: NDArray, size: int, mode: str) -> NDArray:
    if mode == "clamp":
        return np.clip(index, 0, size - 1)
    if mode == "repeat":
        return index % size
    return np.abs((index + size) % (2 * size) - size + 0.5).astype(np.int64)
