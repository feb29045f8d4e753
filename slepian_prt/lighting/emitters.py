"""Mitsuba's environment emitters as distant light: as maps, and as spherical harmonics."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.lighting.environment import Environment
from slepian_prt.lighting.map_rows import Checked, Rows
from slepian_prt.lighting.sky import MAP_TO_SKY, SkyQuadrature, is_sky, sky_quadrature
from slepian_prt.lighting.sky_map import sky_texels
from slepian_prt.lighting.texel_projection import TexelProjection

# Grid that an emitter of unknown kind is evaluated on: rows, and strata each way per texel.
_ROWS, _STRATA = 512, 4

# Brighter radiance, squared in a mean, or summed over many texels, leaves the range of single precision.
BRIGHTEST = 1e18

# Wavelengths, in nm, that spectra are integrated at.
_FROM, _TO, _STEP = 360.0, 830.0, 5.0


@dataclass(frozen=True, repr=False, kw_only=True)
class SkyEnvironment(Environment):
    """The light of a ``sunsky``. Its texels have the sun's power too, but its coefficients come from the sky itself.

    Attributes
    ----------
    quadrature : SkyQuadrature
    samples : (N, 3) float64
        Radiance in its directions. Colours that sRGB has not keep their negative parts, as Mitsuba lights with them.
    emitter : Mitsuba emitter or None
        What to trace for a reference; None if the light was turned.
    """

    quadrature: SkyQuadrature
    samples: NDArray[np.float64]
    emitter: Any

    def turned(self, rotation: NDArray[np.float64]) -> Environment:
        """Turned by a rotation (3, 3) of the world; what was not turned keeps its emitter."""
        to_world = rotation @ self.to_world
        return replace(self, to_world=to_world, emitter=self.emitter if np.all(rotation == np.eye(3)) else None)

    def project(self, bandlimit: int, turn: NDArray[np.float64]) -> NDArray[np.float64]:
        """(3, (L+1)²) coefficients of the light, turned."""
        so_far = self.to_world @ MAP_TO_SKY.T @ self.quadrature.frame.T
        return self.quadrature.project(self.samples, bandlimit, turn @ so_far)


def emitted_environment(mi: Any, emitter: Any, origin: str, clamp_negative: bool = False) -> Environment:
    """A Mitsuba environment emitter (``envmap``, ``constant``, ``sunsky``, …) as a map.

    The texels of an ``envmap`` are taken as they are, with its scale and ``to_world``, whatever its shape; a
    ``sunsky`` becomes a `SkyEnvironment`; others are averaged over each texel of a fixed grid. What texels may be,
    `Checked` says, as for files.

    Raises
    ------
    UserError
        Radiance that is not finite or too bright, or a ``to_world`` that scales or shears.
    """
    if is_sky(emitter):
        quadrature, samples = _sampled_sky(mi, emitter, origin)
        texels = sky_texels(quadrature, samples, lambda directions: evaluate(mi, emitter, directions))
        made = _checked(texels, origin, quadrature.frame @ MAP_TO_SKY, emitter, True)
        return SkyEnvironment(
            made.name, made.texels, made.to_world, quadrature=quadrature, samples=samples, emitter=emitter
        )
    if is_envmap(emitter) and not mi.is_spectral:
        parameters = mi.traverse(emitter)
        # Mitsuba repeats the last column before the first, and the first behind the last.
        texels = np.array(parameters["data"])[:, 1:-1, :3] * float(np.ravel(parameters["scale"])[0])
        mirrored, world = envmap_rotation(parameters["to_world"], origin)
        return _checked(texels[:, ::-1] if mirrored else texels, origin, world, emitter, clamp_negative)
    grid = texel_grid(mi, emitter, origin)
    averaged = grid.averaged(evaluate(mi, emitter, grid.directions))
    return _checked(averaged, origin, grid.to_world, emitter, clamp_negative)


def environment_emitter(mi: Any, environment: Environment) -> Any:
    """What to trace in a Mitsuba scene: the scene's own sky as it is, else the ``envmap`` of a map, for `load_dict`."""
    if isinstance(environment, SkyEnvironment) and environment.emitter is not None:
        return environment.emitter
    matrix = np.eye(4)
    matrix[:3, :3] = environment.to_world
    return {
        "type": "envmap",
        "bitmap": mi.Bitmap(environment.texels),
        "to_world": mi.ScalarTransform4f(matrix.tolist()),
    }


