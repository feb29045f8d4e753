"""As `tracing`, by workers: blocks are traced and projected there, and coded there in the same pieces.

Coefficients stay with the workers: what comes back are sums over blocks, and caps as bytes. Each worker also keeps what
it has finished in a journal, so that others on its machine go on from there when it dies.
"""

from __future__ import annotations

import logging
import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.attempts import HELD_PIECES, Attempt, CodedCap, encode_piece
from slepian_prt.compression.checkpoint import Block, Journal, MemoryStore, journal
from slepian_prt.compression.codec.caps import Tuning
from slepian_prt.compression.codec.encoding import RoundedCaps, round_caps
from slepian_prt.compression.codec.surface import surface_of
from slepian_prt.compression.codec.tuning import tune
from slepian_prt.compression.fingerprint import fingerprint
from slepian_prt.compression.learning import LearnedBases
from slepian_prt.compression.projection import Projection, choose_projection, widen
from slepian_prt.compression.tracing import (
    Advance,
    Cut,
    Projected,
    cut_receivers,
    dark_receivers,
    find_interior_among,
    find_kept,
    project_interior_of_piece,
    split_interior,
    trace_fixed_lights,
)
from slepian_prt.transport.estimator import Estimator
from slepian_prt.transport.interior import InteriorVertices
from slepian_prt.transport.planned import PlannedScene
from slepian_prt.transport.portable import PortableScene, make_portable

if TYPE_CHECKING:
    from distributed import Future

    from slepian_prt.distributed.crew import Crew, Shared
    from slepian_prt.scene.loading import SceneSource

log = logging.getLogger(__name__)


# --- What workers do -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class TracingJob:
    """What workers are given once.

    Attributes
    ----------
    scene : PortableScene
    projection : Projection
    cut : Cut
    fingerprint, folder : str
        Of the journal, and where it is on machines that see the client's disk.
    """

    scene: PortableScene
    projection: Projection
    cut: Cut
    fingerprint: str
    folder: str

    @contextmanager
    def open(self) -> Iterator[_OpenJob]:
        """The job in a worker."""
        with self.scene.open() as planned, _journal_here(self.folder) as store:
            yield _OpenJob(planned.estimator(), self.projection, self.cut, store, planned.settings.samples)


@contextmanager
def _journal_here(folder: str) -> Iterator[Journal]:
    """The client's journal where its disk is seen, else one that ends with the worker, in the folder of its own."""
    if Path(folder).is_dir() and os.access(folder, os.W_OK | os.X_OK):
        yield Journal(Path(folder), look=False)
        return
    from distributed import get_worker

    try:
        place = get_worker().local_directory
    except ValueError:  # not in a worker
        place = None
    with tempfile.TemporaryDirectory(prefix="slepian_prt-", dir=place) as own:
        yield Journal(Path(own), look=False)


class _OpenJob(NamedTuple):
    source: Estimator[Any]
    projection: Projection
    cut: Cut
    store: Journal
    samples: int


class _BlockFacts(NamedTuple):
    """What the client hears of a block."""

    receivers: int
    rays: int
    dark: NDArray[np.int32]


class _PieceFacts(NamedTuple):
    """What the client hears of the coefficients of a piece."""

    total: float
    missed: float
    largest: float


@dataclass(frozen=True, eq=False)
class PieceCoefficients:
    """Coefficients of the caps of a piece.

    Attributes
    ----------
    caps : range
    parts : list of (n, K channels) float32
        In the order of the caps' members.
    facts : _PieceFacts
    """

    caps: range
    parts: list[NDArray[np.float32]]
    facts: _PieceFacts


class _Coded(NamedTuple):
    """Caps of a piece as bytes, and what coding them changed."""

    caps: list[CodedCap]
    distortion: float


class _CodedFacts(NamedTuple):
    distortion: float
    used: int
    principal_axes: list[bool] | None


def _trace_block(job: _OpenJob, number: int) -> Block:
    receivers = job.cut.blocks[number]
    kept = find_kept(job.store, job.projection, job.cut, number, job.samples)
    if kept is None:
        (kept,) = job.source.blocks([receivers], job.projection.block)
        job.store.add(number, kept)
    return kept


def _tell_of_block(_job: _OpenJob, block: Block) -> _BlockFacts:
    return _BlockFacts(block.vertices.size, block.rays, dark_receivers(block))


def _assemble_piece(job: _OpenJob, item: tuple[int, list[Block], InteriorVertices]) -> PieceCoefficients:
    number, blocks, interior = item
    projection, caps = job.projection, job.cut.pieces[number]
    overrides = project_interior_of_piece(job.source, projection, interior)
    store = MemoryStore()
    for own, block in enumerate(blocks):
        store.add(own, block)
    whole = projection.caps(store, dict(enumerate(overrides)))
    members = [projection.learned.clusters.members[c] for c in caps]
    everything = [*blocks, *overrides]
    total, missed = _sum_energies(np.concatenate(members), everything)
    largest = max((float(np.abs(block.coefficients).max(initial=0.0)) for block in everything), default=0.0)
    return PieceCoefficients(caps, [whole.coefficients(c) for c in caps], _PieceFacts(total, missed, largest))


