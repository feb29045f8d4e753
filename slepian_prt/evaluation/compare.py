"""Bases side by side: error, bytes and seconds, against full SH and against path-traced references."""

from __future__ import annotations

import importlib.metadata
import math
import platform
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import slepian_prt
from slepian_prt.compression.clusters import Clusters, cluster_normals
from slepian_prt.compression.compressed import CompressedTransfer, compress
from slepian_prt.errors import UserError, check_terms
from slepian_prt.evaluation.errors import relative_rms
from slepian_prt.evaluation.reference import ReferencePicture, ReferenceVertices, render_reference, vertex_reference
from slepian_prt.relighting.picture import Camera, Picture, trace_camera
from slepian_prt.relighting.relight import negative_part, relight
from slepian_prt.scene.environments import Environment, project_environment
from slepian_prt.scene.loading import open_scene
from slepian_prt.scene.scenes import Scene
from slepian_prt.sphere.harmonics import num_coefficients
from slepian_prt.transport.effects import Effect
from slepian_prt.transport.transfer import Transfer, precompute

DEFAULT_BASES = ("adapted", "transport", "slepian", "incident", "sh", "cpca")
DEFAULT_TERMS = (4, 9, 16, 25, 36)

# Bases that are also shown coded, at these tolerances.
_CODED_BASES = ("adapted", "cpca")
_CODED_TOLERANCES = (0.2, 0.1, 0.05, 0.02)

Status = Callable[[str], None]


@dataclass(frozen=True)
class Method:
    """One basis with one number of terms; the fields of ``methods`` in results.json."""

    basis: str
    coding: str
    terms: float
    bytes_per_vertex: float
    transfer_error: float
    predicted_error: float
    relit_error: dict[str, float]
    image_error: dict[str, float]
    compress_seconds: float
    relight_seconds: float


@dataclass(frozen=True)
class Rung:
    """One step from the path-traced picture to the compressed one; the fields of ``ladder`` in results.json."""

    environment: str
    stage: str
    error: float
    against: str
    noise: float
    seconds: float


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
        "slepian_prt": slepian_prt.__version__,
        **{name: importlib.metadata.version(name) for name in packages},
        "python": platform.python_version(),
    }


def compare(
    scene: str | Path,
    environments: Sequence[Environment],
    *,
    bandlimit: int = 10,
    samples: int = 1024,
    clusters: int = 96,
    bases: Sequence[str] = DEFAULT_BASES,
    terms: Sequence[int] = DEFAULT_TERMS,
    effects: str = "auto",
    bounces: int | None = None,
    albedo: ArrayLike | None = None,
    view: str | int | None = None,
    seed: int = 0,
    width: int | None = None,
    noise: float = 0.01,
    status: Status = lambda _: None,
    on_plan: Callable[[tuple[Effect, ...]], None] = lambda _: None,
    advance: Callable[[int, int], None] = lambda _done, _total: None,
) -> Comparison:
    """Precompute a scene once and compress it in many ways.

    Parameters
    ----------
    scene : path
    environments : maps; without any, the light of a Mitsuba scene itself
    bandlimit, samples, clusters, effects, bounces, albedo, view, seed, on_plan : as `precompute` and `compress`
    bases, terms : every basis is tried with every number of terms that the bandlimit allows
    width : of the pictures
    noise : wanted relative RMS noise of the path-traced references
    status : told what begins
    advance : as in `precompute`

    Raises
    ------
    UserError, ValueError
    """
    if not environments and Path(scene).suffix.lower() != ".xml":
        raise UserError("no light: name a map with --environment (only a Mitsuba .xml scene may have its own)")
    if not (math.isfinite(noise) and noise > 0.0):
        raise UserError(f"noise must be a positive number, not {noise!r}")
    size = num_coefficients(bandlimit)
    for k in terms:
        check_terms(k, 1 << 20)
    wanted = sorted({k for k in terms if k <= size}) or [size]
    started = time.perf_counter()
    status("transport")
    transfer = precompute(
        scene,
        bandlimit,
        samples,
        effects=effects,
        bounces=bounces,
        albedo=albedo,
        view=view,
        seed=seed,
        on_plan=on_plan,
        advance=advance,
    )
    if not environments:
        if transfer.environment is None:
            raise UserError(f"{scene}: the scene has no distant light of its own; name a map with --environment")
        environments = [transfer.environment]
    grouped = cluster_normals(transfer.axes, clusters)
    lighting = [project_environment(environment, bandlimit) for environment in environments]
    full = [relight(transfer, light) for light in lighting]
    with open_scene(scene, albedo=albedo, view=view) as (mi, opened):
        status("camera")
        camera = trace_camera(mi, opened, width)
        views = [
            _view(mi, opened, transfer, environment, camera, radiance, width, noise, status)
            for environment, radiance in zip(environments, full, strict=True)
        ]
    shown = min(wanted, key=lambda k: abs(k - 16))
    methods = []
    for asked, packed in _compressed(transfer, grouped, bases, wanted, status):
        methods.append(_measure(packed, transfer, lighting, full, views, camera))
        if asked == shown:
            for seen, light in zip(views, lighting, strict=True):
                seen.compressed[packed.basis] = camera.picture(relight(packed, light))
    angles = [cap.half_angle for cap in grouped.caps]
    return Comparison(
        transfer,
        len(grouped.caps),
        (min(angles), max(angles)),
        tuple(methods),
        tuple(_ladder(transfer, views, full, methods, shown)),
        tuple(views),
        shown,
        {e.name: negative_part(radiance) for e, radiance in zip(environments, full, strict=True)},
        time.perf_counter() - started,
    )