def project_emitter(
    mi: Any, emitter: Any, bandlimit: int, turn: NDArray[np.float64], origin: str, clamp_negative: bool = False
) -> tuple[NDArray[np.float64], int]:
    """(3, (L+1)²) coefficients of an environment emitter, turned, and how many negative texels were set to zero."""
    if is_sky(emitter):
        quadrature, samples = _sampled_sky(mi, emitter, origin)
        return quadrature.project(samples, bandlimit, turn), 0
    made = emitted_environment(mi, emitter, origin, clamp_negative)
    height, width = made.texels.shape[:2]
    return TexelProjection(height, width, bandlimit, turn @ made.to_world)(made.texels), made.clamped


def _sampled_sky(mi: Any, emitter: Any, origin: str) -> tuple[SkyQuadrature, NDArray[np.float64]]:
    quadrature = sky_quadrature(mi, emitter, lambda directions: evaluate(mi, emitter, directions), origin)
    return quadrature, check_radiance(evaluate(mi, emitter, quadrature.directions), _named(origin, emitter))


def _checked(
    texels: NDArray, origin: str, to_world: NDArray[np.float64], emitter: Any, clamp_negative: bool
) -> Environment:
    """Texels of any shape as an `Environment`."""
    named = _named(origin, emitter)
    texels = check_radiance(np.asarray(texels, dtype=np.float32), named)
    height, width = texels.shape[:2]
    rows = Rows("scene", named, height, width, lambda begin, end: texels[begin:end], any_shape=True)
    checked = Checked(rows, clamp_negative)
    return Environment("scene", np.concatenate(list(checked)), to_world, checked.clamped)


def _named(origin: str, emitter: Any) -> str:
    return f"{origin}: {'envmap' if is_envmap(emitter) else emitter.class_name()}"


def check_radiance(radiance: NDArray, origin: str) -> NDArray:
    """The same radiance.

    Raises
    ------
    UserError
        Not finite, or brighter than `BRIGHTEST`.
    """
    if not np.all(np.isfinite(radiance)):
        raise UserError(f"{origin}: its radiance is NaN or infinite somewhere; repair the light")
    if (brightest := float(np.abs(radiance).max(initial=0.0))) > BRIGHTEST:
        raise UserError(
            f"{origin}: its radiance is up to {brightest:.3g}, more than can be computed with ({BRIGHTEST:.0e}); scale "
            "it down"
        )
    return radiance


