"""What engines have a place for, on the mesh: properties of ``.ply``, attributes and colours of ``.glb``."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.export.ambient import Ambient
from slepian_prt.export.description import NAME
from slepian_prt.export.kinds import BENT_NORMALS, FIRST_DEGREE, OCCLUSION, SKY_VISIBILITY
from slepian_prt.export.transfer_glb import add_surface
from slepian_prt.relighting.drawing.pictures import encode_srgb
from slepian_prt.relighting.files.coloured_mesh import as_in_source, write_ply
from slepian_prt.relighting.files.glb_file import add_node, mesh_center
from slepian_prt.relighting.files.gltf_document import GltfDocument
from slepian_prt.relighting.files.surfaces import Surface

# What the numbers are called.
_NAMES = {
    OCCLUSION: ("occlusion",),
    BENT_NORMALS: ("bent_x", "bent_y", "bent_z"),
    SKY_VISIBILITY: ("sky_dc", "sky_x", "sky_y", "sky_z"),
    FIRST_DEGREE: ("l1_dc", "l1_x", "l1_y", "l1_z"),
}
_COLOURS = ("red", "green", "blue")


def write_ambient_ply(path: str | Path, packed: CompressedTransfer, ambient: Ambient, what: str) -> None:
    """Write the mesh with the numbers as properties of its vertices, and ambient occlusion as sRGB colours.

    Vertices are those of the source, where the mesh knows which they are. With three channels the names of numbers end
    in ``_red``, ``_green`` and ``_blue``.
    """
    channels = ambient.values.shape[1]
    names = [name if channels == 1 else f"{name}_{c}" for c in _COLOURS[:channels] for name in _NAMES[what]]
    columns = np.concatenate([ambient.values.reshape(len(ambient.values), -1), _colours(ambient)], axis=1)
    own, columns = as_in_source(packed.mesh, columns)
    numbers, colours = columns[:, : len(names)], columns[:, len(names) :]
    if what == BENT_NORMALS:  # those of vertices that were split are a mean
        numbers = numbers / np.maximum(np.linalg.norm(numbers, axis=1, keepdims=True), 1e-30)
    properties = dict(zip(names, numbers.T, strict=True))
    write_ply(path, own, np.asarray(encode_srgb(colours) * 255.0 + 0.5).astype(np.uint8), None, properties)


def write_ambient_glb(
    path: str | Path,
    packed: CompressedTransfer,
    ambient: Ambient,
    what: str,
    surfaces: Sequence[Surface],
    up: str = "y",
) -> None:
    """Write the mesh with ambient occlusion as ``COLOR_0``, linear, and other numbers as floats, ``_CUSTOM0`` and on.

    A vector that has room for it has ambient occlusion as its last number.
    """
    document, center = GltfDocument(), mesh_center(packed.mesh)
    colours, attributes = _colours(ambient), _vectors(ambient, what)
    by_part: defaultdict[str, list[dict[str, Any]]] = defaultdict(list)
    for surface in surfaces:
        white = _with_one_reflectance(surface)
        primitive = add_surface(document, packed, center, white, {})
        own = primitive["attributes"]
        own["COLOR_0"] = document.add_attribute(colours[surface.vertices])
        for name, values in attributes.items():
            own[name] = document.add_attribute(values[surface.vertices])
        by_part[surface.name].append(primitive)
    roots = [add_node(document, name, primitives, center) for name, primitives in by_part.items()]
    told = {"version": 1, "kind": what, "attributes": list(attributes), "error": ambient.error()}
    document.write(path, roots, up, {"extras": {NAME: told}}, "write .ply")


def _with_one_reflectance(surface: Surface) -> Surface:
    """The same surface with one reflectance, as its colours are those of occlusion: its own, or 1 if it varies."""
    constant = bool(np.all(surface.reflectance == surface.reflectance[:1]))
    return surface if constant else surface._replace(reflectance=np.ones_like(surface.reflectance))


def _colours(ambient: Ambient) -> NDArray[np.float32]:
    """(V, 3) ambient occlusion as linear colours in [0, 1]."""
    clipped = np.clip(ambient.occlusion, 0.0, 1.0)
    return np.array(np.broadcast_to(clipped, (len(clipped), 3)), dtype=np.float32)


def _vectors(ambient: Ambient, what: str) -> dict[str, NDArray[np.float32]]:
    """(V, 4) for each attribute."""
    if what == OCCLUSION:
        return {}
    if what == BENT_NORMALS:
        mean = ambient.occlusion.mean(axis=1, keepdims=True)
        return {"_CUSTOM0": np.concatenate([ambient.values[:, 0], mean], axis=1)}
    return {f"_CUSTOM{c}": ambient.values[:, c] for c in range(ambient.values.shape[1])}
