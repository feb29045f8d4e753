"""Primitives of glTF meshes with their materials, before and after they are placed in the scene."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from slepian_prt.scene.formats.gltf_draco import decode_draco
from slepian_prt.scene.formats.gltf_file import Document
from slepian_prt.scene.formats.gltf_json import Entry
from slepian_prt.scene.formats.gltf_materials import Mapping, Surface, read_surface
from slepian_prt.scene.formats.gltf_primitives import (
    FAN,
    TRIANGLES,
    Primitive,
    pick_morphs,
    read_attribute,
    read_faces,
)
from slepian_prt.scene.formats.gltf_transforms import Transforms, transform_normals, transform_points
from slepian_prt.scene.formats.parts import MeshPart


@dataclass(frozen=True, eq=False)
class Shape:
    """A primitive, and the part that it makes in its own space; the part has no name yet."""

    primitive: Primitive
    part: MeshPart


@dataclass(frozen=True, eq=False)
class Reading:
    """A file with what was read of it so far: primitives and materials that are used several times are read once."""

    document: Document
    notes: Counter[str] = field(default_factory=Counter)
    shapes: dict[tuple[int, tuple[float, ...]], list[Shape]] = field(default_factory=dict)
    surfaces: dict[int, Surface] = field(default_factory=dict)


def read_shapes(reading: Reading, index: int, mesh: Entry, weights: tuple[float, ...]) -> list[Shape]:
    """All primitives of a mesh that have triangles, in the pose of ``weights`` (none: those of the mesh)."""
    weights = weights or mesh.numbers("weights", (), 0)
    if (index, weights) not in reading.shapes:
        found = [_read_shape(reading, entry, weights) for entry in mesh.entries("primitives")]
        reading.shapes[index, weights] = [shape for shape in found if shape is not None]
    return reading.shapes[index, weights]


def _read_shape(reading: Reading, entry: Entry, weights: tuple[float, ...]) -> Shape | None:
    """A primitive; None, with a note, if it has no triangles."""
    document = reading.document
    mode = entry.integer("mode", TRIANGLES)
    if mode < TRIANGLES:
        reading.notes["points or lines left out"] += 1
        return None
    if mode > FAN:
        raise entry.fault(f"has an unknown mode ({mode})")
    attributes = entry.entry("attributes")
    if attributes is None:
        raise entry.fault("has no attributes")
    primitive = Primitive(document, entry, attributes, pick_morphs(entry, weights), decode_draco(document, entry))
    positions = read_attribute(primitive, "POSITION")
    if positions is None:
        reading.notes["a primitive without positions left out"] += 1
        return None
    count = len(positions)
    faces = read_faces(primitive, count)
    if not len(faces):
        reading.notes["a primitive without triangles left out"] += 1
        return None
    normals = read_attribute(primitive, "NORMAL", count)
    colors = read_attribute(primitive, "COLOR_0", count)
    if colors is not None:
        colors = np.clip(colors[:, :3], 0.0, 1.0)
    part = MeshPart("", positions, faces, normals, None if colors is None else colors.astype(np.float32))
    return Shape(primitive, _add_material(reading, primitive, part))


def _add_material(reading: Reading, primitive: Primitive, part: MeshPart) -> MeshPart:
    """The part with its material, and the coordinates of its textures; without a texture that has no coordinates."""
    if "material" not in primitive.entry.values:
        return part
    index = primitive.entry.integer("material")
    entry = reading.document.find("materials", primitive.entry, "material")
    if index not in reading.surfaces:
        reading.surfaces[index] = read_surface(reading.document, entry, reading.notes)
    surface = reading.surfaces[index]
    material = surface.material
    uv = _map_corners(reading, primitive, part, surface.color)
    if uv is None and material.texture:
        material = replace(material, texture=None)
    metallic_uv = _map_corners(reading, primitive, part, surface.metallic)
    if metallic_uv is None and material.metallic_texture:
        material = replace(material, metallic=0.0, metallic_texture=None)
    if uv is not None and surface.metallic == surface.color:
        metallic_uv = None
    return replace(part, uv=uv, metallic_uv=metallic_uv, material=material)


def _map_corners(
    reading: Reading, primitive: Primitive, part: MeshPart, mapping: Mapping | None
) -> NDArray[np.float32] | None:
    """(F, 3, 2) coordinates of a texture at the corners; None, with a note, if the primitive has none for it."""
    if mapping is None:
        return None
    flat = read_attribute(primitive, f"TEXCOORD_{mapping.channel}", len(part.positions))
    if flat is None:
        reading.notes[f"a texture left out: {primitive.entry.place} has no TEXCOORD_{mapping.channel}"] += 1
        return None
    matrix = np.array(mapping.matrix)
    return (flat @ matrix[:, :2].T + matrix[:, 2]).astype(np.float32)[part.faces]


def place_shape(shape: Shape, transforms: Transforms, name: str) -> MeshPart:
    """Its part where one transform takes it, or one for each vertex."""
    part = shape.part
    mirrored = transforms.mirrored
    # Where the corners of a face disagree, by the majority.
    flipped = mirrored[part.faces].sum(axis=1) > 1 if mirrored.ndim else np.full(len(part.faces), mirrored)
    return replace(
        part,
        name=name,
        positions=transform_points(transforms, part.positions),
        faces=_turn(part.faces, flipped),
        normals=None if part.normals is None else transform_normals(transforms, part.normals),
        uv=None if part.uv is None else _turn(part.uv, flipped),
        metallic_uv=None if part.metallic_uv is None else _turn(part.metallic_uv, flipped),
    )


def _turn(corners: NDArray, flipped: NDArray[np.bool_]) -> NDArray:
    """(F, 3, …) with the corners of some faces the other way around."""
    if not flipped.any():
        return corners
    turned = corners.copy()
    turned[flipped] = corners[flipped][:, [0, 2, 1]]
    return turned
