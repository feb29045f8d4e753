"""What transfer vectors must be, wherever they came from, checked where they enter."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slepian_prt.arrays import real_numbers
from slepian_prt.errors import UserError, check_bandlimit
from slepian_prt.sphere.harmonics import num_coefficients

if TYPE_CHECKING:
    from slepian_prt.transport.transfer import Transfer

# Of the largest coefficient. An unshadowed vertex has 0.28 under light of radiance 1, so that nothing that light does
# comes near; squares of these, and sums of squares over all vertices, stay within float32.
LARGEST = 1e12
SMALLEST = 1e-12


def check_vectors(transfer: Transfer) -> None:
    """Raise UserError for vectors of another shape or type than `Transfer` has, not finite, or out of range."""
    vectors, count = transfer.vectors, len(transfer.mesh.positions)
    size = num_coefficients(check_bandlimit(transfer.bandlimit))
    if not isinstance(vectors, np.ndarray) or vectors.dtype.kind != "f":
        kind = getattr(vectors, "dtype", type(vectors).__name__)
        raise UserError(f"transfer vectors must be an array of floating-point numbers, not {kind}")
    if vectors.shape not in ((count, 1, size), (count, 3, size)):
        raise UserError(
            f"transfer vectors must have shape ({count}, 1 or 3, {size}), for {count} vertices and bandlimit "
            f"{transfer.bandlimit}, not {vectors.shape}"
        )
    largest = max(float(vectors.max(initial=0.0)), -float(vectors.min(initial=0.0)))  # NaN and infinity come through
    if not np.isfinite(largest):
        check_finite(vectors)
    if largest > LARGEST or 0.0 < largest < SMALLEST:
        raise UserError(
            f"the largest coefficient of the transfer vectors must lie within {SMALLEST:g} and {LARGEST:g}, not be "
            f"{largest:g}; unshadowed vertices have 0.28"
        )


def check_axes(transfer: Transfer) -> None:
    """Raise UserError for axes that are not (V, 3) finite numbers."""
    axes, count = real_numbers(transfer.axes, "axes of the transfer"), len(transfer.mesh.positions)
    if axes.shape != (count, 3) or not np.all(np.isfinite(axes)):
        raise UserError(f"axes of the transfer must be ({count}, 3) finite numbers, not of shape {axes.shape}")


def check_finite(vectors: NDArray) -> None:
    """Raise UserError if a vector of (V, channels, n) is not finite."""
    wrong = ~np.isfinite(vectors).all(axis=tuple(range(1, vectors.ndim)))
    if wrong.any():
        raise UserError(
            f"the transfer vectors of {int(wrong.sum())} of {wrong.size} vertices are not finite, the first of vertex "
            f"{int(np.argmax(wrong))}; precompute the transfer again"
        )
