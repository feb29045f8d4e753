"""Bases cut from their candidates, and blocks of vectors projected on them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression import truncation
from slepian_prt.compression.bases import Candidate
from slepian_prt.compression.blocks import CapBlocks, ProjectedCaps, pieces_of
from slepian_prt.compression.checkpoint import Block, BlockStatistics, MemoryStore, Store
from slepian_prt.compression.device_projection import can_project_on_device, project_on_device
from slepian_prt.compression.learning import LearnedBases
from slepian_prt.compression.linear_basis import LinearBasis, in_float16
from slepian_prt.compression.pilot import decorrelate
from slepian_prt.sphere.harmonics import degrees, num_coefficients
from slepian_prt.transport.device.projection import DeviceBlock
from slepian_prt.transport.estimator import TransferBlock

# Functions that are coded may leave out this part of the squared tolerance, by prediction; rounding gets the rest.
_LEFT_OUT = 0.1
_LEFT_OUT_AT_MOST = 0.6
# A second stage needs more functions to choose from: the first may leave out this part of the squared error that it
# would have with the number of functions asked for.
_LEFT_OUT_BEFORE_REFINING = 0.003

# Below this tolerance functions are stored in float32.
_FINE = 0.005

# Rounding of sums of 2601 products in float32, relative to the lengths of what is multiplied: 2601 x 2^-24, times six
# for functions that are orthonormal to float32 and for devices that sum in another order.
_OF_SUMS = 1e-3

# Bytes of names and shapes of arrays in a file.
_HEADERS = 1800


@dataclass(frozen=True, eq=False)
class Projection:
    """What blocks are projected on.

    Attributes
    ----------
    learned : LearnedBases
    bases : tuple of LinearBasis
        One per cap.
    widening : int
        Times that more functions are taken than the pilot asks for.
    """

    learned: LearnedBases
    bases: tuple[LinearBasis, ...]
    widening: int = 1

    @property
    def overhead(self) -> float:
        """Bytes that a file holds beside the coefficients, roughly: functions, which all caps share, caps, headers."""
        return 2.0 * self.bases[0].count * (self.learned.bandlimit + 1) + 32.0 * len(self.bases) + _HEADERS

    def block(self, traced: TransferBlock) -> Block:
        """Project a block of transfer vectors, on the device that they are on."""
        if isinstance(traced, DeviceBlock) and can_project_on_device(self):
            return project_on_device(self, traced)
        clusters = self.learned.clusters
        order = np.argsort(clusters.index[traced.vertices], kind="stable")
        vertices = traced.vertices[order]
        mixed = decorrelate(traced.vectors[order])
        energy = self._energies(mixed)
        self.learned.add_mean(mixed, vertices, -1.0)
        caps, starts = np.unique(clusters.index[vertices], return_index=True)
        missed = np.empty(vertices.size, dtype=np.float32)
        pieces = []
        for c, begin, end in zip(caps, starts, [*starts[1:], vertices.size], strict=True):
            basis, rows = self.bases[c], slice(begin, end)
            piece = basis.project(mixed[rows])
            centred = mixed[rows] if basis.mean is None else mixed[rows] - basis.mean
            missed[rows] = self._energies(centred) - np.einsum("nk,nk->n", piece, piece)
            pieces.append(piece.ravel())
        statistics = BlockStatistics(traced.blocked[order].astype(np.float32), energy, np.maximum(missed, 0.0))
        return Block(vertices.astype(np.int32), statistics, np.concatenate(pieces), traced.rays)

    def misfit(self, block: Block) -> str | None:
        """Why the coefficients of a block cannot be those of vectors of its norms; None if they can be.

        Together with those of what was subtracted they are a vector's own along orthonormal functions, and no longer
        than it, but for rounding.
        """
        of = self.learned.clusters.index[block.vertices]
        subtracted = np.zeros((of.size, self.learned.channels, (self.learned.bandlimit + 1) ** 2), dtype=np.float32)
        self.learned.add_mean(subtracted, block.vertices, -1.0)
        ends = np.cumsum(self.widths[of])
        caps, starts = np.unique(of, return_index=True)
        for c, begin, end in zip(caps, starts, [*starts[1:], of.size], strict=True):
            added = self.bases[c].project(subtracted[begin:end]).astype(np.float64)
            own = block.coefficients[ends[begin] - self.widths[c] : ends[end - 1]].reshape(added.shape)
            length = np.linalg.norm(own - added, axis=1)
            longest = np.sqrt(block.statistics.energy[begin:end], dtype=np.float64)
            if np.any(length > longest + _OF_SUMS * (longest + np.linalg.norm(added, axis=1))):
                return "its coefficients are larger than its vectors"
        return None

    def as_sent(self) -> Projection:
        """The same without what only choosing the bases needs, and what is worked out anew faster than it is sent."""
        bases = tuple(replace(basis) for basis in self.bases)
        return replace(self, learned=self.learned.without_candidates(), bases=bases)

    @property
    def widths(self) -> NDArray[np.int64]:
        """(caps,) coefficients of a receiver of each cap."""
        return np.array([basis.count * self.learned.channels for basis in self.bases], dtype=np.int64)

    def pieces(self) -> list[range]:
        """All caps in pieces whose coefficients are few enough to be coded together."""
        return pieces_of(self.learned.clusters.sizes * self.widths)

    def caps(self, store: Store, overrides: dict[int, Block] | None = None) -> CapBlocks:
        """The projected blocks, to be read cap by cap."""
        clusters, receivers = self.learned.clusters, self.learned.receivers
        return CapBlocks(receivers, clusters.index, clusters.members, self.widths, store, overrides or {})

    def reconstruct(self, cap: int, vertices: NDArray, coefficients: NDArray) -> NDArray[np.float32]:
        """(n, channels, (L+1)²) vectors of some vertices of a cap, channels decorrelated."""
        vectors = self.bases[cap].reconstruct(coefficients, self.learned.channels)
        self.learned.add_mean(vectors, vertices)
        return vectors

    def _energies(self, vectors: NDArray) -> NDArray[np.float32]:
        """(n,) squared norms of (n, channels, (L+1)²) vectors, weighted by the light prior."""
        if self.learned.weights is not None:
            vectors = vectors * self.learned.weights[degrees(self.learned.bandlimit)].astype(np.float32)
        return np.einsum("ncm,ncm->n", vectors, vectors)


def choose_projection(learned: LearnedBases, widening: int = 1) -> Projection:
    """Cut the candidates to as many functions as the settings want, ``widening`` times as many where coding decides."""
    counts = _counts(learned, widening)
    bases = tuple(candidate.cut(int(k)) for candidate, k in zip(learned.candidates, counts, strict=True))
    settings = learned.settings
    coded = settings.resolved_coding == "coded"
    if settings.resolved_coding != "float32" and not (coded and settings.resolved_tolerance < _FINE):
        bases = in_float16(bases)
    if coded and bases:
        wider = learned.widest.get(_formats(bases[0]))
        if wider is not None and all(w.count >= basis.count for w, basis in zip(wider, bases, strict=True)):
            bases = tuple(w.first(basis.count) for w, basis in zip(wider, bases, strict=True))
        else:
            learned.widest[_formats(bases[0])] = bases
    return Projection(learned, bases, widening)


def widen(projection: Projection, caps: ProjectedCaps) -> Projection | None:
    """Twice as many functions if those that blocks were projected on miss more than the tolerance allows; else None.

    The pilot may have seen too little of what there is.
    """
    learned = projection.learned
    settings = learned.settings
    if settings.by_number or settings.resolved_coding != "coded" or settings.needs_all_vectors:
        return None
    most = max(candidate.energies.size for candidate in learned.candidates)
    total, missed = caps.energies()
    enough = missed <= _LEFT_OUT_AT_MOST * settings.resolved_tolerance**2 * total
    if enough or projection.bases[0].count >= most:
        return None
    return choose_projection(learned, 2 * projection.widening)


def narrow(wide: Projection, store: Store, narrower: Projection) -> tuple[Projection, MemoryStore] | None:
    """Blocks projected on many functions, cut to what a projection with fewer would give; None if it cannot be."""
    channels = narrower.learned.channels
    counts = {(w.count, n.count) for w, n in zip(wide.bases, narrower.bases, strict=True)}
    alike = all(_formats(w) == _formats(n) for w, n in zip(wide.bases, narrower.bases, strict=True))
    if len(counts) != 1 or not alike:
        return None
    ((many, few),) = counts
    if few > many:
        return None
    cut = MemoryStore()
    for number, block in store:
        columns = block.coefficients.reshape(-1, many * channels)
        missed = block.statistics.missed + np.sum(columns[:, few * channels :] ** 2, axis=1)
        kept = np.ascontiguousarray(columns[:, : few * channels]).ravel()
        cut.add(number, block._replace(statistics=block.statistics._replace(missed=missed), coefficients=kept))
    return replace(narrower, bases=tuple(basis.first(few) for basis in wide.bases)), cut


def count_by_rule(learned: LearnedBases, candidates: tuple[Candidate, ...]) -> NDArray[np.int64]:
    """How many functions of each cap the rule of the settings keeps: terms, Shannon number, or predicted error."""
    settings, clusters = learned.settings, learned.clusters
    if settings.basis == "none":
        return truncation.by_terms(candidates, num_coefficients(learned.bandlimit))
    if settings.terms is not None:
        return truncation.by_terms(candidates, settings.terms)
    if settings.truncate is not None:
        epsilon = 0.01 if settings.epsilon is None else settings.epsilon
        return truncation.by_shannon(candidates, clusters.caps, learned.bandlimit, settings.truncate, epsilon)
    return truncation.by_tolerance(candidates, clusters.sizes, settings.resolved_tolerance)


def _counts(learned: LearnedBases, widening: int) -> NDArray[np.int64]:
    """How many functions of each cap to project on."""
    settings, candidates, sizes = learned.settings, learned.candidates, learned.clusters.sizes
    coded = settings.resolved_coding == "coded"
    if settings.refine and not coded:
        without = truncation.predicted_error(candidates, count_by_rule(learned, candidates), sizes)
        return truncation.by_tolerance(candidates, sizes, math.sqrt(_LEFT_OUT_BEFORE_REFINING) * without)
    if settings.by_number or not coded:
        return count_by_rule(learned, candidates)
    missing = math.sqrt(_LEFT_OUT) * settings.resolved_tolerance
    if settings.needs_all_vectors:
        return truncation.by_tolerance(candidates, sizes, missing)
    # The same functions for all caps: as many as any of them would want.
    counts = truncation.by_tolerance(candidates, sizes, min(missing * _scale_of_candidates(learned), 1e6))
    return np.minimum(widening * counts.max(), [c.energies.size for c in candidates])


def _scale_of_candidates(learned: LearnedBases) -> float:
    """Norm of whole vectors over that of what candidates see of them, which is less if a mean was taken off."""
    clusters = learned.clusters
    seen = sum(c.total * n for c, n in zip(learned.candidates, clusters.sizes, strict=True))
    assert learned.pilot is not None
    whole = float(learned.pilot.energies[clusters.occlusion_classes] @ learned.power @ clusters.sizes)
    return math.sqrt(whole / seen) if seen > 0.0 else 1.0


def _formats(basis: LinearBasis) -> tuple[Any, ...]:
    """How the functions of a basis are kept."""
    return tuple(None if part is None else part.dtype for part in (basis.radial, basis.dense, basis.mean))
