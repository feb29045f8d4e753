"""glTF 2.0 files (.glb, .gltf): all triangles of the scene that they show, as they stand at rest.

Source: glTF 2.0 (github.com/KhronosGroup/glTF, specification/2.0) and the extensions that are listed here.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.scene.formats.gltf_draco import EXTENSION as DRACO
from slepian_prt.scene.formats.gltf_file import Document, open_gltf
from slepian_prt.scene.formats.gltf_json import Entry
from slepian_prt.scene.formats.gltf_nodes import (
    list_drawn,
    place_nodes,
    read_instances,
    read_joints,
    read_parents,
    refuse_empty,
)
from slepian_prt.scene.formats.gltf_primitives import read_skinning
from slepian_prt.scene.formats.gltf_shapes import Reading, Shape, place_shape, read_shapes
from slepian_prt.scene.formats.gltf_transforms import Transforms, make_transforms
from slepian_prt.scene.formats.parts import MeshFile, MeshPart

# Read, or without a say in where surfaces are and what they reflect diffusely.
_SUPPORTED = {
    "KHR_mesh_quantization", "EXT_meshopt_compression", "KHR_meshopt_compression", DRACO, "EXT_mesh_gpu_instancing",
    "KHR_node_visibility", "KHR_texture_transform", "KHR_texture_basisu", "EXT_texture_webp", "EXT_texture_avif",
    "MSFT_texture_dds", "KHR_lights_punctual", "EXT_lights_ies", "EXT_lights_image_based", "KHR_animation_pointer",
    "KHR_xmp", "KHR_xmp_json_ld", "MSFT_lod", "EXT_mesh_manifold", "CESIUM_primitive_outline", "EXT_mesh_features",
    "EXT_instance_features", "EXT_structural_metadata", "KHR_node_hoverability", "KHR_node_selectability",
    "KHR_interactivity", "KHR_materials_anisotropy", "KHR_materials_clearcoat", "KHR_materials_diffuse_transmission",
    "KHR_materials_dispersion", "KHR_materials_emissive_strength", "KHR_materials_ior", "KHR_materials_iridescence",
    "KHR_materials_pbrSpecularGlossiness", "KHR_materials_sheen", "KHR_materials_specular",
    "KHR_materials_transmission", "KHR_materials_unlit", "KHR_materials_variants", "KHR_materials_volume",
}  # fmt: skip


# What a vertex and a face take when they are placed, and when all parts become one mesh.
_BYTES = (250, 100)


def read_gltf(path: Path) -> MeshFile:
    """Read a .glb or .gltf file, with the files that it names.

    Nodes, skins and morph targets stand as the file leaves them; each primitive of each node, and of each of its
    instances, is a part.

    Raises
    ------
    UserError
        Not glTF 2.0, malformed, needs an extension that is not read, shows no triangles.
    """
    document = open_gltf(path)
    try:
        with np.errstate(all="ignore"):  # numbers that leave the range of floats are found where they come out
            return _read_parts(Reading(document))
    except UserError:
        raise
    except MemoryError:
        raise UserError(f"{path}: needs more memory than there is; export fewer triangles or instances") from None
    except Exception as error:  # what a parser did not foresee is malformed
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise UserError(f"{path}: its glTF is malformed ({reason[:200]}); export it again") from error


def _read_parts(reading: Reading) -> MeshFile:
    document, notes = reading.document, reading.notes
    _check_extensions(document)
    if document.root.entries("animations"):
        notes["animations left out (the pose at rest is read)"] += 1
    parts = list(_place_parts(reading))
    if not parts:
        raise refuse_empty(document)
    names: Counter[str] = Counter()
    unique = []
    for part in parts:
        names[part.name] += 1
        count = names[part.name]
        unique.append(part if count == 1 else replace(part, name=f"{part.name} ({count})"))
    return MeshFile(tuple(unique), tuple(f"{note} ({n} times)" if n > 1 else note for note, n in notes.items()))


def _check_extensions(document: Document) -> None:
    document.root.texts("extensionsUsed")
    required = document.root.texts("extensionsRequired")
    unknown = [name for name in required if name not in _SUPPORTED]
    if unknown:
        raise UserError(
            f"{document.path}: needs the glTF extension {' '.join(unknown[0].split())[:80]}, which is not read here; "
            "export it without"
        )


def _place_parts(reading: Reading) -> Iterator[MeshPart]:
    document = reading.document
    parents = read_parents(document)
    placed = place_nodes(document, parents)
    if not document.table("nodes") and not document.table("scenes"):
        for index, mesh in enumerate(document.table("meshes")):
            reading.notes["the file has no scene; its meshes are read as they are"] = 1
            for shape in read_shapes(reading, index, mesh, ()):
                name = _name(mesh.text("name", "") or mesh.place, mesh, shape)
                yield place_shape(shape, make_transforms(np.eye(4)), name)
        return
    transforms = make_transforms(placed)
    for index in list_drawn(document, parents, reading.notes):
        node = document.table("nodes")[index]
        if "mesh" not in node.values:
            continue
        # Packers put nameless nodes below those with names.
        above = document.table("nodes")[parents[index]].text("name", "") if parents[index] >= 0 else ""
        yield from _place_mesh(reading, node, above, transforms[index], placed)


def _place_mesh(
    reading: Reading, node: Entry, above: str, transform: Transforms, placed: NDArray[np.float64]
) -> Iterator[MeshPart]:
    """The parts of a node's mesh; ``above`` is the name of its parent, ``placed`` has the transforms of all nodes."""
    document = reading.document
    mesh = document.find("meshes", node, "mesh")
    shapes = read_shapes(reading, node.integer("mesh"), mesh, node.numbers("weights", (), 0))
    joints = read_joints(document, node, placed) if "skin" in node.values else None
    instances = read_instances(document, node) if joints is None else None
    times = 1 if instances is None else len(instances)
    document.take(times * sum(_BYTES[0] * len(s.part.positions) + _BYTES[1] * len(s.part.faces) for s in shapes))
    copies = None if instances is None else make_transforms(transform.matrices @ instances)
    for shape in shapes:
        name = _name(node.text("name", "") or mesh.text("name", "") or above or node.place, mesh, shape)
        if joints is not None:
            skinning = read_skinning(shape.primitive, joints, len(shape.part.positions))
            yield place_shape(shape, make_transforms(skinning), name)
        elif copies is None:
            yield place_shape(shape, transform, name)
        else:
            for number in range(len(copies.mirrored)):
                yield place_shape(shape, copies[number], f"{name} [{number}]")


def _name(name: str, mesh: Entry, shape: Shape) -> str:
    """Of a part: that of its node or mesh, and of the primitive if there are several."""
    name = " ".join(name.split())
    return name if len(mesh.entries("primitives")) == 1 else f"{name}, {shape.primitive.entry.place.split(', ')[-1]}"
