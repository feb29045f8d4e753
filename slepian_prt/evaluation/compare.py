"""Methods side by side: error, bytes and seconds, against full SH and against path-traced references."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from slepian_prt.compression.grouping import group_transfer
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.errors import UserError, check_integer
from slepian_prt.evaluation.comparison import Comparison, MethodResult, View
from slepian_prt.evaluation.forecast import forecast
from slepian_prt.evaluation.ladder import NO_BANDLIMIT, Stage, StageError, measure_stages
from slepian_prt.evaluation.lights import check_lights, lights_of
from slepian_prt.evaluation.methods import (
    DEFAULT_METHODS,
    DEFAULT_TERMS,
    MethodRun,
    Workload,
    check_methods,
    run_methods,
)
from slepian_prt.evaluation.metrics import relative_rms, seam
from slepian_prt.evaluation.reference import path_bounces, render_reference, vertex_reference
from slepian_prt.lighting.environment import Environment
from slepian_prt.lighting.projection import project_environment
from slepian_prt.relighting.drawing.backdrop import draw_backdrop
from slepian_prt.relighting.drawing.camera import Camera, aim_camera, trace_camera
from slepian_prt.relighting.drawing.pictures import MAP, Finish
from slepian_prt.relighting.relight import negative_fraction, relight
from slepian_prt.scene.scene import Scene
from slepian_prt.scene.sensors import DEFAULT_WIDTH
from slepian_prt.scene.view import Aim
from slepian_prt.sphere.harmonics import num_coefficients
from slepian_prt.transport.effects import Effect
from slepian_prt.transport.planned import plan_scene
from slepian_prt.transport.settings import TransportSettings
from slepian_prt.transport.transfer import Transfer, compute_transfer

if TYPE_CHECKING:
    from slepian_prt.scene.loading import SceneSource

# Pictures are shown of the number of functions nearest to this.
_PICTURED_TERMS = 16

_LARGEST_TERMS = 1 << 20
_RELIGHT_RUNS = 3

Report = Callable[[str], None]


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

    Raises
    ------
    UserError, ValueError
    """
    check_lights(scene, environments)
    if not 0.0 < noise < 1.0:
        raise UserError(f"noise must be a number in (0, 1), not {noise!r}")
    check_methods(methods)
    transport, grouping = transport or TransportSettings(), grouping or CompressionSettings()
    finish = finish or Finish("white")
    terms = _possible_terms(terms, int(transport.bandlimit))
    started = time.perf_counter()
    with plan_scene(scene, transport, on_plan, lamps=False) as planned:
        environments = lights_of(planned.scene, environments)
        toward_view = planned.plan.view is not None
        seen = aim_camera(planned.scene, aim, width or DEFAULT_WIDTH, toward_view=toward_view)
        report("pilot, for the time")
        report(str(forecast(planned, seen, environments, methods, terms, grouping, noise, width)))
        planned.clock.stop("forecast")
        report("transport")
        transfer = compute_transfer(planned, advance)
        report("camera")
        camera = trace_camera(seen, width)
        pictures = _Pictures(seen, camera, width, noise, finish)
        views = [_view(planned.scene, transfer, light, pictures, report) for light in environments]
    groups = group_transfer(grouping, transfer)
    work = Workload(transfer, groups, [view.lighting for view in views], terms, report)
    pictured_terms = min(terms, key=lambda k: abs(k - _PICTURED_TERMS))
    results, lossy, views = _run_all(methods, work, views, camera, pictured_terms)
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


