"""What a Mitsuba BSDF reflects: the diffuse part at vertices, and what of it transport does not simulate."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.scene.normals import face_areas
from slepian_prt.scene.reflectance.barycentric import points_on
from slepian_prt.scene.reflectance.bsdf_parts import is_textured
from slepian_prt.scene.reflectance.diffuse_lobe import diffuse_albedo
from slepian_prt.scene.reflectance.face_means import FaceMeans

# Barycentric interpolation of an attribute may fall this far below zero.
_ROUNDING = 1e-5

# A texture is looked at so often on each shape, more for very many faces; and so many of these at once.
_LOOKUPS, _LANES = 2.5e5, 1 << 20


def reflects_diffusely(mi: Any, bsdf: Any) -> bool:
    """Whether the material has a diffuse reflecting part."""
    return bsdf is not None and bool(mi.has_flag(bsdf.flags(), mi.BSDFFlags.DiffuseReflection))


def reflects_toward_a_view(mi: Any, bsdf: Any) -> bool:
    """Whether the material reflects, other than as a perfect mirror: what transfer for a given view can hold."""
    return reflects_diffusely(mi, bsdf) or (
        bsdf is not None and bool(mi.has_flag(bsdf.flags(), mi.BSDFFlags.GlossyReflection))
    )


def reflects_on_both_sides(mi: Any, bsdf: Any) -> bool:
    """Whether light on the back is reflected there."""
    return bool(mi.has_flag(bsdf.flags(), mi.BSDFFlags.BackSide))


def lets_all_light_through(mi: Any, bsdf: Any) -> bool:
    """Whether a surface is nothing but a boundary: ``null``, as of media, no opacity, or glass like what is around."""
    flags = mi.BSDFFlags
    does = (flags.Diffuse, flags.Glossy, flags.DeltaReflection, flags.DeltaTransmission)
    if not any(mi.has_flag(bsdf.flags(), flag) for flag in does):
        return bool(mi.has_flag(bsdf.flags(), flags.Null))
    parameters = mi.traverse(bsdf)
    number = {"MaskBSDF": ("opacity.value", 0.0), "SmoothDielectric": ("eta", 1.0)}.get(bsdf.class_name())
    return number is not None and number[0] in parameters and bool(np.all(np.array(parameters[number[0]]) == number[1]))


def surface_points(mi: Any, shape: Any, positions: NDArray, normals: NDArray, faces: NDArray) -> Any:
    """Surface interactions at the vertices of a Mitsuba mesh, with the directions left to set.

    Textures find their coordinates in it, and attributes of the mesh a face to be interpolated on.
    """
    import drjit as dr

    count = len(normals)
    face = np.zeros(count, dtype=np.uint32)
    face[faces] = np.arange(len(faces), dtype=np.uint32)[:, None]
    si = _unplaced(mi, shape, count)
    si.p = mi.Point3f(np.ascontiguousarray(positions.T, dtype=np.float32))
    si.n = mi.Normal3f(np.ascontiguousarray(normals.T, dtype=np.float32))
    si.sh_frame = mi.Frame3f(si.n)
    si.prim_index = mi.UInt32(face)
    if shape.has_vertex_texcoords():
        si.uv = mi.Point2f(shape.vertex_texcoord(dr.arange(mi.UInt32, count)))
    return si


def _unplaced(mi: Any, shape: Any, count: int) -> Any:
    """Surface interactions with a shape, seen from straight above."""
    import drjit as dr

    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.t, si.wi = mi.Float(0.0), mi.Vector3f(0.0, 0.0, 1.0)
    si.shape = mi.ShapePtr(shape)
    return si


class VertexReflectance(NamedTuple):
    """What a material reflects diffusely, as vertices hold it.

    Attributes
    ----------
    albedo : (V, 3) float32
        Where the material is textured, the mean over the faces around the vertex, or what is found at it.
    lost : float
        Relative RMS by which the albedo on the faces differs from what is interpolated between the vertices.
    """

    albedo: NDArray[np.float32]
    lost: float


def diffuse_reflectance(
    mi: Any, shape: Any, positions: NDArray, normals: NDArray, faces: NDArray, origin: str, *, side: int = 1
) -> NDArray[np.float32]:
    """(V, 3) albedo of the diffuse part of a mesh's material at its vertices: see `vertex_reflectance`."""
    return vertex_reflectance(mi, shape, positions, normals, faces, origin, side=side).albedo


