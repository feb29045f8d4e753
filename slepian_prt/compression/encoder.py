"""One compression: bases decided before the vectors are there, blocks projected on them, caps coded."""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from slepian_prt.compression import truncation
from slepian_prt.compression.bases import Candidate, Frame, LinearBasis, Problem, candidates
from slepian_prt.compression.blocks import Caps
from slepian_prt.compression.checkpoint import Block, MemoryStore, Store
from slepian_prt.compression.clustering import Clusters, spread
from slepian_prt.compression.codec import caps as codec
from slepian_prt.compression.compressed import Coded, frames_of
from slepian_prt.compression.grouping import Grouping
from slepian_prt.compression.pilot import Pilot, channel_mixing, decorrelated, learn, pilot_vertices
from slepian_prt.compression.prediction import Expectation, by_degree
from slepian_prt.compression.refinement import refine
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.lighting.spectrum import light_power
from slepian_prt.scene.mesh import Mesh
from slepian_prt.sphere.harmonics import degrees, num_coefficients

# With a given number of functions, rounding may add this part to the squared error of leaving out the others.
_ROUNDING_SHARE = 0.1
_FINEST_ROUNDING = 1e-3

# Functions that are coded may leave out this part of the squared tolerance, by prediction; rounding gets the rest.
_LEFT_OUT = 0.1
_LEFT_OUT_AT_MOST = 0.6
# A second stage needs more functions to choose from: the first may leave out this part of the squared error that it
# would have with the number of functions asked for.
_LEFT_OUT_BEFORE_REFINING = 0.003

# Below this tolerance functions are stored in float32.
_FINE = 0.005

# Bytes of names and shapes of arrays in a file.
_HEADERS = 1800

# Vertices that the step and the models are fitted to, in whole caps.
_SAMPLE = 15_000
_ATTEMPTS = 3
# What is left of the error asked for need not be used up to the last.
_CLOSE = 0.95
_FINER = 0.985


@dataclass(frozen=True)
class WarmStart:
    """What much the same coefficients were coded with: tried first, which saves most of the time.

    Attributes
    ----------
    tuning : codec.Tuning
    turned : tuple of bool
        Which caps' coefficients were turned to their principal axes; empty if that is not known.
    """

    tuning: codec.Tuning
    turned: tuple[bool, ...] = ()


@dataclass(frozen=True)
class Trial:
    """What coding some of the caps gave.

    Attributes
    ----------
    start : WarmStart
        For coding all of them.
    expected : Expectation
        Of a vector, by degree, as measured on these caps.
    missed : (L+1,)
        The part of it that the bases miss.
    errors : (K channels, K channels)
        Mean products of the coefficients' errors.
    decoded : list of (n, K channels)
        The coefficients as they will be decoded, for each cap in the order of its members.
    bytes : float
        Of a vertex, in these caps.
    reading, coding, decoding : float
        Seconds to lay out the surface of these caps, to code them, with a choice of axes, and to decode them.
    """

    start: WarmStart
    expected: Expectation
    missed: NDArray[np.float64]
    errors: NDArray[np.float64]
    decoded: list[NDArray[np.float32]]
    bytes: float
    reading: float
    coding: float
    decoding: float


def _kind(basis: LinearBasis) -> tuple[Any, ...]:
    """How the functions of a basis are kept."""
    parts = (basis.radial, basis.dense, basis.mean)
    return tuple(None if part is None else part.dtype for part in parts)


