"""Caps of a file as groups with an orthonormal basis each: as the file has them, or several as one if they are many."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2

from slepian_prt.errors import UserError
from slepian_prt.relighting.factors import Factors

# Directions of a basis that carry less than this part of its energy are rounding.
_ROUNDING = 1e-10


@dataclass(frozen=True, eq=False)
class Group:
    """Receivers of one or several caps.

    Attributes
    ----------
    members : (n,)
        Receivers where light is counted.
    values : (n, r) float32
        Their transfer along ``functions``, those of largest energy first.
    functions : (r, channels (L+1)²) float64
        Orthonormal if weighted.
    """

    members: NDArray[np.integer]
    values: NDArray[np.float32]
    functions: NDArray[np.float64]


def group_caps(
    parts: Sequence[Factors],
    members: Sequence[NDArray[np.integer]],
    active: NDArray[np.bool_],
    weights: NDArray[np.float64],
    most: int,
) -> list[Group]:
    """At most ``most`` groups of caps.

    Parameters
    ----------
    parts, members
        Of each cap.
    active : (V,)
        Receivers where light is counted.
    weights : ((L+1)²,)
        Of the light, which bases are orthonormal under.
    most : int
    """
    caps = [c for c in range(len(parts)) if active[members[c]].any()]
    labels = np.arange(len(caps))
    if len(caps) > most:
        means = np.stack([_mean_transfer(parts[c], active[members[c]], weights) for c in caps])
        labels = kmeans2(means, most, minit="++", seed=0)[1]
    return [
        _group([(parts[c], members[c], active[members[c]]) for c in np.array(caps)[labels == label]], weights)
        for label in np.unique(labels)
    ]


def _mean_transfer(part: Factors, lit: NDArray[np.bool_], weights: NDArray[np.float64]) -> NDArray[np.float64]:
    mean = part.coefficients[lit].mean(axis=0, dtype=np.float64) @ _rows(part.functions)
    return np.asarray((mean.reshape(-1, weights.size) * weights).ravel())


def _rows(functions: NDArray) -> NDArray:
    """(K, channels (L+1)²) functions (K, channels, (L+1)²), of which a cap may have none."""
    return functions.reshape(len(functions), math.prod(functions.shape[1:]))


def _group(
    caps: Sequence[tuple[Factors, NDArray[np.integer], NDArray[np.bool_]]], weights: NDArray[np.float64]
) -> Group:
    """One basis for all functions of some caps, along the principal axes of their transfer."""
    weighted = [_rows(part.functions * weights).astype(np.float64) for part, _, _ in caps]
    basis = np.linalg.qr(np.concatenate(weighted).T)[0]
    values = np.concatenate(
        [
            part.coefficients[lit] @ (rows @ basis).astype(np.float32)
            for (part, _, lit), rows in zip(caps, weighted, strict=True)
        ]
    )
    with np.errstate(over="ignore", invalid="ignore"):
        products = values.T @ values
    if not np.isfinite(products).all():
        raise UserError("squares of the transfer are too large for float32; precompute it again, of light in its units")
    energies, axes = np.linalg.eigh(products.astype(np.float64))
    kept = axes[:, ::-1][:, energies[::-1] > _ROUNDING * energies.max(initial=0.0)]
    channels = len(basis) // weights.size  # there may be no functions, where all is dark
    functions = (basis @ kept).T.reshape(kept.shape[1], channels, weights.size) / weights
    found = np.concatenate([own[lit] for _, own, lit in caps])
    return Group(found, values @ kept.astype(np.float32), functions.reshape(len(functions), channels * weights.size))
