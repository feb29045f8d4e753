"""Relit meshes as binary glTF 2.0 (``.glb``): light as colours of the vertices, textures as they are, drawn unlit."""

from __future__ import annotations

import json
import struct
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.files import atomic_output
from slepian_prt.relighting.files.coloured_mesh import fits_float32
from slepian_prt.relighting.files.painted_mesh import PaintedMesh, Piece
from slepian_prt.scene.formats.parts import Texture
from slepian_prt.scene.reflectance.textures import encoded_image

_UNLIT = "KHR_materials_unlit"

# Numbers of the specification: component types, targets of buffer views, ways of textures to continue.
_COMPONENTS = {"f4": 5126, "u4": 5125}
_KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3"}
_VERTICES, _INDICES = 34962, 34963
_WRAPS = {"repeat": 10497, "clamp": 33071, "mirror": 33648}
_LINEAR, _MIPMAPS = 9729, 9987

# A quarter turn about x, as a quaternion, that takes z up to y up, which glTF has.
_UPRIGHT = [-0.7071067811865476, 0.0, 0.0, 0.7071067811865476]

_LARGEST = 2**32 - 1


def write_glb(path: str | Path, painted: PaintedMesh, up: str = "y") -> None:
    """Write a painted mesh, complete or not at all.

    Each part is a node, each texture of it a primitive: ``COLOR_0`` is linear, and is multiplied by the texture.
    Materials are unlit, so that viewers show just that, and single-sided, as light is.

    Parameters
    ----------
    path : path
    painted : PaintedMesh
    up : "y" or "z"
        What is up in the mesh; it is put upright for viewers.

    Raises
    ------
    UserError
        More than the 4 GiB that the format holds; a folder that cannot be written to.

    References
    ----------
    Khronos Group, glTF 2.0 specification, 3 and 4; KHR_materials_unlit.
    """
    written = _Document(painted)
    by_part: defaultdict[str, list[Piece]] = defaultdict(list)
    for piece in painted.pieces:
        by_part[piece.name].append(piece)
    for name, pieces in by_part.items():
        mesh = written.add("meshes", {"name": name, "primitives": [written.primitive(piece) for piece in pieces]})
        node: dict[str, Any] = {"name": name, "mesh": mesh}
        if written.center.any():
            node["translation"] = written.center.tolist()
        written.add("nodes", node)
    roots = list(range(len(by_part)))
    if up == "z":
        roots = [written.add("nodes", {"name": "upright", "rotation": _UPRIGHT, "children": roots})]
    content = {
        "asset": {"version": "2.0", "generator": "slepian_prt"},
        "extensionsUsed": [_UNLIT],
        "scene": 0,
        "scenes": [{"nodes": roots}],
        **written.lists,
        "buffers": [{"byteLength": len(written.binary)}],
    }
    text = json.dumps(content, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    written.binary.extend(bytes(-len(written.binary) % 4))
    size = 12 + 8 + len(text) + 8 + len(written.binary)
    if size > _LARGEST:
        raise UserError(f"{path}: needs {size / 2**30:.1f} GiB, and .glb holds 4; write .ply or .npz")
    with atomic_output(path) as file:
        file.write(struct.pack("<4sII", b"glTF", 2, size))
        file.write(struct.pack("<I4s", len(text), b"JSON") + text)
        file.write(struct.pack("<I4s", len(written.binary), b"BIN\0"))
        file.write(written.binary)


class _Document:
    """The lists of the JSON and the one buffer, in the making."""

    def __init__(self, painted: PaintedMesh) -> None:
        self.lists: dict[str, list[dict[str, Any]]] = {}
        self.binary = bytearray()
        self._mesh = painted.mesh
        # Coordinates that float32 does not hold stand about the middle of the model, which the nodes move back.
        fits, positions = fits_float32(painted.mesh), painted.mesh.positions
        used = positions[painted.mesh.receivers.active]
        self.center = np.zeros(3) if fits else 0.5 * (used.min(axis=0) + used.max(axis=0))
        self._materials: dict[int, int] = {}

    def add(self, name: str, entry: dict[str, Any]) -> int:
        """Append to a list; its number there."""
        entries = self.lists.setdefault(name, [])
        entries.append(entry)
        return len(entries) - 1

    def primitive(self, piece: Piece) -> dict[str, Any]:
        """A primitive with its accessors and material."""
        normals = self._mesh.normals[piece.vertices].astype(np.float32)
        attributes = {
            "POSITION": self._accessor((self._mesh.positions[piece.vertices] - self.center).astype(np.float32)),
            "NORMAL": self._accessor(normals),
            "COLOR_0": self._accessor(piece.colors.astype(np.float32)),
        }
        if piece.uv is not None:
            attributes["TEXCOORD_0"] = self._accessor(piece.uv)
        indices = self._accessor(piece.faces.astype(np.uint32).reshape(-1, 1), _INDICES)
        return {"attributes": attributes, "indices": indices, "material": self._material(piece.texture)}

    def _accessor(self, values: NDArray, target: int = _VERTICES) -> int:
        entry: dict[str, Any] = {
            "bufferView": self._view(np.ascontiguousarray(values).tobytes(), target),
            "componentType": _COMPONENTS[values.dtype.str[1:]],
            "count": len(values),
            "type": _KINDS[values.shape[1]],
            "min": values.min(axis=0).tolist(),
            "max": values.max(axis=0).tolist(),
        }
        return self.add("accessors", entry)

    def _view(self, content: bytes, target: int | None) -> int:
        self.binary += bytes(-len(self.binary) % 4)
        entry = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(content)}
        self.binary += content
        return self.add("bufferViews", entry if target is None else {**entry, "target": target})

    def _material(self, texture: Texture | None) -> int:
        key = id(texture)
        if key not in self._materials:
            surface: dict[str, Any] = {"metallicFactor": 0.0, "roughnessFactor": 1.0}
            if texture is not None:
                surface["baseColorTexture"] = {"index": self._texture(texture)}
            material = {"pbrMetallicRoughness": surface, "extensions": {_UNLIT: {}}, "doubleSided": False}
            self._materials[key] = self.add("materials", material)
        return self._materials[key]

    def _texture(self, texture: Texture) -> int:
        content, suffix = encoded_image(texture)
        mime = "image/png" if suffix == ".png" else "image/jpeg"
        image = self.add("images", {"mimeType": mime, "bufferView": self._view(content, None)})
        across, along = (_WRAPS[wrap] for wrap in texture.wrap)
        filters = {"magFilter": _LINEAR, "minFilter": _MIPMAPS}
        sampler = self.add("samplers", {"wrapS": across, "wrapT": along, **filters})
        return self.add("textures", {"source": image, "sampler": sampler})
