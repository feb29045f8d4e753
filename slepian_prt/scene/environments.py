"""Environment maps as distant light, checked, and projected on spherical harmonics as Mitsuba would light with them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.errors import UserError, check_bandlimit
from slepian_prt.scene.maps import Checked, Rows, array_rows, file_rows
from slepian_prt.scene.projection import Projection, resampled

# Grid that a sky without texels is evaluated on: rows, and strata each way per texel.
_SKY_ROWS, _SKY_STRATA = 512, 4


@dataclass(frozen=True)
class Environment:
    """A distant light: radiance by direction, on a latitude-longitude grid.

    Attributes
    ----------
    name : str
    texels : (H, W, 3) float32
        Linear RGB radiance, none negative, all finite, H >= 3.
    to_world : (3, 3)
        Rotation from the map's frame (y up) to the world.
    clamped : int
        Number of negative texels that were set to zero.
    """

    name: str
    texels: NDArray[np.float32]
    to_world: NDArray[np.float64]
    clamped: int = 0

    def rotated(self, degrees: float) -> Environment:
        """Turned counter-clockwise about the world's up axis y."""
        return replace(self, to_world=about_up(degrees) @ self.to_world)


def about_up(degrees: float) -> NDArray[np.float64]:
    """Rotation matrix about y by an angle in degrees, counter-clockwise seen from above."""
    if not math.isfinite(degrees):
        raise UserError(f"rotation must be a finite number of degrees, not {degrees!r}")
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def read_environment(path: str | Path, *, clamp_negative: bool = False) -> Environment:
    """Read a latitude-longitude map: .exr (any compression, half or float), .hdr, .png or .jpg (taken as sRGB).

    Small negative texels, which encoders leave, are set to zero and counted.

    Raises
    ------
    UserError
        Missing or unreadable file, a shape other than 2:1, NaN or infinite texels, or (unless ``clamp_negative``)
        negative texels that matter.
    """
    return _whole(file_rows(path), clamp_negative)


def check_names(paths: Sequence[str | Path]) -> None:
    """Raise UserError unless results under maps can be told apart by the names of their files."""
    names = [Path(path).stem for path in paths]
    if len(set(names)) < len(names):
        raise UserError(f"environments must have different names, not {', '.join(names)}; rename one of the files")


def make_environment(
    texels: ArrayLike, *, name: str = "environment", origin: str = "environment", clamp_negative: bool = False
) -> Environment:
    """Check an array (H, W) or (H, W, 3), W = 2H, of radiance and wrap it; see `read_environment`."""
    return _whole(array_rows(texels, name, origin), clamp_negative)


def _whole(rows: Rows, clamp_negative: bool) -> Environment:
    checked = Checked(rows, clamp_negative)
    image = np.concatenate(list(checked))
    if len(image) < 3:  # the smallest that Mitsuba takes
        image = resampled(image, 3, max(image.shape[1], 6))
    return Environment(rows.name, image, np.eye(3), checked.clamped)


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


def project_environment(
    environment: Environment | str | Path | ArrayLike | Any,
    bandlimit: int,
    *,
    rotate: float | ArrayLike = 0.0,
    clamp_negative: bool = False,
) -> NDArray[np.float64]:
    """Spherical-harmonic coefficients of a map's radiance, in world space.

    Exact for maps that are bandlimited themselves; maps of fewer than 8 rows per degree are interpolated first, as
    Mitsuba would. Files (.exr) are read a few rows at a time.

    Parameters
    ----------
    environment : Environment, a path, an array (H, 2H, 3), or an environment emitter of Mitsuba's current variant
    bandlimit : int
    rotate : float or (3, 3)
        Degrees, counter-clockwise about the up axis y; or any rotation of the light.
    clamp_negative : bool
        Of a path or an array: set negative texels to zero however much light they are.

    Returns
    -------
    (3, (L+1)²) float64

    Raises
    ------
    UserError, ValueError
    """
    bandlimit = check_bandlimit(bandlimit)
    return project_checked(environment, bandlimit, rotate=rotate, clamp_negative=clamp_negative)[0]


def project_checked(
    environment: Environment | str | Path | ArrayLike | Any,
    bandlimit: int,
    *,
    rotate: float | ArrayLike = 0.0,
    clamp_negative: bool = False,
) -> tuple[NDArray[np.float64], int]:
    """`project_environment`, and how many negative texels were set to zero."""
    turn = turned(rotate)
    if hasattr(environment, "is_environment"):
        environment = _of_emitter(environment)
    if isinstance(environment, str | Path):
        rows = file_rows(environment)
    elif isinstance(environment, Environment):
        height, width = environment.texels.shape[:2]
        projection = Projection(height, width, bandlimit, turn @ environment.to_world)
        return projection(environment.texels), environment.clamped
    else:
        rows = array_rows(environment, "environment", "environment")
    if not Projection.enough_rows(rows.height, bandlimit):
        return project_checked(_whole(rows, clamp_negative), bandlimit, rotate=turn)
    checked = Checked(rows, clamp_negative)
    lighting = Projection(rows.height, rows.width, bandlimit, turn).of_rows(checked)
    return lighting, checked.clamped


def turned(rotate: float | ArrayLike) -> NDArray[np.float64]:
    """The rotation matrix that ``rotate`` of `project_environment` stands for.

    Raises
    ------
    UserError
        Not finite, or a matrix that is no rotation.
    """
    if hasattr(rotate, "matrix"):  # a transform of Mitsuba
        rotate = np.array(rotate.matrix, dtype=np.float64).reshape(4, 4)[:3, :3]
    try:
        matrix = np.asarray(rotate, dtype=np.float64)
    except (TypeError, ValueError):
        raise UserError(f"rotation must be a number of degrees or a (3, 3) matrix, not {rotate!r}") from None
    if matrix.ndim == 0:
        return about_up(float(matrix))
    if matrix.shape != (3, 3) or not np.all(np.isfinite(matrix)):
        raise UserError(f"rotation must be a number of degrees or a (3, 3) matrix, not of shape {matrix.shape}")
    if np.abs(matrix @ matrix.T - np.eye(3)).max() > 1e-6 or np.linalg.det(matrix) < 0.0:
        raise UserError("rotation must be a rotation matrix: orthogonal, with determinant 1")
    return matrix


def _of_emitter(emitter: Any) -> Environment:
    if not emitter.is_environment():
        raise UserError(f"emitter {emitter.class_name()} is no distant light; give an envmap, a sunsky or a constant")
    import mitsuba as mi

    return emitted_environment(mi, emitter, "emitter")
