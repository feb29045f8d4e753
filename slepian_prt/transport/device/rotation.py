"""Rotation of real spherical harmonic expansions on Mitsuba's arrays, each by a rotation of its own.

As `rotate_sh`: R = Rz(α) Ry(β) Rz(γ) with Ry(β) = Jᵀ Z(β) J. All degrees are turned at once, and J is one matrix of
blocks along its diagonal: eleven times as many products as there are in the blocks at L = 10, and for a graphics card
still less work than to launch a kernel for each degree.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.sphere.harmonics import num_coefficients, orders
from slepian_prt.sphere.rotation import to_y_axis
from slepian_prt.transport.hemisphere import pairs

# Numbers that are read and written in one go: rows of vectors are padded to whole packets.
PACKET = 4


def padded(size: int) -> int:
    """Columns of rows of ``size`` numbers with zeros behind, in whole packets."""
    return -(-size // PACKET) * PACKET


def padded_rows(values: NDArray, columns: int) -> NDArray[np.float32]:
    """(n, columns) float32 of (n, k) values with zeros behind; the values themselves where they are that already."""
    if values.shape[1] == columns:
        return np.ascontiguousarray(values, dtype=np.float32)
    rows = np.zeros((len(values), columns), dtype=np.float32)
    rows[:, : values.shape[1]] = values
    return rows


class DeviceRotation:
    """Rotates vectors from the frames of receivers into the world.

    Parameters
    ----------
    mi : Mitsuba
    bandlimit : int

    Attributes
    ----------
    columns : int
        Of rows of vectors: (L+1)², padded.
    """

    def __init__(self, mi: Any, bandlimit: int) -> None:
        size = num_coefficients(bandlimit)
        self._mi, self.columns = mi, padded(size)
        order = np.zeros(self.columns)
        order[:size] = orders(bandlimit)
        mirrored = np.arange(self.columns)
        mirrored[:size] -= 2 * orders(bandlimit)
        to_y = np.zeros((self.columns, self.columns), dtype=np.float32)
        for l in range(bandlimit + 1):
            degree = slice(l * l, (l + 1) ** 2)
            to_y[degree, degree] = to_y_axis(l)
        self._order, self._mirrored = mi.Float64(order), mi.UInt32(mirrored.astype(np.uint32))
        self._to_y = mi.TensorXf(to_y)

    def into_world(self, vectors: Any, angles: NDArray[np.float64]) -> Any:
        """Float (n columns) of vectors in the world, from those in frames Rz(α) Ry(β) Rz(γ).

        Parameters
        ----------
        vectors : Float (n columns)
        angles : (3, n)
            α, β and γ.
        """
        import drjit as dr

        shape = (angles.shape[1], self.columns)
        about_z = self._mi.TensorXf(self._turned(vectors, angles[2]), shape)
        about_y: Any = dr.matmul(about_z, self._to_y, Bt=True)
        about_y = dr.matmul(self._mi.TensorXf(self._turned(about_y.array, angles[1]), shape), self._to_y)
        return self._turned(about_y.array, angles[0])

    def _turned(self, vectors: Any, angles: NDArray[np.float64]) -> Any:
        """The vectors turned about z, each by its angle."""
        import drjit as dr

        mi = self._mi
        row, column = pairs(mi, len(angles), self.columns)
        # Multiples of angles in float32 would lose what their whole turns take.
        angle = dr.gather(mi.Float64, mi.Float64(angles), row) * dr.gather(mi.Float64, self._order, column)
        angle -= dr.round(angle * (0.5 / math.pi)) * (2.0 * math.pi)
        sine, cosine = dr.sincos(mi.Float(angle))
        other = row * dr.opaque(mi.UInt32, self.columns) + dr.gather(mi.UInt32, self._mirrored, column)
        return vectors * cosine - dr.gather(mi.Float, vectors, other) * sine


def angles_of(axes: NDArray[np.float64], turns: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, n) angles α, β and γ of the frames that `turned_frames` makes of axes (n, 3) and turns (n,)."""
    sine = np.hypot(axes[:, 0], axes[:, 1])
    alpha = np.where(sine == 0.0, 0.0, np.arctan2(axes[:, 1], axes[:, 0]))
    return np.stack([alpha, np.arctan2(sine, axes[:, 2]), turns])
