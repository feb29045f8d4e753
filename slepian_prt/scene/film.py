"""The pixels of a camera as receivers: light that a picture shows, whatever shines."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.scene.mesh import Mesh

# Octahedral coordinates of normals: this many steps from the middle of the square to its border.
_STEPS = 127
_MIDDLE = 128


@dataclass(frozen=True, eq=False)
class FilmOutline:
    """What is known of a film without its pixels.

    Attributes
    ----------
    name : str
    width, height : int
    noise_power : (L+1,)
        As of `Film`.
    """

    name: str
    width: int
    height: int
    noise_power: NDArray[np.float64]

    def relative_noise(self, energy: NDArray[np.float64], power: NDArray[np.float64]) -> float:
        """Relative RMS noise of the picture, averaged over the rotations of a light; 1 where all there is can be noise.

        Parameters
        ----------
        energy : (L+1,)
            Mean squared norm of a transfer vector in each degree, with its noise.
        power : (L+1,)
            Of the light, per harmonic.
        """
        noise, whole = float(power @ self.noise_power), float(power @ energy)
        return math.sqrt(noise / max(whole - noise, noise)) if noise > 0.0 else 0.0


@dataclass(frozen=True, eq=False)
class Film:
    """The film of a camera, whose V = width x height pixels are receivers, row by row from the upper left.

    Attributes
    ----------
    name : str
        Id of the camera.
    width, height : int
        Of the picture, in pixels: of the crop window, where the film has one.
    crop : (int, int)
        Column and row of the film that the picture begins at.
    size : (int, int)
        Width and height of the whole film.
    background : (V, 3) float32
        What part of the light right behind the scene each pixel shows past everything, or through holes and absorbing
        media; it is not in the transfer.
    directions : (k, rows, columns, 3) float32
        World space: where rays go that start on a grid over the picture, corners included, evenly spaced along each
        side; through k points of the aperture. Of such lengths that between the nodes they are linear.
    noise : (V,) float32
        Expected standard deviation of radiance, RMS over the channels, under light of mean radiance 1 whose power falls
        as 1/(l+1)²; zero where it is not known.
    noise_power : (L+1,) float64
        Expected squared norm of the noise of a transfer vector, in each degree.
    """

    name: str
    width: int
    height: int
    crop: tuple[int, int]
    size: tuple[int, int]
    background: NDArray[np.float32]
    directions: NDArray[np.float32]
    noise: NDArray[np.float32]
    noise_power: NDArray[np.float64]

    @property
    def coverage(self) -> NDArray[np.float32]:
        """(V,) part of each pixel that the scene covers: 1 less the mean of ``background``."""
        return np.clip(1.0 - self.background.mean(axis=1), 0.0, 1.0).astype(np.float32)

    def picture(self, values: ArrayLike) -> NDArray[Any]:
        """(…, H, W, …) from values of the pixels (…, V, 3), or (V,)."""
        array = np.asarray(values)
        if array.ndim == 1:
            return array.reshape(self.height, self.width)
        return array.reshape(*array.shape[:-2], self.height, self.width, array.shape[-1])

    def looks(self) -> NDArray[np.float32]:
        """(k, H, W, 3) directions through the middles of the pixels, by interpolation on the grid."""
        across, down = (
            _between(n, m) for n, m in zip((self.width, self.height), self.directions.shape[2:0:-1], strict=True)
        )
        rows = _interpolated(self.directions, 1, *down)
        looks = _interpolated(rows, 2, *across)
        return np.asarray(looks / np.linalg.norm(looks, axis=-1, keepdims=True), dtype=np.float32)

    @property
    def outline(self) -> FilmOutline:
        """What is known of it without its pixels."""
        return FilmOutline(self.name, self.width, self.height, self.noise_power)

    def relative_noise(self, energy: NDArray[np.float64], power: NDArray[np.float64]) -> float:
        """As of `FilmOutline`."""
        return self.outline.relative_noise(energy, power)

    def at_bandlimit(self, bandlimit: int) -> Film:
        """The same with what is known of fewer degrees."""
        return replace(self, noise_power=self.noise_power[: bandlimit + 1])


def _between(pixels: int, nodes: int) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Of the middles of pixels: the grid node before each, and how far it is on the way to the next."""
    place = (np.arange(pixels) + 0.5) / pixels * (nodes - 1)
    before = np.minimum(place.astype(np.int64), max(nodes - 2, 0))
    return before, (place - before).astype(np.float32)


