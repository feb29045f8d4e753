"""The distant light of a Mitsuba scene as spherical harmonics on Dr.Jit's arrays, with gradients."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.lighting.emitters import envmap_rotation, is_envmap, sky_grid
from slepian_prt.lighting.texel_projection import TexelProjection
from slepian_prt.relighting.mitsuba.linear_op import linear_op
from slepian_prt.relighting.mitsuba.spectra import emitted_srgb


def distant_light(mi: Any, emitter: Any, bandlimit: int, turn: NDArray[np.float64]) -> Any:
    """Coefficients of an environment emitter's radiance, 3 (L+1)² of them, red, green and blue one after the other.

    Parameters
    ----------
    mi : Mitsuba, in the variant of the emitter
    emitter : ``envmap``, ``constant``, ``sunsky`` or another environment emitter
    bandlimit : int
    turn : (3, 3)
        Rotation of the light.

    Raises
    ------
    UserError
        Texels that are not finite, or a ``to_world`` that shears.
    """
    if is_envmap(emitter) and not mi.is_spectral:
        return _project_texels(mi, emitter, bandlimit, turn)
    return _project_samples(mi, emitter, bandlimit, turn)


def _project_texels(mi: Any, emitter: Any, bandlimit: int, turn: NDArray[np.float64]) -> Any:
    """Of an ``envmap``; gradients go to its texels and its scale."""
    import drjit as dr

    parameters = mi.traverse(emitter)
    data = parameters["data"]
    height, stored_width, channels = data.shape
    mirrored, world = envmap_rotation(parameters["to_world"], "envmap")
    projection = TexelProjection(height, stored_width - 2, bandlimit, turn @ world)
    columns = slice(None, None, -1 if mirrored else 1)

    def project(texels: NDArray) -> NDArray:
        # Mitsuba repeats the last column before the first, and the first behind the last.
        stored = texels.reshape(height, stored_width, channels)
        return projection(_check_finite(stored[:, 1:-1])[:, columns])

    def adjoint(coefficients: NDArray) -> NDArray:
        stored = np.zeros((height, stored_width, channels), dtype=np.float32)
        stored[:, 1:-1] = projection.adjoint(coefficients.reshape(channels, -1))[:, columns]
        return stored

    return linear_op(project, adjoint, data, mi.Float) * dr.ravel(mi.Float(parameters["scale"]))


def _project_samples(mi: Any, emitter: Any, bandlimit: int, turn: NDArray[np.float64]) -> Any:
    """Of any environment emitter, evaluated on a grid of directions."""
    import drjit as dr

    grid = sky_grid(mi, emitter, emitter.class_name())
    projection = TexelProjection(grid.height, grid.width, bandlimit, turn @ grid.to_world)
    si = dr.zeros(mi.SurfaceInteraction3f, len(grid.directions))
    si.wi = -mi.Vector3f(grid.directions.T.astype(np.float32))
    # What is the same in all directions comes as one number.
    srgb = dr.ravel(emitted_srgb(mi, emitter, si) + dr.zeros(mi.Color3f, len(grid.directions)))

    def project(samples: NDArray) -> NDArray:
        return projection(grid.averaged(_check_finite(samples.reshape(-1, 3))))

    def adjoint(coefficients: NDArray) -> NDArray:
        return grid.spread(projection.adjoint(coefficients.reshape(3, -1)))

    return linear_op(project, adjoint, srgb, mi.Float)


def _check_finite(texels: NDArray) -> NDArray:
    if not np.all(np.isfinite(texels)):
        raise UserError("the light of the scene has texels that are NaN or infinite; repair the map")
    return texels
