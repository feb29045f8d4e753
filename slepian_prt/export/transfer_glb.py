"""Transfer in the run-time format as binary glTF 2.0 (``.glb``): what a shader needs to relight a model."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.export.byte_texture import byte_texture, texels_of
from slepian_prt.export.description import NAME, describe
from slepian_prt.lighting.fixed_lights import lamp_scales
from slepian_prt.relighting.files.glb_file import add_geometry, add_node, mesh_center
from slepian_prt.relighting.files.gltf_document import NEAREST, GltfDocument
from slepian_prt.relighting.files.surfaces import Surface
from slepian_prt.runtime.gpu_transfer import GpuTransfer


class Carrier(NamedTuple):
    """How the bytes of vertices are carried.

    Attributes
    ----------
    attributes : dict of str to (V, k) array
        Of the vertices of the mesh.
    told : dict
        The same in words, for those who read it.
    material : dict
        Properties of all materials.
    """

    attributes: dict[str, NDArray]
    told: dict[str, Any]
    material: dict[str, Any]


def write_transfer_glb(
    path: str | Path,
    packed: CompressedTransfer,
    gpu: GpuTransfer,
    surfaces: Sequence[Surface],
    attributes: str = "bytes",
    up: str = "y",
) -> None:
    """Write a model with its transfer, complete or not at all.

    Each part is a node, each texture of it a primitive, of an unlit material: what surfaces reflect, without light.

    Parameters
    ----------
    path : path
    packed : CompressedTransfer
    gpu : GpuTransfer
        Of the same.
    surfaces : sequence of Surface
        Of its mesh.
    attributes : one of `ATTRIBUTES`
    up : "y" or "z"
        What is up in the mesh; a node puts it upright.

    Raises
    ------
    UserError
        More than the format, or a texture, holds; a folder that cannot be written to.

    References
    ----------
    Khronos Group, glTF 2.0 specification, 3.7.2.1 (application-specific attributes begin with an underscore).
    """
    document, center = GltfDocument(), mesh_center(packed.mesh)
    carrier = _carry_in_texture(document, gpu) if attributes == "texture" else _carry_in_attributes(gpu, attributes)
    more = dict(carrier.attributes)
    if packed.fixed is not None:
        more["_LAMPS"] = packed.fixed.radiance(lamp_scales(packed.fixed, 1.0))
    by_part: defaultdict[str, list[dict[str, Any]]] = defaultdict(list)
    for surface in surfaces:
        primitive = add_surface(document, packed, center, surface, carrier.material)
        own = primitive["attributes"]
        for name, values in more.items():
            own[name] = document.add_attribute(np.ascontiguousarray(values[surface.vertices]))
        if "TEXCOORD_2" in own:  # sets have to be numbered without gaps
            own["TEXCOORD_1"] = own["TEXCOORD_2"]
            own.setdefault("TEXCOORD_0", own["TEXCOORD_2"])
        by_part[surface.name].append(primitive)
    roots = [add_node(document, name, primitives, center) for name, primitives in by_part.items()]
    extras = {NAME: describe(document, packed, gpu, carrier.told)}
    document.write(path, roots, up, {"extras": extras}, "give fewer `functions`, or export parts of the model")


def add_surface(
    document: GltfDocument, packed: CompressedTransfer, center: NDArray, surface: Surface, material: dict[str, Any]
) -> dict[str, Any]:
    """A primitive with the geometry of a surface and what it reflects: ``COLOR_0`` only where that varies."""
    reflectance = surface.reflectance
    varies = bool(np.any(reflectance != reflectance[:1]))
    attributes = add_geometry(document, packed.mesh, center, surface.vertices)
    if surface.uv is not None:
        attributes["TEXCOORD_0"] = document.add_attribute(surface.uv)
    if varies:
        attributes["COLOR_0"] = document.add_attribute(_unorm16(reflectance), normalized=True)
    color = (1.0, 1.0, 1.0) if varies else np.clip(reflectance[0], 0.0, 1.0)
    return {
        "attributes": attributes,
        "indices": document.add_indices(surface.faces),
        "material": document.add_material(surface.texture, color, **material),
    }


def _carry_in_attributes(gpu: GpuTransfer, kind: str) -> Carrier:
    """Four bytes in each of some vectors; the same numbers as floats if that is wanted."""
    names = [f"_CUSTOM{number}" for number in range(gpu.function_count // 4)]
    vectors = np.split(gpu.vertices, len(names), axis=1)
    if kind == "float":
        vectors = [vector.astype(np.float32) for vector in vectors]
    told = {"in": kind, "attributes": names, "numbers": "0 to 255, four to an attribute, not normalised"}
    return Carrier(dict(zip(names, vectors, strict=True)), told, {})


def _carry_in_texture(document: GltfDocument, gpu: GpuTransfer) -> Carrier:
    """An image, and where vertices find their texels."""
    content, places = byte_texture(gpu.vertices)
    texture = document.add_image(content, "image/png", ("clamp", "clamp"), (NEAREST, NEAREST))
    told = {
        "in": "texture",
        "texture": texture,
        "coordinates": "TEXCOORD_2",
        "texels": texels_of(gpu.function_count),
        "numbers": "red, green and blue of texels from TEXCOORD_2 to the right, times 255; the last may be filled up",
    }
    # Importers leave out textures that no material has. Occlusion is linear as it is, and this one has no effect.
    material = {"occlusionTexture": {"index": texture, "texCoord": 2, "strength": 0.0}}
    return Carrier({"TEXCOORD_2": places}, told, material)


def _unorm16(colors: NDArray) -> NDArray[np.uint16]:
    """(n, 4) linear colours in 16 bits, opaque."""
    opaque = np.column_stack([np.clip(colors, 0.0, 1.0), np.ones(len(colors))])
    return np.asarray(opaque * 65535.0 + 0.5).astype(np.uint16)
