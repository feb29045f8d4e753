"""A binary glTF 2.0 file (``.glb``) in the making: the lists of its JSON and its one buffer."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.errors import UserError
from slepian_prt.files import atomic_output
from slepian_prt.scene.formats.parts import Texture
from slepian_prt.scene.reflectance.textures import encoded_image

UNLIT = "KHR_materials_unlit"

# Numbers of the specification: component types, targets of buffer views, ways of textures to continue.
_COMPONENTS = {"f4": 5126, "u4": 5125, "u2": 5123, "u1": 5121}
_KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
_VERTICES, _INDICES = 34962, 34963
_WRAPS = {"repeat": 10497, "clamp": 33071, "mirror": 33648}
NEAREST, LINEAR, _MIPMAPS = 9728, 9729, 9987

# A quarter turn about x, as a quaternion, that takes z up to y up, which glTF has.
_UPRIGHT = [-0.7071067811865476, 0.0, 0.0, 0.7071067811865476]

_LARGEST = 2**32 - 1


class GltfDocument:
    """The lists of the JSON and the buffer that they speak of.

    Attributes
    ----------
    lists : dict of str to list of dict
        ``accessors``, ``meshes``, …
    binary : bytearray

    References
    ----------
    Khronos Group, glTF 2.0 specification, 3 and 4.
    """

    def __init__(self) -> None:
        self.lists: dict[str, list[dict[str, Any]]] = {}
        self.binary = bytearray()
        self._textures: dict[int, tuple[Texture, int]] = {}

    def add(self, name: str, entry: dict[str, Any]) -> int:
        """Append to a list; its number there."""
        entries = self.lists.setdefault(name, [])
        entries.append(entry)
        return len(entries) - 1

    def add_view(self, content: bytes, target: int | None = None) -> int:
        """Bytes, from a multiple of four on."""
        self.binary += bytes(-len(self.binary) % 4)
        entry = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(content)}
        self.binary += content
        return self.add("bufferViews", entry if target is None else {**entry, "target": target})

    def add_attribute(self, values: NDArray, **more: Any) -> int:
        """An accessor of (n, k) float32, uint16 or uint8 numbers, k from 1 to 4; ``more`` of its properties."""
        return self._add_accessor(values, _VERTICES, more)

    def add_indices(self, faces: NDArray) -> int:
        """An accessor of the corners of triangles (F, 3)."""
        return self._add_accessor(faces.astype(np.uint32).reshape(-1, 1), _INDICES, {})

    def add_image(self, content: bytes, mime: str, wrap: tuple[str, str], filters: tuple[int, int]) -> int:
        """A texture of an encoded image, ``wrap`` along u and v, with filters for magnification and minification."""
        image = self.add("images", {"mimeType": mime, "bufferView": self.add_view(content)})
        across, along = (_WRAPS[way] for way in wrap)
        magnified, minified = filters
        sampler = {"wrapS": across, "wrapT": along, "magFilter": magnified, "minFilter": minified}
        return self.add("textures", {"source": image, "sampler": self.add("samplers", sampler)})

    def add_texture(self, texture: Texture) -> int:
        """A texture of a surface; each once."""
        if id(texture) not in self._textures:
            content, suffix = encoded_image(texture)
            mime = "image/png" if suffix == ".png" else "image/jpeg"
            # With the texture, so that no other one gets its address.
            self._textures[id(texture)] = texture, self.add_image(content, mime, texture.wrap, (LINEAR, _MIPMAPS))
        return self._textures[id(texture)][1]

    def add_material(self, texture: Texture | None, color: ArrayLike = (1.0, 1.0, 1.0), **more: Any) -> int:
        """A material that shows a texture times a linear colour and ``COLOR_0``, and no light of the viewer; each once.

        It is single-sided, as light is. ``more`` of its properties.
        """
        surface: dict[str, Any] = {"metallicFactor": 0.0, "roughnessFactor": 1.0}
        factor = np.asarray(color, dtype=np.float64)
        if np.any(factor != 1.0):
            surface["baseColorFactor"] = [*factor.tolist(), 1.0]
        if texture is not None:
            surface["baseColorTexture"] = {"index": self.add_texture(texture)}
        material = {"pbrMetallicRoughness": surface, "extensions": {UNLIT: {}}, "doubleSided": False, **more}
        known = self.lists.get("materials", [])
        return known.index(material) if material in known else self.add("materials", material)

    def write(
        self,
        path: str | Path,
        roots: list[int],
        up: str = "y",
        more: Mapping[str, Any] | None = None,
        instead: str = "write .ply or .npz",
    ) -> None:
        """Write the file, complete or not at all.

        Parameters
        ----------
        path : path
        roots : list of int
            Nodes of the scene.
        up : "y" or "z"
            What is up in them; they are put upright for viewers.
        more : mapping, optional
            Other properties of the root: ``extras``, ….
        instead : str
            What to do where it is too large.

        Raises
        ------
        UserError
            More than the 4 GiB that the format holds; a folder that cannot be written to.
        """
        if up == "z":
            roots = [self.add("nodes", {"name": "upright", "rotation": _UPRIGHT, "children": roots})]
        content = {
            "asset": {"version": "2.0", "generator": "slepian_prt"},
            "extensionsUsed": [UNLIT],
            "scene": 0,
            "scenes": [{"nodes": roots}],
            **self.lists,
            "buffers": [{"byteLength": len(self.binary)}],
            **(more or {}),
        }
        text = json.dumps(content, separators=(",", ":"), allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        self.binary.extend(bytes(-len(self.binary) % 4))
        size = 12 + 8 + len(text) + 8 + len(self.binary)
        if size > _LARGEST:
            raise UserError(f"{path}: needs {size / 2**30:.1f} GiB, and .glb holds 4; {instead}")
        with atomic_output(path) as file:
            file.write(struct.pack("<4sII", b"glTF", 2, size))
            file.write(struct.pack("<I4s", len(text), b"JSON") + text)
            file.write(struct.pack("<I4s", len(self.binary), b"BIN\0"))
            file.write(self.binary)

    def _add_accessor(self, values: NDArray, target: int, more: dict[str, Any]) -> int:
        entry: dict[str, Any] = {
            "bufferView": self.add_view(np.ascontiguousarray(values).tobytes(), target),
            "componentType": _COMPONENTS[values.dtype.str[1:]],
            "count": len(values),
            "type": _KINDS[values.shape[1]],
            "min": values.min(axis=0).tolist(),
            "max": values.max(axis=0).tolist(),
            **more,
        }
        return self.add("accessors", entry)
