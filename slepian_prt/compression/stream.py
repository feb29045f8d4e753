"""From transfer vectors to a file: bases first, then block after block of vertices, then cap after cap.

Bases are made from a pilot, before the vectors are there. So each block of vertices is traced, projected and forgotten,
and the vectors of the whole mesh are never held; what is kept are the coefficients.
"""

from __future__ import annotations

import hashlib
import logging
import time
from collections.abc import Callable
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from slepian_prt.compression.baselines import iterate_clusters, pca_candidates
from slepian_prt.compression.checkpoint import Block, Journal, MemoryStore, Store, journal
from slepian_prt.compression.clustering import Clusters
from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.encoder import Encoder
from slepian_prt.compression.grouping import Grouping, grouped, surveyed
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.lighting.projection import project_environment
from slepian_prt.scene.mesh import Mesh
from slepian_prt.transport.effects import Effect
from slepian_prt.transport.estimator import Estimator, TransferBlock
from slepian_prt.transport.interior import find_interior
from slepian_prt.transport.planned import PlannedScene, plan_scene
from slepian_prt.transport.settings import TransportSettings
from slepian_prt.transport.transfer import Transfer, compute_transfer

log = logging.getLogger(__name__)

# Vertices that are projected at a time when their vectors are there.
_BLOCK = 1 << 14

# Terms that clusters of PCA are iterated for when their number is not given.
USUAL_TERMS = 16

Tell = Callable[[str], None]
Review = Callable[[CompressedTransfer], float | None]


def compress(
    transfer: Transfer,
    basis: str = "adapted",
    *,
    clusters: int | Clusters | Grouping | None = None,
    report: Tell = lambda _: None,
    **options: Any,
) -> CompressedTransfer:
    """Cluster, project, truncate and code transfer vectors.

    Parameters
    ----------
    transfer : Transfer
    basis : str
    clusters : int, or Clusters of the transfer's own axes, or a Grouping, made before
    report : callable
        Told what is being done.
    **options
        The other attributes of `CompressionSettings`: tolerance, terms, truncate, epsilon, group_by, occlusion_classes,
        light_prior, refine, coding.

    Raises
    ------
    ValueError
        An unknown name, a number outside its range, or options that exclude each other.
    """
    if isinstance(clusters, Clusters):
        clusters = Grouping(clusters, transfer.axes)
    if not isinstance(clusters, Grouping) and clusters is not None:
        options["clusters"] = clusters
    settings = CompressionSettings(basis=basis, **options)
    settings.check(transfer.bandlimit)
    started = time.perf_counter()
    grouping = clusters if isinstance(clusters, Grouping) else grouped(settings, transfer)
    if settings.basis == "cpca":
        terms = settings.terms or USUAL_TERMS
        iterated = iterate_clusters(grouping.clusters, transfer.axes, transfer.vectors, terms, report)
        grouping = Grouping(iterated, transfer.axes)
    work = Encoder(
        settings,
        transfer.mesh,
        grouping,
        transfer.bandlimit,
        transfer.seed,
        toward_view=transfer.toward_view,
    )
    if settings.needs_all_vectors:
        candidates = pca_candidates(transfer.bandlimit, grouping.clusters, transfer.vectors)
        work.use(candidates, transfer.vectors.shape[1])
    else:
        report(f"basis {basis}")
        work.learn(lambda vertices: transfer.vectors[vertices])
    return compressed(transfer, work, report, started)


def compressed(
    transfer: Transfer, work: Encoder, report: Tell, started: float, review: Review = lambda _: None
) -> CompressedTransfer:
    """Project and code vectors that are there, with bases that are learnt.

    ``started`` is when compression began, by `time.perf_counter`; ``review`` as of `streamed`.
    """
    store = projected(transfer, work)
    report("coding")
    return _reviewed(partial(finished, transfer, work, store, started), work, review, report)


