"""Quantised coefficients, predicted from neighbours on the surface and entropy-coded.

Coefficients of an orthonormal basis are rounded to multiples of one step. That is reverse water-filling: components
whose variance is below the distortion round to zero and cost nothing, all others get the same distortion. The integers
of a cap's vertices are coded coarse to fine along a space-filling curve: each is predicted from the mean of those
mesh neighbours that are known already, in integer arithmetic, and the difference is entropy-coded (asymmetric numeral
systems, by the library `constriction`) with one of a few histograms that are stored. Decoding is exact on any machine,
and each cap decodes by itself.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import constriction
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from slepian_prt.scene.meshes import morton

_ANS = constriction.stream.stack.AnsCoder
_Categorical = constriction.stream.model.Categorical

# Differences beyond this are rare; they are coded as an escape and kept aside.
_LARGEST = 96
# Histograms, one for each range of the mean size of a difference, logarithmic.
_CLASSES = 28
# Shrinkage of predictions is stored in this many parts.
_SHRINK = 32


@dataclass(frozen=True)
class CodedCap:
    """The integers of one cap, coded.

    Attributes
    ----------
    words : (n,) uint32
    classes : (K,) uint8
        Histogram of each component; 0 if all of its differences are zero, which needs no bits.
    escapes : (e,) int32
        Differences beyond the histograms, in the order of coding.
    """

    words: NDArray[np.uint32]
    classes: NDArray[np.uint8]
    escapes: NDArray[np.int32]


@dataclass(frozen=True)
class Coded:
    """All caps and what they share.

    Attributes
    ----------
    caps : tuple of CodedCap
    histograms : (_CLASSES, 2 _LARGEST + 2) uint32
        Counts of the differences -_LARGEST.._LARGEST and of escapes.
    shrink : (2, K_max) uint8
        How much of a prediction is believed for each component, in 1/32: from mesh neighbours, and from the curve.
    """

    caps: tuple[CodedCap, ...]
    histograms: NDArray[np.uint32]
    shrink: NDArray[np.uint8]


def surface_order(positions: NDArray, members: list[NDArray]) -> list[NDArray[np.int64]]:
    """Members of each cap along a Z-order curve of all positions."""
    rank = np.empty(len(positions), dtype=np.int64)
    rank[np.argsort(morton(positions), kind="stable")] = np.arange(len(positions))
    return [m[np.argsort(rank[m], kind="stable")] for m in members]


def adjacency(faces: NDArray, count: int) -> csr_array:
    """(V, V) pattern of vertices that share an edge."""
    a, b = (np.concatenate([faces[:, i] for i in order]) for order in ((0, 1, 2), (1, 2, 0)))
    pattern = csr_array((np.ones(2 * a.size, dtype=np.int32), (np.r_[a, b], np.r_[b, a])), shape=(count, count))
    pattern.data[:] = 1
    return pattern


def quantise(coefficients: NDArray, step: float) -> NDArray[np.signedinteger]:
    """Nearest multiples of ``step``, as integers, of 16 bits where those do."""
    multiples = np.rint(coefficients / np.float32(step))
    small = multiples.size == 0 or float(np.abs(multiples).max()) <= np.iinfo(np.int16).max
    return multiples.astype(np.int16 if small else np.int32)


def step_for(coefficients: list[NDArray], energy: float) -> float:
    """The step whose rounding errors add up to ``energy``, the sum of squares over all coefficients given.

    The error grows with the step but for noise, so bisection on its logarithm finds it; the result is on the safe side.
    """
    low = high = max(float(np.sqrt(12.0 * energy / max(sum(c.size for c in coefficients), 1))), 1e-30)

    def rounding(step: float) -> float:
        return float(sum(np.sum((c - step * np.rint(c / step)) ** 2, dtype=np.float64) for c in coefficients))

    while rounding(high) < energy and high < 1e30:
        high *= 2.0
    while rounding(low) > energy and low > 1e-30:
        low *= 0.5
    for _ in range(14):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if rounding(middle) < energy else (low, middle)
    return low


def encode(quantised: list[NDArray[np.signedinteger]], neighbours: list[csr_array]) -> Coded:
    """Code the integers of each cap.

    Parameters
    ----------
    quantised : list of (n_c, K_c) integers, in surface order
    neighbours : list of (n_c, n_c) patterns of the same vertices
    """
    widest = max(q.shape[1] for q in quantised)
    shrink = _fit_shrinkage(quantised, neighbours, widest)
    classes = []
    histograms = np.zeros((_CLASSES, 2 * _LARGEST + 2), dtype=np.uint32)
    for q, near in zip(quantised, neighbours, strict=True):
        d = _differences(q, near, shrink)
        classes.append(_classify(d))
        for kind in np.unique(classes[-1][classes[-1] > 0]):
            symbols = _symbols(d[:, classes[-1] == kind])
            histograms[kind] += np.bincount(symbols.ravel(), minlength=2 * _LARGEST + 2).astype(np.uint32)
    models = _models(histograms)
    caps = []
    for q, near, kinds in zip(quantised, neighbours, classes, strict=True):
        d = _differences(q, near, shrink)  # once more: those of all caps together would take too much memory
        coder = _ANS()
        escapes = []
        present = np.unique(kinds[kinds > 0])
        for kind in present[::-1]:  # a stack: the last in is the first out
            coder.encode_reverse(_symbols(d[:, kinds == kind]).ravel(), models[kind])
        for kind in present:
            block = d[:, kinds == kind].ravel()
            escapes.append(block[np.abs(block) > _LARGEST])
        caps.append(
            CodedCap(
                coder.get_compressed(),
                kinds,
                np.concatenate([np.zeros(0, dtype=np.int32), *escapes]).astype(np.int32),
            )
        )
    return Coded(tuple(caps), histograms, shrink)


def decode(coded: Coded, neighbours: list[csr_array]) -> list[NDArray[np.int32]]:
    """The integers again, (n_c, K_c) for each cap, exactly.

    Raises
    ------
    ValueError
        The parts do not fit together.
    """
    models = _models(coded.histograms)
    return [_decode_cap(cap, near, models, coded.shrink) for cap, near in zip(coded.caps, neighbours, strict=True)]


def _decode_cap(cap: CodedCap, near: csr_array, models: dict[int, Any], shrink: NDArray) -> NDArray[np.int32]:
    count = near.shape[0]
    q = np.zeros((count, cap.classes.size), dtype=np.int32)
    coder = _ANS(np.ascontiguousarray(cap.words))
    taken = 0
    for kind in np.unique(cap.classes[cap.classes > 0]):
        if kind not in models:
            raise ValueError("histogram missing")
        columns = np.flatnonzero(cap.classes == kind)
        symbols = coder.decode(models[kind], count * columns.size).astype(np.int32) - _LARGEST
        escaped = np.flatnonzero(symbols > _LARGEST)
        symbols[escaped] = cap.escapes[taken : taken + escaped.size]
        taken += escaped.size
        q[:, columns] = symbols.reshape(count, columns.size)
    if taken != cap.escapes.size:
        raise ValueError("number of escapes")
    for step in _steps(near):
        q[step.todo] += step.predict(q, shrink)
    return q


# --- Prediction ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Step:
    """Vertices of one level, and what they are predicted from: known mesh neighbours or, without any, the curve."""

    todo: NDArray[np.int64]
    sources: csr_array
    counts: NDArray[np.int64]
    on_curve: NDArray[np.bool_]

    def sums(self, q: NDArray[np.signedinteger]) -> NDArray[np.int64]:
        return np.asarray(self.sources @ q.astype(np.int64))

    def predict(self, q: NDArray[np.signedinteger], shrink: NDArray[np.uint8]) -> NDArray[np.int32]:
        """Shrunken means, rounded half up, in integers throughout."""
        believed = shrink[self.on_curve.astype(int), : q.shape[1]].astype(np.int64)
        divisor = (_SHRINK * np.maximum(self.counts, 1))[:, None]
        return ((2 * self.sums(q) * believed + divisor) // (2 * divisor)).astype(np.int32)


def _steps(near: csr_array) -> Iterator[_Step]:
    """Levels from coarse to fine: ranks that are odd multiples of 2^j know those that are multiples of 2^(j+1)."""
    count = near.shape[0]
    stride = 1
    while stride < count:
        stride *= 2
    while stride >= 1:
        todo = np.arange(stride, count, 2 * stride)
        if todo.size:
            rows = near[todo].tocoo()
            known = rows.col % (2 * stride) == 0
            row, col = rows.row[known], rows.col[known]
            counts = np.bincount(row, minlength=todo.size)
            alone = np.flatnonzero(counts == 0)
            after = todo[alone] + stride
            inside = after < count
            row = np.concatenate([row, alone, alone[inside]])
            col = np.concatenate([col, todo[alone] - stride, after[inside]])
            sources = csr_array((np.ones(row.size, dtype=np.int64), (row, col)), shape=(todo.size, count))
            yield _Step(todo, sources, np.bincount(row, minlength=todo.size), counts == 0)
        stride //= 2


def _differences(q: NDArray[np.signedinteger], near: csr_array, shrink: NDArray[np.uint8]) -> NDArray[np.int32]:
    d = q.astype(np.int32)
    for step in _steps(near):
        d[step.todo] -= step.predict(q, shrink)
    return d


def _fit_shrinkage(
    quantised: list[NDArray[np.signedinteger]], neighbours: list[csr_array], widest: int
) -> NDArray[np.uint8]:
    """Least squares over all caps: how much of the mean of neighbours predicts a component."""
    products, squares = np.zeros((2, widest)), np.zeros((2, widest))
    for q, near in zip(quantised, neighbours, strict=True):
        for step in _steps(near):
            mean = step.sums(q) / np.maximum(step.counts, 1)[:, None]
            for kind in (0, 1):
                rows = step.on_curve == bool(kind)
                products[kind, : q.shape[1]] += (mean[rows] * q[step.todo[rows]]).sum(axis=0)
                squares[kind, : q.shape[1]] += (mean[rows] ** 2).sum(axis=0)
    ratio = np.divide(products, squares, out=np.zeros_like(products), where=squares > 0)
    return np.clip(np.rint(ratio * _SHRINK), 0, 255).astype(np.uint8)


# --- Entropy coding --------------------------------------------------------------------------------------------------


def _classify(differences: NDArray[np.int32]) -> NDArray[np.uint8]:
    """Histogram of each component, by the mean size of its differences: half-octaves from 2^-9 upward."""
    if len(differences) == 0:
        return np.zeros(differences.shape[1], dtype=np.uint8)
    mean = np.abs(differences).mean(axis=0)
    with np.errstate(divide="ignore"):
        kind = np.clip(np.rint(2.0 * (np.log2(mean) + 9.0)) + 1, 1, _CLASSES - 1)
    return np.where(mean > 0, kind, 0).astype(np.uint8)


def _symbols(differences: NDArray[np.int32]) -> NDArray[np.int32]:
    shifted = differences + _LARGEST
    return np.where(np.abs(differences) > _LARGEST, 2 * _LARGEST + 1, shifted).astype(np.int32)


def _models(histograms: NDArray[np.uint32]) -> dict[int, Any]:
    """Entropy models from stored counts; unseen differences keep the coder's smallest probability."""
    return {
        kind: _Categorical(counts.astype(np.float64) / counts.sum(), perfect=False)
        for kind, counts in enumerate(histograms)
        if counts.sum() > 0
    }
