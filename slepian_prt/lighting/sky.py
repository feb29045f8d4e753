"""Mitsuba's sun and sky: the sky on rings about the zenith, the sun's disk by itself.

The disk is small and some 1e5 times as bright as the sky, so that no grid of directions finds its power. The radiance f
of both together is split into what a grid integrates well and what is left of the disk,

    f = g + (f - g),

where g is f outside the disk, and inside it goes on with what f is at the disk's rim in the same direction from its
centre. The first part is integrated on rings about the zenith (Gauss–Legendre in √cos θ, at whose zero the horizon
lies and sky models have a root), the second on rings about the sun.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.lighting.texel_projection import legendre_on_rings, legendre_spread, legendre_sum
from slepian_prt.sphere.harmonics import real_sh
from slepian_prt.sphere.rotation import rotate_sh

# Rings of the sky between zenith and horizon, and directions on each.
_RINGS, _AZIMUTHS = 160, 320

# What 1 - cos of an angle is off by at most in single precision, where Mitsuba asks whether a direction meets the sun.
_ROUNDING = 5e-7

# Radiance above the sky's, relative to the largest, that tells a direction that met the sun.
_MET = 0.05

# Directions whose harmonics are evaluated at a time.
_BLOCK = 4096

# Columns: where the axes of a map (y up) go in the sky's frame (z up).
MAP_TO_SKY = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])

Evaluate = Callable[[NDArray[np.float64]], NDArray[np.float64]]


@dataclass(frozen=True)
class Sun:
    """Where the disk is.

    Attributes
    ----------
    direction : (3,)
        In the sky's own frame, z its zenith.
    depth : float
        1 - cos of the half-angle, as single precision has it.
    """

    direction: NDArray[np.float64]
    depth: float

    @property
    def half_angle(self) -> float:
        """In radians."""
        return _angle(self.depth)

    @property
    def axes(self) -> NDArray[np.float64]:
        """(3, 3) rotation from the sun's frame, z toward it and x upward, to the sky's."""
        z = self.direction
        y = np.cross(z, [0.0, 0.0, 1.0] if abs(z[2]) < 0.999 else [1.0, 0.0, 0.0])
        y /= np.linalg.norm(y)
        return np.stack([np.cross(y, z), y, z], axis=1)

    def beside(self, directions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Directions (n, 3) in the sky's frame; those in the disk moved away from its centre to just outside."""
        depth = self.depth + 2.0 * _ROUNDING
        local = directions @ self.axes
        inside = 1.0 - local[:, 2] < depth
        azimuth = np.arctan2(local[inside, 1], local[inside, 0])
        moved = directions.copy()
        moved[inside] = _around(np.full(azimuth.shape, depth), azimuth) @ self.axes.T
        return moved


@dataclass(frozen=True)
class Disk:
    """Points of a sun's disk, n of them.

    Attributes
    ----------
    directions, evaluated : (n, 3)
        Where they are, and where the emitter is asked for their radiance, in the sky's frame.
    solid_angles : (n,)
    """

    directions: NDArray[np.float64]
    evaluated: NDArray[np.float64]
    solid_angles: NDArray[np.float64]


