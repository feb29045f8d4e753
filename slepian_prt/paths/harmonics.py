"""Spherical harmonics on Mitsuba's arrays, and transfer vectors as sums over paths."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.paths.tracer import PathEnds
from slepian_prt.renderer import variants
from slepian_prt.sphere.harmonics import legendre_factors, num_coefficients


def sh_values(mi: Any, bandlimit: int, direction: Any) -> list[Any]:
    """All (L+1)² real spherical harmonics (list of Float) of unit vectors (Vector3f), as `real_sh`, in float32.

    ``drjit.sh_eval`` ends at degree 9.
    """
    import drjit as dr

    start, a, b = (table.astype(np.float32).tolist() for table in legendre_factors(bandlimit))
    x, y, z = direction
    values: list[Any] = [None] * num_coefficients(bandlimit)
    cos_m, sin_m = dr.full(mi.Float, 1.0, dr.width(x)), mi.Float(0.0)  # sin^m θ cos mφ = Re (x + iy)^m
    for m in range(bandlimit + 1):
        before, p = mi.Float(0.0), mi.Float(start[m])
        for l in range(m, bandlimit + 1):
            if l > m:
                before, p = p, a[l][m] * z * p - b[l][m] * before
            values[l * l + l + m] = p * cos_m
            if m:
                values[l * l + l - m] = p * sin_m
        cos_m, sin_m = x * cos_m - y * sin_m, x * sin_m + y * cos_m
    return values


# Paths that are added in one go, between which the sums stay in registers.
_UNROLLED = 4

# Numbers in the harmonics of paths that are multiplied at a time on a graphics card, and receivers by one call.
_NUMBERS = 1 << 26
_MOST_RECEIVERS = 65535


class PathSums(NamedTuple):
    """Sums over the paths of n receivers.

    Attributes
    ----------
    vectors : (n, 3, (L+1)²) float32
        Σ β y_lm(ω) of the paths that escape.
    squares : (n, 3) float32
        Σ β², which give the second moments of all degrees: by the addition theorem Σ_m (β y_lm)² = β² (2l+1)/4π.
    """

    vectors: NDArray[np.float32]
    squares: NDArray[np.float32]


def sum_paths(mi: Any, bandlimit: int, ends: PathEnds, per_receiver: int) -> PathSums:
    """Add up what paths contribute that escape.

    Parameters
    ----------
    mi : Mitsuba
    bandlimit : int
    ends : PathEnds
        The paths of a receiver side by side.
    per_receiver : int
        How many of them each has.
    """
    import drjit as dr

    β, direction = dr.select(ends.escaped, ends.throughput, 0.0), mi.Vector3f(ends.ray.d)
    dr.eval(β, direction)
    by = sum_by_products if variants.is_on_device(mi) else sum_by_loops
    return by(mi, bandlimit, β, direction, per_receiver)


def sum_by_loops(mi: Any, bandlimit: int, β: Any, direction: Any, per_receiver: int) -> PathSums:
    """Each lane a receiver, whose hundreds of sums a processor keeps in its first-level cache."""
    import drjit as dr

    size = num_coefficients(bandlimit)
    count = dr.width(β) // per_receiver
    first = dr.arange(mi.UInt32, count) * dr.opaque(mi.UInt32, per_receiver)
    sums = [mi.Float(0.0) for _ in range(3 * size + 3)]

    # A receiver's sums stay in the first-level cache, and are added in the same order every time.
    def add(path: Any, *sums: Any) -> tuple[Any, ...]:
        terms = list(sums)
        for step in range(_UNROLLED):
            inside = path + step < end
            here = dr.gather(mi.Color3f, β, path + step, inside)
            values = sh_values(mi, bandlimit, dr.gather(mi.Vector3f, direction, path + step, inside))
            for c in range(3):
                for i, value in enumerate(values):
                    terms[c * size + i] = dr.fma(here[c], value, terms[c * size + i])
                terms[3 * size + c] = dr.fma(here[c], here[c], terms[3 * size + c])
        return path + _UNROLLED, *terms

    end = first + dr.opaque(mi.UInt32, per_receiver)
    _, *sums = dr.while_loop((first, *sums), lambda path, *_: path < end, add, label="slepian_prt: sums over paths")
    row = dr.arange(mi.UInt32, count) * len(sums)
    table = dr.zeros(mi.Float, count * len(sums))
    for column, values in enumerate(sums):
        dr.scatter(table, values, row + column, mode=dr.ReduceMode.NoConflicts)
    rows = np.array(table).reshape(count, len(sums))
    return PathSums(rows[:, : 3 * size].reshape(count, 3, size), rows[:, 3 * size :])


def sum_by_products(mi: Any, bandlimit: int, β: Any, direction: Any, per_receiver: int) -> PathSums:
    """Each lane a path, and a product of matrices for each receiver: no thread of a card has room for the sums."""
    import drjit as dr

    size, count = num_coefficients(bandlimit), dr.width(β) // per_receiver
    vectors, squares = [], []
    step = max(1, min(_MOST_RECEIVERS, _NUMBERS // (per_receiver * size)))
    for begin in range(0, count, step):
        some = min(step, count - begin)
        path = dr.arange(mi.UInt32, some * per_receiver)
        place = path + begin * per_receiver
        values = sh_values(mi, bandlimit, dr.gather(mi.Vector3f, direction, place))
        harmonics = dr.zeros(mi.Float, some * per_receiver * size)
        for i, value in enumerate(values):
            dr.scatter(harmonics, value, path * size + i, mode=dr.ReduceMode.NoConflicts)
        receiver = path // dr.opaque(mi.UInt32, per_receiver)
        carried, here = dr.zeros(mi.Float, 3 * some * per_receiver), dr.gather(mi.Color3f, β, place)
        for c in range(3):
            row = path + (2 * receiver + c) * per_receiver  # (3 receiver + c) per_receiver, and which of its paths
            dr.scatter(carried, here[c], row, mode=dr.ReduceMode.NoConflicts)
        sums: Any = dr.matmul(
            mi.TensorXf(carried, (some, 3, per_receiver)), mi.TensorXf(harmonics, (some, per_receiver, size))
        )
        vectors.append(np.array(sums))
        squares.append(np.array(dr.block_sum(dr.square(carried), per_receiver)).reshape(some, 3))
    return PathSums(np.concatenate(vectors), np.concatenate(squares))