class Encoder:
    """One compression: what was decided, and how blocks become caps.

    Attributes
    ----------
    bases : tuple of LinearBasis
        What blocks are projected on.
    pilot : Pilot or None
    start : WarmStart or None
        What coding tries first.
    keeps : bool
        Whether what was coded is wanted as it will be decoded too.
    decoded : list of codec.DecodedCap
        Where it was wanted, after `finish`.
    """

    bases: tuple[LinearBasis, ...]
    channels: int

    def __init__(
        self,
        settings: CompressionSettings,
        mesh: Mesh,
        grouping: Grouping,
        bandlimit: int,
        seed: int,
        *,
        toward_view: bool = False,
    ) -> None:
        self.start: WarmStart | None = None
        self.keeps = False
        self.decoded: list[codec.DecodedCap] = []
        self.settings, self.mesh, self.bandlimit, self._seed = settings, mesh, bandlimit, seed
        self.clusters = grouping.clusters
        self._toward_view = toward_view
        self._axes = grouping.axes
        self._factor = 1
        self.pilot: Pilot | None = None
        self._found: list[Candidate] = []
        # The widest bases so far, by how they are kept: narrower ones are their first functions.
        self._made: dict[tuple[Any, ...], tuple[LinearBasis, ...]] = {}
        prior = settings.light_prior
        self._weights = None if prior is None else prior.weights

    # --- Before the vectors ---

    @property
    def _codes(self) -> bool:
        return self.settings.codes == "coded"

    @property
    def _name(self) -> str:
        return "sh" if self.settings.basis == "none" else self.settings.basis

    def learn(self, vectors_of: Callable[[NDArray], NDArray]) -> None:
        """Make the bases from a pilot; ``vectors_of`` gives (n, channels, (L+1)²) for vertices."""
        self._made.clear()
        vertices = pilot_vertices(self.clusters, self._axes, self._seed)
        vectors = decorrelated(vectors_of(vertices))
        # The decoder knows the normals; toward a view they tell little.
        told = self._normals if self._codes and not self._toward_view else None
        with threadpool_limits(1, "blas"):
            self._learn(vertices, vectors, told)

    def _learn(self, vertices: NDArray, vectors: NDArray, told: NDArray | None) -> None:
        pilot = learn(self.clusters, self._axes, vertices, vectors, told)
        self.pilot = pilot
        problem = Problem(self.bandlimit, self._frames(), pilot, self._weights)
        self.use(candidates(self._name, problem), vectors.shape[1])

    def _frames(self) -> tuple[Frame, ...]:
        """Where the functions of each cap stand."""
        clusters = self.clusters
        one_for_all = self._codes or self.settings.refine
        centers = frames_of(clusters) if one_for_all else [cap.center for cap in clusters.caps]
        spreads = [spread(c, self._axes[members]) for c, members in zip(centers, clusters.members, strict=True)]
        half_angles = [cap.half_angle for cap in clusters.caps]
        if one_for_all:
            # One set of functions for all caps: it is stored once, and what it does not fit costs little.
            half_angles = [float(np.average(half_angles, weights=clusters.sizes))] * len(centers)
            spreads = [float(np.average(spreads, weights=clusters.sizes))] * len(centers)
        return tuple(map(Frame, centers, half_angles, spreads, clusters.kinds.tolist()))

    def use(self, found: list[Candidate], channels: int) -> None:
        """Cut candidates, one for each cap, to the bases that blocks are projected on."""
        self._found, self.channels = found, channels
        counts = self._counts()
        bases = tuple(candidate.cut(int(k)) for candidate, k in zip(found, counts, strict=True))
        if self.settings.codes != "float32" and not (self._codes and self.settings.asked < _FINE):
            bases = tuple(basis.as_float16() for basis in bases)
        wider = self._made.get(_kind(bases[0])) if self._codes and bases else None
        if wider is not None and all(w.count >= basis.count for w, basis in zip(wider, bases, strict=True)):
            bases = tuple(w.first(basis.count) for w, basis in zip(wider, bases, strict=True))
        elif bases:
            self._made[_kind(bases[0])] = bases
        self.bases = bases

    @cached_property
    def _normals(self) -> NDArray[np.float64]:
        return self.mesh.normals.astype(np.float32).astype(np.float64)

    def _counts(self) -> NDArray[np.int64]:
        """How many functions of each cap to project on."""
        settings, found, sizes = self.settings, self._found, self.clusters.sizes
        if settings.refine and not self._codes:
            without = truncation.predicted_error(found, self._by_rule(found), sizes)
            return truncation.by_tolerance(found, sizes, math.sqrt(_LEFT_OUT_BEFORE_REFINING) * without)
        if settings.by_number or not self._codes:
            return self._by_rule(found)
        if settings.needs_all_vectors:
            return truncation.by_tolerance(found, sizes, math.sqrt(_LEFT_OUT) * settings.asked)
        # The same functions for all caps: as many as any of them would want.
        missing = math.sqrt(_LEFT_OUT) * settings.asked * self._scale_of_candidates()
        counts = truncation.by_tolerance(found, sizes, min(missing, 1e6))
        return np.minimum(self._factor * counts.max(), [c.energies.size for c in found])

    def _by_rule(self, found: list[Candidate]) -> NDArray[np.int64]:
        """How many functions the rule that was asked for keeps."""
        settings = self.settings
        if settings.basis == "none":
            return truncation.by_terms(found, num_coefficients(self.bandlimit))
        if settings.terms is not None:
            return truncation.by_terms(found, settings.terms)
        if settings.truncate is not None:
            epsilon = 0.01 if settings.epsilon is None else settings.epsilon
            return truncation.by_shannon(found, self.clusters.caps, self.bandlimit, settings.truncate, epsilon)
        return truncation.by_tolerance(found, self.clusters.sizes, settings.asked)

    def _scale_of_candidates(self) -> float:
        """Norm of whole vectors over that of what candidates see of them, which is less if a mean was taken off."""
        sizes = self.clusters.sizes
        seen = sum(c.total * n for c, n in zip(self._found, sizes, strict=True))
        assert self.pilot is not None
        power = np.ones(self.bandlimit + 1) if self._weights is None else self._weights**2
        whole = float(self.pilot.energies[self.clusters.kinds] @ power @ sizes)
        return math.sqrt(whole / seen) if seen > 0.0 else 1.0

    def asked(self, tolerance: float) -> Encoder:
        """The same, what was learnt included, with another tolerance."""
        other = copy.copy(self)
        other.settings = replace(self.settings, tolerance=tolerance)
        other._factor = 1
        other.use(self._found, self.channels)
        return other

    def refine_to(self, tolerance: float, tuning: codec.Tuning) -> None:
        """Code with a finer tolerance from now on, beginning from what was coded before; the bases stay."""
        ratio = tolerance / self.settings.asked
        self.settings = replace(self.settings, tolerance=tolerance)
        self.start = WarmStart(replace(tuning, step=tuning.step * ratio))

    def of_clusters(self, clusters: Clusters) -> Encoder:
        """The same on some members of the clusters only."""
        other = copy.copy(self)
        other.clusters = clusters
        return other

    def narrowed(self, finer: Encoder, store: MemoryStore) -> MemoryStore | None:
        """What another of the same, with more functions, has projected, cut to those of this one; None if it cannot be.

        The bases of ``finer`` are then this one's too, as far as they are wanted.
        """
        widths = {(basis.count, mine.count) for basis, mine in zip(finer.bases, self.bases, strict=True)}
        alike = all(_kind(a) == _kind(b) for a, b in zip(finer.bases, self.bases, strict=True))
        if len(widths) != 1 or not alike:
            return None
        ((wide, narrow),) = widths
        if narrow > wide:
            return None
        self.bases = tuple(basis.first(narrow) for basis in finer.bases)
        found = MemoryStore()
        for number, block in store:
            columns = block.coefficients.reshape(-1, wide * self.channels)
            figures = block.figures.copy()
            figures[:, 2] += np.sum(columns[:, narrow * self.channels :] ** 2, axis=1)
            kept = np.ascontiguousarray(columns[:, : narrow * self.channels]).ravel()
            found.add(number, block._replace(figures=figures, coefficients=kept))
        return found

    @property
    def overhead(self) -> float:
        """Bytes that a file holds beside the coefficients, roughly: functions, which all caps share, caps, headers."""
        return 2.0 * self.bases[0].count * (self.bandlimit + 1) + 32.0 * len(self.bases) + _HEADERS

    # --- Block after block ---

    def block(self, vertices: NDArray, vectors: NDArray, blocked: NDArray, rays: int) -> Block:
        """Project a block of (n, channels, (L+1)²) transfer vectors."""
        order = np.argsort(self.clusters.index[vertices], kind="stable")
        vertices = vertices[order]
        mixed = decorrelated(vectors[order])
        figures = np.zeros((vertices.size, 3), dtype=np.float32)
        figures[:, 0] = blocked[order]
        figures[:, 1] = self._squares(mixed)
        if self.pilot is not None and self.pilot.mean is not None:
            kinds = self.clusters.kinds[self.clusters.index[vertices]]
            for kind in np.unique(kinds):
                chosen = kinds == kind
                mixed[chosen, 0] -= self.pilot.mean.vectors(self._normals[vertices[chosen]], int(kind))
        rest = self._squares(mixed)
        caps, starts = np.unique(self.clusters.index[vertices], return_index=True)
        pieces = []
        for c, begin, end in zip(caps, starts, [*starts[1:], vertices.size], strict=True):
            basis, rows = self.bases[c], slice(begin, end)
            piece = basis.project(mixed[rows])
            if basis.mean is not None:
                rest[rows] = self._squares(mixed[rows] - basis.mean)
            rest[rows] -= np.einsum("nk,nk->n", piece, piece)
            pieces.append(piece.ravel())
        figures[:, 2] = np.maximum(rest, 0.0)
        return Block(vertices.astype(np.int32), figures, np.concatenate(pieces), rays)

    def _squares(self, vectors: NDArray) -> NDArray[np.float32]:
        """(n,) squared norms of (n, channels, (L+1)²) vectors, weighted by the light prior."""
        if self._weights is not None:
            vectors = vectors * self._weights[degrees(self.bandlimit)].astype(np.float32)
        return np.einsum("ncm,ncm->n", vectors, vectors)

    # --- Cap after cap ---

    def widened(self, store: Store, overrides: dict[int, Block]) -> bool:
        """Whether the bases miss more than the tolerance allows, in which case they are now twice as large.

        The pilot may have seen too little of what there is.
        """
        total, missed = self._caps(store, overrides).energies()
        most = max(found.energies.size for found in self._found)
        enough = missed <= _LEFT_OUT_AT_MOST * self.settings.asked**2 * total
        fixed = self.settings.by_number or not self._codes or self.settings.needs_all_vectors
        if fixed or enough or self.bases[0].count >= most:
            return False
        self._factor *= 2
        self.use(self._found, self.channels)
        return True

    def _caps(self, store: Store, overrides: dict[int, Block]) -> Caps:
        widths = np.array([basis.count * self.channels for basis in self.bases], dtype=np.int64)
        return Caps(self.mesh, self.clusters, widths, store, overrides)

    def finish(self, store: Store, overrides: dict[int, Block]) -> dict[str, Any]:
        """What the result holds of coefficients, bases and expected error."""
        caps = self._caps(store, overrides)
        common = {"basis": self.settings.basis, "channels": self.channels, "prior": ""}
        if self.settings.light_prior is not None:
            common["prior"] = self.settings.light_prior.name
        if self._codes:
            return {**common, **self._coded(caps)}
        if self.settings.refine:
            return {**common, **self._refined(caps)}
        kind = np.dtype(self.settings.codes)
        return {
            **common,
            "bases": self.bases,
            "coefficients": tuple(caps.members(c).astype(kind) for c in range(len(self.bases))),
            "expected": self._expected(self._lost()),
            "terms": self._mean_terms(self.bases),
        }

    def _lost(self) -> list[NDArray[np.float64]]:
        """What the bases are expected to lose of each cap's vectors, by degree."""
        return [found.lost(b.count + (b.mean is not None)) for found, b in zip(self._found, self.bases, strict=True)]

    def _mean_terms(self, bases: tuple[LinearBasis, ...]) -> float:
        counts = np.array([basis.count + (basis.mean is not None) for basis in bases])
        return float(counts @ self.clusters.sizes / self.clusters.sizes.sum())

    def _expected(self, lost: list[NDArray]) -> Expectation:
        """From what each cap's vectors are expected to lose."""
        sizes = self.clusters.sizes / self.clusters.sizes.sum()
        if self.pilot is not None:
            total = sizes @ self.pilot.energies[self.clusters.kinds]
        else:  # what nothing holds is everything
            total = sizes @ np.array([found.lost(0) for found in self._found])
        return Expectation(sizes @ np.array(lost), total)

    def _refined(self, caps: Caps) -> dict[str, Any]:
        """Mean and principal axes of the coefficients of each cap."""
        refined = [
            refine(basis, found.lost(basis.count), caps.members(c), self.channels)
            for c, (basis, found) in enumerate(zip(self.bases, self._found, strict=True))
        ]
        found = [part.candidate for part in refined]
        counts = self._by_rule(found)
        bases = tuple(part.candidate.cut(int(k)) for part, k in zip(refined, counts, strict=True))
        if self.settings.codes == "float16":
            bases = tuple(basis.as_float16() for basis in bases)
        return {
            "bases": bases,
            "coefficients": tuple(
                part.coefficients(caps.members(c), basis.count).astype(self.settings.codes)
                for c, (part, basis) in enumerate(zip(refined, bases, strict=True))
            ),
            "expected": self._expected([c.lost(int(k)) for c, k in zip(found, counts, strict=True)]),
            "terms": self._mean_terms(bases),
        }

    def _coded(self, caps: Caps) -> dict[str, Any]:
        """All caps coded with one step, such that the error asked for is met by measurement."""
        total, missed = caps.energies()
        everything = range(len(self.bases))
        tuning, encoded = self._encoded(caps, everything, self._distortion(total, missed))
        self.decoded = [cap.decoded for cap in encoded if cap.decoded is not None]
        used = np.array([cap.used / self.channels for cap in encoded]) + (self.bases[0].mean is not None)
        return {
            "bases": self.bases,
            "coded": Coded(tuning, tuple(cap.words for cap in encoded)),
            "mean": None if self.pilot is None else self.pilot.mean,
            "expected": self._measured(everything, encoded, total, missed)[0],
            "terms": float(used @ self.clusters.sizes / self.clusters.sizes.sum()),
        }

    def trial(self, store: Store, numbers: Sequence[int]) -> Trial:
        """Code the caps of the given ``numbers``, whose blocks alone are in the store."""
        caps = self._caps(store, {})
        total, missed = caps.energies()
        begin = time.perf_counter()
        samples = [caps.along(c) for c in numbers]
        read = time.perf_counter()
        finest = caps.largest() / codec.LARGEST_MULTIPLE
        with threadpool_limits(1, "blas"):
            tuning = codec.tune(samples, self._distortion(total, missed), finest)
            tuned = time.perf_counter()
            encoded = [self._encode(caps, c, tuning, None) for c in numbers]
            coded = time.perf_counter()
        decoded = [
            codec.decode_cap(cap.words, self.bases[c].count * self.channels, surface, tuning)
            for c, cap, (_, surface) in zip(numbers, encoded, samples, strict=True)
        ]
        read_back = time.perf_counter()
        size = self.clusters.sizes[list(numbers)].sum()
        return Trial(
            WarmStart(tuning),
            *self._measured(numbers, encoded, total, missed),
            sum(cap.errors for cap in encoded) / size,
            [self._of_members(caps, c, cap, tuning.step) for c, cap in zip(numbers, decoded, strict=True)],
            4.0 * sum(cap.words.size for cap in encoded) / size,
            read - begin,
            coded - tuned,
            read_back - coded,
        )

    def _of_members(self, caps: Caps, c: int, decoded: codec.DecodedCap, step: float) -> NDArray[np.float32]:
        """(n, K channels) coefficients of a cap in the order of its members."""
        values = decoded.multiples * (step / codec.PARTS)
        if decoded.axes is not None:
            values = values @ decoded.axes
        found = np.empty(values.shape, dtype=np.float32)
        found[np.searchsorted(self.clusters.members[c], caps.along(c)[1].order)] = values
        return found

    def reconstructed(self, c: int, coefficients: NDArray) -> NDArray[np.float32]:
        """(n, channels, (L+1)²) vectors of a cap, channels decorrelated."""
        vectors = self.bases[c].reconstruct(coefficients, self.channels)
        if self.pilot is not None and self.pilot.mean is not None:
            kind = int(self.clusters.kinds[c])
            vectors[:, 0] += self.pilot.mean.vectors(self._normals[self.clusters.members[c]], kind)
        return vectors

    def under(self, errors: NDArray, missed: NDArray, lighting: NDArray) -> NDArray[np.float64]:
        """(3,) mean squared errors of radiance under one light, of coefficients that are off alike in all caps.

        Parameters
        ----------
        errors : (K channels, K channels)
            Mean products of the coefficients' errors; what caps have in common is their functions, not how they stand.
        missed : (L+1,)
            What the bases miss, by degree: averaged over the rotations of the light.
        lighting : (3, (L+1)²)
        """
        count, mixing = self.bases[0].count, channel_mixing(self.channels).astype(np.float64)
        products = errors.reshape(count, self.channels, count, self.channels)
        found = missed @ np.array([light_power(light) for light in lighting]).T
        for basis, size in zip(self.bases, self.clusters.sizes, strict=True):
            along = basis.synthesis @ lighting.T  # (K, 3)
            for c in range(3):
                mixed = mixing[:, c if self.channels == 3 else 0]
                of_channel = np.einsum("kdle,d,e->kl", products, mixed, mixed)
                found[c] += size / self.clusters.sizes.sum() * float(along[:, c] @ of_channel @ along[:, c])
        return found

    def _distortion(self, total: float, missed: float) -> float:
        """What rounding may change of vectors whose squares sum to ``total``, of which the bases miss ``missed``."""
        if self.settings.by_number:
            return max(_ROUNDING_SHARE * missed, _FINEST_ROUNDING**2 * total)
        return max(self.settings.asked**2 * total - missed, 0.01 * self.settings.asked**2 * total)

    def _measured(
        self, numbers: Sequence[int], encoded: list[codec.EncodedCap], total: float, missed: float
    ) -> tuple[Expectation, NDArray[np.float64]]:
        """What coding some caps lost, by degree, and the part of it that the bases miss."""
        lost, norm = np.zeros(self.bandlimit + 1), self.clusters.sizes[list(numbers)].sum() * self.channels
        for c, cap in zip(numbers, encoded, strict=True):
            basis = self.bases[c]
            errors = np.einsum("kclc->kl", cap.errors.reshape(basis.count, self.channels, basis.count, self.channels))
            lost += by_degree(np.sum((errors @ basis.synthesis) * basis.synthesis, axis=0)) / norm
        expected = self._expected(self._lost())
        # What the bases miss is spread over the degrees as the pilot has it; its sum was measured on all vertices.
        power = np.ones(self.bandlimit + 1) if self._weights is None else self._weights**2
        foreseen, whole = float(power @ expected.lost), float(power @ expected.total)
        missing = expected.lost * (missed / norm / foreseen if foreseen > 0.0 else 0.0)
        everything = expected.total * (total / norm / whole if whole > 0.0 else 1.0)
        return Expectation(lost + missing, everything), missing

    def _encoded(
        self, caps: Caps, numbers: Sequence[int], wanted: float
    ) -> tuple[codec.Tuning, list[codec.EncodedCap]]:
        """Tune on some caps, code those of the given numbers, and again with another step until what rounding changed
        is what is wanted."""
        # Many small problems: threads of BLAS gain nothing, and cost minutes where the cores are busy.
        with threadpool_limits(1, "blas"):
            return self._encoded_by_one(caps, numbers, wanted)

    def _encoded_by_one(
        self, caps: Caps, numbers: Sequence[int], wanted: float
    ) -> tuple[codec.Tuning, list[codec.EncodedCap]]:
        finest = caps.largest() / codec.LARGEST_MULTIPLE
        turned: Sequence[bool | None] = [None] * len(numbers)
        if self.start is None:
            sizes = self.clusters.sizes
            chosen = self.some_caps(_SAMPLE, numbers)
            part = sizes[chosen].sum() / sizes[list(numbers)].sum()
            tuning = codec.tune([caps.along(c) for c in chosen], wanted * part, finest)
        else:
            tuning, turned = self.start.tuning, self.start.turned or turned
            # Coded once more if it were a little too coarse; a little too fine is good enough.
            tuning = replace(tuning, step=_FINER * tuning.step)
        best: tuple[codec.Tuning, list[codec.EncodedCap]] | None = None
        attempts = 0
        encoded: list[codec.EncodedCap] = []
        while True:
            attempts += 1
            encoded = [self._encode(caps, c, tuning, turn) for c, turn in zip(numbers, turned, strict=True)]
            turned = [cap.turned for cap in encoded]  # a slightly different step does not change what pays
            distortion = sum(cap.distortion for cap in encoded)
            if distortion <= wanted * (1.0 + 1e-9) or tuning.step <= finest:
                best = tuning, encoded
            enough = _CLOSE if self.start is None else _CLOSE * _FINER**2
            close = enough * wanted <= distortion <= wanted or tuning.step <= finest or distortion == 0.0
            # If nothing is coded, a coarser step changes nothing.
            close = close or (distortion <= wanted and not any(cap.used for cap in encoded))
            if best is not None and (close or attempts >= _ATTEMPTS):
                return best
            # A little less than aimed for is enough.
            step = codec.next_step(tuning.step, distortion, 0.5 * (1.0 + _CLOSE) * wanted)
            tuning = replace(tuning, step=max(step, finest))

    def _encode(self, caps: Caps, c: int, tuning: codec.Tuning, turn: bool | None) -> codec.EncodedCap:
        """One cap; without ``turn``, turned as was asked for."""
        if turn is None:
            turn = False if self.settings.needs_all_vectors else self.settings.refine
        return codec.encode_cap(*caps.along(c), tuning, turn=turn, keep=self.keeps)

    def some_caps(self, vertices: int, numbers: Sequence[int] | None = None) -> list[int]:
        """Caps of all sizes that together hold so many vertices, the same every time."""
        sizes, chosen, held = self.clusters.sizes, [], 0
        among = np.zeros(len(sizes), dtype=bool)
        among[range(len(sizes)) if numbers is None else list(numbers)] = True
        for c in np.random.default_rng(self._seed).permutation(len(sizes)):
            if held < vertices and sizes[c] > 0 and among[c]:
                chosen.append(int(c))
                held += int(sizes[c])
        return chosen
