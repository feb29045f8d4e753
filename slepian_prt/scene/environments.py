"""Environment maps: read, checked, and projected on spherical harmonics as Mitsuba's ``envmap`` would light with them.

Measured with Mitsuba 3.9: texel (row r, column c) of an H x W map is centred on the direction with
u = (c + ½)/W = atan2(x, -z)/2π and v = r/(H - 1) = acos(y)/π, and the map is interpolated bilinearly. The first and
the last row sit on the poles, half a row off the usual convention.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.errors import UserError, check_bandlimit
from slepian_prt.scene.variants import bitmap_module
from slepian_prt.sphere.harmonics import legendre_polynomials, num_coefficients
from slepian_prt.sphere.rotation import rotate_sh

# More negative energy than this part of the positive is no rounding of an encoder but a broken map.
_NEGATIVE_TOLERANCE = 1e-3
# Rows per degree below which bilinear interpolation matters, and is carried out.
_ROWS_PER_DEGREE = 8

# Grid that a sky without texels is evaluated on: rows, and strata each way per texel.
_SKY_ROWS, _SKY_STRATA = 512, 4

# Columns: where the map's frame (polar axis z, azimuth -2πu from x) goes in Mitsuba's world, y up.
_MAP_TO_WORLD = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])


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
    path = Path(path)
    if path.is_dir():
        raise UserError(f"{path}: is a folder; name an environment map (.exr, .hdr or .png)")
    if not path.is_file():
        raise UserError(f"{path}: no such file; name an environment map (.exr, .hdr or .png)")
    mi = bitmap_module()
    try:
        bitmap = mi.Bitmap(str(path))
        linear = bitmap.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, srgb_gamma=False)
    except Exception as error:  # Mitsuba raises RuntimeError for most, but also others
        reason = " ".join(str(error).split()) or type(error).__name__
        raise UserError(f"{path}: cannot be read as an environment map ({reason}); convert it to .exr") from None
    return make_environment(np.array(linear), name=path.stem, origin=str(path), clamp_negative=clamp_negative)


def make_environment(
    texels: ArrayLike, *, name: str = "environment", origin: str = "environment", clamp_negative: bool = False
) -> Environment:
    """Check an array (H, W) or (H, W, 3), W = 2H, of radiance and wrap it; see `read_environment`."""
    image = np.array(texels, dtype=np.float32)
    if image.ndim == 2:
        image = image[..., None]
    if image.ndim != 3 or image.shape[2] not in (1, 3) or image.shape[0] == 0:
        raise UserError(f"{origin}: an environment map has shape (H, 2H, 3), not {np.shape(texels)}")
    # A copy: Mitsuba takes no read-only views.
    image = np.array(np.broadcast_to(image, (*image.shape[:2], 3)), order="C")
    height, width = image.shape[:2]
    if width != 2 * height:
        raise UserError(
            f"{origin}: is {width} x {height} texels; a latitude-longitude map is twice as wide as high, so convert "
            "it (a cube map or light probe needs to be resampled) or crop it"
        )
    if not np.all(np.isfinite(image)):
        bad = np.argwhere(~np.isfinite(image).all(axis=2))
        raise UserError(
            f"{origin}: {len(bad)} texels are NaN or infinite (the first in row {bad[0][0]}, column {bad[0][1]}); "
            "repair the map"
        )
    negative = image < 0.0
    clamped = int(negative.any(axis=2).sum())
    if clamped:
        sine = np.sin((np.arange(height) + 0.5) * np.pi / height)[:, None, None]
        lost, kept = -np.sum(np.where(negative, image, 0.0) * sine), np.sum(np.where(negative, 0.0, image) * sine)
        if lost > _NEGATIVE_TOLERANCE * kept and not clamp_negative:
            raise UserError(
                f"{origin}: {clamped} texels are negative (down to {image.min():.4g}) and amount to "
                f"{lost / max(kept, 1e-30):.1%} of the light; repair the map, or pass --clamp-negative to set them to "
                "zero"
            )
        image = np.maximum(image, 0.0)
    if height < 3:  # the smallest that Mitsuba takes
        image = _resampled(image, 3, max(width, 6))
    return Environment(name, image, np.eye(3), clamped)


def emitted_environment(mi: Any, emitter: Any, origin: str) -> Environment:
    """A Mitsuba environment emitter (``envmap``, ``constant``, ``sunsky``, …) as a map.

    The texels of an ``envmap`` are taken as they are, with its scale and ``to_world``; others are averaged over each
    texel of a fixed grid, finely enough that the sun keeps its power.
    """
    import drjit as dr

    parameters = mi.traverse(emitter)
    if emitter.class_name() == "EnvironmentMapEmitter":
        # Mitsuba repeats the last column before the first, and the first behind the last.
        texels = np.array(parameters["data"])[:, 1:-1, :3] * float(np.ravel(parameters["scale"])[0])
        world = np.array(parameters["to_world"].matrix, dtype=np.float64).reshape(4, 4)[:3, :3]
        world = world / np.linalg.norm(world, axis=0)
        if np.linalg.det(world) < 0.0:  # mirrored, as many exporters do: the map turned left to right instead
            texels, world = texels[:, ::-1], world * [-1.0, 1.0, 1.0]
        if np.abs(world @ world.T - np.eye(3)).max() > 1e-4:
            raise UserError(f"{origin}: the envmap's to_world shears it; use rotations and mirrorings only")
        made = make_environment(texels, name="scene", origin=f"{origin}: envmap", clamp_negative=True)
        return replace(made, to_world=world)
    height = 3 if emitter.class_name() == "ConstantBackgroundEmitter" else _SKY_ROWS
    finer = 1 if height == 3 else _SKY_STRATA
    width = 2 * height
    # Row r is centred on v = r/(H-1), column c on (c + 1/2)/W; the first and last row are half cells at the poles.
    row, column, i, j = np.meshgrid(
        np.arange(height), np.arange(width), np.arange(finer), np.arange(finer), indexing="ij", sparse=True
    )
    v = np.clip((row + (i + 0.5) / finer - 0.5) / (height - 1), 0.0, 1.0)
    u = (column + (j + 0.5) / finer) / width
    theta, phi = v * np.pi, u * 2.0 * np.pi
    shape = np.broadcast_shapes(row.shape, column.shape, i.shape, j.shape)
    towards = [np.sin(phi) * np.sin(theta), np.cos(theta), -np.cos(phi) * np.sin(theta)]
    d = np.stack([np.broadcast_to(axis, shape).ravel() for axis in towards]).astype(np.float32)
    si = dr.zeros(mi.SurfaceInteraction3f, d.shape[1])
    si.wi = -mi.Vector3f(d)
    radiance = np.array(emitter.eval(si)).T
    radiance = np.broadcast_to(radiance, (d.shape[1], 3)).reshape(*shape, 3)
    solid = np.broadcast_to(np.maximum(np.sin(theta), 1e-6), shape)[..., None]
    texels = np.sum(radiance * solid, axis=(2, 3)) / np.sum(solid, axis=(2, 3))
    return make_environment(texels, name="scene", origin=f"{origin}: {emitter.class_name()}", clamp_negative=True)


def project_environment(
    environment: Environment | str | Path | ArrayLike, bandlimit: int, *, rotate: float = 0.0
) -> NDArray[np.float64]:
    """Spherical-harmonic coefficients of a map's radiance, in world space.

    An FFT along each row and a Legendre sum over the rows; Clenshaw–Curtis weights make it exact for maps that are
    bandlimited themselves. Maps of fewer than 8 rows per degree are interpolated first, as Mitsuba would.

    Parameters
    ----------
    environment : Environment, a path, or an array (H, 2H, 3)
    bandlimit : int
    rotate : float
        Degrees, counter-clockwise about the up axis y.

    Returns
    -------
    (3, (L+1)²) float64

    Raises
    ------
    UserError, ValueError
    """
    bandlimit = check_bandlimit(bandlimit)
    if isinstance(environment, str | Path):
        environment = read_environment(environment)
    elif not isinstance(environment, Environment):
        environment = make_environment(environment)
    environment = environment.rotated(rotate)
    texels = environment.texels
    wanted = _ROWS_PER_DEGREE * (bandlimit + 1) + 1
    if texels.shape[0] < wanted:
        factor = math.ceil(wanted / texels.shape[0])
        texels = _resampled(texels, factor * texels.shape[0] + 1, factor * texels.shape[1])
    height, width = texels.shape[:2]
    rows = np.empty((height, 3, bandlimit + 1), dtype=np.complex128)
    for row in range(height):  # one row in float64 at a time: maps can be large
        rows[row] = np.fft.rfft(texels[row].astype(np.float64), axis=0)[: bandlimit + 1].T
    m = np.arange(bandlimit + 1)
    # ∫ f(φ') e^{-imφ'} dφ' with φ' = -2π(c + ½)/W, the azimuth in the map's frame.
    moments = np.conj(rows * np.exp(-1j * np.pi * m / width)) * (2.0 * np.pi / width)
    theta = np.linspace(0.0, np.pi, height)
    weighted = moments * _clenshaw_curtis(height - 1)[:, None, None]
    coefficients = np.zeros((3, num_coefficients(bandlimit)))
    z, sine = np.cos(theta), np.sin(theta)
    for order in range(bandlimit + 1):
        legendre = legendre_polynomials(bandlimit, order, z) * sine**order
        by_degree = legendre @ weighted[:, :, order]
        l = np.arange(order, bandlimit + 1)
        coefficients[:, l * l + l + order] = by_degree.real.T
        if order:
            coefficients[:, l * l + l - order] = -by_degree.imag.T
    return rotate_sh(coefficients, environment.to_world @ _MAP_TO_WORLD)


@cache
def _clenshaw_curtis(n: int) -> NDArray[np.float64]:
    """Weights of ∫ f(cos θ) sin θ dθ on θ_j = πj/n, j = 0..n, exact for polynomials of degree n."""
    k = np.arange(1, n // 2 + 1)
    b = np.where(2 * k == n, 1.0, 2.0) / (4.0 * k * k - 1.0)
    # The cosine sum is a real FFT of length 2n of coefficients at even frequencies.
    spectrum = np.zeros(n + 1)
    spectrum[0] = 1.0
    np.subtract.at(spectrum, 2 * k, b)
    full = np.zeros(2 * n)
    full[: n + 1] = spectrum
    weights = np.fft.fft(full).real[: n + 1] * (2.0 / n)
    weights[[0, n]] *= 0.5
    weights.setflags(write=False)
    return weights


def _resampled(texels: NDArray, height: int, width: int) -> NDArray[np.float32]:
    """Bilinear interpolation of Mitsuba's convention on a finer grid of the same convention."""
    rows, columns = texels.shape[:2]
    r = np.linspace(0.0, rows - 1.0, height)
    c = (np.arange(width) + 0.5) * columns / width - 0.5
    r0 = np.minimum(r.astype(int), max(rows - 2, 0))
    c0 = np.floor(c).astype(int)
    fr, fc = (r - r0)[:, None, None], (c - c0)[None, :, None]
    r1, c1 = np.minimum(r0 + 1, rows - 1), (c0 + 1) % columns
    c0 = c0 % columns
    top = texels[r0][:, c0] * (1 - fc) + texels[r0][:, c1] * fc
    bottom = texels[r1][:, c0] * (1 - fc) + texels[r1][:, c1] * fc
    return (top * (1 - fr) + bottom * fr).astype(np.float32)