def _reviewed(
    code: Callable[[], CompressedTransfer], work: Encoder, review: Review, report: Tell
) -> CompressedTransfer:
    """Code until a review is content."""
    packed = code()
    while (finer := review(packed)) is not None:
        report(f"coding once more, tolerance {finer:.3g}")
        assert packed.coded is not None
        work.refine_to(finer, packed.coded.tuning)
        packed = code()
    return packed


def projected(transfer: Transfer, work: Encoder) -> MemoryStore:
    """Blocks of vectors that are there, on bases that hold enough of them."""
    while True:
        store = MemoryStore()
        for number, begin in enumerate(range(0, len(transfer.vectors), _BLOCK)):
            vertices = np.arange(begin, min(begin + _BLOCK, len(transfer.vectors)))
            store.add(number, work.block(vertices, transfer.vectors[vertices], np.zeros(vertices.size), 0))
        if not work.widened(store, {}):
            return store


def finished(transfer: Transfer, work: Encoder, store: MemoryStore, started: float) -> CompressedTransfer:
    """Code what was projected."""
    result = work.finish(store, {})
    own = transfer.environment
    packed = CompressedTransfer(
        **result,
        mesh=transfer.mesh,
        parts=transfer.parts,
        bandlimit=transfer.bandlimit,
        clusters=work.clusters,
        effects=transfer.effects,
        bounces=transfer.bounces,
        samples=transfer.samples,
        seed=transfer.seed,
        rays_traced=transfer.rays_traced,
        seconds={**transfer.seconds, "compress": time.perf_counter() - started},
        source=transfer.source,
        lighting=None if own is None else project_environment(own, transfer.bandlimit),
        view=transfer.view,
        toward_view=transfer.toward_view,
    )
    return packed.knowing(work.decoded) if work.decoded else packed


def precompute_compressed(
    scene: str | Path | Mesh,
    settings: CompressionSettings,
    transport: TransportSettings,
    *,
    on_plan: Callable[[tuple[Effect, ...]], None] = lambda _: None,
    advance: Callable[[int, int], None] = lambda _done, _total: None,
    report: Tell = lambda _: None,
) -> CompressedTransfer:
    """Transfer of a scene, compressed as it is traced.

    Work that is killed goes on from its finished blocks when it is started again with the same arguments. Vectors are
    held all at once only where vertices depend on each other (interreflection), toward a view, and for bases that must
    see them all.

    Parameters
    ----------
    scene : path of a mesh or Mitsuba scene, or a `Mesh`
    settings : CompressionSettings
    transport : TransportSettings
    on_plan, advance : as of `precompute`
    report : callable
        Told what is being done.

    Raises
    ------
    UserError
    """
    settings.check(int(transport.bandlimit))
    with plan_scene(scene, transport, on_plan) as planned:
        if not planned.by_blocks or settings.needs_all_vectors:
            transfer = compute_transfer(planned, advance)
            return compress(transfer, report=report, **vars(settings))
        source, grouping = planned.estimator(), surveyed(settings, planned)
        work = Encoder(settings, planned.scene.mesh, grouping, int(transport.bandlimit), transport.seed)
        work.learn(lambda vertices: source.estimate(vertices).vectors)
        return streamed(planned, source, work, advance, report)


def streamed(
    planned: PlannedScene,
    source: Estimator[Any],
    work: Encoder,
    advance: Callable[[int, int], None],
    report: Tell,
    review: Review = lambda _: None,
) -> CompressedTransfer:
    """Trace and project block after block, then code.

    Parameters
    ----------
    planned : PlannedScene
        That does `by_blocks`.
    source : Estimator
        Of ``planned``.
    work : Encoder
        With its bases learnt.
    advance, report : as of `precompute_compressed`
    review : callable
        Given what was coded; answers with a finer tolerance to code again with, or None.
    """
    of_pilot = source.rays
    while True:
        with journal(_fingerprint(planned, work)) as store:
            _trace(planned, source, work, store, advance)
            overrides = _borrowed(planned, source, work, store)
            if not work.widened(store, overrides):
                planned.clock.stop("transport")
                report("coding")
                rays = of_pilot + sum(block.rays for _, block in store)
                code = partial(_finished, planned, work, store, overrides, rays)
                return _reviewed(code, work, review, report)
        log.info("the pilot foresaw too little error; once more with %d functions of each cap", work.bases[0].count)


