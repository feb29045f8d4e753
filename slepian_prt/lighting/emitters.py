"""Mitsuba's environment emitters as maps."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.lighting.environment import Environment, make_environment

# Grid that a sky without texels is evaluated on: rows, and strata each way per texel.
_SKY_ROWS, _SKY_STRATA = 512, 4


def emitted_environment(mi: Any, emitter: Any, origin: str) -> Environment:
    """A Mitsuba environment emitter (``envmap``, ``constant``, ``sunsky``, …) as a map.

    The texels of an ``envmap`` are taken as they are, with its scale and ``to_world``; others are averaged over each
    texel of a fixed grid, finely enough that the sun keeps its power.
    """
    import drjit as dr

    if is_envmap(emitter):
        parameters = mi.traverse(emitter)
        # Mitsuba repeats the last column before the first, and the first behind the last.
        texels = np.array(parameters["data"])[:, 1:-1, :3] * float(np.ravel(parameters["scale"])[0])
        mirrored, world = envmap_rotation(parameters["to_world"], origin)
        made = make_environment(
            texels[:, ::-1] if mirrored else texels, name="scene", origin=f"{origin}: envmap", clamp_negative=True
        )
        return replace(made, to_world=world)
    grid = sky_grid(mi, emitter, origin)
    si = dr.zeros(mi.SurfaceInteraction3f, len(grid.directions))
    si.wi = -mi.Vector3f(grid.directions.T.astype(np.float32))
    radiance = np.broadcast_to(np.array(emitter.eval(si)).T, (len(grid.directions), 3))
    texels = grid.averaged(radiance)
    return make_environment(texels, name="scene", origin=f"{origin}: {emitter.class_name()}", clamp_negative=True)


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
class SkyGrid:
    """Directions that a sky is evaluated in, some for each texel of a map.

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


def sky_grid(mi: Any, emitter: Any, origin: str) -> SkyGrid:
    """The grid for an environment emitter: an ``envmap``'s own texels, few for what is constant, else a fine one."""
    world, finer = np.eye(3), 1
    if is_envmap(emitter):
        parameters = mi.traverse(emitter)
        height, width = parameters["data"].shape[0], parameters["data"].shape[1] - 2
        _, world = envmap_rotation(parameters["to_world"], origin)  # mirrored or not: it is evaluated in the world
    elif emitter.class_name() == "ConstantBackgroundEmitter":
        height, width = 3, 6
    else:
        height, width, finer = _SKY_ROWS, 2 * _SKY_ROWS, _SKY_STRATA
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
    return SkyGrid(height, width, directions @ world.T, world, solid)