def evaluate(mi: Any, emitter: Any, directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 3) linear sRGB radiance of an environment emitter in directions (n, 3) of the world."""
    import drjit as dr

    si = dr.zeros(mi.SurfaceInteraction3f, len(directions))
    si.wi = -mi.Vector3f(directions.T.astype(np.float32))
    with dr.suspend_grad():
        srgb = np.array(emitted_srgb(mi, emitter, si), dtype=np.float64)
    # What is the same in all directions comes as one number.
    return np.array(np.broadcast_to(srgb.T, (len(directions), 3)))


def emitted_srgb(mi: Any, emitter: Any, si: Any) -> Any:
    """Linear sRGB (Color3f) of the radiance that comes from where ``si`` looks, in any variant."""
    if not mi.is_spectral:
        radiance = mi.unpolarized_spectrum(emitter.eval(si))
        return mi.Color3f(radiance) if mi.is_rgb else mi.Color3f(radiance[0])
    xyz = mi.Color3f(0.0)
    count = len(si.wavelengths)
    wavelengths = np.arange(_FROM + 0.5 * _STEP, _TO, _STEP)
    for begin in range(0, wavelengths.size, count):
        some = wavelengths[begin : begin + count]
        si.wavelengths = type(si.wavelengths)(np.resize(some, count).tolist())
        radiance = mi.unpolarized_spectrum(emitter.eval(si))
        for i in range(some.size):
            xyz += radiance[i] * mi.cie1931_xyz(si.wavelengths[i]) * _STEP
    return mi.xyz_to_srgb(xyz)


def is_envmap(emitter: Any) -> bool:
    """Whether the emitter has texels."""
    return bool(emitter.class_name() == "EnvironmentMapEmitter")


def envmap_rotation(to_world: Any, origin: str) -> tuple[bool, NDArray[np.float64]]:
    """Whether an ``envmap`` has to be turned left to right (many exporters mirror), and its rotation (3, 3) then.

    Raises
    ------
    UserError
        A transform that scales or shears.
    """
    world = np.array(to_world.matrix, dtype=np.float64).reshape(4, 4)[:3, :3]
    mirrored = bool(np.linalg.det(world) < 0.0)
    if mirrored:
        world = world * [-1.0, 1.0, 1.0]
    if np.abs(world @ world.T - np.eye(3)).max() > 1e-4:
        raise UserError(
            f"{origin}: the envmap's to_world scales or shears it, which lights no scene as meant; use rotations "
            "(about axes of length one) and mirrorings only"
        )
    return mirrored, world


@dataclass(frozen=True)
class TexelGrid:
    """Directions that an emitter is evaluated in, some for each texel of a map.

    Attributes
    ----------
    height, width : int
    directions : (H W strata, 3)
        In the world; those of a texel together.
    to_world : (3, 3)
        Of the map.
    solid_angles : (H, W, strata)
        Of each direction, but for a factor.
    """

    height: int
    width: int
    directions: NDArray[np.float64]
    to_world: NDArray[np.float64]
    solid_angles: NDArray[np.float64]

    def averaged(self, samples: NDArray) -> NDArray[np.float64]:
        """(H, W, C) texels from (H W strata, C) samples."""
        values = samples.reshape(*self.solid_angles.shape, -1)
        return np.asarray(np.einsum("hws,hwsc->hwc", self._weights, values))

    def spread(self, texels: NDArray) -> NDArray[np.float64]:
        """The transpose of `averaged`."""
        return np.asarray(np.einsum("hws,hwc->hwsc", self._weights, texels).reshape(-1, texels.shape[2]))

    @property
    def _weights(self) -> NDArray[np.float64]:
        return np.asarray(self.solid_angles / self.solid_angles.sum(axis=2, keepdims=True))


def texel_grid(mi: Any, emitter: Any, origin: str) -> TexelGrid:
    """The grid for an environment emitter: an ``envmap``'s own texels, few for what is constant, else a fine one."""
    world, finer = np.eye(3), 1
    if is_envmap(emitter):
        parameters = mi.traverse(emitter)
        height, width = parameters["data"].shape[0], parameters["data"].shape[1] - 2
        _, world = envmap_rotation(parameters["to_world"], origin)  # mirrored or not: it is evaluated in the world
    elif emitter.class_name() == "ConstantBackgroundEmitter":
        height, width = 3, 6
    else:
        height, width, finer = _ROWS, 2 * _ROWS, _STRATA
    # Row r is centred on v = r/(H-1), column c on (c + 1/2)/W; the first and last row are half cells at the poles.
    row, column, i, j = np.meshgrid(
        np.arange(height), np.arange(width), np.arange(finer), np.arange(finer), indexing="ij", sparse=True
    )
    v = np.clip((row + (i + 0.5) / finer - 0.5) / (height - 1), 0.0, 1.0)
    u = (column + (j + 0.5) / finer) / width
    theta, phi = v * np.pi, u * 2.0 * np.pi
    shape = np.broadcast_shapes(row.shape, column.shape, i.shape, j.shape)
    towards = [np.sin(phi) * np.sin(theta), np.cos(theta), -np.cos(phi) * np.sin(theta)]
    directions = np.stack([np.broadcast_to(axis, shape).ravel() for axis in towards], axis=1)
    solid = np.broadcast_to(np.maximum(np.sin(theta), 1e-6), shape).reshape(height, width, -1)
    return TexelGrid(height, width, directions @ world.T, world, solid)
