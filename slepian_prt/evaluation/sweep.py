"""What accuracy costs: error, seconds and bytes of many settings, each measured.

Errors are those of relit radiance at a sample of the vertices, against Monte Carlo without a bandlimit whose own noise
is stated. Rays are traced once for each number of samples, at the highest bandlimit; transfer of a lower one is its
first coefficients. Every finished setting is kept, so that a sweep that was stopped goes on.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.encoder import WarmStart
from slepian_prt.compression.grouping import Grouping, group_transfer
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.compression.stream import compress
from slepian_prt.compression.tolerance_sweep import ToleranceSweep
from slepian_prt.errors import UserError
from slepian_prt.evaluation.compare import versions
from slepian_prt.evaluation.metrics import relative_rms
from slepian_prt.evaluation.reference import ReferenceVertices, vertex_reference
from slepian_prt.lighting.environment import Environment
from slepian_prt.lighting.projection import project_environment
from slepian_prt.sphere.harmonics import num_coefficients
from slepian_prt.transport.effects import Effect
from slepian_prt.transport.planned import PlannedScene, plan_scene
from slepian_prt.transport.settings import TransportSettings
from slepian_prt.transport.transfer import Transfer, compute_transfer

# Vertices that errors are measured at, and those that transport is timed on at each bandlimit.
REFERENCE_VERTICES = 4000
_TIMED = 1024
_RUNS = 3

# Of a reference for transfer with as many bounces as matter.
_MANY_BOUNCES = 16

# Stages of a transfer that grow with its rays and vertices.
_TRACED = ("transport", "interreflection")

Tell = Callable[[str], None]


@dataclass(frozen=True)
class Axes:
    """What is varied; every combination is a setting.

    Attributes
    ----------
    samples, bandlimits, clusters : tuple of int
    bases : tuple of str
    tolerances : tuple of float
    bounces : tuple of int or None
        Of light between surfaces; None until what is left is negligible.
    """

    samples: tuple[int, ...] = (64, 256, 1024)
    bandlimits: tuple[int, ...] = (5, 10)
    clusters: tuple[int, ...] = (96,)
    bases: tuple[str, ...] = ("adapted",)
    tolerances: tuple[float, ...] = (0.2, 0.05, 0.02)
    bounces: tuple[int | None, ...] = (None,)

    def check(self) -> None:
        """
        Raises
        ------
        UserError
            An axis without values, or a value out of range.
        """
        for name, values in vars(self).items():
            if not values:
                raise UserError(f"{name} has no values to sweep over")
            if len(set(values)) < len(values):
                raise UserError(f"{name} has a value twice: {', '.join(map(str, values))}")
        for samples, bandlimit, bounces in product(self.samples, self.bandlimits, self.bounces):
            TransportSettings(bandlimit, samples, bounces=bounces)
        for setting in self.settings():
            CompressionSettings(basis=setting.basis, tolerance=setting.tolerance, clusters=setting.clusters).check(
                setting.bandlimit
            )

    def settings(self) -> Iterator[Setting]:
        """All combinations, those that share most next to each other."""
        for samples, bounces in product(self.samples, self.bounces):
            for bandlimit, clusters, basis in product(self.bandlimits, self.clusters, self.bases):
                for tolerance in sorted(self.tolerances):
                    yield Setting(samples, bandlimit, clusters, basis, tolerance, bounces)


@dataclass(frozen=True)
class Setting:
    """One combination."""

    samples: int
    bandlimit: int
    clusters: int
    basis: str
    tolerance: float
    bounces: int | None = None

    @property
    def label(self) -> str:
        bounced = "" if self.bounces is None else f"{self.bounces} bounces, "
        own = f"L = {self.bandlimit}, {self.clusters} caps, {self.basis}, {self.tolerance:g}"
        return f"{self.samples} rays, {bounced}{own}"


@dataclass(frozen=True)
class Point:
    """What a setting costs and gives; the fields of ``points`` in sweep.json, beside those of the setting.

    Attributes
    ----------
    setting : Setting
    error : dict of str to float
        For each environment, relative RMS error of relit radiance against the reference.
    full_error : dict of str to float
        The same of full SH, before compression.
    bytes_per_vertex : float
    transport_seconds, compress_seconds : float
        Transport below the highest bandlimit is scaled from it by the times on a sample of vertices. Compression was
        timed with the largest number of rays, which hardly matters to it.
    transport_spread : float
        Of some runs on that sample, longest less shortest over the median.
    prepare_seconds, relight_seconds : float
        Before the first light, and for each, the mean over the environments.
    """

    setting: Setting
    error: dict[str, float]
    full_error: dict[str, float]
    bytes_per_vertex: float
    transport_seconds: float
    transport_spread: float
    compress_seconds: float
    prepare_seconds: float
    relight_seconds: float

    @property
    def seconds(self) -> float:
        """From the loaded and planned scene to the file."""
        return self.transport_seconds + self.compress_seconds

    @classmethod
    def from_dict(cls, found: dict[str, Any]) -> Point:
        """From what `as_dict` gives."""
        setting = Setting(**{part.name: found[part.name] for part in fields(Setting)})
        return cls(setting, **{part.name: found[part.name] for part in fields(cls) if part.name != "setting"})

    def as_dict(self) -> dict[str, Any]:
        own = asdict(self)
        return {**own.pop("setting"), **own, "seconds": self.seconds}


@dataclass(frozen=True)
class Sweep:
    """Everything that a sweep found.

    Attributes
    ----------
    source : str
    vertices : int
    environments : tuple of str
    noise : dict of str to float
        Of the reference under each environment.
    points : tuple of Point
    shared : dict of str to float
        Seconds that all settings share: loading and planning the scene, compiling kernels, references.
    effects : tuple of Effect
    command : str
    machine : dict
        What it ran on.
    """

    source: str
    vertices: int
    environments: tuple[str, ...]
    noise: dict[str, float]
    points: tuple[Point, ...]
    shared: dict[str, float]
    effects: tuple[Effect, ...]
    command: str = ""
    machine: dict[str, Any] = field(default_factory=lambda: machine())

    @classmethod
    def read(cls, path: str | Path) -> Sweep:
        """A finished sweep from its sweep.json.

        Raises
        ------
        UserError
            The file is missing, or is not that of a sweep.
        """
        try:
            found = json.loads(Path(path).read_text())
            return cls(
                found["scene"],
                int(found["vertices"]),
                tuple(found["environments"]),
                found["reference_noise"],
                tuple(Point.from_dict(point) for point in found["points"]),
                found["shared_seconds"],
                tuple(Effect(**effect) for effect in found["effects"]),
                found["command"],
                found["machine"],
            )
        except OSError as error:
            raise UserError(f"{path}: {error.strerror or error}; name the sweep.json of a finished sweep") from None
        except (ValueError, KeyError, TypeError, AttributeError):
            raise UserError(f"{path}: is not the sweep.json of a finished sweep; run the sweep again") from None

    def results(self) -> dict[str, Any]:
        """What sweep.json holds."""
        return {
            "scene": self.source,
            "vertices": self.vertices,
            "environments": list(self.environments),
            "reference_noise": self.noise,
            "points": [point.as_dict() for point in self.points],
            "pareto": {
                name: {
                    cost: [point.setting.label for point in pareto(self.points, name, cost)]
                    for cost in ("seconds", "bytes_per_vertex")
                }
                for name in self.environments
            },
            "shared_seconds": self.shared,
            "effects": [effect.as_dict() for effect in self.effects],
            "machine": self.machine,
            "versions": versions(),
            "command": self.command,
        }


def machine() -> dict[str, Any]:
    """What the times were measured on."""
    model = platform.processor() or platform.machine()
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                model = line.partition(":")[2].strip()
                break
    except OSError:
        pass
    return {"processor": model, "cores": len(os.sched_getaffinity(0)), "system": platform.system()}


def pareto(points: Sequence[Point], environment: str, cost: str) -> list[Point]:
    """The points that none beats in error without costing more, cheapest first."""
    front: list[Point] = []
    for point in sorted(points, key=lambda p: (getattr(p, cost), p.error[environment])):
        if not front or point.error[environment] < front[-1].error[environment]:
            front.append(point)
    return front


def _effort(value: float | None) -> float:
    """None is as many bounces as matter."""
    return float("inf") if value is None else value


def findings(sweep: Sweep) -> list[str]:
    """Where more effort along one axis makes the error larger by more than noise explains: said, not hidden."""
    by_setting = {point.setting: point for point in sweep.points}
    found = []
    for axis in ("samples", "bandlimit", "bounces", "tolerance"):
        values = sorted({getattr(s, axis) for s in by_setting}, key=_effort, reverse=axis == "tolerance")
        for setting, point in by_setting.items():
            place = values.index(getattr(setting, axis))
            if place + 1 == len(values):
                continue
            better = by_setting.get(replace(setting, **{axis: values[place + 1]}))
            if better is None:
                continue
            for name in sweep.environments:
                if better.error[name] > point.error[name] * 1.02 + 0.1 * sweep.noise[name]:
                    step = f"{axis} {getattr(setting, axis)} to {values[place + 1]}"
                    found.append(
                        f"Under {name}, {step} raises the error from {point.error[name]:.2%} to "
                        f"{better.error[name]:.2%} ({setting.label})."
                    )
    return found


def sweep(
    scene: str | Path,
    environments: Sequence[Environment],
    axes: Axes,
    transport: TransportSettings,
    *,
    noise: float = 0.005,
    journal: Path | None = None,
    report: Tell = lambda _: None,
    advance: Callable[[int, int], None] = lambda _done, _total: None,
    on_plan: Callable[[tuple[Effect, ...]], None] = lambda _: None,
) -> Sweep:
    """Measure every setting.

    Parameters
    ----------
    scene : path
    environments : maps; without any, the light of a Mitsuba scene itself
    axes : Axes
    transport : TransportSettings
        Of it the effects, albedo and seed count.
    noise : wanted relative RMS noise of the references
    journal : path
        Where finished settings are kept until all are done; those found there are not measured again.
    report : told what is done
    advance : given (settings finished since the last call, settings in all)
    on_plan : as of `precompute`

    Raises
    ------
    UserError
    """
    axes.check()
    if not environments and Path(scene).suffix.lower() != ".xml":
        raise UserError("no light: name a map with `environment` (only a Mitsuba .xml scene may have its own)")
    settings = list(axes.settings())
    first = replace(transport, samples=max(axes.samples), bandlimit=max(axes.bandlimits), bounces=axes.bounces[0])
    with plan_scene(scene, first, on_plan) as planned:
        if not environments:
            if planned.scene.environment is None:
                raise UserError(f"{scene}: the scene has no distant light of its own; name a map with `environment`")
            environments = [planned.scene.environment]
        kept = Journal(journal, planned, environments, noise)
        found = {setting: kept.points[setting] for setting in settings if setting in kept.points}
        if found:
            report(f"{len(found)} of {len(settings)} settings were measured before and are kept")
            advance(len(found), len(settings))
        begin = time.perf_counter()
        planned.estimator().estimate(np.flatnonzero(planned.scene.mesh.receivers.active)[:64])
        shared = {**planned.clock.seconds, "kernels": time.perf_counter() - begin}
        report("references")
        measure = _Measure.made(planned, environments, noise, _most(axes.bounces))
        shared["references"] = sum(reference.seconds for reference in measure.references)
        # The most rays first: what is coded with them helps the others.
        for samples, bounces in product(sorted(axes.samples, reverse=True), axes.bounces):
            left = [s for s in settings if (s.samples, s.bounces) == (samples, bounces) and s not in found]
            if not left:
                continue
            report(f"transport, {samples} rays, L = {first.bandlimit}")
            asked = planned.with_settings(samples=samples, bounces=bounces)
            parts = _parts(asked, axes.bandlimits)
            asked.clock.stop("timing")
            transfer = compute_transfer(asked)
            for setting in left:
                report(setting.label)
                found[setting] = measure.point(setting, transfer, *parts[setting.bandlimit])
                kept.add(found[setting])
                advance(1, len(settings))
    kept.remove()
    return Sweep(
        str(scene),
        len(planned.scene.mesh.positions),
        tuple(environment.name for environment in environments),
        {e.name: reference.noise for e, reference in zip(environments, measure.references, strict=True)},
        tuple(found[setting] for setting in settings),
        shared,
        planned.plan.effects,
    )


def _most(bounces: Sequence[int | None]) -> int:
    """Bounces of a reference for all of these."""
    return max(_MANY_BOUNCES if count is None else count for count in bounces)


def _parts(planned: PlannedScene, bandlimits: Sequence[int]) -> dict[int, tuple[float, float]]:
    """Time of transport at each bandlimit as a part of that at the highest, and its spread, on a sample of vertices."""
    receivers = np.flatnonzero(planned.scene.mesh.receivers.active)
    some = receivers[:: max(1, receivers.size // _TIMED)]
    times: dict[int, list[float]] = {}
    for bandlimit in bandlimits:
        source = replace(planned, settings=replace(planned.settings, bandlimit=bandlimit)).estimator()
        source.estimate(some)
        times[bandlimit] = []
        for _ in range(_RUNS):
            begin = time.perf_counter()
            source.estimate(some)
            times[bandlimit].append(time.perf_counter() - begin)
    longest = float(np.median(times[max(bandlimits)]))
    return {l: (float(np.median(t)) / longest, float(np.ptp(t) / np.median(t))) for l, t in times.items()}


@dataclass(frozen=True, eq=False)
class _Measure:
    """What errors are measured against.

    Attributes
    ----------
    environments : maps
    vertices : (n,)
        That have a reference.
    references : one for each environment
    albedo : (n, 3)
    """

    environments: tuple[Environment, ...]
    vertices: NDArray[np.int64]
    references: tuple[ReferenceVertices, ...]
    albedo: NDArray[np.float32]
    # Caps by their number, which no other axis changes, and the seconds that they took.
    _groupings: dict[int, tuple[Grouping, float]] = field(default_factory=dict, init=False, repr=False)
    # What the settings with the largest number of rays took, and what those with fewer may start from.
    _timed: dict[Setting, _Timed] = field(default_factory=dict, init=False, repr=False)
    # Those with fewer rays that differ in their tolerance only.
    _family: list[tuple[Setting, ToleranceSweep]] = field(default_factory=list, init=False, repr=False)

    @classmethod
    def made(
        cls, planned: PlannedScene, environments: Sequence[Environment], noise: float, most_bounces: int
    ) -> _Measure:
        receivers = np.flatnonzero(planned.scene.mesh.receivers.active)
        rng = np.random.default_rng(planned.settings.seed)
        vertices = np.sort(rng.choice(receivers, min(REFERENCE_VERTICES, receivers.size), replace=False))
        bounces = most_bounces if planned.plan.interreflection else 0
        references = tuple(
            vertex_reference(planned.scene, environment, noise=noise, bounces=bounces, vertices=vertices)
            for environment in environments
        )
        return cls(tuple(environments), vertices, references, planned.scene.mesh.albedo[vertices])

    def point(self, setting: Setting, transfer: Transfer, part: float, spread: float) -> Point:
        """Compress transfer of the highest bandlimit as a setting wants it, and measure."""
        size = num_coefficients(setting.bandlimit)
        lights = [project_environment(environment, setting.bandlimit) for environment in self.environments]
        alike = replace(setting, samples=0)
        timed = self._timed.get(alike)
        if timed is None:
            # The largest number of rays comes first and is timed by itself; others share what they can.
            packed = self._alone(setting, _cut(transfer, setting.bandlimit))
            begin = time.perf_counter()
            turned = packed.turned  # decodes
            decoded = time.perf_counter()
            vectors = packed.reconstruct(self.vertices)
            rest = time.perf_counter()
            operator = packed.operator
            prepared = time.perf_counter()
            for light in lights:
                operator.apply(light[None])
            seconds = (time.perf_counter() - prepared) / len(lights)
            start = None if packed.coded is None else WarmStart(packed.coded.tuning, turned)
            prepare = decoded - begin + prepared - rest
            timed = _Timed(packed.seconds["compress"], prepare, seconds, start)
            self._timed[alike] = timed
        else:
            packed = self._family_of(setting, transfer).compressed(setting.tolerance, timed.start)
            vectors = packed.reconstruct(self.vertices)
        traced = sum(seconds for stage, seconds in transfer.seconds.items() if stage in _TRACED)
        return Point(
            setting,
            self._errors(vectors if vectors.ndim == 3 else vectors[:, None, :], lights),
            self._errors(transfer.vectors[self.vertices][:, :, :size], lights),
            packed.bytes_per_vertex,
            traced * part,
            spread,
            timed.compress,
            timed.prepare,
            timed.relight,
        )

    def _grouping(self, setting: Setting, transfer: Transfer) -> tuple[Grouping, float]:
        if setting.clusters not in self._groupings:
            begin = time.perf_counter()
            grouping = group_transfer(CompressionSettings(clusters=setting.clusters), transfer)
            self._groupings[setting.clusters] = grouping, time.perf_counter() - begin
        return self._groupings[setting.clusters]

    def _alone(self, setting: Setting, cut: Transfer) -> CompressedTransfer:
        """As a user would have it, the time for caps included."""
        grouping, seconds = self._grouping(setting, cut)
        packed = compress(cut, setting.basis, tolerance=setting.tolerance, clusters=grouping)
        return replace(packed, seconds={"compress": packed.seconds["compress"] + seconds})

    def _family_of(self, setting: Setting, transfer: Transfer) -> ToleranceSweep:
        """Settings that follow each other and differ in their tolerance share bases and projections."""
        alike = replace(setting, tolerance=0.0)
        if not self._family or self._family[0][0] != alike:
            settings = CompressionSettings(basis=setting.basis, clusters=setting.clusters)
            grouping, _ = self._grouping(setting, transfer)
            self._family[:] = [(alike, ToleranceSweep(_cut(transfer, setting.bandlimit), settings, grouping))]
        return self._family[0][1]

    def _errors(self, vectors: NDArray, lights: Sequence[NDArray]) -> dict[str, float]:
        """Of transfer vectors (n, channels, (L+1)²) at the vertices that have a reference."""
        found = {}
        for environment, reference, light in zip(self.environments, self.references, lights, strict=True):
            # What the reference sees as black may be inside other geometry, where transfer borrows from neighbours.
            lit = reference.radiance.any(axis=1)
            radiance = np.einsum("ncm,dm->ncd" if vectors.shape[1] == 1 else "ndm,dm->nd", vectors[lit], light)
            radiance = radiance.reshape(-1, 3) * self.albedo[lit]
            found[environment.name] = relative_rms(radiance, reference.radiance[lit])
        return found


@dataclass(frozen=True)
class _Timed:
    """What one setting took, with the largest number of rays."""

    compress: float
    prepare: float
    relight: float
    start: WarmStart | None


def _cut(transfer: Transfer, bandlimit: int) -> Transfer:
    """With fewer degrees, apart from the light of the scene."""
    vectors = transfer.vectors[:, :, : num_coefficients(bandlimit)]
    return replace(transfer, bandlimit=bandlimit, vectors=vectors, environment=None)


class Journal:
    """Finished settings on disk, for the same scene, maps and job; without a path, none.

    Attributes
    ----------
    points : dict of Setting to Point
    """

    def __init__(
        self, path: Path | None, planned: PlannedScene, environments: Sequence[Environment], noise: float
    ) -> None:
        self._path = path
        self.points: dict[Setting, Point] = {}
        self._key = _fingerprint(planned, environments, noise)
        if path is None or not path.is_file():
            return
        for line in path.read_text().splitlines():
            try:
                entry = json.loads(line)
                if entry["key"] == self._key:
                    point = Point(Setting(**entry["setting"]), **entry["point"])
                    self.points[point.setting] = point
            except (ValueError, KeyError, TypeError):
                continue  # the line that was being written when it was killed

    def add(self, point: Point) -> None:
        """Keep a point, on the disk when this returns."""
        if self._path is None:
            return
        own = asdict(point)
        line = json.dumps({"key": self._key, "setting": own.pop("setting"), "point": own})
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with self._path.open("a") as file:
            file.write(line + "\n")
            file.flush()
            os.fsync(file.fileno())

    def remove(self) -> None:
        """All is done."""
        if self._path is not None:
            self._path.unlink(missing_ok=True)


def _fingerprint(planned: PlannedScene, environments: Sequence[Environment], noise: float) -> str:
    """Of everything but the axes that a point depends on."""
    digest = hashlib.sha256()
    own = replace(planned.settings, samples=1, bandlimit=0, bounces=None)
    digest.update(repr((versions(), machine(), own, noise)).encode())
    mesh = planned.scene.mesh
    for array in (mesh.positions, mesh.normals, mesh.faces, mesh.albedo):
        digest.update(np.ascontiguousarray(array).tobytes())
    for shape in planned.scene.occluders:
        box = shape.bbox()
        digest.update(
            repr((np.array(box.min), np.array(box.max), float(np.array(shape.surface_area()).ravel()[0]))).encode()
        )
    for environment in environments:
        digest.update(repr((environment.name, environment.to_world.tolist())).encode())
        digest.update(environment.texels.tobytes())
    return digest.hexdigest()[:32]
