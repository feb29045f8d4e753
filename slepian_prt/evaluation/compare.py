"""Bases side by side: error, bytes and seconds, against full SH and against path-traced references."""

from __future__ import annotations

import math
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.grouping import group_transfer
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.errors import UserError, check_integer
from slepian_prt.evaluation.ladder import Rung, Stage, ladder
from slepian_prt.evaluation.methods import DEFAULT_METHODS, Entry, check_methods, entries
from slepian_prt.evaluation.metrics import relative_rms, seam
from slepian_prt.evaluation.reference import ReferencePicture, ReferenceVertices, render_reference, vertex_reference
from slepian_prt.lighting.environment import Environment
from slepian_prt.lighting.projection import project_environment
from slepian_prt.relighting.camera import Camera, trace_camera
from slepian_prt.relighting.pictures import Picture
from slepian_prt.relighting.relight import negative_fraction, relight
from slepian_prt.scene.loading import open_scene
from slepian_prt.scene.scene import Scene
from slepian_prt.sphere.harmonics import num_coefficients
from slepian_prt.transport.effects import Effect
from slepian_prt.transport.planned import plan_scene
from slepian_prt.transport.settings import TransportSettings
from slepian_prt.transport.transfer import Transfer, compute_transfer

DEFAULT_TERMS = (4, 9, 16, 25, 36)

Status = Callable[[str], None]