def _run_all(
    methods: Sequence[str], work: Workload, views: list[View], camera: Camera, pictured_terms: int
) -> tuple[tuple[MethodResult, ...], dict[str, MethodRun], list[View]]:
    """All methods measured.

    Returns
    -------
    results : tuple of MethodResult
    lossy : dict of str to MethodRun
        Of the first method, by coding: what the ladder ends with.
    views : list of View
        With the pictures of every method.
    """
    results: list[MethodResult] = []
    lossy: dict[str, MethodRun] = {}
    for run in run_methods(methods, work):
        results.append(_measure(run, work.transfer, views, camera))
        pictured = run.wanted_terms == pictured_terms
        if run.method == methods[0] and (pictured or run.coding == "coded"):
            lossy[run.coding] = run  # of the coded ones the last, which is the most exact
        if pictured:
            views = [_with_picture(view, run, camera) for view in views]
    return tuple(results), lossy, views


def _possible_terms(terms: Sequence[int], bandlimit: int) -> list[int]:
    """Those numbers of functions that the bandlimit has, or else all functions."""
    size = num_coefficients(bandlimit)
    for k in terms:
        check_integer(k, "terms", 1, _LARGEST_TERMS)
    return sorted({k for k in terms if k <= size}) or [size]


class _Pictures(NamedTuple):
    """How pictures are taken.

    Attributes
    ----------
    scene : Scene
        With the camera.
    camera : Camera
    width : int or None
    noise : float
        Wanted of the references.
    finish : Finish
    """

    scene: Scene
    camera: Camera
    width: int | None
    noise: float
    finish: Finish


def _view(scene: Scene, transfer: Transfer, environment: Environment, pictures: _Pictures, report: Report) -> View:
    """Full SH and references under one environment."""
    camera, noise = pictures.camera, pictures.noise
    lighting = project_environment(environment, transfer.bandlimit)
    radiance = relight(transfer, lighting)
    report(f"path-traced reference under {environment.name}")
    bounces = path_bounces(transfer.bounces, transfer.effects)
    reference = render_reference(pictures.scene, environment, width=pictures.width, noise=noise, bounces=bounces)
    reference = replace(reference, picture=camera.masked(reference.picture))
    report(f"reference at the vertices under {environment.name}")
    toward = transfer.view if transfer.toward_view else None
    vertices = vertex_reference(scene, environment, noise=noise, bounces=bounces, view=toward)
    interpolated, full = camera.picture(vertices.radiance), camera.picture(radiance)
    backdrop = draw_backdrop(environment, camera.directions) if pictures.finish.background == MAP else None
    return View(environment, lighting, radiance, reference, vertices, interpolated, full, backdrop)


def _with_picture(view: View, run: MethodRun, camera: Camera) -> View:
    picture = camera.picture(run.radiance(view.lighting))
    return replace(view, compressed={**view.compressed, run.method: picture})


def _measure(run: MethodRun, transfer: Transfer, views: Sequence[View], camera: Camera) -> MethodResult:
    """Errors, bytes and seconds of one run."""
    relit_error, image_error, predicted, times, seams = {}, {}, {}, [], []
    for view in views:
        radiance = run.radiance(view.lighting)  # the first call prepares the functions
        for _ in range(_RELIGHT_RUNS):
            begin = time.perf_counter()
            radiance = run.radiance(view.lighting)
            times.append(time.perf_counter() - begin)
        name = view.environment.name
        relit_error[name] = relative_rms(radiance, view.radiance)
        image_error[name] = relative_rms(camera.picture(radiance).radiance, view.reference.picture.radiance)
        if run.compressed is not None:
            predicted[name] = run.compressed.predicted_relit_error(view.lighting)
            seams.append(seam(radiance, view.radiance, transfer.mesh.faces, run.compressed.clusters.index))
    across, within = np.mean(seams, axis=0).tolist() if seams else (None, None)
    return MethodResult(
        run.method,
        run.coding,
        run.terms,
        run.transfer.bytes_per_vertex,
        relative_rms(run.transfer.reconstruct(), transfer.vectors),
        None if run.compressed is None else run.compressed.predicted_error,
        relit_error,
        predicted,
        image_error,
        across,
        within,
        run.seconds,
        float(np.median(times)),
    )


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
