"""Primitives of glTF meshes: their triangles and attributes, in the shape that their morph targets give them.

Source: glTF 2.0, sections 3.7.2 (topology, morph targets) and 3.7.3.3 (skins).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from slepian_prt.scene.formats.gltf_accessors import Elements, read_accessor, read_indices
from slepian_prt.scene.formats.gltf_file import Document
from slepian_prt.scene.formats.gltf_json import Entry

TRIANGLES, STRIP, FAN = 4, 5, 6

# Types of attributes, and whether their integers stand for numbers up to 1 (None: as the accessor says).
_ATTRIBUTES: dict[str, tuple[tuple[str, ...], bool | None]] = {
    "POSITION": (("VEC3",), None),
    "NORMAL": (("VEC3",), True),
    "TEXCOORD": (("VEC2",), None),
    "COLOR": (("VEC3", "VEC4"), True),
    "JOINTS": (("VEC4",), False),
    "WEIGHTS": (("VEC4",), True),
}


@dataclass(frozen=True, eq=False)
class Primitive:
    """Part of a mesh.

    Attributes
    ----------
    document : Document
    entry, attributes : Entry
    morphs : tuple of (weight, Entry)
        Targets of another weight than 0.
    decoded : mapping of arrays
        Attributes that were compressed with Draco, and its ``faces``.
    """

    document: Document
    entry: Entry
    attributes: Entry
    morphs: tuple[tuple[float, Entry], ...] = ()
    decoded: Mapping[str, NDArray] = field(default_factory=dict)


def pick_morphs(entry: Entry, weights: tuple[float, ...]) -> tuple[tuple[float, Entry], ...]:
    """The targets of a primitive with their weights; those of weight 0 left out."""
    targets = entry.entries("targets")
    if weights and len(weights) != len(targets):
        raise entry.fault(f"has {len(targets)} morph targets and {len(weights)} weights")
    return tuple((weight, target) for weight, target in zip(weights, targets, strict=False) if weight)


def read_attribute(primitive: Primitive, name: str, count: int | None = None) -> NDArray[np.float64] | None:
    """(V, ·) numbers of an attribute, with its morph targets; None if the primitive does not have it.

    Parameters
    ----------
    count : int, optional
        V, if it is known.

    Raises
    ------
    UserError
        Of another type or number.
    """
    if name not in primitive.attributes.values:
        return None
    kinds, normalized = _ATTRIBUTES[name.split("_")[0]]
    values = _read(primitive, primitive.attributes, name, kinds).scaled(normalized)
    if count is not None and len(values) != count:
        raise primitive.entry.fault(f"has {count} of POSITION and {len(values)} of {name}")
    for weight, target in primitive.morphs:
        if name in target.values:
            moved = read_accessor(primitive.document, target.integer(name), target, kinds).scaled(normalized)
            if moved.shape != values.shape:
                raise target.fault(f"has {len(moved)} of {name} for {len(values)}")
            values = values + weight * moved
    return values


def _read(primitive: Primitive, attributes: Entry, name: str, kinds: tuple[str, ...]) -> Elements:
    index = attributes.integer(name)
    if name not in primitive.decoded:
        return read_accessor(primitive.document, index, attributes, kinds)
    accessor = primitive.document.at("accessors", index, attributes)
    values = primitive.decoded[name]
    if f"VEC{values.shape[1]}" not in kinds:
        raise primitive.entry.fault(f"has {values.shape[1]} components of {name} in its Draco data")
    return Elements(values, accessor.flag("normalized"))


def read_faces(primitive: Primitive, count: int) -> NDArray[np.int64]:
    """(F, 3) triangles over ``count`` vertices; those that join strips, of fewer than three vertices, left out.

    Raises
    ------
    UserError
        Vertices that do not exist, or a number of indices that is none of triangles.
    """
    entry = primitive.entry
    if "faces" in primitive.decoded:
        faces = primitive.decoded["faces"].astype(np.int64)
    else:
        if "indices" in entry.values:
            indices = read_indices(primitive.document, entry.integer("indices"), entry)
        else:
            indices = np.arange(count, dtype=np.int64)
        faces = _triangulate(entry, indices)
    if faces.size and faces.max() >= count:
        raise entry.fault(f"names vertex {faces.max()} of {count}")
    return faces


def _triangulate(entry: Entry, indices: NDArray[np.int64]) -> NDArray[np.int64]:
    mode = entry.integer("mode", TRIANGLES)
    if mode == TRIANGLES:
        if len(indices) % 3:
            raise entry.fault(f"has {len(indices)} indices, which are no triangles")
        return indices.reshape(-1, 3)
    if len(indices) < 3:
        return np.empty((0, 3), dtype=np.int64)
    if mode == STRIP:
        first, second, third = indices[:-2], indices[1:-1].copy(), indices[2:].copy()
        second[1::2], third[1::2] = indices[3::2], indices[2:-1:2]
        faces = np.stack([first, second, third], axis=1)
    else:
        hub = np.full(len(indices) - 2, indices[0])
        faces = np.stack([indices[1:-1], indices[2:], hub], axis=1)
    a, b, c = faces.T
    return faces[(a != b) & (b != c) & (c != a)]


def read_skinning(primitive: Primitive, joints: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """(V, 3, 4) the transform of each vertex: the mean of those of its joints (J, 4, 4), weighted.

    Raises
    ------
    UserError
        No weights, or joints that the skin does not have.
    """
    places: list[NDArray] = []
    weights: list[NDArray] = []
    while (more := read_attribute(primitive, f"JOINTS_{len(places)}", count)) is not None:
        weight = read_attribute(primitive, f"WEIGHTS_{len(places)}", count)
        if weight is None:
            raise primitive.entry.fault(f"has JOINTS_{len(places)} without WEIGHTS_{len(places)}")
        places.append(more)
        weights.append(weight)
    if not places:
        raise primitive.entry.fault("has a skin and no JOINTS_0")
    place, weight = np.concatenate(places, axis=1), np.concatenate(weights, axis=1)
    if not np.isfinite(weight).all() or (weight < 0).any():
        raise primitive.entry.fault("has weights of joints that are negative or not finite")
    total = weight.sum(axis=1, keepdims=True)
    weight[total[:, 0] == 0.0, 0] = 1.0  # a vertex without weights stays with its first joint
    weight /= np.where(total == 0.0, 1.0, total)
    place[weight == 0.0] = 0
    bad = ~((place >= 0) & (place < len(joints)))
    if bad.any():
        raise primitive.entry.fault(f"names joint {place[bad][0]:g} of {len(joints)}")
    out = np.zeros((count, 3, 4))
    for column, share in zip(place.T.astype(np.int64), weight.T, strict=True):
        out += share[:, None, None] * joints[column, :3]
    return out
