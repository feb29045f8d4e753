"""The distant light of a Mitsuba scene as spherical harmonics on Dr.Jit's arrays, with gradients."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.errors import UserError
from slepian_prt.lighting.emitters import envmap_rotation, is_envmap, sky_grid
from slepian_prt.lighting.texel_projection import Projection
from slepian_prt.relighting.operator import transfer_operator
from slepian_prt.relighting.relight import negative_fraction
from slepian_prt.sphere.harmonics import degrees

# Wavelengths, in nm, that spectra are integrated at.
_FROM, _TO, _STEP = 360.0, 830.0, 5.0


def linear(apply: Callable[[NDArray], NDArray], transpose: Callable[[NDArray], NDArray], value: Any, kind: Any) -> Any:
    """A linear map of numpy arrays as an operation of Dr.Jit that gradients go through both ways.

    Parameters
    ----------
    apply, transpose : callable
        Of flat arrays.
    value : Dr.Jit array or tensor
    kind : type
        Of the flat result.
    """
    import drjit as dr

    class Linear(dr.CustomOp):
        def eval(self, value: Any) -> Any:
            return kind(_flat(apply(np.array(value).ravel())))

        def forward(self) -> None:
            self.set_grad_out(kind(_flat(apply(np.array(self.grad_in("value")).ravel()))))

        def backward(self) -> None:
            back = _flat(transpose(np.array(self.grad_out()).ravel()))
            flat = dr.array_t(value)(back)
            self.set_grad_in("value", type(value)(flat, value.shape) if dr.is_tensor_v(value) else flat)

    return dr.custom(Linear, value)


def _flat(values: NDArray) -> NDArray[np.float32]:
    return np.ascontiguousarray(values, dtype=np.float32).ravel()


class Relit:
    """Radiance of the vertices of a file for unit albedo, under the light of a scene as it is when asked.

    Parameters
    ----------
    mi : Mitsuba, in the variant of the scene
    packed : CompressedTransfer
    turn : (3, 3)
        Rotation from the scene to the world of the file.
    damping : (L+1,)
        Factor of each degree of the light.

    Attributes
    ----------
    negative : float
        Part of the vertices that were negative under the last light, by `negative_fraction`.
    """

    def __init__(
        self, mi: Any, packed: CompressedTransfer, turn: NDArray[np.float64], damping: NDArray[np.float64]
    ) -> None:
        self._mi, self._packed, self._turn = mi, packed, turn
        self._damping = np.tile(damping[degrees(packed.bandlimit)], 3).astype(np.float32)
        self.negative = 0.0
        self._seen: list[tuple[str, Any]] | None = None
        self._radiance: Any = None

    def under(self, emitter: Any) -> Any:
        """(3 V,) flat Float; what was computed last if the emitter is as it was then."""
        import drjit as dr

        mi = self._mi
        if emitter is None:
            return dr.zeros(mi.Float, self._packed.mesh.albedo.size)
        # Copies: what `mi.traverse` gives changes with the emitter. Those of arrays are of their handles only.
        seen = [
            (name, type(value)(value) if dr.is_array_v(value) else repr(value))
            for name, value in mi.traverse(emitter).items()
        ]
        if self._seen is not None and _unchanged(self._seen, seen):
            return self._radiance
        light = distant_light(mi, emitter, self._packed.bandlimit, self._turn) * mi.Float(self._damping)
        operator = transfer_operator(self._packed)

        def apply(coefficients: NDArray) -> NDArray:
            return operator.apply(coefficients.reshape(1, 3, -1))[0]

        def transpose(radiance: NDArray) -> NDArray:
            return operator.adjoint(radiance.reshape(1, -1, 3))[0]

        radiance = linear(apply, transpose, light, mi.Float)
        if not dr.grad_enabled(radiance):
            self._seen, self._radiance = seen, radiance
            self.negative = negative_fraction(np.array(radiance).reshape(-1, 3))
        return radiance


def _unchanged(before: list[tuple[str, Any]], now: list[tuple[str, Any]]) -> bool:
    """Whether the parameters of an emitter are the same; not so while gradients are followed."""
    import drjit as dr

    if [name for name, _ in before] != [name for name, _ in now]:
        return False
    for (_, old), (_, new) in zip(before, now, strict=True):
        if not dr.is_array_v(new):
            if old != new:
                return False
            continue
        if dr.grad_enabled(new) or type(old) is not type(new) or old.shape != new.shape:
            return False
        a, b = (x.array if dr.is_tensor_v(x) else x for x in (old, new))
        # Equal indices are the same array in memory; others are compared, which is still faster than relighting.
        if getattr(a, "index", -1) != getattr(b, "index", -2) and not np.array_equal(np.array(a), np.array(b)):
            return False
    return True


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
    import drjit as dr

    if is_envmap(emitter) and not mi.is_spectral:
        parameters = mi.traverse(emitter)
        data = parameters["data"]
        height, halo, channels = data.shape
        mirrored, world = envmap_rotation(parameters["to_world"], "envmap")
        projection = Projection(height, halo - 2, bandlimit, turn @ world)

        def apply(texels: NDArray) -> NDArray:
            # Mitsuba repeats the last column before the first, and the first behind the last.
            own = _finite(texels.reshape(height, halo, channels)[:, 1:-1])
            return projection(own[:, ::-1] if mirrored else own)

        def transpose(coefficients: NDArray) -> NDArray:
            texels = np.zeros((height, halo, channels), dtype=np.float32)
            own = projection.adjoint(coefficients.reshape(channels, -1))
            texels[:, 1:-1] = own[:, ::-1] if mirrored else own
            return texels

        return linear(apply, transpose, data, mi.Float) * dr.ravel(mi.Float(parameters["scale"]))
    grid = sky_grid(mi, emitter, emitter.class_name())
    projection = Projection(grid.height, grid.width, bandlimit, turn @ grid.to_world)
    si = dr.zeros(mi.SurfaceInteraction3f, len(grid.directions))
    si.wi = -mi.Vector3f(grid.directions.T.astype(np.float32))
    # What is the same in all directions comes as one number.
    colour = dr.ravel(_colour(mi, emitter, si) + dr.zeros(mi.Color3f, len(grid.directions)))

    def mean(samples: NDArray) -> NDArray:
        return projection(grid.averaged(_finite(samples.reshape(-1, 3))))

    def spread(coefficients: NDArray) -> NDArray:
        return grid.spread(projection.adjoint(coefficients.reshape(3, -1)))

    return linear(mean, spread, colour, mi.Float)


def _finite(texels: NDArray) -> NDArray:
    if not np.all(np.isfinite(texels)):
        raise UserError("the light of the scene has texels that are NaN or infinite; repair the map")
    return texels


def _colour(mi: Any, emitter: Any, si: Any) -> Any:
    """Linear sRGB of the radiance that comes from where ``si`` looks."""
    if not mi.is_spectral:
        colour = mi.unpolarized_spectrum(emitter.eval(si))
        return mi.Color3f(colour) if mi.is_rgb else mi.Color3f(colour[0])
    xyz = mi.Color3f(0.0)
    count = len(si.wavelengths)
    wavelengths = np.arange(_FROM + 0.5 * _STEP, _TO, _STEP)
    for begin in range(0, wavelengths.size, count):
        some = wavelengths[begin : begin + count]
        si.wavelengths = type(si.wavelengths)(np.resize(some, count).tolist())
        seen = mi.unpolarized_spectrum(emitter.eval(si))
        for i in range(some.size):
            xyz += seen[i] * mi.cie1931_xyz(si.wavelengths[i]) * _STEP
    return mi.xyz_to_srgb(xyz)


def smooth_spectra(mi: Any) -> NDArray[np.float64]:
    """(3, 3) from linear sRGB to the coefficients of `smooth_basis` that give a spectrum of that colour.

    It is linear in the colour, so that negative radiance (ringing) and gradients are as in RGB, and smooth, so that
    reflectances change its colour about as they do in RGB.
    """
    wavelengths = np.arange(_FROM, _TO + 0.5, 1.0)
    matching = np.array([np.array(part) for part in mi.cie1931_xyz(mi.Float(wavelengths.astype(np.float32)))])
    to_xyz = np.array([np.array(mi.srgb_to_xyz(mi.Color3f(*unit))).ravel() for unit in np.eye(3).tolist()]).T
    return np.asarray(np.linalg.solve(matching.astype(np.float64) @ np.stack(smooth_basis(wavelengths)).T, to_xyz))


def smooth_basis(wavelength: Any) -> list[Any]:
    """Polynomials of the wavelength in nm up to degree two."""
    x = (wavelength - 0.5 * (_FROM + _TO)) / (0.5 * (_TO - _FROM))
    return [0.0 * x + 1.0, x, x * x]
