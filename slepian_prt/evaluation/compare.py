"""Methods side by side: error, bytes and seconds, against full SH and against path-traced references."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from slepian_prt.compression.grouping import group_transfer
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.distributed.given import given_crew
from slepian_prt.errors import UserError, check_integer
from slepian_prt.evaluation.comparison import Comparison, View
from slepian_prt.evaluation.forecast import forecast
from slepian_prt.evaluation.ladder import NO_BANDLIMIT, Stage, StageError, measure_stages
from slepian_prt.evaluation.lights import check_lights, lights_of
from slepian_prt.evaluation.measuring import Measured, measure_methods
from slepian_prt.evaluation.methods import (
    DEFAULT_METHODS,
    DEFAULT_TERMS,
    MethodRun,
    Workload,
    check_methods,
    run_methods,
)
from slepian_prt.evaluation.methods_by_workers import measure_by_workers
from slepian_prt.evaluation.reference import ReferencePicture, ReferenceVertices, path_bounces
from slepian_prt.evaluation.references import WantedReferences, find_references
from slepian_prt.lighting.environment import Environment
from slepian_prt.lighting.projection import project_environment
from slepian_prt.machine.threads import one_blas_thread
from slepian_prt.relighting.drawing.backdrop import draw_backdrop
from slepian_prt.relighting.drawing.camera import Camera, aim_camera, trace_camera
from slepian_prt.relighting.drawing.pictures import MAP, Finish
from slepian_prt.relighting.relight import negative_fraction, relight
from slepian_prt.scene.scene import Scene
from slepian_prt.scene.sensors import DEFAULT_WIDTH
from slepian_prt.scene.view import Aim
from slepian_prt.sphere.harmonics import num_coefficients
from slepian_prt.transport.by_workers.scene import by_workers
from slepian_prt.transport.effects import Effect
from slepian_prt.transport.planned import PlannedScene, plan_scene
from slepian_prt.transport.settings import TransportSettings
from slepian_prt.transport.transfer import Transfer, compute_transfer

if TYPE_CHECKING:
    from slepian_prt.distributed.crew import Crew
    from slepian_prt.scene.loading import SceneSource

# Pictures are shown of the number of functions nearest to this.
_PICTURED_TERMS = 16

_LARGEST_TERMS = 1 << 20

Report = Callable[[str], None]


@one_blas_thread()
def compare(
    scene: SceneSource,
    environments: Sequence[Environment],
    *,
    transport: TransportSettings | None = None,
    grouping: CompressionSettings | None = None,
    methods: Sequence[str] = DEFAULT_METHODS,
    terms: Sequence[int] = DEFAULT_TERMS,
    width: int | None = None,
    noise: float = 0.01,
    aim: Aim | None = None,
    finish: Finish | None = None,
    report: Report = lambda _: None,
    on_plan: Callable[[tuple[Effect, ...]], None] = lambda _: None,
    advance: Callable[[int, int], None] = lambda _done, _total: None,
    client: Any = None,
) -> Comparison:
    """Precompute a scene once and compress it in many ways.

    Parameters
    ----------
    scene : as of `precompute`
    environments : maps; without any, the light of a Mitsuba scene itself
    transport : TransportSettings
    grouping : what is grouped into caps; the rest of it does not count
    methods, terms : every method is tried with every number of terms that the bandlimit allows
    width : of the pictures
    noise : wanted relative RMS noise of the path-traced references
    aim : the camera of the pictures; by default that of the scene, or one that sees the whole model
    finish : their background, by default white, and their exposure
    report : given how long all will take, and the name of each step as it begins
    on_plan, advance : as of `precompute`
    client : as of `precompute`; seconds are those of its workers, and how long all will take is not told

    Raises
    ------
    UserError, ValueError
    """
    _check(scene, environments, methods, noise)
    transport, grouping = transport or TransportSettings(), grouping or CompressionSettings()
    finish = finish or Finish("white")
    terms = _possible_terms(terms, int(transport.bandlimit))
    started = time.perf_counter()
    with given_crew(client) as crew:
        with plan_scene(scene, transport, on_plan, lamps=False) as here, by_workers(here, crew, scene) as planned:
            environments = lights_of(planned.scene, environments)
            framed, toward_view = width or DEFAULT_WIDTH, planned.plan.view is not None
            seen = aim_camera(planned.scene, aim, framed, toward_view=toward_view)
            if crew is None:
                report("pilot, for the time")
                report(str(forecast(planned, seen, environments, methods, terms, grouping, noise, width)))
                planned.clock.stop("forecast")
            report("transport")
            transfer = compute_transfer(planned, advance)
            bounces = path_bounces(transfer.bounces, transfer.effects)
            wanted = WantedReferences(environments, aim, framed, width, noise, bounces, toward_view)
            camera, views = _look(planned, seen, transfer, wanted, finish, report)
        groups = group_transfer(grouping, transfer)
        work = Workload(transfer, groups, [view.lighting for view in views], terms, report)
        pictured_terms = min(terms, key=lambda k: abs(k - _PICTURED_TERMS))
        results, lossy, views = _measure(crew, methods, work, views, camera, pictured_terms)
    report("ladder")
    ladder = [error for view in views for error in _measure_ladder(view, transfer, camera, lossy.values())]
    angles = [cap.half_angle for cap in groups.clusters.caps]
    return Comparison(
        transfer,
        grouping,
        len(angles),
        (min(angles), max(angles)),
        results,
        tuple(ladder),
        tuple(views),
        pictured_terms,
        {view.environment.name: negative_fraction(view.radiance) for view in views},
        finish,
        time.perf_counter() - started,
        list(lossy.values())[-1].compressed if lossy else None,
    )


def _check(scene: SceneSource, environments: Sequence[Environment], methods: Sequence[str], noise: float) -> None:
    check_lights(scene, environments)
    if not 0.0 < noise < 1.0:
        raise UserError(f"noise must be a number in (0, 1), not {noise!r}")
    check_methods(methods)


def _measure(
    crew: Crew | None, methods: Sequence[str], work: Workload, views: list[View], camera: Camera, pictured_terms: int
) -> Measured:
    """All methods, here or by workers."""
    if crew is not None:
        return measure_by_workers(crew, methods, work, views, camera, pictured_terms)
    runs = run_methods(methods, work)
    return measure_methods(runs, methods[0], work.transfer, views, camera, pictured_terms)


def _possible_terms(terms: Sequence[int], bandlimit: int) -> list[int]:
    """Those numbers of functions that the bandlimit has, or else all functions."""
    size = num_coefficients(bandlimit)
    for k in terms:
        check_integer(k, "terms", 1, _LARGEST_TERMS)
    return sorted({k for k in terms if k <= size}) or [size]


def _look(
    planned: PlannedScene, seen: Scene, transfer: Transfer, wanted: WantedReferences, finish: Finish, report: Report
) -> tuple[Camera, list[View]]:
    """The camera of the pictures, and what is there under each environment."""
    report("camera")
    camera = trace_camera(seen, wanted.width)
    references = find_references(planned, seen, wanted, report)
    pairs = zip(wanted.environments, references, strict=True)
    return camera, [_view(transfer, environment, camera, finish, *found) for environment, found in pairs]


def _view(
    transfer: Transfer,
    environment: Environment,
    camera: Camera,
    finish: Finish,
    reference: ReferencePicture,
    vertices: ReferenceVertices,
) -> View:
    """Full SH and references under one environment."""
    lighting = project_environment(environment, transfer.bandlimit)
    radiance = relight(transfer, lighting)
    reference = replace(reference, picture=camera.masked(reference.picture))
    interpolated, full = camera.picture(vertices.radiance), camera.picture(radiance)
    backdrop = draw_backdrop(environment, camera.directions) if finish.background == MAP else None
    return View(environment, lighting, radiance, reference, vertices, interpolated, full, backdrop)


def _measure_ladder(view: View, transfer: Transfer, camera: Camera, lossy: Iterable[MethodRun]) -> list[StageError]:
    """From radiance without a bandlimit down to coded coefficients, under one environment."""
    exact = view.vertices
    traced = sum(seconds for stage, seconds in transfer.seconds.items() if stage not in ("load", "plan", "forecast"))
    size = 2.0 * transfer.vectors[0].size  # in float16
    stages = [
        Stage(NO_BANDLIMIT, exact.radiance, exact.noise, exact.seconds, None),
        Stage(f"full SH, bandlimit {transfer.bandlimit}", view.radiance, 0.0, traced, size),
    ]
    for run in lossy:
        title = f"{run.method}, {run.terms:.3g} functions" + (", coded" if run.coding == "coded" else "")
        radiance = run.radiance(view.lighting)
        stages.append(Stage(title, radiance, 0.0, run.seconds, run.transfer.bytes_per_vertex))
    reference = view.reference
    return measure_stages(view.environment.name, reference.picture, reference.noise, reference.seconds, camera, stages)