@dataclass(frozen=True)
class SkyQuadrature:
    """The linear map from radiance in some directions to spherical-harmonic coefficients.

    Attributes
    ----------
    frame : (3, 3)
        Rotation from the sky's frame, z its zenith, to the world.
    sun : Sun or None
        None if it does not shine.
    disk : Disk
    """

    frame: NDArray[np.float64]
    sun: Sun | None
    disk: Disk

    @property
    def directions(self) -> NDArray[np.float64]:
        """(N, 3) in the world: of the rings, of the disk, and beside it."""
        rings = _ring_directions()
        if self.sun is None:
            return rings @ self.frame.T
        disk = self.disk
        return np.concatenate([self.sun.beside(rings), disk.evaluated, self.sun.beside(disk.directions)]) @ self.frame.T

    def project(self, samples: NDArray, bandlimit: int, turn: NDArray[np.float64]) -> NDArray[np.float64]:
        """(C, (L+1)²) coefficients of radiance (N, C) in `directions`, with the light turned."""
        rings = samples[: _RINGS * _AZIMUTHS].astype(np.float64)
        spectrum = np.fft.rfft(rings.reshape(_RINGS, _AZIMUTHS, -1), axis=1)
        spectrum = _padded(spectrum, bandlimit) * (2.0 * np.pi / _AZIMUTHS)
        coefficients = legendre_sum(spectrum, _ring_legendre(bandlimit))
        flux = self.disk_flux(samples)
        for begin in range(0, len(flux), _BLOCK):
            part = slice(begin, begin + _BLOCK)
            coefficients += flux[part].T @ real_sh(bandlimit, self.disk.directions[part])
        return rotate_sh(coefficients, turn @ self.frame)

    def adjoint(self, coefficients: NDArray, turn: NDArray[np.float64]) -> NDArray[np.float64]:
        """(N, C) from coefficients (C, (L+1)²): the transpose of `project`."""
        in_sky = rotate_sh(np.asarray(coefficients, dtype=np.float64), (turn @ self.frame).T)
        bandlimit = math.isqrt(in_sky.shape[1]) - 1
        moments = legendre_spread(in_sky, _ring_legendre(bandlimit)) * (2.0 * np.pi / _AZIMUTHS)
        spectrum = _padded(moments, _AZIMUTHS // 2)
        spectrum[:, 1 : _AZIMUTHS // 2] *= 0.5  # of the real part of an FFT: an inverse FFT without its 1/W
        rings = np.fft.irfft(spectrum, n=_AZIMUTHS, axis=1, norm="forward").reshape(_RINGS * _AZIMUTHS, -1)
        disk = np.empty((len(self.disk.directions), len(in_sky)))
        for begin in range(0, len(disk), _BLOCK):
            part = slice(begin, begin + _BLOCK)
            disk[part] = real_sh(bandlimit, self.disk.directions[part]) @ in_sky.T
        disk *= self.disk.solid_angles[:, None]
        return np.concatenate([rings, disk, -disk])

    def disk_flux(self, samples: NDArray) -> NDArray[np.float64]:
        """(n, C) irradiance from each point of the disk, less what the sky around it would send."""
        disk, beside = np.split(samples[_RINGS * _AZIMUTHS :].astype(np.float64), 2)
        return (disk - beside) * self.disk.solid_angles[:, None]


# --- The emitter -----------------------------------------------------------------------------------------------------


def is_sky(emitter: Any) -> bool:
    """Whether the emitter is a ``sunsky``, or one that changes with time."""
    return emitter.class_name() in ("SunskyEmitter", "TimedSunskyEmitter")


def sky_quadrature(mi: Any, emitter: Any, evaluate: Evaluate, origin: str) -> SkyQuadrature:
    """For a sky of Mitsuba; of one that changes with time, at time 0.

    Parameters
    ----------
    mi : Mitsuba, in the variant of the emitter
    emitter : ``sunsky`` or ``timed_sunsky``
    evaluate : callable
        Gives its radiance (n, 3) in directions (n, 3) of the world.
    origin : str
        For users.

    Raises
    ------
    UserError
        A transform that scales or shears.
    """
    parameters = mi.traverse(emitter)
    frame = _sky_frame(parameters["to_world"], origin)
    toward = _sun_direction(mi, emitter, parameters)
    direction = frame.T @ (toward / np.linalg.norm(toward))
    if direction[2] < 0.0 or float(parameters["sun_scale"]) == 0.0:
        return SkyQuadrature(frame, None, Disk(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)))
    aperture = re.search(r"Sun aperture = ([-+.\de]+)", str(emitter))
    if aperture is None:
        raise UserError(f"{origin}: its sun has an aperture that cannot be found; use Mitsuba 3.9")
    half_angle = np.float32(math.radians(0.5 * float(aperture[1])))
    sun = Sun(direction, 1.0 - float(np.cos(half_angle)))
    # Harmonics of degree 100, and the darkening towards the rim, are integrated to 1e-6; where the horizon cuts the
    # disk, to 1e-4.
    radii = 64 if _angle(sun.depth) > math.asin(min(1.0, direction[2])) else 12 + math.ceil(60.0 * sun.half_angle)
    disk = sun_disk(sun, radii, 24 + math.ceil(300.0 * sun.half_angle), lambda local: evaluate(local @ frame.T))
    return SkyQuadrature(frame, sun, disk)


def sun_disk(sun: Sun, radii: int, azimuths: int, evaluate: Evaluate) -> Disk:
    """Points of the disk above the horizon: Gauss–Legendre from its centre to its rim, and about it.

    The radius is μ, the cosine at which the sun's own surface is met, which limb darkening is a polynomial of:
    1 - cos γ = (1 - μ²) (1 - cos α) at γ from the centre of a disk of half-angle α.
    """
    node, weight = np.polynomial.legendre.leggauss(radii)
    mu = 0.5 * (node + 1.0)
    depth = (1.0 - mu**2) * sun.depth
    share = mu * weight * sun.depth  # dΩ = 2μ (1 - cos α) dμ dψ
    # Above the horizon are azimuths ψ, from the upward one, of cos ψ > -tan η / tan γ, at the sun's elevation η.
    cosine, sine = 1.0 - depth, np.sqrt(depth * (2.0 - depth))
    rise = sun.direction[2] * cosine / np.maximum(math.hypot(*sun.direction[:2]) * sine, 1e-300)
    widest = np.arccos(np.clip(-rise, -1.0, 1.0))
    node, weight = np.polynomial.legendre.leggauss(azimuths)
    whole = widest == np.pi
    equal = (2.0 * np.arange(azimuths) + 1.0) / azimuths - 1.0  # better than Gauss–Legendre on whole circles
    psi = widest[:, None] * np.where(whole[:, None], equal, node)
    solid = share[:, None] * widest[:, None] * np.where(whole[:, None], 2.0 / azimuths, weight)
    depth = np.broadcast_to(depth[:, None], psi.shape)
    directions = (_around(depth.ravel(), psi.ravel()) @ sun.axes.T).reshape(radii, azimuths, 3)
    evaluated = _where_sun_is_met(sun, directions, depth, evaluate)
    return Disk(directions.reshape(-1, 3), evaluated.reshape(-1, 3), solid.ravel())


def _where_sun_is_met(
    sun: Sun, directions: NDArray[np.float64], depth: NDArray[np.float64], evaluate: Evaluate
) -> NDArray[np.float64]:
    """(radii, azimuths, 3) directions to evaluate in: near the rim Mitsuba's single precision misses the disk here and
    meets it there, so one that meets it stands for those beside it that do not."""
    doubtful = sun.depth - depth < _ROUNDING
    if not doubtful.any():
        return directions
    flat = directions.reshape(-1, 3)
    above = (evaluate(flat) - evaluate(sun.beside(flat))).sum(axis=1).reshape(depth.shape)
    met = (above > _MET * above.max()) | ~doubtful
    chosen = directions.copy()
    # Radii go from the rim inward.
    for radius in range(len(directions) - 1, -1, -1):
        hits = np.flatnonzero(met[radius])
        if hits.size == 0 and radius + 1 < len(directions):
            chosen[radius] = chosen[radius + 1]
            continue
        if hits.size == 0:
            chosen[radius] = sun.direction
            continue
        apart = np.abs(np.arange(met.shape[1])[:, None] - hits)
        nearest = hits[np.argmin(np.minimum(apart, met.shape[1] - apart), axis=1)]
        chosen[radius] = directions[radius, nearest]
    return chosen


def _sky_frame(to_world: Any, origin: str) -> NDArray[np.float64]:
    """(3, 3) rotation whose third column is the zenith; a mirroring transform is turned into one."""
    world = np.array(to_world.matrix, dtype=np.float64).reshape(4, 4)[:3, :3]
    if not np.allclose(world @ world.T, np.eye(3), atol=1e-4):
        raise UserError(
            f"{origin}: the sky's to_world scales or shears it, which lights no scene as meant; use rotations (about "
            "axes of length one) and mirrorings only"
        )
    if np.linalg.det(world) < 0.0:
        world = world * [1.0, -1.0, 1.0]
    left, _, right = np.linalg.svd(world)
    return np.asarray(left @ right)


def _sun_direction(mi: Any, emitter: Any, parameters: Any) -> NDArray[np.float64]:
    """(3,) in the world."""
    if "sun_direction" not in parameters:
        parameters = mi.traverse(mi.load_dict(_at_its_start(mi, parameters)))
    return np.array(parameters["sun_direction"], dtype=np.float64).ravel()


def _at_its_start(mi: Any, parameters: Any) -> dict[str, Any]:
    """A ``sunsky`` whose sun stands where that of a ``timed_sunsky`` does at time 0."""
    at = {name: float(np.ravel(parameters[name])[0]) for name in ("latitude", "longitude", "timezone")}
    date = {name: int(np.ravel(parameters[f"start_{name}"])[0]) for name in ("year", "month", "day")}
    hour = float(np.ravel(parameters["window_start_time"])[0])
    matrix = np.array(parameters["to_world"].matrix, dtype=np.float64).reshape(4, 4)
    return {"type": "sunsky", "to_world": mi.ScalarTransform4f(matrix.tolist()), "hour": hour, **at, **date}


# --- Rings -----------------------------------------------------------------------------------------------------------


@lru_cache(maxsize=1)
def _rings() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Polar angles and weights of rings above the horizon, for ∫ f sin θ dθ."""
    node, weight = np.polynomial.legendre.leggauss(_RINGS)
    t = 0.5 * (node + 1.0)  # √cos θ
    return np.arccos(t * t), t * weight


@lru_cache(maxsize=1)
def _ring_directions() -> NDArray[np.float64]:
    theta = np.repeat(_rings()[0], _AZIMUTHS)
    phi = np.tile(2.0 * np.pi * np.arange(_AZIMUTHS) / _AZIMUTHS, _RINGS)
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)


@lru_cache(maxsize=4)
def _ring_legendre(bandlimit: int) -> list[NDArray[np.float64]]:
    return legendre_on_rings(bandlimit, *_rings())


def _padded(spectrum: NDArray[np.complex128], highest: int) -> NDArray[np.complex128]:
    """Orders 0..highest of a spectrum (rings, orders, C); zero where it has none."""
    kept = min(highest + 1, spectrum.shape[1])
    padded = np.zeros((len(spectrum), highest + 1, spectrum.shape[2]), dtype=np.complex128)
    padded[:, :kept] = spectrum[:, :kept]
    return padded


def _around(depth: NDArray[np.float64], azimuth: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 3) directions about z, at 1 - cos of their angle to it."""
    sine = np.sqrt(depth * (2.0 - depth))
    return np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), 1.0 - depth], axis=1)


def _angle(depth: float) -> float:
    return 2.0 * math.asin(math.sqrt(0.5 * depth))
