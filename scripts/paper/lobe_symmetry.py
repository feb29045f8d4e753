"""How radially symmetric a lobe is: the energy that its best radially symmetric part holds."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from slepian_prt.sphere.quadrature import gauss_legendre
from slepian_prt.sphere.rotation import rotation_to

Lobe = Callable[[NDArray], NDArray]


class Symmetry(NamedTuple):
    """The part of a lobe's energy, 0 to 1, that is radially symmetric about an axis in the xz plane.

    Attributes
    ----------
    part : float
    axis : float
        Angle of the axis from z towards x, radians.
    """

    part: float
    axis: float


def symmetric_part(lobe: Lobe, axis: float, polar: int = 256, azimuths: int = 180) -> Symmetry:
    """Energy of the means of a lobe over circles about an axis, over that of the lobe.

    Of all radially symmetric functions about that axis, these means are next to the lobe in L² over the sphere.

    Parameters
    ----------
    lobe : callable
        Values (n,) at unit directions (n, 3) of the whole sphere.
    axis : radians from z towards x
    polar, azimuths : int
        Nodes, by Gauss's rule in the angle from the axis and evenly around it.
    """
    rule = gauss_legendre(polar)
    theta = 0.5 * np.pi * (1.0 + rule.nodes)
    weights = 0.5 * np.pi * rule.weights * np.sin(theta)
    phi = 2.0 * np.pi * (np.arange(azimuths) + 0.5) / azimuths
    around = np.stack(
        np.broadcast_arrays(
            np.outer(np.sin(theta), np.cos(phi)), np.outer(np.sin(theta), np.sin(phi)), np.cos(theta)[:, None]
        ),
        axis=-1,
    )
    turn = rotation_to([math.sin(axis), 0.0, math.cos(axis)])
    values = lobe((around @ turn.T).reshape(-1, 3)).reshape(polar, azimuths)
    symmetric = values.mean(axis=1)
    return Symmetry(float(weights @ symmetric**2 / (weights @ (values**2).mean(axis=1))), axis)


def best_symmetry(lobe: Lobe, near: float, within: float = 0.6) -> Symmetry:
    """The same about the axis for which it is largest, at most ``within`` radians from another."""
    found = minimize_scalar(
        lambda axis: -symmetric_part(lobe, float(axis)).part,
        bounds=(near - within, near + within),
        method="bounded",
        options={"xatol": 1e-3},
    )
    return max(symmetric_part(lobe, float(found.x)), symmetric_part(lobe, near))


def lobe_toward(mi: Any, bsdf: Any, angle: float) -> Lobe:
    """What a BSDF sends toward one direction, ``angle`` from z towards -x, of light from each: f cos θ."""
    import drjit as dr

    outgoing = mi.Vector3f(-math.sin(angle), 0.0, math.cos(angle))

    def lobe(directions: NDArray) -> NDArray[np.float64]:
        surface = dr.zeros(mi.SurfaceInteraction3f, len(directions))
        surface.wi = outgoing
        light = mi.Vector3f(np.asarray(directions.T, dtype=np.float32))
        return np.array(bsdf.eval(mi.BSDFContext(), surface, light)[0], dtype=np.float64)

    return lobe


def falls_below(angles: NDArray, parts: NDArray, least: float) -> float | None:
    """The angle where parts first fall below the least wanted, between two that were measured; None if they do not."""
    below = np.flatnonzero(parts < least)
    if below.size == 0:
        return None
    second = int(below[0])
    if second == 0:
        return float(angles[0])
    slope = (parts[second] - parts[second - 1]) / (angles[second] - angles[second - 1])
    return float(angles[second - 1] + (least - parts[second - 1]) / slope)
