"""From transfer vectors to compressed transfer: bases first, then block after block of receivers, then cap after cap.

Bases are made from a pilot, before the vectors are there. So each block of receivers is traced, projected and
forgotten, and the vectors of all are never held; what is kept are the coefficients.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any

import numpy as np

from slepian_prt.compression import decoder
from slepian_prt.compression.checkpoint import MemoryStore
from slepian_prt.compression.clustering import Clusters
from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.encoder import Encoding, WarmStart, encode
from slepian_prt.compression.grouping import Grouping, group_scene, group_transfer, regroup
from slepian_prt.compression.learning import LearnedBases, fit_bases, learn_bases, pilot_of
from slepian_prt.compression.memory import check_coding_memory, check_scene_memory, check_vectors_memory
from slepian_prt.compression.noise import coded_within_noise
from slepian_prt.compression.principal_components import USUAL_TERMS, iterate_clusters
from slepian_prt.compression.projection import choose_projection, widen
from slepian_prt.compression.settings import DEFAULT_CLUSTERS, CompressionSettings
from slepian_prt.compression.stored_mesh.stored import StoredMesh, store_mesh
from slepian_prt.compression.stored_mesh.transfers import as_stored, stored_mesh_of
from slepian_prt.compression.tracing import Projected, trace_and_project
from slepian_prt.compression.tracing_by_workers import trace_by_workers
from slepian_prt.errors import check_transfer
from slepian_prt.lighting.projection import project_environment
from slepian_prt.lighting.spectrum import LightPrior
from slepian_prt.machine.memory import held_memory
from slepian_prt.machine.threads import one_blas_thread
from slepian_prt.transport.by_workers.scene import by_workers
from slepian_prt.transport.checks import check_axes, check_vectors
from slepian_prt.transport.effects import Effect
from slepian_prt.transport.estimator import Estimator, TransferBlock
from slepian_prt.transport.planned import PlannedScene, plan_scene
from slepian_prt.transport.settings import TransportSettings
from slepian_prt.transport.transfer import Transfer, compute_transfer

if TYPE_CHECKING:
    from slepian_prt.distributed.crew import Crew
    from slepian_prt.scene.loading import SceneSource

# Receivers that are projected at a time when their vectors are there.
_BLOCK = 1 << 14

Report = Callable[[str], None]
Advance = Callable[[int, int], None]


def _silent(*_: object) -> None:
    """Reports to nobody."""


@one_blas_thread()
def compress(
    transfer: Transfer,
    basis: str = "adapted",
    *,
    tolerance: float | None = None,
    terms: int | None = None,
    truncate: str | None = None,
    epsilon: float | None = None,
    clusters: int | Clusters | Grouping = DEFAULT_CLUSTERS,
    group_by: str = "normal",
    occlusion_classes: int = 1,
    light_prior: LightPrior | None = None,
    refine: bool | None = None,
    coding: str | None = None,
    exact_mesh: bool = False,
    report: Report = _silent,
) -> CompressedTransfer:
    """Cluster, project, truncate and code transfer vectors.

    At most one of ``tolerance``, ``terms`` and ``truncate`` may be given; without any, the tolerance is 0.02.

    Parameters
    ----------
    transfer : Transfer
    basis : str
        Functions to compress with: ``adapted`` to the mean transport over each cap; ``transport`` that nothing shadows;
        the paper's ``slepian`` functions of the cap of normals, ``incident`` on the cap of incident light; ``sh`` of
        low degree; ``pca`` and ``cpca`` from all vectors; ``direct``; or ``none``, all (L+1)² spherical harmonics.
    tolerance : float in (0, 1), optional
        Wanted relative RMS error of the transfer vectors or, with a light prior, of radiance under such light. Raised
        to a third of the noise that vectors of paths have, which finer steps would only keep more of.
    terms : int in [1, (L+1)²], optional
        Instead: this many functions in each cap.
    truncate : ``n_g``, ``n_ref`` or ``count``, optional
        Instead: as many functions as the Shannon number of each cap, generalised, refined or counted.
    epsilon : float in (0, 1), optional
        Concentration down to which ``truncate`` counts; 0.01 by default.
    clusters : int in [1, 4096], or Clusters of the transfer's own axes, or a Grouping
        How many caps, or those that were made before.
    group_by : ``normal``, ``bent`` or ``surface``
        What is grouped into caps: normals, mean directions of the light that is not blocked, or patches of the surface.
    occlusion_classes : int in [1, 16]
        Classes of equally many vertices, from occluded to open, that are grouped and learnt from separately.
    light_prior : LightPrior, optional
        Errors count under light of this spectrum; from `falling_prior` or `measured_prior`.
    refine : bool, optional
        Whether the coefficients of each cap are turned to their principal axes. By default where that makes the file
        smaller.
    coding : ``coded``, ``float16`` or ``float32``, optional
        Coefficients predicted, rounded and entropy-coded, or plain. By default ``coded`` with a tolerance, and
        ``float32`` with a given number of functions.
    exact_mesh : bool
        Whether positions and albedo of the mesh are kept to the bit, and normals in float32. By default positions are
        rounded to 1/65,535 of the largest side of the mesh, normals to a quarter of a degree; see `store_mesh`.
    report : callable
        Told what is being done.

    Returns
    -------
    CompressedTransfer

    Raises
    ------
    UserError
        An unknown name, a number outside its range, or options that exclude each other; vectors that are not finite, of
        another shape, or beyond 1e±12.
    """
    check_transfer(transfer)
    check_vectors(transfer)
    check_axes(transfer)
    settings = CompressionSettings(
        basis=basis,
        tolerance=tolerance,
        terms=terms,
        truncate=truncate,
        epsilon=epsilon,
        clusters=DEFAULT_CLUSTERS if isinstance(clusters, Clusters | Grouping) else clusters,
        group_by=group_by,
        occlusion_classes=occlusion_classes,
        light_prior=light_prior,
        refine=refine,
        coding=coding,
        exact_mesh=exact_mesh,
    )
    settings.check(transfer.bandlimit)
    check_vectors_memory(transfer, settings)
    settings = coded_within_noise(settings, transfer)
    started = time.perf_counter()
    seen = as_stored(transfer, exact=exact_mesh)
    if isinstance(clusters, Clusters | Grouping):
        grouping = regroup(clusters, seen)
    else:
        grouping = group_transfer(settings, transfer)
    report(f"basis {basis}")
    projected = project_transfer(transfer, learn_from(seen, settings, grouping, report))
    report("coding")
    return encode_transfer(transfer, projected, started)


def learn_from(
    transfer: Transfer, settings: CompressionSettings, grouping: Grouping, report: Report = _silent
) -> LearnedBases:
    """Bases from a pilot of vectors that are there, or from all of them."""
    receivers, bandlimit, seed = transfer.mesh.receivers, transfer.bandlimit, transfer.seed
    if not settings.needs_all_vectors:
        vectors = transfer.vectors[pilot_of(grouping, seed)]
        toward = transfer.toward_view
        return learn_bases(settings, receivers, grouping, bandlimit, seed, vectors, toward_view=toward)
    if settings.basis == "cpca":
        terms = settings.terms or USUAL_TERMS
        iterated = iterate_clusters(grouping.clusters, transfer.axes, transfer.vectors, terms, report)
        grouping = Grouping(iterated, transfer.axes)
    return fit_bases(settings, receivers, grouping, bandlimit, seed, transfer.vectors)


def project_transfer(transfer: Transfer, learned: LearnedBases) -> Projected:
    """Project vectors that are there."""
    projection = choose_projection(learned)
    check_coding_memory(projection, held_memory())
    while True:
        store = MemoryStore()
        for number, begin in enumerate(range(0, len(transfer.vectors), _BLOCK)):
            vertices = np.arange(begin, min(begin + _BLOCK, len(transfer.vectors)))
            unknown = np.zeros(vertices.size, dtype=np.float32)
            block = TransferBlock(vertices, transfer.vectors[vertices], unknown, 0)
            store.add(number, projection.block(block))
        blocks = projection.caps(store)
        wider = widen(projection, blocks)
        if wider is None:
            return Projected(projection, blocks)
        projection = wider
        del store, blocks  # before the next are made


def encode_transfer(
    transfer: Transfer,
    projected: Projected,
    started: float,
    *,
    warm_start: WarmStart | None = None,
    keep_decoded: bool = False,
) -> CompressedTransfer:
    """Encode what was projected of vectors that are there; compression ``started`` then, by `time.perf_counter`."""
    encoding = _encode(projected, warm_start, keep_decoded)
    own = transfer.environment
    stored = stored_mesh_of(transfer, exact=projected.projection.learned.settings.exact_mesh)
    return _assemble(
        encoding,
        mesh=transfer.mesh if stored is None else stored.mesh,
        stored=stored,
        parts=transfer.parts,
        bandlimit=transfer.bandlimit,
        effects=transfer.effects,
        bounces=transfer.bounces,
        samples=transfer.samples,
        seed=transfer.seed,
        rays_traced=transfer.rays_traced,
        path_noise=transfer.noise,
        seconds={**transfer.seconds, "compress": time.perf_counter() - started},
        source=transfer.source,
        parameters=transfer.parameters,
        lighting=None if own is None else project_environment(own, transfer.bandlimit),
        view=transfer.view,
        toward_view=transfer.toward_view,
        fixed=transfer.fixed,
        film=transfer.film,
    )


@one_blas_thread()
def compress_scene(
    scene: SceneSource,
    settings: CompressionSettings,
    transport: TransportSettings,
    *,
    on_plan: Callable[[tuple[Effect, ...]], None] = _silent,
    advance: Advance = _silent,
    report: Report = _silent,
    crew: Crew | None = None,
) -> CompressedTransfer:
    """Transfer of a scene, compressed as it is traced.

    Work that is killed goes on from its finished blocks when it is started again with the same arguments. Vectors are
    held all at once only where receivers depend on each other (interreflection), toward a view, and for bases that must
    see them all.

    Parameters
    ----------
    scene : as of `precompute`
    settings : CompressionSettings
    transport : TransportSettings
    on_plan, advance : as of `precompute`
    report : callable
        Told what is being done.
    crew : Crew, optional
        Workers that trace and code; the file is the same with any number of them, and without.

    Raises
    ------
    UserError
    """
    settings.check(int(transport.bandlimit))
    with plan_scene(scene, transport, on_plan) as planned:
        if not planned.by_blocks or settings.needs_all_vectors:
            check_scene_memory(planned, settings)
            with by_workers(planned, crew, scene) as shared:
                transfer = compute_transfer(shared, advance)
            return compress(transfer, report=report, **vars(settings))
        source, grouping = planned.estimator(), group_scene(settings, planned)
        seed, receivers = transport.seed, _stored_mesh(planned, settings).mesh.receivers
        vectors = source.estimate(pilot_of(grouping, seed)).vectors
        learned = learn_bases(settings, receivers, grouping, int(transport.bandlimit), seed, vectors)
        with trace(planned, source, learned, scene, crew, advance) as projected:
            report("coding")
            return encode_planned(planned, projected)


def trace(
    planned: PlannedScene,
    source: Estimator[Any],
    learned: LearnedBases,
    scene: SceneSource,
    crew: Crew | None,
    advance: Advance = _silent,
) -> AbstractContextManager[Projected]:
    """As `trace_and_project`, here or by workers."""
    if crew is None:
        return trace_and_project(planned, source, learned, advance)
    return trace_by_workers(planned, source, learned, crew, scene, advance)


def encode_planned(
    planned: PlannedScene, projected: Projected, *, warm_start: WarmStart | None = None, keep_decoded: bool = False
) -> CompressedTransfer:
    """Encode what was traced and projected."""
    begin = time.perf_counter()
    encoding = _encode(projected, warm_start, keep_decoded)
    seconds, scene, bandlimit = planned.clock.seconds, planned.scene, projected.projection.learned.bandlimit
    seconds["compress"] = seconds.get("compress", 0.0) + time.perf_counter() - begin
    stored = _stored_mesh(planned, projected.projection.learned.settings)
    return _assemble(
        encoding,
        mesh=stored.mesh,
        stored=stored,
        parts=scene.parts,
        bandlimit=bandlimit,
        effects=planned.plan.effects,
        bounces=0,
        samples=int(planned.settings.samples),
        seed=planned.settings.seed,
        rays_traced=projected.rays,
        seconds=dict(seconds),
        source=scene.path,
        parameters=dict(planned.settings.parameters or {}),
        lighting=None if scene.environment is None else project_environment(scene.environment, bandlimit),
        view=scene.view,
        fixed=projected.fixed,
    )


def _encode(projected: Projected, warm_start: WarmStart | None, keep_decoded: bool) -> Encoding:
    return encode(
        projected.projection,
        projected.blocks,
        projected.make_coder,
        warm_start=warm_start,
        keep_decoded=keep_decoded,
    )


def _stored_mesh(planned: PlannedScene, settings: CompressionSettings) -> StoredMesh:
    return store_mesh(planned.scene.mesh, planned.scene.parts, exact=settings.exact_mesh)


def _assemble(encoding: Any, **about: Any) -> CompressedTransfer:
    fields = dict(vars(encoding))
    decoded = fields.pop("decoded")
    packed = CompressedTransfer(**fields, **about)
    if decoded:
        decoder.remember(packed, decoded)
    return packed
