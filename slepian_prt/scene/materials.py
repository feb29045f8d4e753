"""What a Mitsuba BSDF reflects: the diffuse part at vertices, and what of it transport does not simulate."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError

# Barycentric interpolation of an attribute may fall this far below zero.
_ROUNDING = 1e-5


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


def left_out(mi: Any, bsdf: Any, name: str, *, view: bool) -> list[str]:
    """What of the material of a receiving shape is not simulated, each as the name of an effect."""
    flags = mi.BSDFFlags

    def has(*wanted: Any) -> bool:
        return any(mi.has_flag(bsdf.flags(), flag) for flag in wanted)

    notes = []
    if not view and has(flags.GlossyReflection):
        notes.append(
            f"glossy reflection of shape '{name}' (`view` simulates it; the diffuse part counts as Lambertian)"
        )
    if has(flags.DeltaReflection):
        notes.append(f"mirror reflection of shape '{name}'")
    if has(flags.DiffuseTransmission, flags.GlossyTransmission, flags.DeltaTransmission):
        notes.append(f"transmission through shape '{name}'")
    if re.search("BumpMap|NormalMap", str(bsdf)):
        notes.append(f"bump or normal map of shape '{name}'")
    if has(flags.Null):
        notes.append(f"transparency of shape '{name}' (it casts full shadows)")
    return notes


def surface_points(mi: Any, shape: Any, positions: NDArray, normals: NDArray, faces: NDArray) -> Any:
    """Surface interactions at the vertices of a Mitsuba mesh, with the directions left to set.

    Textures find their coordinates in it, and attributes of the mesh a face to be interpolated on.
    """
    import drjit as dr

    count = len(normals)
    face = np.zeros(count, dtype=np.uint32)
    face[faces] = np.arange(len(faces), dtype=np.uint32)[:, None]
    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.t, si.wi = mi.Float(0.0), mi.Vector3f(0.0, 0.0, 1.0)
    si.p = mi.Point3f(np.ascontiguousarray(positions.T, dtype=np.float32))
    si.n = mi.Normal3f(np.ascontiguousarray(normals.T, dtype=np.float32))
    si.sh_frame = mi.Frame3f(si.n)
    si.shape = mi.ShapePtr(shape)
    si.prim_index = mi.UInt32(face)
    if shape.has_vertex_texcoords():
        si.uv = mi.Point2f(shape.vertex_texcoord(dr.arange(mi.UInt32, count)))
    return si


def diffuse_reflectance(
    mi: Any, shape: Any, positions: NDArray, normals: NDArray, faces: NDArray, origin: str
) -> NDArray[np.float32]:
    """(V, 3) albedo of the diffuse part of a mesh's material at its vertices.

    Constants, bitmaps (at the texture coordinates) and attributes of the mesh alike.

    Raises
    ------
    UserError
        A texture that cannot be evaluated, or is not a reflectance.
    """
    if not reflects_diffusely(mi, shape.bsdf()):
        return np.zeros((len(normals), 3), dtype=np.float32)  # what Mitsuba answers for metals is no reflectance
    points = surface_points(mi, shape, positions, normals, faces)
    try:
        if "BlendBSDF" in str(shape.bsdf()):
            # Mitsuba blends in what metals answer; the diffuse lobe itself, straight up and down, is ρ/π.
            context = mi.BSDFContext()
            context.type_mask = mi.BSDFFlags.DiffuseReflection
            values = np.pi * np.array(shape.bsdf().eval(context, points, mi.Vector3f(0.0, 0.0, 1.0))).T
        else:
            values = np.array(shape.bsdf().eval_diffuse_reflectance(points)).T
    except Exception as error:  # whatever a texture plugin raises
        reason = " ".join(str(error).split()) or type(error).__name__
        raise UserError(f"{origin}: its reflectance cannot be evaluated ({reason}); correct its material") from None
    reflectance = np.broadcast_to(values, (len(normals), 3)).astype(np.float32)
    if not np.all(np.isfinite(reflectance)) or reflectance.min() < -_ROUNDING:
        raise UserError(f"{origin}: its reflectance is negative or not finite; correct its material")
    if reflectance.max() > 1.0 + _ROUNDING:
        raise UserError(f"{origin}: its reflectance is {reflectance.max():.3g}, and no surface reflects more than 1")
    return np.clip(reflectance, 0.0, 1.0) * np.float32(_not_metal(mi, shape.bsdf()))


def _not_metal(mi: Any, bsdf: Any) -> float:
    """Part of a ``principled`` material that is no metal: Mitsuba calls all of its base colour diffuse."""
    if "Principled" not in str(bsdf):
        return 1.0
    parameters = mi.traverse(bsdf)
    names = parameters.keys()
    metallic = [np.ravel(np.array(parameters[name])) for name in names if name.endswith("metallic.value")]
    return 1.0 - float(metallic[0][0]) if metallic and metallic[0].size == 1 else 1.0
