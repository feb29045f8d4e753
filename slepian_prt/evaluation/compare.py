"""Methods side by side: error, bytes and seconds, against full SH and against path-traced references."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.grouping import group_transfer
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.errors import UserError, check_integer
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
from slepian_prt.evaluation.provenance import versions
from slepian_prt.evaluation.reference import ReferencePicture, ReferenceVertices, render_reference, vertex_reference
from slepian_prt.lighting.environment import Environment
from slepian_prt.lighting.projection import project_environment
from slepian_prt.relighting.backdrop import draw_backdrop
from slepian_prt.relighting.camera import Camera, aim_camera, trace_camera
from slepian_prt.relighting.pictures import MAP, Finish, Picture
from slepian_prt.relighting.relight import negative_fraction, relight
from slepian_prt.scene.scene import Scene
from slepian_prt.scene.sensors import DEFAULT_WIDTH
from slepian_prt.scene.view import Aim
from slepian_prt.sphere.harmonics import num_coefficients
from slepian_prt.transport.effects import Effect
from slepian_prt.transport.planned import plan_scene
from slepian_prt.transport.settings import TransportSettings
from slepian_prt.transport.transfer import Transfer, compute_transfer

# Pictures are shown of the number of functions nearest to this.
_PICTURED_TERMS = 16

_LARGEST_TERMS = 1 << 20
_RELIGHT_RUNS = 3

Report = Callable[[str], None]


@dataclass(frozen=True)
class MethodResult:
    """What one method with one setting costs and loses; the fields of ``methods`` in results.json.

    Attributes
    ----------
    basis, coding : str
    terms : float
        Mean number of functions.
    bytes_per_vertex : float
    transfer_error : float
        Relative RMS error of the transfer vectors.
    predicted_error : float or None
        The same as compression foresaw it, of methods that do.
    relit_error : dict of str to float
        For each environment, relative RMS error of radiance at the vertices against full SH.
    predicted_relit_error : dict of str to float
        The same as compression foresaw it, averaged over the rotations of the map.
    image_error : dict of str to float
        For each environment, relative RMS error of the picture against the path-traced reference.
    seam_across, seam_within : float or None
        Jumps of the error along edges between caps and within them, see `metrics.seam`; means over the environments.
    compress_seconds, relight_seconds : float
    """

    basis: str
    coding: str
    terms: float
    bytes_per_vertex: float
    transfer_error: float
    predicted_error: float | None
    relit_error: dict[str, float]
    predicted_relit_error: dict[str, float]
    image_error: dict[str, float]
    seam_across: float | None
    seam_within: float | None
    compress_seconds: float
    relight_seconds: float


@dataclass(frozen=True, eq=False)
class View:
    """One environment: its light, the references under it, and pictures from one camera.

    Attributes
    ----------
    environment : Environment
    lighting : (3, (L+1)²)
    radiance : (V, 3)
        Of full SH.
    reference : ReferencePicture
        Path-traced, without what transfer knows no light of.
    vertices : ReferenceVertices
    interpolated, full : Picture
        Of ``vertices``, and of full SH.
    backdrop : (H, W, 3) or None
        Radiance of the environment as the camera sees it, where that is the background.
    compressed : dict of str to Picture
        Of each method.
    """

    environment: Environment
    lighting: NDArray[np.float64]
    radiance: NDArray[np.float32]
    reference: ReferencePicture
    vertices: ReferenceVertices
    interpolated: Picture
    full: Picture
    backdrop: NDArray[np.float32] | None = None
    compressed: dict[str, Picture] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Comparison:
    """Everything that the report shows.

    Attributes
    ----------
    transfer : Transfer
    grouping : CompressionSettings
        Of which only the grouping counts.
    clusters : int
        Number of caps.
    half_angles : (float, float)
        Of the narrowest and the widest cap, radians.
    methods : tuple of MethodResult
    ladder : tuple of StageError
    views : tuple of View
        One for each environment.
    pictured_terms : int
        Number of functions of the compressed pictures.
    negative : dict of str to float
        For each environment, the part of the vertices that full SH makes negative.
    finish : Finish
        Background and exposure of the pictures.
    seconds : float
        That the whole comparison took.
    """

    transfer: Transfer
    grouping: CompressionSettings
    clusters: int
    half_angles: tuple[float, float]
    methods: tuple[MethodResult, ...]
    ladder: tuple[StageError, ...]
    views: tuple[View, ...]
    pictured_terms: int
    negative: dict[str, float]
    finish: Finish
    seconds: float

    def results(self) -> dict[str, Any]:
        """What results.json holds; its names are stable."""
        return {
            "scene": self.transfer.source,
            "vertices": len(self.transfer.positions),
            "bandlimit": self.transfer.bandlimit,
            "samples": self.transfer.samples,
            "seed": self.transfer.seed,
            "clusters": self.clusters,
            "group_by": self.grouping.group_by,
            "occlusion_classes": self.grouping.occlusion_classes,
            "environments": [view.environment.name for view in self.views],
            "methods": [asdict(method) for method in self.methods],
            "ladder": [asdict(error) for error in self.ladder],
            "references": {
                view.environment.name: {
                    "noise": view.reference.noise,
                    "samples_per_pixel": view.reference.samples,
                    "seconds": view.reference.seconds,
                }
                for view in self.views
            },
            "bounces": self.transfer.bounces,
            "toward_camera": self.transfer.toward_view,
            "effects": [effect.as_dict() for effect in self.transfer.effects],
            "rays_traced": self.transfer.rays_traced,
            "seconds": {**self.transfer.seconds, "total": self.seconds},
            "versions": versions(),
        }


def compare(
    scene: str | Path,
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
    scene : path
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
    if not (math.isfinite(noise) and noise > 0.0):
        raise UserError(f"noise must be a positive number, not {noise!r}")
    check_methods(methods)
    transport, grouping = transport or TransportSettings(), grouping or CompressionSettings()
    finish = finish or Finish("white")
    terms = _possible_terms(terms, int(transport.bandlimit))
    started = time.perf_counter()
    with plan_scene(scene, transport, on_plan) as planned:
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
    results: list[MethodResult] = []
    lossy: dict[str, MethodRun] = {}  # of the first method, by coding: what the ladder ends with
    for run in run_methods(methods, work):
        results.append(_measure(run, transfer, views, camera))
        pictured = run.wanted_terms == pictured_terms
        if run.method == methods[0] and (pictured or run.coding == "coded"):
            lossy[run.coding] = run  # of the coded ones the last, which is the most exact
        if pictured:
            views = [_with_picture(view, run, camera) for view in views]
    report("ladder")
    ladder = [error for view in views for error in _measure_ladder(view, transfer, camera, lossy.values())]
    angles = [cap.half_angle for cap in groups.clusters.caps]
    return Comparison(
        transfer,
        grouping,
        len(angles),
        (min(angles), max(angles)),
        tuple(results),
        tuple(ladder),
        tuple(views),
        pictured_terms,
        {view.environment.name: negative_fraction(view.radiance) for view in views},
        finish,
        time.perf_counter() - started,
    )


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
    reference = render_reference(
        pictures.scene, environment, width=pictures.width, noise=noise, bounces=transfer.bounces
    )
    reference = replace(reference, picture=camera.masked(reference.picture))
    report(f"reference at the vertices under {environment.name}")
    toward = transfer.view if transfer.toward_view else None
    vertices = vertex_reference(scene, environment, noise=noise, bounces=transfer.bounces, view=toward)
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
