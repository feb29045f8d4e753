"""The ways to compress that a comparison holds against each other."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.baselines import haar_transfer
from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.grouping import Grouping
from slepian_prt.compression.principal_components import USUAL_TERMS, iterate_clusters
from slepian_prt.compression.settings import BASES
from slepian_prt.compression.stream import compress
from slepian_prt.errors import UserError
from slepian_prt.lighting.spectrum import measured_prior
from slepian_prt.sphere.harmonics import num_coefficients
from slepian_prt.transport.transfer import Transfer

# What Direct3D's PRT library (D3DX) recommends: SH of order 6, 24 PCA vectors.
_D3DX_BANDLIMIT, _D3DX_TERMS = 5, 24

METHODS = (*BASES, "adapted+light", "adapted+pca", "haar", "d3dx")
DEFAULT_METHODS = (
    "adapted", "adapted+light", "adapted+pca", "transport", "slepian", "incident", "sh", "cpca", "haar", "d3dx"
)  # fmt: skip

# Methods that are also shown coded, at these tolerances.
_CODED = ("adapted", "adapted+light")
_CODED_TOLERANCES = (0.2, 0.1, 0.05, 0.02)


class Relightable(Protocol):
    """What a method makes of transfer vectors."""

    @property
    def bytes_per_vertex(self) -> float:
        """Everything counted."""

    def reconstruct(self) -> NDArray[np.float32]:
        """Transfer vectors."""

    def radiance(self, lighting: NDArray) -> NDArray[np.float32]:
        """(V, 3) outgoing radiance under lighting (3, (L+1)²)."""


@dataclass(frozen=True)
class Entry:
    """One method with one setting.

    Attributes
    ----------
    method : str
    coding : str
    terms : float
    asked : int or None
        Number of functions that was asked for.
    made : Relightable
    seconds : float
        That compression took.
    """

    method: str
    coding: str
    terms: float
    asked: int | None
    made: Relightable
    seconds: float

    @property
    def packed(self) -> CompressedTransfer | None:
        """The same if it is ours, which knows what error to expect."""
        return self.made if isinstance(self.made, CompressedTransfer) else None


def check_methods(methods: Sequence[str]) -> None:
    """Raise UserError on an unknown method."""
    for method in methods:
        if method == "none":
            raise UserError("basis none is full SH, which every comparison shows; leave it out")
        if method not in METHODS:
            raise UserError(f"basis must be one of {', '.join(METHODS)}, not {method!r}")


def entries(
    transfer: Transfer,
    clusters: Grouping,
    methods: Sequence[str],
    terms: Sequence[int],
    lighting: Sequence[NDArray],
    report: Callable[[str], None],
) -> Iterator[Entry]:
    """Every method with every number of terms, some coded to every tolerance, and full SH last."""
    for method in methods:
        if method == "d3dx":
            report("d3dx")
            yield _timed(method, "float16", _D3DX_TERMS, None, lambda: _d3dx(transfer, clusters))
            continue
        for k in terms:
            report(f"{method}, {k} terms")
            if method == "haar":
                yield _haar(transfer, k)
            else:
                yield _compressed(transfer, clusters, method, lighting, terms=k, coding="float16")
        if method == "cpca":
            yield from _cpca_coded(transfer, clusters, report)
            continue
        for tolerance in _CODED_TOLERANCES if method in _CODED else ():
            report(f"{method}, coded to {tolerance:g}")
            yield _compressed(transfer, clusters, method, lighting, tolerance=tolerance)
    report("full SH")
    yield _compressed(transfer, clusters, "none", lighting, coding="float16")


def _compressed(
    transfer: Transfer,
    clusters: Grouping,
    method: str,
    lighting: Sequence[NDArray],
    *,
    terms: int | None = None,
    tolerance: float | None = None,
    coding: str | None = None,
) -> Entry:
    basis, _, addition = method.partition("+")
    prior = measured_prior(lighting, transfer.bandlimit, "the maps") if addition == "light" else None
    packed = compress(
        transfer,
        basis,
        terms=terms,
        tolerance=tolerance,
        coding=coding,
        clusters=None if basis == "none" else clusters,
        light_prior=prior,
        refine=True if addition == "pca" else None,
    )
    return Entry(method, packed.coding, packed.terms, terms, packed, packed.seconds["compress"])


def _cpca_coded(transfer: Transfer, clusters: Grouping, report: Callable[[str], None]) -> Iterator[Entry]:
    """Clusters are iterated once for all tolerances, and that time counts each time."""
    begin = time.perf_counter()
    iterated = iterate_clusters(clusters.clusters, transfer.axes, transfer.vectors, USUAL_TERMS, report)
    seconds = time.perf_counter() - begin
    for tolerance in _CODED_TOLERANCES:
        report(f"cpca, coded to {tolerance:g}")
        packed = compress(transfer, "pca", tolerance=tolerance, clusters=iterated)
        yield Entry("cpca", packed.coding, packed.terms, None, packed, seconds + packed.seconds["compress"])


def _haar(transfer: Transfer, terms: int) -> Entry:
    return _timed("haar", "8 bits", terms, terms, lambda: haar_transfer(transfer.vectors, terms, transfer.mesh.albedo))


def _timed(method: str, coding: str, terms: float, asked: int | None, make: Callable[[], Relightable]) -> Entry:
    begin = time.perf_counter()
    made = make()
    return Entry(method, coding, terms, asked, made, time.perf_counter() - begin)


@dataclass(frozen=True)
class _Padded:
    """Transfer of a lower bandlimit."""

    packed: CompressedTransfer
    size: int

    @property
    def bytes_per_vertex(self) -> float:
        return self.packed.bytes_per_vertex

    def reconstruct(self) -> NDArray[np.float32]:
        vectors = self.packed.reconstruct()
        padding = [(0, 0)] * (vectors.ndim - 1) + [(0, self.size - vectors.shape[-1])]
        return np.pad(vectors, padding)

    def radiance(self, lighting: NDArray) -> NDArray[np.float32]:
        return self.packed.radiance(lighting[:, : num_coefficients(self.packed.bandlimit)])


def _d3dx(transfer: Transfer, clusters: Grouping) -> _Padded:
    bandlimit = min(transfer.bandlimit, _D3DX_BANDLIMIT)
    size = num_coefficients(bandlimit)
    cut = replace(transfer, bandlimit=bandlimit, vectors=transfer.vectors[:, :, :size], environment=None)
    packed = compress(cut, "cpca", terms=min(_D3DX_TERMS, size), coding="float16", clusters=clusters)
    return _Padded(packed, num_coefficients(transfer.bandlimit))