def _sum_energies(members: NDArray[np.int64], blocks: Sequence[Block]) -> tuple[float, float]:
    """Of the receivers of a piece; later blocks replace what earlier ones have of theirs."""
    order = np.argsort(members, kind="stable")
    ascending = members[order]
    sums = np.zeros((2, members.size), dtype=np.float64)
    for block in blocks:
        places = order[np.searchsorted(ascending, block.vertices)]
        sums[0, places], sums[1, places] = block.statistics.energy, block.statistics.missed
    return float(sums[0].sum()), float(sums[1].sum())


def _tell_of_piece(_job: _OpenJob, piece: PieceCoefficients) -> _PieceFacts:
    return piece.facts


def _coefficients_of(_job: _OpenJob, item: tuple[PieceCoefficients, int]) -> NDArray[np.float32]:
    piece, cap = item
    return piece.parts[cap - piece.caps.start]


def _tune(job: _OpenJob, item: tuple[list[NDArray], Sequence[int], float, float, bool | None]) -> Tuning:
    samples, caps, distortion, finest, principal_axes = item
    learned = job.projection.learned
    rows = surface_of(learned.receivers).rows([learned.clusters.members[c] for c in caps])
    return tune(samples, rows, distortion, finest, principal_axes)


def _round_piece(job: _OpenJob, item: tuple[PieceCoefficients, Tuning, Sequence[bool | None]]) -> RoundedCaps:
    piece, tuning, choices = item
    learned = job.projection.learned
    rows = surface_of(learned.receivers).rows([learned.clusters.members[c] for c in piece.caps])
    return round_caps(piece.parts, rows, tuning, choices)


def _round_again(_job: _OpenJob, item: tuple[RoundedCaps, Tuning]) -> RoundedCaps:
    rounded, tuning = item
    return rounded.with_tuning(tuning)


def _encode_rounded(job: _OpenJob, item: tuple[range, RoundedCaps, bool]) -> _Coded:
    caps, rounded, keep = item
    return _Coded(encode_piece(job.projection, caps, rounded, keep), rounded.distortion)


def _encode_piece(job: _OpenJob, item: tuple[PieceCoefficients, Tuning, Sequence[bool | None], bool]) -> _Coded:
    piece, tuning, choices, keep = item
    return _encode_rounded(job, (piece.caps, _round_piece(job, (piece, tuning, choices)), keep))


def _tell_of_rounded(_job: _OpenJob, rounded: RoundedCaps) -> _CodedFacts:
    return _CodedFacts(rounded.distortion, rounded.used, None)


def _tell_of_coded(_job: _OpenJob, coded: _Coded) -> _CodedFacts:
    axes = [cap.content.principal_axes for cap in coded.caps]
    return _CodedFacts(coded.distortion, sum(cap.used for cap in coded.caps), axes)


def _caps_of(_job: _OpenJob, coded: _Coded) -> list[CodedCap]:
    return coded.caps


# --- What the client does --------------------------------------------------------------------------------------------


@contextmanager
def trace_by_workers(
    planned: PlannedScene,
    source: Estimator[Any],
    learned: LearnedBases,
    crew: Crew,
    scene: SceneSource,
    advance: Advance = lambda _done, _total: None,
) -> Iterator[Projected]:
    """As `trace_and_project`, by workers.

    Parameters
    ----------
    planned, source, learned, advance : as of `trace_and_project`
    crew : Crew
    scene : as of `precompute`
        What was planned.
    """
    rays, portable = source.rays, make_portable(planned, scene)
    projection = choose_projection(learned)
    while True:
        cut = cut_receivers(source, projection)
        name = fingerprint(planned, projection, cut.blocks)
        with journal(name) as store:
            job = crew.share(TracingJob(portable, projection.as_sent(), cut, name, str(store.folder)), name)
            try:
                blocks, facts = _trace(crew, job, cut, advance)
                interior = find_interior_among(planned, [fact.dark for fact in facts])
                pieces = _assemble(crew, job, cut, blocks, split_interior(projection, cut, interior))
                caps = RemoteCaps(crew, job, cut, pieces, projection)
                del blocks  # the pieces have them; what dies is made again from the journal
                wider = widen(projection, caps)
                if wider is None:
                    fixed, fixed_rays = trace_fixed_lights(planned, interior)
                    rays += fixed_rays + sum(fact.rays for fact in facts)
                    yield Projected(projection, caps, rays, fixed, RemoteCoder)
                    return
            finally:
                crew.release(job)
        projection = wider
        log.info("the pilot foresaw too little error; once more with %d functions of each cap", wider.bases[0].count)


def _trace(crew: Crew, job: Shared, cut: Cut, advance: Advance) -> tuple[list[Future], list[_BlockFacts]]:
    count = sum(block.size for block in cut.blocks)
    blocks = crew.submit(_trace_block, range(len(cut.blocks)), job)
    facts: list[Any] = [None] * len(blocks)
    for number, fact in crew.results(crew.submit(_tell_of_block, blocks, job, priority=1)):
        facts[number] = fact
        advance(fact.receivers, count)
    return blocks, facts


