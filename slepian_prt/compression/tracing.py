"""Receivers traced and projected: block after block, in pieces of whole caps that are coded together afterwards.

Pieces and blocks depend on the scene and on what is asked of it, not on who traces them: so a file comes out the same
from one process and from any number of workers (`tracing_by_workers`).
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.attempts import LocalCoder
from slepian_prt.compression.blocks import ProjectedCaps
from slepian_prt.compression.checkpoint import Block, Journal, Wanted, journal
from slepian_prt.compression.encoder import MakeCoder
from slepian_prt.compression.fingerprint import fingerprint
from slepian_prt.compression.learning import LearnedBases
from slepian_prt.compression.memory import check_coding_memory
from slepian_prt.compression.projection import Projection, choose_projection, widen
from slepian_prt.lighting.fixed_lights import FixedLights
from slepian_prt.machine.threads import one_blas_thread
from slepian_prt.transport.estimator import Estimator, TransferBlock
from slepian_prt.transport.fixed_lights import direct_fixed_lights
from slepian_prt.transport.interior import InteriorVertices, find_interior
from slepian_prt.transport.memory import estimate_tracing
from slepian_prt.transport.planned import PlannedScene

log = logging.getLogger(__name__)

# Receivers inside other geometry that are projected at a time.
_INTERIOR_BLOCK = 1 << 14

Advance = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class Projected:
    """All receivers, projected on bases that hold enough of them.

    Attributes
    ----------
    projection : Projection
    blocks : ProjectedCaps
    rays : int
        Traced for it.
    fixed : FixedLights or None
        Light of the lamps, where receivers were traced.
    make_coder : callable
        Gives what rounds the caps; see `encode`.
    """

    projection: Projection
    blocks: ProjectedCaps
    rays: int = 0
    fixed: FixedLights | None = None
    make_coder: MakeCoder = LocalCoder


@dataclass(frozen=True, eq=False)
class Cut:
    """Receivers cut into blocks.

    Attributes
    ----------
    pieces : list of range
        Successive caps that are coded together.
    blocks : list of (n,) int64
        Receivers that are traced together, all in caps of one piece.
    of_piece : list of range
        Which blocks are those of each piece.
    """

    pieces: list[range]
    blocks: list[NDArray[np.int64]]
    of_piece: list[range]


def cut_receivers(source: Estimator[Any], projection: Projection) -> Cut:
    """Cut all receivers, for what they are projected on."""
    members, pieces = projection.learned.clusters.members, projection.pieces()
    blocks: list[NDArray[np.int64]] = []
    of_piece = []
    for piece in pieces:
        own = source.pieces(np.concatenate([members[c] for c in piece]))
        of_piece.append(range(len(blocks), len(blocks) + len(own)))
        blocks += own
    return Cut(pieces, blocks, of_piece)


@contextmanager
def trace_and_project(
    planned: PlannedScene,
    source: Estimator[Any],
    learned: LearnedBases,
    advance: Advance = lambda _done, _total: None,
) -> Iterator[Projected]:
    """Trace and project block after block; blocks are on disk, and gone when the with-block ends well.

    Parameters
    ----------
    planned : PlannedScene
        That does `by_blocks`.
    source : Estimator
        Of ``planned``.
    learned : LearnedBases
    advance : as of `precompute`
    """
    rays = source.rays
    projection = choose_projection(learned)
    check_coding_memory(projection, estimate_tracing(planned))
    while True:
        cut = cut_receivers(source, projection)
        with journal(fingerprint(planned, projection, cut.blocks)) as store:
            _trace(source, projection, cut, store, advance, planned.settings.samples)
            dark = [dark_receivers(block) for _, block in store]
            interior = find_interior_among(planned, dark)
            overrides = project_interior(source, projection, cut, interior)
            blocks = projection.caps(store, dict(enumerate(block for own in overrides for block in own)))
            wider = widen(projection, blocks)
            if wider is None:
                fixed, fixed_rays = trace_fixed_lights(planned, interior)
                rays += fixed_rays + sum(block.rays for _, block in store)
                yield Projected(projection, blocks, rays, fixed)
                return
        projection = wider
        log.info("the pilot foresaw too little error; once more with %d functions of each cap", wider.bases[0].count)


def trace_fixed_lights(planned: PlannedScene, interior: InteriorVertices) -> tuple[FixedLights | None, int]:
    """Light of the lamps, and the rays that it took; the clock of the scene tells transport and this apart."""
    planned.clock.stop("transport")
    fixed, rays = direct_fixed_lights(planned, interior)
    if fixed is not None:
        planned.clock.stop("fixed lights")
    return fixed, rays


def _trace(
    source: Estimator[Any], projection: Projection, cut: Cut, store: Journal, advance: Advance, samples: int
) -> None:
    """Trace and project all blocks that are not in the store already."""
    count = sum(block.size for block in cut.blocks)
    left = [number for number in range(len(cut.blocks)) if find_kept(store, projection, cut, number, samples) is None]
    kept = len(cut.blocks) - len(left)
    if kept:
        log.info("%d of %d blocks were finished before and are kept", kept, len(cut.blocks))
        advance(count - sum(cut.blocks[number].size for number in left), count)
    traced = source.blocks([cut.blocks[number] for number in left], projection.block)
    for number, block in zip(left, traced, strict=True):
        store.add(number, block)
        advance(block.vertices.size, count)


def find_kept(store: Journal, projection: Projection, cut: Cut, number: int, samples: int) -> Block | None:
    """A block that was finished before, if it is what is wanted of its receivers, with so many rays from each.

    One that is not is put aside with a note.
    """
    block = store.find(number)
    if block is None:
        return None
    receivers = cut.blocks[number]
    wanted = Wanted(receivers, projection.learned.clusters.index[receivers], projection.widths, samples)
    reason = wanted.misfit(block) or projection.misfit(block)
    if reason is not None:
        store.forget(number, reason)
        return None
    return block


def dark_receivers(block: Block) -> NDArray[np.int32]:
    """Those that see nothing of the sky."""
    return block.vertices[block.statistics.blocked >= 1.0]


def find_interior_among(planned: PlannedScene, dark: list[NDArray[np.int32]]) -> InteriorVertices:
    """Receivers inside other geometry, among those that see nothing of the sky, (n,) in each block."""
    found = np.sort(np.concatenate([np.zeros(0, dtype=np.int64), *dark]))
    return find_interior(planned.scene, found[planned.scene.receivers.active[found]])


def project_interior(
    source: Estimator[Any], projection: Projection, cut: Cut, interior: InteriorVertices
) -> list[list[Block]]:
    """For each piece, blocks of the receivers inside other geometry, whose transfer is that of their neighbours."""
    own = split_interior(projection, cut, interior)
    return [project_interior_of_piece(source, projection, part) for part in own]


def split_interior(projection: Projection, cut: Cut, interior: InteriorVertices) -> list[InteriorVertices]:
    """Those in the caps of each piece."""
    caps = projection.learned.clusters.index[interior.vertices]
    rows = [np.flatnonzero((caps >= piece.start) & (caps < piece.stop)) for piece in cut.pieces]
    return [InteriorVertices(interior.vertices[own], interior.weights[own]) for own in rows]


def project_interior_of_piece(
    source: Estimator[Any], projection: Projection, interior: InteriorVertices
) -> list[Block]:
    """Their blocks."""
    blocks = []
    for begin in range(0, interior.vertices.size, _INTERIOR_BLOCK):
        rows = slice(begin, begin + _INTERIOR_BLOCK)
        vertices, weights = interior.vertices[rows], interior.weights[rows]
        visible = np.unique(weights.indices)
        vectors = (weights[:, visible] @ source.estimate(visible).vectors[:, 0]).astype(np.float32)
        block = TransferBlock(vertices, vectors[:, None, :], np.ones(vertices.size, dtype=np.float32), 0)
        with one_blas_thread():  # as all other blocks
            blocks.append(projection.block(block))
    return blocks
