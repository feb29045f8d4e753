"""Mitsuba shapes as triangle meshes with vertices: receivers of light."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from slepian_prt.scene.mesh import Mesh, check_geometry, make_mesh
from slepian_prt.scene.mitsuba.parametric import PARAMETRIC, cut_cube, fewest_cuts, parametric
from slepian_prt.scene.mitsuba.triangles import Triangles, along_normals, faceted, mesh_of, triangles_of
from slepian_prt.scene.normals import face_areas
from slepian_prt.scene.reflectance.materials import VertexReflectance, vertex_reflectance


@dataclass(frozen=True)
class ReceivingShape:
    """A shape that light is computed on.

    Attributes
    ----------
    shape : Mitsuba mesh
        The scene's own, or one that replaces a sphere and the like.
    mesh : Mesh
    triangles : Triangles
        As Mitsuba numbers them; ``mesh`` has the same vertices and leaves out degenerate faces.
    texture_lost : float
        See `materials.VertexReflectance.lost`.
    shines : bool
        Whether it is a lamp too.
    original : ReceivingShape or None
        What it is a copy of.
    """

    shape: Any
    mesh: Mesh
    triangles: Triangles
    texture_lost: float = 0.0
    shines: bool = False
    original: ReceivingShape | None = None


def shape_triangles(mi: Any, shape: Any, origin: str, diagonal: float, fewest: int) -> Triangles | None:
    """The triangles of a shape, or None for what cannot be given any (curves, implicit surfaces, instances).

    Faces turn, and normals point, the way that Mitsuba's do at hits of the surface.

    Parameters
    ----------
    mi : Mitsuba
    shape : Mitsuba shape with a BSDF
    origin : str
        For messages.
    diagonal, fewest
        Of the whole scene, and the fewest cuts: set how finely a shape that is not a mesh is cut.

    Raises
    ------
    UserError
    """
    kind = shape.class_name()
    if kind in PARAMETRIC:
        triangles = along_normals(parametric(mi, shape, kind, origin, diagonal, fewest))  # it may be mirrored
        return _as_hit(mi, shape, triangles, 0)
    if not shape.is_mesh() or kind == "EllipsoidsMesh":  # whose vertices Mitsuba shows nobody
        return None
    own = triangles_of(mi, shape)
    check_geometry(own.positions, own.faces, origin)
    triangles = along_normals(faceted(own) if shape.has_face_normals() else own)
    triangles = _as_hit(mi, shape, triangles, _largest(own))
    return along_normals(cut_cube(triangles, diagonal, fewest)) if kind == "Cube" else triangles


def receiving_shape(mi: Any, shape: Any, name: str, origin: str, triangles: Triangles) -> ReceivingShape:
    """The shape as a receiver.

    Parameters
    ----------
    mi : Mitsuba
    shape : Mitsuba shape with a BSDF
    name, origin : str
        For logs and messages.
    triangles : Triangles
        Of `shape_triangles`.

    Raises
    ------
    UserError
    """
    positions, faces = triangles.positions, triangles.faces
    mesh = make_mesh(positions, faces, normals=triangles.normals, name=name, origin=origin)
    traced = shape if triangles.are_own else mesh_of(mi, shape.bsdf(), name, triangles, mesh.normals)
    albedo, lost = vertex_reflectance(mi, traced, positions, mesh.normals, faces, origin)
    return ReceivingShape(traced, replace(mesh, albedo=albedo, known_albedo=False), triangles, lost, shape.is_emitter())


def reflectance_behind(mi: Any, receiving: ReceivingShape, origin: str) -> VertexReflectance:
    """What the back of a shape reflects whose material reflects on both sides.

    Raises
    ------
    UserError
        As of `vertex_reflectance`.
    """
    triangles = receiving.triangles
    return vertex_reflectance(
        mi, receiving.shape, triangles.positions, receiving.mesh.normals, triangles.faces, origin, side=-1
    )


def without_emission(mi: Any, shape: Any, diagonal: float) -> Any:
    """The surface of a shape that shines as a mesh that does not; of the whole scene's ``diagonal``.

    What has neither vertices nor a formula is returned as it is.
    """
    name = shape.id() or "lamp"
    triangles = shape_triangles(mi, shape, name, diagonal, fewest_cuts(1))
    if triangles is None:
        return shape
    mesh = make_mesh(triangles.positions, triangles.faces, normals=triangles.normals, name=name, origin=name)
    return mesh_of(mi, shape.bsdf(), name, triangles, mesh.normals)


def mitsuba_mesh(mi: Any, mesh: Mesh) -> Any:
    """A Mitsuba mesh of the same geometry with a diffuse BSDF of its albedo."""
    constant = bool(np.all(mesh.albedo == mesh.albedo[0]))
    reflectance = (
        {"type": "rgb", "value": mesh.albedo[0].tolist()}
        if constant
        else {"type": "mesh_attribute", "name": "vertex_albedo"}
    )
    bsdf = mi.load_dict({"type": "twosided", "material": {"type": "diffuse", "reflectance": reflectance}})
    triangles = Triangles(mesh.positions, None, mesh.faces, None, {}, are_own=False)
    shape = mesh_of(mi, bsdf, mesh.name, triangles, mesh.normals)
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


def _largest(triangles: Triangles) -> int:
    return int(np.argmax(face_areas(triangles.positions, triangles.faces)))


def _as_hit(mi: Any, shape: Any, triangles: Triangles, face: int) -> Triangles:
    """The triangles on the side that Mitsuba's shading normals point to at surface hits.

    With ``flip_normals`` Mitsuba flips those of some shapes, not the ones that it keeps at the vertices.

    Parameters
    ----------
    mi : Mitsuba
    shape : Mitsuba shape
    triangles : Triangles
    face : int
        One of the faces of the shape as Mitsuba has it.
    """
    import drjit as dr

    positions, normals, faces = triangles[:3]
    largest = _largest(triangles)
    corner = positions[faces[largest]]
    turned = np.cross(corner[1] - corner[0], corner[2] - corner[0])
    size = float(np.linalg.norm(np.ptp(corner, axis=0)))
    towards = turned / max(float(np.linalg.norm(turned)), 1e-300)
    if normals is not None and normals[faces[largest, 0]] @ towards < 0.0:
        towards = -towards
    start = corner.mean(axis=0) + size * towards
    ray = mi.Ray3f(mi.Point3f(start.tolist()), mi.Vector3f((-towards).tolist()))
    met = dr.zeros(mi.PreliminaryIntersection3f)
    met.t, met.prim_index, met.prim_uv = mi.Float(size), mi.UInt32(face), mi.Point2f(1.0 / 3.0, 1.0 / 3.0)
    met.shape = mi.ShapePtr(shape)
    hit = shape.compute_surface_interaction(ray, met, mi.RayFlags.All)
    if float(np.array(hit.sh_frame.n).ravel() @ towards) >= 0.0:
        return triangles
    return triangles._replace(normals=None if normals is None else -normals, faces=faces[:, ::-1].copy(), are_own=False)
