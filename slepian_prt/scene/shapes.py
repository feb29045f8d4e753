"""Mitsuba shapes as triangle meshes with vertices: receivers of light."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.errors import UserError
from slepian_prt.scene.ids import load_keeping_ids
from slepian_prt.scene.materials import diffuse_reflectance
from slepian_prt.scene.mesh import Mesh, make_mesh
from slepian_prt.scene.normals import angle_weighted_normals, face_areas, split_at_creases

# Shapes that have a formula instead of vertices are cut into faces of about this part of the scene's diagonal.
_FACE_SIZE = 1.0 / 96.0
_FEWEST_CUTS, _MOST_CUTS = 48, 128
_MANY_SHAPES = 20

# Faces whose normals are within this angle, in degrees, lie in one plane.
_PLANE = 0.1


@dataclass(frozen=True)
class ReceivingShape:
    """A shape that light is computed on.

    Attributes
    ----------
    shape : Mitsuba mesh
        The scene's own, or one that replaces a sphere and the like.
    mesh : Mesh
    faces : (F', 3) int64
        The faces as Mitsuba numbers them; ``mesh`` leaves out degenerate ones.
    """

    shape: Any
    mesh: Mesh
    faces: NDArray[np.int64]


class _Surface(NamedTuple):
    """Triangles as they are given to Mitsuba.

    Attributes
    ----------
    positions : (V, 3)
    normals : (V, 3) or None
    faces : (F, 3)
    uv : (V, 2) or None
    """

    positions: NDArray
    normals: NDArray | None
    faces: NDArray
    uv: NDArray | None


def fewest_cuts(shapes: int) -> int:
    """Cuts along a shape that is not a mesh, at least: fewer where a scene has very many."""
    return max(12, min(_FEWEST_CUTS, round(_FEWEST_CUTS * math.sqrt(_MANY_SHAPES / max(shapes, 1)))))


def receiving_shape(mi: Any, shape: Any, name: str, origin: str, diagonal: float, fewest: int) -> ReceivingShape | None:
    """The shape with vertices, or None for what cannot be given any (curves, implicit surfaces, instances).

    Parameters
    ----------
    mi : Mitsuba
    shape : Mitsuba shape with a BSDF
    name, origin : str
        For logs and messages.
    diagonal, fewest
        Of the whole scene, and the fewest cuts: set how finely a shape that is not a mesh is cut.

    Raises
    ------
    UserError
    """
    kind, faceted = shape.class_name(), False
    if kind in _PARAMETRIC:
        surface = _parametric(mi, shape, kind, origin, diagonal, fewest)
    elif not shape.is_mesh():
        return None
    else:
        surface = _of_mesh(mi, shape)
        if shape.has_face_normals():
            surface, faceted = _faceted(surface), True
        if kind == "Cube":
            surface = _subdivided(surface, diagonal, fewest)
    positions, normals, faces, uv = surface
    replaced = kind in _PARAMETRIC or kind == "Cube" or faceted
    if replaced and normals is not None:
        faces = _along_normals(positions, normals, faces)  # a mirroring to_world turns them
    if _is_flipped(mi, shape, positions, normals, faces):
        # Mitsuba flips the normals of surface hits, not those that it keeps at the vertices.
        normals, faces, replaced = None if normals is None else -normals, faces[:, ::-1].copy(), True
    mesh = make_mesh(positions, faces, normals=normals, name=name, origin=origin)
    traced = _mesh(mi, shape.bsdf(), name, positions, mesh.normals, faces, uv) if replaced else shape
    albedo = diffuse_reflectance(mi, traced, positions, mesh.normals, faces, origin)
    return ReceivingShape(traced, Mesh(name, mesh.positions, mesh.normals, mesh.faces, albedo, mesh.notes), faces)


def mitsuba_mesh(mi: Any, mesh: Mesh) -> Any:
    """A Mitsuba mesh of the same geometry with a diffuse BSDF of its albedo."""
    constant = bool(np.all(mesh.albedo == mesh.albedo[0]))
    reflectance = (
        {"type": "rgb", "value": mesh.albedo[0].tolist()}
        if constant
        else {"type": "mesh_attribute", "name": "vertex_albedo"}
    )
    bsdf = mi.load_dict({"type": "twosided", "material": {"type": "diffuse", "reflectance": reflectance}})
    shape = _mesh(mi, bsdf, mesh.name, mesh.positions, mesh.normals, mesh.faces, None)
    if not constant:
        add_vertex_attribute(mi, shape, "vertex_albedo", mesh.albedo)
    return shape


def add_vertex_attribute(mi: Any, shape: Any, name: str, values: ArrayLike) -> None:
    """Give a Mitsuba mesh a three-channel attribute per vertex, or change the values of the one it has.

    Mitsuba does not check the length (it would read out of bounds) and returns zeros, silently, for channel counts
    other than one and three.
    """
    array = np.ascontiguousarray(values, dtype=np.float32)
    if array.shape != (shape.vertex_count(), 3):
        raise ValueError(f"{name} must have shape ({shape.vertex_count()}, 3), not {array.shape}")
    parameters = mi.traverse(shape)
    if name in parameters:
        parameters[name] = mi.Float(array.ravel())
        parameters.update()
    else:
        shape.add_attribute(name, 3, array.ravel())


def _mesh(
    mi: Any, bsdf: Any, name: str, positions: NDArray, normals: NDArray, faces: NDArray, uv: NDArray | None
) -> Any:
    properties = mi.Properties()
    properties["mesh_bsdf"] = bsdf
    shape = mi.Mesh(
        name,
        len(positions),
        len(faces),
        props=properties,
        has_vertex_normals=True,
        has_vertex_texcoords=uv is not None,
    )
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = mi.Float(positions.astype(np.float32).ravel())
    parameters["vertex_normals"] = mi.Float(normals.astype(np.float32).ravel())
    parameters["faces"] = mi.UInt32(faces.astype(np.uint32).ravel())
    if uv is not None:
        parameters["vertex_texcoords"] = mi.Float(uv.astype(np.float32).ravel())
    parameters.update()
    return shape


def _along_normals(positions: NDArray, normals: NDArray, faces: NDArray) -> NDArray[np.int64]:
    """The faces, turned where they run against the normals at their corners."""
    corner = positions[faces]
    turned = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    against = np.einsum("ij,ij->i", turned, normals[faces].sum(axis=1)) < 0.0
    return np.where(against[:, None], faces[:, ::-1], faces)


def _is_flipped(mi: Any, shape: Any, positions: NDArray, normals: NDArray | None, faces: NDArray) -> bool:
    """Whether Mitsuba's normal at a surface hit is opposite to that of the faces or vertices given."""
    corner = positions[faces]
    turned = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    largest = int(np.argmax(np.einsum("ij,ij->i", turned, turned)))
    towards = turned[largest] / np.linalg.norm(turned[largest])
    if normals is not None and normals[faces[largest, 0]] @ towards < 0.0:
        towards = -towards
    size = float(np.linalg.norm(np.ptp(corner[largest], axis=0)))
    start = corner[largest].mean(axis=0) + size * towards
    ray = mi.Ray3f(mi.Point3f(start.tolist()), mi.Vector3f((-towards).tolist()))
    hit = load_keeping_ids(mi, {"type": "scene", "shape": shape}).ray_intersect(ray)
    return float(np.array(hit.n).ravel() @ towards) < 0.0


def _of_mesh(mi: Any, shape: Any) -> _Surface:
    """What a Mitsuba mesh holds."""
    import drjit as dr

    vertex, face = dr.arange(mi.UInt32, shape.vertex_count()), dr.arange(mi.UInt32, shape.face_count())
    positions = np.array(shape.vertex_position(vertex), dtype=np.float64).T
    faces = np.array(shape.face_indices(face), dtype=np.int64).T
    normals = np.array(shape.vertex_normal(vertex), dtype=np.float64).T if shape.has_vertex_normals() else None
    uv = np.array(shape.vertex_texcoord(vertex), dtype=np.float32).T if shape.has_vertex_texcoords() else None
    return _Surface(positions, normals, faces, uv)


def _faceted(surface: _Surface) -> _Surface:
    """A mesh that is drawn flat (``face_normals``): faces share vertices only where they lie in one plane."""
    places = np.unique(surface.positions, axis=0, return_inverse=True)[1].ravel()
    vertices, faces, _ = split_at_creases(surface.positions, surface.faces, places, _PLANE)
    positions = surface.positions[vertices]
    uv = None if surface.uv is None else surface.uv[vertices]
    return _Surface(positions, angle_weighted_normals(positions, faces), faces, uv)


# --- Shapes with a formula -------------------------------------------------------------------------------------------


def _on_sphere(u: NDArray, v: NDArray) -> tuple[NDArray, NDArray]:
    theta, phi = np.pi * v, 2.0 * np.pi * u
    p = np.column_stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    return p, p


def _on_rectangle(u: NDArray, v: NDArray) -> tuple[NDArray, NDArray]:
    return np.column_stack([2.0 * u - 1.0, 2.0 * v - 1.0, 0.0 * u]), np.column_stack([0.0 * u, 0.0 * u, 1.0 + 0.0 * u])


def _on_disk(u: NDArray, v: NDArray) -> tuple[NDArray, NDArray]:
    phi = 2.0 * np.pi * v
    return np.column_stack([u * np.cos(phi), u * np.sin(phi), 0.0 * u]), np.column_stack(
        [0.0 * u, 0.0 * u, 1.0 + 0.0 * u]
    )


def _on_cylinder(u: NDArray, v: NDArray) -> tuple[NDArray, NDArray]:
    phi = 2.0 * np.pi * u
    return np.column_stack([np.cos(phi), np.sin(phi), v]), np.column_stack([np.cos(phi), np.sin(phi), 0.0 * u])


# Points and normals of Mitsuba's shapes in their own space, by the texture coordinates that Mitsuba gives them.
_PARAMETRIC = {"Sphere": _on_sphere, "Rectangle": _on_rectangle, "Disk": _on_disk, "Cylinder": _on_cylinder}


def _parametric(mi: Any, shape: Any, kind: str, origin: str, diagonal: float, fewest: int) -> _Surface:
    """A grid over the shape's own parameters, so that textures stay where they are."""
    matrix = np.array(mi.traverse(shape)["to_world"].matrix, dtype=np.float64).reshape(4, 4)
    linear, offset = matrix[:3, :3], matrix[:3, 3]
    if not np.all(np.isfinite(matrix)) or abs(np.linalg.det(linear)) <= 1e-12 * np.abs(linear).max() ** 3:
        raise UserError(f"{origin}: its to_world flattens it to nothing; correct the transform")

    def evaluate(uv: NDArray) -> tuple[NDArray, NDArray]:
        positions, normals = _PARAMETRIC[kind](uv[:, 0], uv[:, 1])
        normals = normals @ np.linalg.inv(linear)
        return positions @ linear.T + offset, normals / np.linalg.norm(normals, axis=1, keepdims=True)

    coarse = np.stack(np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 9), indexing="ij"), axis=-1)
    grid = evaluate(coarse.reshape(-1, 2))[0].reshape(9, 9, 3)
    along = [np.linalg.norm(np.diff(grid, axis=axis), axis=2).sum(axis=axis).max() for axis in (0, 1)]
    cuts = [_cuts(float(length), diagonal, fewest) for length in along]
    u, v = np.meshgrid(*(np.linspace(0.0, 1.0, n + 1) for n in cuts), indexing="ij")
    uv = np.column_stack([u.ravel(), v.ravel()])
    positions, normals = evaluate(uv)
    index = np.arange(uv.shape[0]).reshape(u.shape)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    area = face_areas(positions, faces)
    faces = faces[area > 1e-4 * area.max()]  # at the poles triangles have no area but for rounding
    used, faces = np.unique(faces, return_inverse=True)  # a pole needs fewer vertices than the grid has there
    return _Surface(positions[used], normals[used], faces.reshape(-1, 3), uv[used])


