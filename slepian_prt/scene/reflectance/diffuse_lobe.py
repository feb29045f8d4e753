"""How much diffuse light the diffuse lobe of a Mitsuba BSDF reflects, measured on the BSDF.

What a material calls its diffuse reflectance is a parameter and not what is reflected: a plastic with 0.5 reflects
0.46, because its coat reflects light on its way in and out, and a nonlinear one 0.26.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.scene.reflectance.bsdf_parts import PERTURBING, parts_of
from slepian_prt.scene.reflectance.principled_lobe import principled_albedo

# Nodes in either cosine, and azimuths: of the points that the shape of a lobe is measured at, and of all points where
# the shape is not the same everywhere.
_FINE, _COARSE = (16, 8), (6, 4)
_PROBES = 32
_SAME_SHAPE = 1e-3

# Evaluations in one launch.
_LANES = 1 << 20


def diffuse_albedo(mi: Any, bsdf: Any, points: Any, *, side: int = 1) -> NDArray[np.float64]:
    """Bihemispherical reflectance of the diffuse reflecting lobe, ρ = (1/π) ∬ f_d(ω_i, ω_o) cos θ_i cos θ_o dω_i dω_o.

    Parameters
    ----------
    mi : Mitsuba
    bsdf : Mitsuba BSDF
    points : Mitsuba surface interactions
        n of them; their directions do not count.
    side : 1 or -1
        With -1 the surface is seen, and lit, from behind.

    Returns
    -------
    (n, 3) array

    Notes
    -----
    A mask counts by its opacity, a bump or normal map as what is nested in it. A BSDF of another plugin that cannot be
    asked for its diffuse lobe alone has the diffuse reflectance that it names itself.
    """
    import drjit as dr

    count, kind = dr.width(points), bsdf.class_name()
    if not mi.has_flag(bsdf.flags(), mi.BSDFFlags.DiffuseReflection):
        return np.zeros((count, 3))
    parts = parts_of(mi, bsdf)
    if kind == "TwoSidedBRDF":
        return diffuse_albedo(mi, parts["brdf_0" if side > 0 else "brdf_1"], points)
    if kind in PERTURBING:
        return diffuse_albedo(mi, parts["nested_bsdf"], points, side=side)
    if kind == "MaskBSDF":
        return _weight(parts["opacity"], points) * diffuse_albedo(mi, parts["nested_bsdf"], points, side=side)
    if kind == "BlendBSDF":
        first, second = (diffuse_albedo(mi, parts[name], points, side=side) for name in ("bsdf_0", "bsdf_1"))
        return np.asarray(first + _weight(parts["weight"], points) * (second - first))
    if kind in ("SmoothDiffuse", "Principled") and side < 0:
        return np.zeros((count, 3))
    if kind == "SmoothDiffuse":
        return _values(mi, bsdf.eval_diffuse_reflectance(points), count)
    if kind in ("Principled", "PrincipledThin"):
        return np.broadcast_to(principled_albedo(parts, points, thin=kind == "PrincipledThin"), (count, 3))
    return _measured(mi, bsdf, points, side)


def _weight(texture: Any, points: Any) -> NDArray[np.float64]:
    """(n, 1) opacity, or weight in a blend."""
    return np.clip(np.array(texture.eval_1(points), dtype=np.float64), 0.0, 1.0)[:, None]


def _values(mi: Any, spectrum: Any, count: int) -> NDArray[np.float64]:
    return np.broadcast_to(np.array(mi.unpolarized_spectrum(spectrum), dtype=np.float64).T, (count, 3))


def _measured(mi: Any, bsdf: Any, points: Any, side: int) -> NDArray[np.float64]:
    """By numerical integration.

    Textures scale the lobes of Mitsuba's BSDFs and do not change their shape. Where that is so at a few points, one
    evaluation tells the reflectance of each of the others.
    """
    import drjit as dr

    count = dr.width(points)
    chosen = np.unique(np.linspace(0, count - 1, min(count, _PROBES)).round().astype(np.uint32))
    probes = dr.gather(mi.SurfaceInteraction3f, points, mi.UInt32(chosen))
    reference = mi.Vector3f(0.36, 0.48, 0.8 * side)
    if _ignores_types(mi, bsdf, probes, reference):
        points.wi = mi.Vector3f(0.0, 0.0, float(side))
        return _values(mi, bsdf.eval_diffuse_reflectance(points), count)
    points.wi = reference
    single = _values(mi, bsdf.eval(_diffuse_only(mi), points, reference), count)
    exact = _integrated(mi, bsdf, probes, side, _FINE)
    probed = single[chosen]
    ratio = float(exact.sum() / probed.sum()) if probed.sum() > 0.0 else 0.0
    if np.all(np.abs(exact - ratio * probed) <= _SAME_SHAPE * np.abs(exact)):
        return ratio * single
    return _integrated(mi, bsdf, points, side, _COARSE)


def _diffuse_only(mi: Any) -> Any:
    context = mi.BSDFContext()
    context.type_mask = mi.BSDFFlags.DiffuseReflection
    return context


def _ignores_types(mi: Any, bsdf: Any, points: Any, direction: Any) -> bool:
    """Whether a BSDF that also has other lobes answers with all of them, whatever types it is asked for."""
    flags = mi.BSDFFlags
    if not mi.has_flag(bsdf.flags(), flags.Glossy) and not mi.has_flag(bsdf.flags(), flags.DiffuseTransmission):
        return False
    context = mi.BSDFContext()
    context.type_mask = flags.Null
    points.wi = direction
    return bool(np.any(np.array(mi.unpolarized_spectrum(bsdf.eval(context, points, direction))) != 0.0))


@cache
def _pairs(nodes: int, azimuths: int) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float64]]:
    """Pairs of directions, (n, 3) each, and their weights (n,) in a mean over both, cosine-weighted, which add up to 1.

    Gauss-Legendre in the cosines, as Fresnel's formulas are smooth in these; the azimuth of the first directions turns
    from pair to pair, so that all are met.
    """
    node, weight = np.polynomial.legendre.leggauss(nodes)
    cosine, weight = 0.5 * (node + 1.0), 0.5 * weight * (node + 1.0)
    first, second, turn = (index.ravel() for index in np.indices((nodes, nodes, azimuths)))
    start = 2.0 * math.pi * ((np.arange(first.size) * 0.5 * (math.sqrt(5.0) - 1.0)) % 1.0)
    return (
        _directions(cosine[first], start),
        _directions(cosine[second], start + 2.0 * math.pi * turn / azimuths),
        weight[first] * weight[second] / azimuths,
    )


def _directions(cosine: NDArray, azimuth: NDArray) -> NDArray[np.float32]:
    sine = np.sqrt(1.0 - cosine**2)
    return np.column_stack([sine * np.cos(azimuth), sine * np.sin(azimuth), cosine]).astype(np.float32)


def _integrated(mi: Any, bsdf: Any, points: Any, side: int, grid: tuple[int, int]) -> NDArray[np.float64]:
    """(n, 3) integrals over the pairs of a grid, at each point."""
    import drjit as dr

    count, context = dr.width(points), _diffuse_only(mi)
    toward, outward, weight = _pairs(*grid)
    up = np.array([1.0, 1.0, side], dtype=np.float32)
    step = max(1, _LANES // len(weight))
    result = np.empty((count, 3))
    for start in range(0, count, step):
        chosen = np.arange(start, min(start + step, count), dtype=np.uint32)
        lanes = dr.gather(mi.SurfaceInteraction3f, points, mi.UInt32(np.repeat(chosen, len(weight))))
        lanes.wi = mi.Vector3f(np.tile(up * toward, (chosen.size, 1)).T)
        out = np.tile(up * outward, (chosen.size, 1))
        reflected = _values(mi, bsdf.eval(context, lanes, mi.Vector3f(out.T)), len(out)) / np.abs(out[:, 2:])
        result[chosen] = math.pi * np.einsum("npc,p->nc", reflected.reshape(chosen.size, -1, 3), weight)
    return result