def _interpolated(values: NDArray, axis: int, before: NDArray, part: NDArray) -> NDArray:
    shape = [1] * values.ndim
    shape[axis] = -1
    weight = part.reshape(shape)
    after = np.minimum(before + 1, values.shape[axis] - 1)
    return np.asarray((1.0 - weight) * values.take(before, axis) + weight * values.take(after, axis))


# --- Pixels as a mesh ------------------------------------------------------------------------------------------------


def film_mesh(name: str, width: int, height: int, normals: NDArray, notes: tuple[str, ...] = ()) -> Mesh:
    """Pixels as the vertices of a flat mesh, of unit albedo: what compression knows of them.

    Pixel (column, row) lies at (column, row, 0), and each square of four is cut into two triangles, along the diagonal
    from upper right to lower left.

    Parameters
    ----------
    name : str
    width, height : int
    normals : (V, 3)
        Axes of the pixels, zero where no light arrives.
    notes : tuple of str
    """
    rows, columns = np.divmod(np.arange(width * height), width)
    positions = np.stack([columns, rows, np.zeros_like(rows)], axis=1).astype(np.float64)
    corner = (np.arange(height - 1)[:, None] * width + np.arange(width - 1)).ravel()
    upper = np.stack([corner, corner + 1, corner + width], axis=1)
    lower = np.stack([corner + 1, corner + width + 1, corner + width], axis=1)
    faces = np.concatenate([upper, lower]).astype(np.int32)
    albedo = np.ones((width * height, 3), dtype=np.float32)
    return Mesh(name, positions, normals, faces, albedo, notes, known_albedo=True)


def pack_axes(axes: NDArray) -> NDArray[np.uint8]:
    """(2, V) octahedral coordinates (Meyer et al. 2010) of unit vectors (V, 3) in 8 bits; zero of zero vectors.

    The octahedron |x| + |y| + |z| = 1 is unfolded to a square. Axes that are read back differ by less than 1 degree.
    """
    length = np.abs(axes).sum(axis=1, keepdims=True)
    flat = axes / np.maximum(length, 1e-300)
    square = np.where(
        flat[:, 2:] < 0.0, (1.0 - np.abs(flat[:, 1::-1])) * np.where(flat[:, :2] < 0.0, -1.0, 1.0), flat[:, :2]
    )
    steps = np.rint(square * _STEPS).astype(np.int64)
    # Opposite points of each side of the square are the same: one of them is kept, so that what was read packs alike.
    on_side = np.abs(steps[:, ::-1]) == _STEPS
    steps = np.where(on_side, np.abs(steps), steps) + _MIDDLE
    steps[length[:, 0] == 0.0] = 0
    return np.ascontiguousarray(steps.T).astype(np.uint8)


def unpack_axes(packed: NDArray[np.uint8]) -> NDArray[np.float64]:
    """(V, 3) unit vectors, or zero, from what `pack_axes` gives."""
    u, v = (packed.astype(np.float64) - _MIDDLE) / _STEPS
    z = 1.0 - np.abs(u) - np.abs(v)
    folded = np.maximum(-z, 0.0)
    x = u - np.where(u < 0.0, -1.0, 1.0) * folded
    y = v - np.where(v < 0.0, -1.0, 1.0) * folded
    axes = np.stack([x, y, z], axis=1)
    axes /= np.sqrt(x * x + y * y + z * z)[:, None]  # in this order: the same on every machine
    axes[(packed == 0).all(axis=0)] = 0.0
    return axes


def stored_axes(axes: NDArray) -> NDArray[np.float64]:
    """(V, 3) axes as they are read back from a file: what bases must be made for."""
    return unpack_axes(pack_axes(axes))
