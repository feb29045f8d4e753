"""Projected blocks encoded: plainly, along principal axes, or entropy-coded to a wanted error."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.attempts import Attempt, CodedCap, Coder, LocalCoder
from slepian_prt.compression.bases import Candidate
from slepian_prt.compression.blocks import ProjectedCaps
from slepian_prt.compression.clustering import Clusters
from slepian_prt.compression.codec.caps import Coded, DecodedCap, Tuning
from slepian_prt.compression.codec.prediction import LARGEST_MULTIPLE
from slepian_prt.compression.codec.tuning import next_step
from slepian_prt.compression.learning import LearnedBases
from slepian_prt.compression.linear_basis import LinearBasis, in_float16, in_range_of_float16
from slepian_prt.compression.pilot import MeanTransfer
from slepian_prt.compression.prediction import Expectation
from slepian_prt.compression.projection import Projection, count_by_rule
from slepian_prt.compression.refinement import refine
from slepian_prt.errors import UserError
from slepian_prt.machine.threads import one_blas_thread

# With a given number of functions, rounding may add this part to the squared error of leaving out the others.
_ROUNDING_SHARE = 0.1
_FINEST_ROUNDING = 1e-3

# Receivers, and coefficients, that the step and the models are fitted to at most, in whole caps.
_SAMPLE = 15_000
_SAMPLE_COEFFICIENTS = 1 << 21
_ATTEMPTS = 3
_MOST_ATTEMPTS = 40
# What is left of the error asked for need not be used up to the last.
_CLOSE = 0.95
_FINER = 0.985


@dataclass(frozen=True)
class WarmStart:
    """What nearly the same coefficients were coded with: tried first, which saves most of the time.

    Attributes
    ----------
    tuning : Tuning
    principal_axes : tuple of bool
        Which caps were coded along their principal axes; empty if that is not known.
    """

    tuning: Tuning
    principal_axes: tuple[bool, ...] = ()

    def scaled(self, ratio: float) -> WarmStart:
        """For a tolerance that is ``ratio`` times as large."""
        return WarmStart(replace(self.tuning, step=self.tuning.step * ratio))


MakeCoder = Callable[[Projection, Any, bool], Coder]


@dataclass(frozen=True, kw_only=True)
class Encoding:
    """What a compressed transfer holds of coefficients, bases and expected error; see `CompressedTransfer`.

    Attributes
    ----------
    decoded : tuple of DecodedCap
        What decoders will get of each cap, where that was wanted; not a part of the file.
    """

    basis: str
    bases: tuple[LinearBasis, ...]
    clusters: Clusters
    channels: int
    prior: str
    expected: Expectation
    terms: float
    coefficients: tuple[NDArray, ...] = ()
    coded: Coded | None = None
    mean: MeanTransfer | None = None
    decoded: tuple[DecodedCap, ...] = ()


def encode(
    projection: Projection,
    blocks: ProjectedCaps,
    make_coder: MakeCoder = LocalCoder,
    *,
    warm_start: WarmStart | None = None,
    keep_decoded: bool = False,
) -> Encoding:
    """Encode all caps as the settings of the projection ask.

    Parameters
    ----------
    projection : Projection
    blocks : ProjectedCaps
        All receivers, projected.
    make_coder : callable
        Gives what rounds all caps, where the receivers are.
    warm_start : WarmStart, optional
    keep_decoded : bool
        Whether what was coded is wanted as it will be decoded.
    """
    settings = projection.learned.settings
    if settings.resolved_coding == "coded":
        return _encode_coded(projection, blocks, make_coder(projection, blocks, keep_decoded), warm_start)
    if settings.refine:
        return _encode_refined(projection, blocks)
    coding = settings.resolved_coding
    return _encoding(
        projection,
        projection.bases,
        expected=expect(projection.learned, _lost(projection)),
        terms=_mean_terms(projection.learned, projection.bases),
        coefficients=_plain(map(blocks.coefficients, range(len(projection.bases))), coding),
    )


def _encoding(projection: Projection, bases: tuple[LinearBasis, ...], **fields: object) -> Encoding:
    learned = projection.learned
    prior = learned.settings.light_prior
    return Encoding(
        basis=learned.settings.basis,
        bases=bases,
        clusters=learned.clusters,
        channels=learned.channels,
        prior="" if prior is None else prior.name,
        **fields,  # type: ignore[arg-type]
    )


def _plain(caps: Iterable[NDArray], coding: str) -> tuple[NDArray, ...]:
    """Coefficients of each cap in float16 or float32."""
    kept, largest = [], 0.0
    for coefficients in caps:
        largest = max(largest, float(np.abs(coefficients).max(initial=0.0)))
        with np.errstate(over="ignore"):  # told below
            kept.append(coefficients.astype(coding))
    if coding == "float16" and not in_range_of_float16(largest):
        raise UserError(f"coefficients of {largest:.3g} do not fit `coding=float16`; choose `coding=float32`")
    return tuple(kept)


def _encode_refined(projection: Projection, blocks: ProjectedCaps) -> Encoding:
    """Mean and principal axes of the coefficients of each cap, uncoded."""
    learned = projection.learned
    refined = [
        refine(basis, candidate.lost(basis.count), blocks.coefficients(c), learned.channels)
        for c, (basis, candidate) in enumerate(zip(projection.bases, learned.candidates, strict=True))
    ]
    candidates = tuple(part.candidate for part in refined)
    counts = count_by_rule(learned, candidates)
    bases = tuple(candidate.cut(int(k)) for candidate, k in zip(candidates, counts, strict=True))
    coding = learned.settings.resolved_coding
    if coding == "float16":
        bases = in_float16(bases)
    return _encoding(
        projection,
        bases,
        expected=expect(learned, [c.lost(int(k)) for c, k in zip(candidates, counts, strict=True)]),
        terms=_mean_terms(learned, bases),
        coefficients=_plain(
            (
                part.coefficients(blocks.coefficients(c), basis.count)
                for c, (part, basis) in enumerate(zip(refined, bases, strict=True))
            ),
            coding,
        ),
    )


def _encode_coded(
    projection: Projection, blocks: ProjectedCaps, coder: Coder, warm_start: WarmStart | None
) -> Encoding:
    """All caps coded with one step, such that the error asked for is met by measurement."""
    learned = projection.learned
    total, missed = blocks.energies()
    wanted = allowed_distortion(projection, total, missed)
    # Many small problems: threads of BLAS gain nothing, and cost minutes where the cores are busy.
    with one_blas_thread():
        tuning, encoded = _encode_to_distortion(projection, blocks, coder, wanted, warm_start)
    sizes = learned.clusters.sizes
    used = np.array([cap.used / learned.channels for cap in encoded]) + (projection.bases[0].mean is not None)
    everyone = blocks.size(range(len(encoded)))
    expected, _ = measure_expectation(projection, [cap.lost for cap in encoded], everyone, total, missed)
    return _encoding(
        projection,
        projection.bases,
        expected=expected,
        terms=float(used @ sizes / sizes.sum()),
        coded=Coded(tuning, tuple(cap.content for cap in encoded)),
        mean=None if learned.pilot is None else learned.pilot.mean,
        decoded=tuple(cap.decoded for cap in encoded if cap.decoded is not None),
    )


def _encode_to_distortion(
    projection: Projection, blocks: ProjectedCaps, coder: Coder, wanted: float, warm_start: WarmStart | None
) -> tuple[Tuning, list[CodedCap]]:
    """Tune on some caps, code all, and again with another step until what rounding changed is what is wanted."""
    count, width = len(projection.bases), max(1, int(blocks.widths.max(initial=0)))
    finest = blocks.largest() / LARGEST_MULTIPLE
    choices: Sequence[bool | None] = [principal_axes_asked(projection)] * count
    if warm_start is None:
        sample = sample_caps(projection.learned, min(_SAMPLE, _SAMPLE_COEFFICIENTS // width))
        part = blocks.size(sample) / blocks.size(range(count))
        tuning = blocks.tune(sample, wanted * part, finest, choices[0])
    else:
        choices = warm_start.principal_axes or choices
        # Coded once more if it were a little too coarse; a little too fine is good enough.
        tuning = replace(warm_start.tuning, step=_FINER * warm_start.tuning.step)
    tuning = replace(tuning, predictor=tuning.predictor.of_width(width))
    enough = _CLOSE if warm_start is None else _CLOSE * _FINER**2
    last: Attempt | None = None
    best: Attempt | None = None
    for number in range(1, _MOST_ATTEMPTS + 1):
        last = coder.attempt(tuning, choices, last)
        choices = last.principal_axes or choices
        distortion = last.distortion
        if distortion <= wanted * (1.0 + 1e-9) or tuning.step <= finest:
            best = last
        close = enough * wanted <= distortion <= wanted or tuning.step <= finest or distortion == 0.0
        # If nothing is coded, a coarser step changes nothing.
        close = close or (distortion <= wanted and not last.used)
        if best is not None and (close or number >= _ATTEMPTS):
            break
        # A little less than aimed for is enough.
        step = next_step(tuning.step, distortion, 0.5 * (1.0 + _CLOSE) * wanted)
        tuning = replace(tuning, step=max(step, finest))
    chosen = best or last
    assert chosen is not None
    return chosen.tuning, chosen.encode()


def principal_axes_asked(projection: Projection) -> bool | None:
    """Whether caps are coded along their principal axes; None where that pays."""
    settings = projection.learned.settings
    return False if settings.needs_all_vectors else settings.refine


def sample_caps(learned: LearnedBases, receivers: int) -> list[int]:
    """Caps of all sizes that together hold so many receivers, the same every time."""
    sizes, held = learned.clusters.sizes, 0
    chosen = []
    for c in np.random.default_rng(learned.seed).permutation(len(sizes)):
        if held < receivers and sizes[c] > 0:
            chosen.append(int(c))
            held += int(sizes[c])
    return chosen


# --- Expected error --------------------------------------------------------------------------------------------------


def allowed_distortion(projection: Projection, total: float, missed: float) -> float:
    """What rounding may change of vectors whose squares sum to ``total``, of which the bases miss ``missed``."""
    settings = projection.learned.settings
    if settings.by_number:
        return max(_ROUNDING_SHARE * missed, _FINEST_ROUNDING**2 * total)
    allowed = settings.resolved_tolerance**2 * total
    return max(allowed - missed, 0.01 * allowed)


def expect(learned: LearnedBases, lost: Sequence[NDArray]) -> Expectation:
    """From what each cap's vectors are expected to lose, (L+1,) each."""
    clusters = learned.clusters
    shares = clusters.sizes / clusters.sizes.sum()
    if learned.pilot is not None:
        total = shares @ learned.pilot.energies[clusters.occlusion_classes]
    else:  # what nothing holds is everything
        total = shares @ np.array([candidate.lost(0) for candidate in learned.candidates])
    return Expectation(shares @ np.array(lost), total)