@dataclass(frozen=True)
class Method:
    """One basis with one number of terms; the fields of ``methods`` in results.json.

    The two seams are those of `errors.seam`, over all environments.
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


@dataclass(frozen=True)
class View:
    """The pictures of one environment."""

    environment: Environment
    reference: ReferencePicture
    vertices: ReferenceVertices
    interpolated: Picture
    full: Picture
    compressed: dict[str, Picture] = field(default_factory=dict)


@dataclass(frozen=True)
class Comparison:
    """Everything that the report shows."""

    transfer: Transfer
    grouping: CompressionSettings
    clusters: int
    half_angles: tuple[float, float]
    methods: tuple[Method, ...]
    ladder: tuple[Rung, ...]
    views: tuple[View, ...]
    shown_terms: int
    negative: dict[str, float]
    seconds: float

    def results(self) -> dict[str, Any]:
        """What results.json holds (DESIGN: stable names)."""
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
            "ladder": [asdict(rung) for rung in self.ladder],
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


def versions() -> dict[str, str]:
    """Versions of what a result depends on."""
    packages = ("mitsuba", "drjit", "numpy", "scipy")
    return {
        "slepian_prt": version("slepian_prt"),
        **{name: version(name) for name in packages},
        "python": platform.python_version(),
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
    report: Status = lambda _: None,
    on_plan: Callable[[tuple[Effect, ...]], None] = lambda _: None,
    advance: Callable[[int, int], None] = lambda _done, _total: None,
) -> Comparison:
    """Precompute a scene once and compress it in many ways.

    Parameters
    ----------
    scene : path
    environments : maps; without any, the light of a Mitsuba scene itself
    transport : what is asked of transport
    grouping : what is grouped into caps; the rest of it does not count
    methods, terms : every method is tried with every number of terms that the bandlimit allows
    on_plan : as of `precompute`
    width : of the pictures
    noise : wanted relative RMS noise of the path-traced references
    report : told what begins
    advance : as in `precompute`

    Raises
    ------
    UserError, ValueError
    """
    if not environments and Path(scene).suffix.lower() != ".xml":
        raise UserError("no light: name a map with `environment` (only a Mitsuba .xml scene may have its own)")
    if not (math.isfinite(noise) and noise > 0.0):
        raise UserError(f"noise must be a positive number, not {noise!r}")
    transport, grouping = transport or TransportSettings(), grouping or CompressionSettings()
    check_methods(methods)
    bandlimit = int(transport.bandlimit)
    size = num_coefficients(bandlimit)
    for k in terms:
        check_integer(k, "terms", 1, 1 << 20)
    wanted = sorted({k for k in terms if k <= size}) or [size]
    started = time.perf_counter()
    report("transport")
    with plan_scene(scene, transport, on_plan) as planned:
        transfer = compute_transfer(planned, advance)
    if not environments:
        if transfer.environment is None:
            raise UserError(f"{scene}: the scene has no distant light of its own; name a map with `environment`")
        environments = [transfer.environment]
    made = group_transfer(grouping, transfer)
    clusters = made.clusters
    lighting = [project_environment(environment, bandlimit) for environment in environments]
    full = [relight(transfer, light) for light in lighting]
    with open_scene(scene, albedo=transport.albedo, view=transport.view) as opened:
        report("camera")
        camera = trace_camera(opened, width)
        views = [
            _view(opened, transfer, environment, camera, radiance, width, noise, report)
            for environment, radiance in zip(environments, full, strict=True)
        ]
    shown = min(wanted, key=lambda k: abs(k - 16))
    seen = _Seen(transfer, lighting, full, views, camera)
    measured = []
    lossy: dict[str, tuple[str, Entry]] = {}
    for entry in entries(transfer, made, methods, wanted, lighting, report):
        measured.append(seen.measured(entry))
        if entry.method == methods[0] and (entry.asked == shown or entry.coding == "coded"):
            # Of the coded ones the last, which is the most exact.
            title = f"{entry.method}, {entry.terms:.3g} functions" + (", coded" if entry.coding == "coded" else "")
            lossy[entry.coding] = (title, entry)
        if entry.asked == shown:
            seen.keep_pictures(entry)
    report("ladder")
    rungs = seen.rungs(list(lossy.values()))
    angles = [cap.half_angle for cap in clusters.caps]
    return Comparison(
        transfer,
        grouping,
        len(clusters.caps),
        (min(angles), max(angles)),
        tuple(measured),
        tuple(rungs),
        tuple(views),
        shown,
        {e.name: negative_fraction(radiance) for e, radiance in zip(environments, full, strict=True)},
        time.perf_counter() - started,
    )


def _view(
    scene: Scene,
    transfer: Transfer,
    environment: Environment,
    camera: Camera,
    full: NDArray,
    width: int | None,
    noise: float,
    report: Status,
) -> View:
    """References and the picture of full SH radiance, (V, 3), under one environment."""
    report(f"path-traced reference under {environment.name}")
    reference = render_reference(scene, environment, width=width, noise=noise, bounces=transfer.bounces)
    reference = replace(reference, picture=camera.masked(reference.picture))
    report(f"reference at the vertices under {environment.name}")
    toward = transfer.view if transfer.toward_view else None
    vertices = vertex_reference(scene, environment, noise=noise, bounces=transfer.bounces, view=toward)
    return View(environment, reference, vertices, camera.picture(vertices.radiance), camera.picture(full))


@dataclass(frozen=True, eq=False)
class _Seen:
    """What entries are measured against: lights, full SH under each, and pictures of it.

    Attributes
    ----------
    transfer : Transfer
    lighting, full, views : one for each environment
    camera : Camera
    """

    transfer: Transfer
    lighting: list[NDArray]
    full: list[NDArray]
    views: list[View]
    camera: Camera

    def measured(self, entry: Entry) -> Method:
        """Errors, bytes and seconds of one entry."""
        relit_error, image_error, predicted, times, seams = {}, {}, {}, [], []
        for light, reference, view in zip(self.lighting, self.full, self.views, strict=True):
            radiance = entry.made.radiance(light)  # the first call prepares the functions
            for _ in range(3):
                begin = time.perf_counter()
                radiance = entry.made.radiance(light)
                times.append(time.perf_counter() - begin)
            name, drawn = view.environment.name, view.reference.picture.radiance
            relit_error[name] = relative_rms(radiance, reference)
            image_error[name] = relative_rms(self.camera.picture(radiance).radiance, drawn)
            if entry.packed is not None:
                predicted[name] = entry.packed.predicted_relit_error(light)
                seams.append(seam(radiance, reference, self.transfer.mesh.faces, entry.packed.clusters.index))
        return Method(
            entry.method,
            entry.coding,
            entry.terms,
            entry.made.bytes_per_vertex,
            relative_rms(entry.made.reconstruct().ravel(), self.transfer.vectors.ravel()),
            None if entry.packed is None else entry.packed.predicted_error,
            relit_error,
            predicted,
            image_error,
            float(np.mean([across for across, _ in seams])) if seams else None,
            float(np.mean([within for _, within in seams])) if seams else None,
            entry.seconds,
            float(np.median(times)),
        )

    def keep_pictures(self, entry: Entry) -> None:
        """For the report."""
        for view, light in zip(self.views, self.lighting, strict=True):
            view.compressed[entry.method] = self.camera.picture(entry.made.radiance(light))

    def rungs(self, lossy: Sequence[tuple[str, Entry]]) -> list[Rung]:
        """The ladders of all environments; of what is lossy, titles and entries."""
        found: list[Rung] = []
        for view, full, light in zip(self.views, self.full, self.lighting, strict=True):
            drawn, stages = view.reference, self._stages(view, full, light, lossy)
            found += ladder(view.environment.name, drawn.picture, drawn.noise, drawn.seconds, self.camera, stages)
        return found

    def _stages(self, view: View, full: NDArray, light: NDArray, lossy: Sequence[tuple[str, Entry]]) -> list[Stage]:
        """From radiance without a bandlimit down to coded coefficients, under one environment."""
        exact, transfer = view.vertices, self.transfer
        traced = sum(value for stage, value in transfer.seconds.items() if stage not in ("load", "plan"))
        size = 2.0 * transfer.vectors[0].size  # in float16
        return [
            Stage("radiance at the vertices, no bandlimit", exact.radiance, exact.noise, exact.seconds, None),
            Stage(f"full SH, bandlimit {transfer.bandlimit}", full, 0.0, traced, size),
            *(
                Stage(title, entry.made.radiance(light), 0.0, entry.seconds, entry.made.bytes_per_vertex)
                for title, entry in lossy
            ),
        ]