def _assemble(
    crew: Crew, job: Shared, cut: Cut, blocks: Sequence[Future], interior: Sequence[InteriorVertices]
) -> list[Future]:
    items = [
        (number, [blocks[b] for b in own], part)
        for number, (own, part) in enumerate(zip(cut.of_piece, interior, strict=True))
    ]
    return crew.submit(_assemble_piece, items, job)


class RemoteCaps:
    """Coefficients of all receivers that are with workers; see `ProjectedCaps`.

    Parameters
    ----------
    crew : Crew
    job : Shared
        A `TracingJob`.
    cut : Cut
    pieces : sequence of Future
        `PieceCoefficients`.
    projection : Projection
    """

    def __init__(self, crew: Crew, job: Shared, cut: Cut, pieces: Sequence[Future], projection: Projection) -> None:
        self.crew, self.job, self.cut, self.pieces = crew, job, cut, pieces
        self._sizes, self.widths = projection.learned.clusters.sizes, projection.widths
        self._piece_of = np.repeat(np.arange(len(cut.pieces)), [len(piece) for piece in cut.pieces])
        told = dict(crew.results(crew.submit(_tell_of_piece, pieces, job, priority=1)))
        self._facts: list[_PieceFacts] = [told[number] for number in range(len(pieces))]

    def size(self, caps: Sequence[int]) -> int:
        return int(sum(self._sizes[c] for c in caps))

    def energies(self) -> tuple[float, float]:
        return sum(fact.total for fact in self._facts), sum(fact.missed for fact in self._facts)

    def largest(self) -> float:
        return max((fact.largest for fact in self._facts), default=0.0)

    def coefficients(self, cap: int) -> NDArray[np.float32]:
        found = self.crew.submit(_coefficients_of, [(self.pieces[self._piece_of[cap]], cap)], self.job)
        return np.asarray(self.crew.gather(found)[0])

    def tune(self, caps: Sequence[int], distortion: float, finest: float, principal_axes: bool | None) -> Tuning:
        # The caps alone go to the worker that does it, not the pieces that they are in.
        samples = self.crew.submit(_coefficients_of, [(self.pieces[self._piece_of[c]], c) for c in caps], self.job)
        item = (samples, list(caps), distortion, finest, principal_axes)
        (tuning,) = self.crew.gather(self.crew.submit(_tune, [item], self.job))
        assert isinstance(tuning, Tuning)
        return tuning


class RemoteCoder:
    """Rounds all caps where they are; see `Coder`."""

    def __init__(self, projection: Projection, caps: RemoteCaps, keep: bool) -> None:
        self._caps, self._keep = caps, keep
        self._rounded: list[Future] = []

    def attempt(self, tuning: Tuning, choices: Sequence[bool | None], before: Attempt | None) -> Attempt:
        caps, crew, job = self._caps, self._caps.crew, self._caps.job
        own = [[choices[c] for c in piece] for piece in caps.cut.pieces]
        if len(caps.pieces) > HELD_PIECES:
            items = [(piece, tuning, some, self._keep) for piece, some in zip(caps.pieces, own, strict=True)]
            coded = crew.submit(_encode_piece, items, job)
            facts = self._hear(coded, _tell_of_coded)
            axes = [along for fact in facts for along in fact.principal_axes or ()]
            return _attempt(tuning, facts, axes, lambda: self._collect(coded))
        if before is None:
            rounded = crew.submit(_round_piece, [(p, tuning, c) for p, c in zip(caps.pieces, own, strict=True)], job)
        else:
            rounded = crew.submit(_round_again, [(piece, tuning) for piece in self._rounded], job)
        self._rounded = rounded
        return _attempt(tuning, self._hear(rounded, _tell_of_rounded), None, lambda: self._encode(rounded))

    def _hear(self, futures: Sequence[Future], tell: Any) -> list[_CodedFacts]:
        crew, job = self._caps.crew, self._caps.job
        told = dict(crew.results(crew.submit(tell, futures, job, priority=1)))
        return [told[number] for number in range(len(futures))]

    def _encode(self, rounded: Sequence[Future]) -> list[CodedCap]:
        pieces = self._caps.cut.pieces
        items = [(caps, own, self._keep) for caps, own in zip(pieces, rounded, strict=True)]
        return self._collect(self._caps.crew.submit(_encode_rounded, items, self._caps.job))

    def _collect(self, coded: Sequence[Future]) -> list[CodedCap]:
        """Finished caps, as they come."""
        found: list[list[CodedCap]] = [[] for _ in coded]
        for number, part in self._caps.crew.results(coded):
            found[number] = part.caps
        return [cap for part in found for cap in part]


def _attempt(tuning: Tuning, facts: Sequence[_CodedFacts], axes: list[bool] | None, encode: Any) -> Attempt:
    return Attempt(tuning, sum(fact.distortion for fact in facts), sum(fact.used for fact in facts), axes, encode)