def measure_expectation(
    projection: Projection, lost: Sequence[NDArray[np.float64]], receivers: int, total: float, missed: float
) -> tuple[Expectation, NDArray[np.float64]]:
    """What coding some caps lost, by degree, and the part of it that the bases miss.

    Parameters
    ----------
    projection : Projection
    lost : sequence of (L+1,)
        Of each of these caps; see `CodedCap`.
    receivers : int
        In these caps.
    total, missed : float
        Sums over them, as of `ProjectedCaps.energies`.
    """
    learned = projection.learned
    norm = receivers * learned.channels
    coded = np.zeros(learned.bandlimit + 1)
    for own in lost:
        coded += own / norm
    expected = expect(learned, _lost(projection))
    # What the bases miss is spread over the degrees as the pilot has it; its sum was measured on all receivers.
    foreseen, whole = float(learned.power @ expected.lost), float(learned.power @ expected.total)
    missing = expected.lost * (missed / norm / foreseen if foreseen > 0.0 else 0.0)
    everything = expected.total * (total / norm / whole if whole > 0.0 else 1.0)
    return Expectation(coded + missing, everything), missing


def _lost(projection: Projection) -> list[NDArray[np.float64]]:
    """What the bases are expected to lose of each cap's vectors, by degree."""
    pairs: Sequence[tuple[Candidate, LinearBasis]] = list(
        zip(projection.learned.candidates, projection.bases, strict=True)
    )
    return [candidate.lost(basis.count + (basis.mean is not None)) for candidate, basis in pairs]


def _mean_terms(learned: LearnedBases, bases: tuple[LinearBasis, ...]) -> float:
    counts = np.array([basis.count + (basis.mean is not None) for basis in bases])
    return float(counts @ learned.clusters.sizes / learned.clusters.sizes.sum())
