"""The distant light of a Mitsuba scene as spherical harmonics on Dr.Jit's arrays, with gradients."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.lighting.emitters import (
    check_radiance,
    emitted_srgb,
    envmap_rotation,
    evaluate,
    is_envmap,
    texel_grid,
)
from slepian_prt.lighting.sky import is_sky, sky_quadrature
from slepian_prt.lighting.texel_projection import TexelProjection
from slepian_prt.relighting.mitsuba.device_envmap import DeviceEnvmap
from slepian_prt.relighting.mitsuba.linear_op import linear_op


class EnvmapTables:
    """The last map that was projected on the device, so that one whose texels change is not prepared again."""

    def __init__(self) -> None:
        self._key: tuple[Any, ...] = ()
        self._map: Any = None

    def of(self, mi: Any, projection: TexelProjection, mirrored: bool) -> DeviceEnvmap:
        """What projects such a map."""
        shape = projection.height, projection.width, projection.bandlimit
        key = (mi.variant(), mirrored, *shape, projection.to_world.tobytes())
        if key != self._key:
            self._key, self._map = key, DeviceEnvmap(mi, projection, mirrored=mirrored)
        return self._map


def distant_light(
    mi: Any, emitter: Any, bandlimit: int, turn: NDArray[np.float64], tables: EnvmapTables | None = None
) -> Any:
    """Coefficients of an environment emitter's radiance, 3 (L+1)² of them, red, green and blue one after the other.

    Parameters
    ----------
    mi : Mitsuba, in the variant of the emitter
    emitter : ``envmap``, ``constant``, ``sunsky`` or another environment emitter
    bandlimit : int
    turn : (3, 3)
        Rotation of the light.
    tables : EnvmapTables, optional
        With it, texels of an ``envmap`` are projected where they are, by Dr.Jit; without, by NumPy.

    Raises
    ------
    UserError
        Radiance that is not finite or too bright, a ``to_world`` that shears, or gradients asked of where the sun is.
    """
    if is_sky(emitter):
        return _project_sky(mi, emitter, bandlimit, turn)
    if is_envmap(emitter) and not mi.is_spectral:
        return _project_texels(mi, emitter, bandlimit, turn, tables)
    return _project_samples(mi, emitter, bandlimit, turn)


def _project_texels(
    mi: Any, emitter: Any, bandlimit: int, turn: NDArray[np.float64], tables: EnvmapTables | None
) -> Any:
    """Of an ``envmap``; gradients go to its texels and its scale."""
    import drjit as dr

    parameters = mi.traverse(emitter)
    data = parameters["data"]
    height, stored_width, channels = data.shape
    mirrored, world = envmap_rotation(parameters["to_world"], "envmap")
    projection = TexelProjection(height, stored_width - 2, bandlimit, turn @ world)
    if tables is not None:
        return tables.of(mi, projection, mirrored).light(data) * dr.ravel(mi.Float(parameters["scale"]))
    columns = slice(None, None, -1 if mirrored else 1)

    def project(texels: NDArray) -> NDArray:
        # Mitsuba repeats the last column before the first, and the first behind the last.
        stored = texels.reshape(height, stored_width, channels)
        return projection(check_radiance(stored[:, 1:-1], "envmap")[:, columns])

    def adjoint(coefficients: NDArray) -> NDArray:
        stored = np.zeros((height, stored_width, channels), dtype=np.float32)
        stored[:, 1:-1] = projection.adjoint(coefficients.reshape(channels, -1))[:, columns]
        return stored

    return linear_op(project, adjoint, data, mi.Float) * dr.ravel(mi.Float(parameters["scale"]))


def _project_sky(mi: Any, emitter: Any, bandlimit: int, turn: NDArray[np.float64]) -> Any:
    """Of a ``sunsky``; gradients go to its radiance in fixed directions."""
    import drjit as dr

    name = emitter.class_name()
    if dr.grad_enabled(mi.traverse(emitter).get("sun_direction", 0.0)):
        raise UserError(f"{name}: gradients do not go to sun_direction, which moves the rim of the sun; disable them")
    quadrature = sky_quadrature(mi, emitter, lambda directions: evaluate(mi, emitter, directions), name)

    def project(samples: NDArray) -> NDArray:
        return quadrature.project(check_radiance(samples.reshape(-1, 3), name), bandlimit, turn)

    def adjoint(coefficients: NDArray) -> NDArray:
        return quadrature.adjoint(coefficients.reshape(3, -1), turn)

    return linear_op(project, adjoint, _radiance(mi, emitter, quadrature.directions), mi.Float)


def _project_samples(mi: Any, emitter: Any, bandlimit: int, turn: NDArray[np.float64]) -> Any:
    """Of any environment emitter, evaluated on a grid of directions."""
    name = emitter.class_name()
    grid = texel_grid(mi, emitter, name)
    projection = TexelProjection(grid.height, grid.width, bandlimit, turn @ grid.to_world)

    def project(samples: NDArray) -> NDArray:
        return projection(grid.averaged(check_radiance(samples.reshape(-1, 3), name)))

    def adjoint(coefficients: NDArray) -> NDArray:
        return grid.spread(projection.adjoint(coefficients.reshape(3, -1)))

    return linear_op(project, adjoint, _radiance(mi, emitter, grid.directions), mi.Float)


def _radiance(mi: Any, emitter: Any, directions: NDArray[np.float64]) -> Any:
    """(3 n,) linear sRGB in directions (n, 3), followed by gradients."""
    import drjit as dr

    si = dr.zeros(mi.SurfaceInteraction3f, len(directions))
    si.wi = -mi.Vector3f(directions.T.astype(np.float32))
    # What is the same in all directions comes as one number.
    return dr.ravel(emitted_srgb(mi, emitter, si) + dr.zeros(mi.Color3f, len(directions)))
