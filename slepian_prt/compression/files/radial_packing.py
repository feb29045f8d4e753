"""Radial bases as arrays of a file."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.linear_basis import LinearBasis


def pack_radial(bases: tuple[LinearBasis, ...]) -> dict[str, NDArray]:
    """Arrays that hold the radial bases of all caps, each function once.

    Caps of the same shared half-angle have the same functions, and so have the orders m and -m; coefficients of
    degrees below |m| are zero. Stored are one table of functions per family of caps, the family of each cap, and for
    each function whether it repeats the one before it.
    """
    families: list[tuple[NDArray[np.int16], NDArray]] = []
    family = np.zeros(len(bases), dtype=np.uint16)
    for i, basis in enumerate(bases):
        if basis.orders is None or basis.radial is None:
            raise ValueError("all bases must be radial")
        mine = (basis.orders, basis.radial)
        for j, known in enumerate(families):
            k = min(len(mine[0]), len(known[0]))
            if np.array_equal(mine[0][:k], known[0][:k]) and np.array_equal(mine[1][:k], known[1][:k]):
                families[j], family[i] = (mine if len(mine[0]) > k else known), j
                break
        else:
            family[i] = len(families)
            families.append(mine)
    repeats, values = [], []
    for orders, radial in families:
        for k, (m, row) in enumerate(zip(orders, radial, strict=True)):
            repeats.append(k > 0 and np.array_equal(row, radial[k - 1]))
            if not repeats[-1]:
                values.append(row[abs(m) :])
    return {
        "radial/family": family,
        "radial/count": np.array([len(orders) for orders, _ in families], dtype=np.uint16),
        "radial/order": np.concatenate([orders for orders, _ in families]),
        "radial/repeats": np.packbits(repeats),
        "radial/values": np.concatenate(values),
    }


def unpack_radial(
    arrays: dict[str, NDArray], terms: NDArray, bandlimit: int
) -> tuple[list[NDArray[np.int16]], list[NDArray]]:
    """Orders and radial coefficients of each cap from what `pack_radial` made."""
    counts, orders = arrays["radial/count"].astype(np.int64), arrays["radial/order"]
    repeats = np.unpackbits(arrays["radial/repeats"], count=orders.size).astype(bool)
    radial = np.zeros((orders.size, bandlimit + 1), dtype=arrays["radial/values"].dtype)
    taken = 0
    for k, m in enumerate(np.abs(orders.astype(np.int64)).tolist()):
        if repeats[k]:
            radial[k] = radial[k - 1]
        else:
            radial[k, m:] = arrays["radial/values"][taken : taken + bandlimit + 1 - m]
            taken += bandlimit + 1 - m
    starts = np.concatenate([[0], np.cumsum(counts)])[arrays["radial/family"]]
    chosen = [slice(start, start + k) for start, k in zip(starts, terms, strict=True)]
    return [orders[s] for s in chosen], [radial[s] for s in chosen]