def _finished(
    planned: PlannedScene, work: Encoder, store: Store, overrides: dict[int, Block], rays: int
) -> CompressedTransfer:
    """Code what was traced."""
    begin = time.perf_counter()
    result = work.finish(store, overrides)
    seconds = planned.clock.seconds
    seconds["compress"] = seconds.get("compress", 0.0) + time.perf_counter() - begin
    own = planned.scene.environment
    packed = CompressedTransfer(
        **result,
        mesh=planned.scene.mesh,
        parts=planned.scene.parts,
        bandlimit=work.bandlimit,
        clusters=work.clusters,
        effects=planned.plan.effects,
        bounces=0,
        samples=int(planned.settings.samples),
        seed=planned.settings.seed,
        rays_traced=rays,
        seconds=seconds,
        source=planned.scene.path,
        lighting=None if own is None else project_environment(own, work.bandlimit),
        view=planned.scene.view,
    )
    return packed.knowing(work.decoded) if work.decoded else packed


def _trace(
    planned: PlannedScene, source: Estimator[Any], work: Encoder, store: Journal, advance: Callable[[int, int], None]
) -> None:
    """Trace and project all blocks that are not in the journal already."""
    pieces, count = source.pieces(), len(planned.scene.mesh.positions)
    done = {number for number, _ in store}
    left = [number for number in range(len(pieces)) if number not in done]
    if done:
        log.info("%d of %d blocks were finished before and are kept", len(done), len(pieces))
        advance(sum(pieces[number].size for number in done), count)

    def project(block: TransferBlock) -> Block:
        return work.block(block.vertices, block.vectors, block.blocked, block.rays)

    for number, block in zip(left, source.blocks([pieces[number] for number in left], project), strict=True):
        store.add(number, block)
        advance(block.vertices.size, count)


def _borrowed(planned: PlannedScene, source: Estimator[Any], work: Encoder, store: Store) -> dict[int, Block]:
    """Blocks of the vertices inside other geometry, whose transfer is that of their neighbours."""
    dark = [block.vertices[block.figures[:, 0] >= 1.0] for _, block in store]
    receivers = planned.scene.mesh.receivers.active
    found = np.sort(np.concatenate([np.zeros(0, dtype=np.int32), *dark]))
    interior = find_interior(planned.scene, found[receivers[found]].astype(np.int64))
    overrides = {}
    for number, begin in enumerate(range(0, interior.vertices.size, _BLOCK)):
        rows = interior.vertices[begin : begin + _BLOCK]
        weights = interior.weights[begin : begin + _BLOCK]
        lenders = np.unique(weights.indices)
        vectors = weights[:, lenders] @ source.estimate(lenders).vectors[:, 0]
        overrides[number] = work.block(rows, vectors[:, None, :].astype(np.float32), np.ones(rows.size), 0)
    return overrides


def _fingerprint(planned: PlannedScene, work: Encoder) -> str:
    """Of everything that blocks of coefficients depend on."""
    digest = hashlib.sha256()
    scene, transport, plan = planned.scene, planned.settings, planned.plan
    digest.update(
        repr((version("slepian_prt"), scene.mi.variant(), transport.bandlimit, transport.seed, plan.nodes)).encode()
    )
    arrays = [
        scene.mesh.positions,
        scene.mesh.normals,
        scene.mesh.faces,
        plan.shadowed,
        scene.origin,
        scene.ray_origins,
    ]
    for shape in scene.shapes:
        box = shape.bbox()
        arrays += [np.array(box.min), np.array(box.max), np.array([shape.surface_area()], dtype=np.float64)]
    arrays += [work.clusters.index, *(basis.analysis for basis in work.bases)]
    if work.pilot is not None and work.pilot.mean is not None:
        arrays.append(work.pilot.mean.zonal)
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:32]
