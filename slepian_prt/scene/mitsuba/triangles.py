"""Triangles of Mitsuba meshes as arrays, and Mitsuba meshes made of them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.scene.normals import angle_weighted_normals, run_against, split_at_creases

# Faces whose normals are within this angle, in degrees, lie in one plane.
_PLANE = 0.1

# What every mesh may have; other parameters of vertices and faces are attributes that its file gives it.
_GEOMETRY = ("vertex_positions", "vertex_normals", "vertex_texcoords")


class Triangles(NamedTuple):
    """Triangles as they are given to Mitsuba.

    Attributes
    ----------
    positions : (V, 3)
    normals : (V, 3) or None
    faces : (F, 3)
    uv : (V, 2) or None
    attributes : dict of str to (V, k) or (F, k)
        What textures may look up at vertices or faces, by names that begin with ``vertex_`` and ``face_``.
    are_own : bool
        Whether these are the very triangles of a Mitsuba mesh, in its order.
    """

    positions: NDArray
    normals: NDArray | None
    faces: NDArray
    uv: NDArray | None
    attributes: dict[str, NDArray]
    are_own: bool


def triangles_of(mi: Any, shape: Any) -> Triangles:
    """What a Mitsuba mesh holds."""
    import drjit as dr

    vertex, face = dr.arange(mi.UInt32, shape.vertex_count()), dr.arange(mi.UInt32, shape.face_count())
    positions = np.array(shape.vertex_position(vertex), dtype=np.float64).T
    faces = np.array(shape.face_indices(face), dtype=np.int64).T
    normals = np.array(shape.vertex_normal(vertex), dtype=np.float64).T if shape.has_vertex_normals() else None
    uv = np.array(shape.vertex_texcoord(vertex), dtype=np.float32).T if shape.has_vertex_texcoords() else None
    parameters, attributes = mi.traverse(shape), {}
    for name in parameters.keys():  # noqa: SIM118 (iterating over it yields pairs)
        if name.startswith(("vertex_", "face_")) and name not in _GEOMETRY:
            count = len(positions) if name.startswith("vertex_") else len(faces)
            attributes[name] = np.array(parameters[name], dtype=np.float32).reshape(count, -1)
    return Triangles(positions, normals, faces, uv, attributes, are_own=True)


def faceted(triangles: Triangles) -> Triangles:
    """A mesh that is drawn flat (``face_normals``): faces share vertices only where they lie in one plane."""
    places = np.unique(triangles.positions, axis=0, return_inverse=True)[1].ravel()
    vertices, faces, _ = split_at_creases(triangles.positions, triangles.faces, places, _PLANE)
    positions = triangles.positions[vertices]
    return Triangles(
        positions,
        angle_weighted_normals(positions, faces),
        faces,
        None if triangles.uv is None else triangles.uv[vertices],
        {
            name: values[vertices] if name.startswith("vertex_") else values
            for name, values in triangles.attributes.items()
        },
        are_own=False,
    )


def along_normals(triangles: Triangles) -> Triangles:
    """The faces, turned where they run against the normals at their corners."""
    if triangles.normals is None:
        return triangles
    faces = triangles.faces
    against = run_against(triangles.positions, faces, triangles.normals)
    if not against.any():
        return triangles
    return triangles._replace(faces=np.where(against[:, None], faces[:, ::-1], faces), are_own=False)


def mesh_of(mi: Any, bsdf: Any, name: str, triangles: Triangles, normals: NDArray) -> Any:
    """A Mitsuba mesh of triangles, with the normals given."""
    properties = mi.Properties()
    properties["mesh_bsdf"] = bsdf
    shape = mi.Mesh(
        name,
        len(triangles.positions),
        len(triangles.faces),
        props=properties,
        has_vertex_normals=True,
        has_vertex_texcoords=triangles.uv is not None,
    )
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = mi.Float(triangles.positions.astype(np.float32).ravel())
    parameters["vertex_normals"] = mi.Float(normals.astype(np.float32).ravel())
    parameters["faces"] = mi.UInt32(triangles.faces.astype(np.uint32).ravel())
    if triangles.uv is not None:
        parameters["vertex_texcoords"] = mi.Float(triangles.uv.astype(np.float32).ravel())
    parameters.update()
    for attribute, values in triangles.attributes.items():
        shape.add_attribute(attribute, values.shape[1], values.astype(np.float32).ravel())
    return shape