def _view(
    mi: Any,
    scene: Scene,
    transfer: Transfer,
    environment: Environment,
    camera: Camera,
    full: NDArray,
    width: int | None,
    noise: float,
    status: Status,
) -> View:
    """References and the picture of full SH radiance, (V, 3), under one environment."""
    status(f"path-traced reference under {environment.name}")
    reference = render_reference(mi, scene, environment, width=width, noise=noise, bounces=transfer.bounces)
    reference = replace(reference, picture=camera.masked(reference.picture))
    status(f"reference at the vertices under {environment.name}")
    toward = transfer.view if transfer.toward_view else None
    vertices = vertex_reference(mi, scene, environment, noise=noise, bounces=transfer.bounces, view=toward)
    return View(environment, reference, vertices, camera.picture(vertices.radiance), camera.picture(full))


def _compressed(
    transfer: Transfer, grouped: Clusters, bases: Sequence[str], terms: Sequence[int], status: Status
) -> Iterator[tuple[int | None, CompressedTransfer]]:
    """Every basis with every number of terms, which is given too, some coded to every tolerance, and full SH last."""
    for basis in bases:
        for k in terms:
            status(f"{basis}, {k} terms")
            yield k, compress(transfer, basis, terms=k, clusters=grouped, coding="float16")
        for tolerance in _CODED_TOLERANCES if basis in _CODED_BASES else ():
            status(f"{basis}, coded to {tolerance:g}")
            yield None, compress(transfer, basis, tolerance=tolerance, clusters=grouped)
    status("full SH")
    yield None, compress(transfer, "none", coding="float16")


def _measure(
    packed: CompressedTransfer,
    transfer: Transfer,
    lighting: list[NDArray],
    full: list[NDArray],
    views: list[View],
    camera: Camera,
) -> Method:
    relit_error, image_error, times = {}, {}, []
    for light, reference, view in zip(lighting, full, views, strict=True):
        radiance = relight(packed, light)  # the first call prepares the functions
        for _ in range(3):
            begin = time.perf_counter()
            radiance = relight(packed, light)
            times.append(time.perf_counter() - begin)
        name = view.environment.name
        relit_error[name] = relative_rms(radiance, reference)
        image_error[name] = relative_rms(camera.picture(radiance).radiance, view.reference.picture.radiance)
    return Method(
        packed.basis,
        packed.coding,
        packed.terms,
        packed.bytes_per_vertex,
        relative_rms(packed.reconstruct().ravel(), transfer.vectors.ravel()),
        packed.predicted_error,
        relit_error,
        image_error,
        packed.seconds["compress"],
        float(np.median(times)),
    )


def _ladder(
    transfer: Transfer,
    views: list[View],
    full: list[NDArray],
    methods: list[Method],
    shown: int,
) -> list[Rung]:
    """For each environment: what interpolation, bandlimit and truncation each cost, in the picture and in seconds."""
    rungs = []
    for view, radiance in zip(views, full, strict=True):
        name, reference = view.environment.name, view.reference
        in_picture = "path-traced picture"
        rungs += [
            Rung(name, "path-traced picture", 0.0, in_picture, reference.noise, reference.seconds),
            Rung(
                name,
                "radiance at the vertices, no bandlimit, interpolated",
                relative_rms(view.interpolated.radiance, reference.picture.radiance),
                in_picture,
                float(np.hypot(reference.noise, view.vertices.noise)),
                view.vertices.seconds,
            ),
            Rung(
                name,
                f"full SH, bandlimit {transfer.bandlimit}",
                relative_rms(view.full.radiance, reference.picture.radiance),
                in_picture,
                reference.noise,
                transfer.seconds["transport"],
            ),
            Rung(
                name,
                f"full SH, bandlimit {transfer.bandlimit}",
                relative_rms(radiance, view.vertices.radiance),
                "radiance at the vertices",
                view.vertices.noise,
                transfer.seconds["transport"],
            ),
        ]
        rungs += [
            Rung(
                name,
                f"{method.basis}, {method.terms:g} terms",
                method.image_error[name],
                in_picture,
                reference.noise,
                method.compress_seconds,
            )
            for method in methods
            if method.terms == shown and method.basis != "none" and method.coding != "coded"
        ]
    return rungs