def _cuts(length: float, diagonal: float, fewest: int) -> int:
    return int(np.clip(math.ceil(min(length / max(_FACE_SIZE * diagonal, 1e-300), 1e6)), fewest, _MOST_CUTS))


def _subdivided(surface: _Surface, diagonal: float, fewest: int) -> _Surface:
    """Every triangle cut into n² by interpolation; corners that were apart (hard edges) stay apart."""
    positions, normals, faces, uv = surface
    if normals is None or uv is None:
        return surface
    corner = positions[faces]
    longest = float(np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max())
    n = max(2, math.ceil(_cuts(longest, diagonal, fewest) / 2))
    i, j = np.array([(i, j) for i in range(n + 1) for j in range(n + 1 - i)]).T
    weights = np.column_stack([n - i - j, i, j]) / n
    number = np.full((n + 1, n + 1), -1)
    number[i, j] = np.arange(i.size)
    up = np.array([(number[a, b], number[a + 1, b], number[a, b + 1]) for a in range(n) for b in range(n - a)])
    down = np.array(
        [(number[a + 1, b], number[a + 1, b + 1], number[a, b + 1]) for a in range(n) for b in range(n - a - 1)]
    )
    pattern = np.concatenate([up, down.reshape(-1, 3)])
    parts = [
        np.einsum("pk,fkc->fpc", weights, values[faces].astype(np.float64)).reshape(-1, values.shape[1])
        for values in (positions, normals, uv)
    ]
    # The two triangles of a side share the points along their common edge: those that agree to rounding in everything.
    in_box = (parts[0] - positions.min(axis=0)) / max(longest, 1e-300)
    _, first, which = np.unique(
        np.round(np.concatenate([in_box, *parts[1:]], axis=1), 5), axis=0, return_index=True, return_inverse=True
    )
    cut = (np.arange(len(faces))[:, None, None] * i.size + pattern).reshape(-1, 3)
    return _Surface(parts[0][first], parts[1][first], which.ravel()[cut], parts[2][first])