def vertex_reflectance(
    mi: Any, shape: Any, positions: NDArray, normals: NDArray, faces: NDArray, origin: str, *, side: int = 1
) -> VertexReflectance:
    """What the diffuse lobe of a mesh's material reflects, as `diffuse_lobe.diffuse_albedo` measures it.

    Textures count by their mean over the faces around a vertex, each point weighted as interpolation from the vertex
    weights it, unless what is found at the vertices interpolates to something nearer to them.

    Parameters
    ----------
    mi : Mitsuba
    shape : Mitsuba mesh
    positions, normals : (V, 3)
        Of its vertices, in its own space.
    faces : (F, 3)
        In the order in which Mitsuba numbers them.
    origin : str
        For messages.
    side : 1 or -1
        With -1 the material is seen from behind.

    Raises
    ------
    UserError
        A texture that cannot be evaluated, or is not a reflectance.
    """
    count, bsdf = len(normals), shape.bsdf()
    if not reflects_diffusely(mi, bsdf):
        return VertexReflectance(np.zeros((count, 3), dtype=np.float32), 0.0)
    try:
        if not is_textured(mi, bsdf):
            first = surface_points(mi, shape, positions[:1], normals[:1], np.zeros((1, 3), dtype=np.int64))
            albedo, lost = _checked(diffuse_albedo(mi, bsdf, first, side=side), origin), 0.0
        else:
            albedo, lost = _textured_reflectance(mi, shape, positions, normals, faces, origin, side)
    except UserError:
        raise
    except Exception as error:  # whatever a texture plugin raises
        reason = " ".join(str(error).split()) or type(error).__name__
        raise UserError(f"{origin}: its reflectance cannot be evaluated ({reason}); correct its material") from None
    return VertexReflectance(np.broadcast_to(albedo, (count, 3)).astype(np.float32), lost)


def _checked(reflectance: NDArray[np.float64], origin: str) -> NDArray[np.float64]:
    """Values from 0 to 1, free of rounding."""
    if not np.all(np.isfinite(reflectance)) or reflectance.min(initial=0.0) < -_ROUNDING:
        raise UserError(f"{origin}: its reflectance is negative or not finite; correct its material")
    if reflectance.max(initial=0.0) > 1.0 + _ROUNDING:
        raise UserError(f"{origin}: its reflectance is {reflectance.max():.3g}, and no surface reflects more than 1")
    return np.clip(reflectance, 0.0, 1.0)


def _textured_reflectance(
    mi: Any, shape: Any, positions: NDArray, normals: NDArray, faces: NDArray, origin: str, side: int
) -> tuple[NDArray[np.float64], float]:
    """(V, 3) albedo at the vertices, and what interpolation between them loses.

    It is the mean around each vertex, or what is found at it where that loses less: colours of vertices, and textures
    that are smooth on a face, are not to be blurred.
    """
    means = _face_means(mi, shape, positions, normals, faces, origin, side)
    around = np.clip(means.around_vertices(len(positions)), 0.0, 1.0)
    there = diffuse_albedo(mi, shape.bsdf(), surface_points(mi, shape, positions, normals, faces), side=side)
    lost = [means.lost(around), means.lost(np.clip(np.nan_to_num(there), 0.0, 1.0))]
    if lost[1] < lost[0]:
        return np.clip(np.nan_to_num(there), 0.0, 1.0), lost[1]
    return around, lost[0]


def _face_means(
    mi: Any, shape: Any, positions: NDArray, normals: NDArray, faces: NDArray, origin: str, side: int
) -> FaceMeans:
    area, bsdf = face_areas(positions, faces), shape.bsdf()
    grid, sliver = points_on(len(faces), _LOOKUPS), _is_sliver(positions, faces, area)
    moments, squares = np.zeros((len(faces), 3, 3)), np.zeros((len(faces), 3))
    at_once = max(1, _LANES // max(len(faces), 1))
    for start in range(0, len(grid), at_once):
        some = grid[start : start + at_once]
        values = diffuse_albedo(mi, bsdf, _face_points(mi, shape, positions, normals, faces, some), side=side)
        values = values.reshape(len(some), len(faces), 3)
        values = _checked(np.where(sliver[:, None], np.clip(np.nan_to_num(values), 0.0, 1.0), values), origin)
        moments += np.einsum("pk,pfc->fkc", some, values) / len(grid)
        squares += np.einsum("pfc,pfc->fc", values, values) / len(grid)
    return FaceMeans(faces, area, moments, squares, grid.T @ grid / len(grid))


def _is_sliver(positions: NDArray, faces: NDArray, area: NDArray) -> NDArray[np.bool_]:
    """(F,) faces so narrow that Mitsuba's float32 cannot tell where on them a point is: attributes are NaN there."""
    corner = positions[faces]
    longest = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max(axis=1)
    return np.asarray(area <= 1e-3 * longest**2)


def _face_points(
    mi: Any, shape: Any, positions: NDArray, normals: NDArray, faces: NDArray, barycentric: NDArray
) -> Any:
    """Surface interactions on the faces: all faces at the first point (n, 3) of the grid, then all at the second."""
    import drjit as dr

    def interpolated(values: NDArray) -> NDArray[np.float32]:
        return np.einsum("pk,fkc->cpf", barycentric, values[faces]).reshape(values.shape[1], -1).astype(np.float32)

    lanes = len(barycentric) * len(faces)
    si = _unplaced(mi, shape, lanes)
    si.p = mi.Point3f(interpolated(positions))
    si.n = dr.normalize(mi.Normal3f(interpolated(normals)))
    si.sh_frame = mi.Frame3f(si.n)
    si.prim_index = mi.UInt32(np.tile(np.arange(len(faces), dtype=np.uint32), len(barycentric)))
    if shape.has_vertex_texcoords():
        uv = np.array(shape.vertex_texcoord(dr.arange(mi.UInt32, len(positions)))).T
        si.uv = mi.Point2f(interpolated(uv))
    else:  # as Mitsuba has it: where the point is on its face
        si.uv = mi.Point2f(np.repeat(barycentric[:, 1:].T, len(faces), axis=1).astype(np.float32))
    return si
