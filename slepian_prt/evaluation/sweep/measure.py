"""Measuring the settings of a sweep, one after the other."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.decoder import coded_along_principal_axes
from slepian_prt.compression.encoder import WarmStart
from slepian_prt.compression.grouping import Grouping, group_transfer
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.compression.stream import compress
from slepian_prt.compression.tolerance_sweep import ToleranceSweep
from slepian_prt.evaluation.sweep.axes import Axes, Setting
from slepian_prt.evaluation.sweep.results import Point
from slepian_prt.evaluation.vertex_error import MapMetric
from slepian_prt.lighting.environment import Environment
from slepian_prt.lighting.projection import project_environment
from slepian_prt.relighting.operator import transfer_operator
from slepian_prt.transport.planned import PlannedScene
from slepian_prt.transport.transfer import Transfer

# Vertices that errors are measured at, and those that transport is timed on at each bandlimit.
_REFERENCE_VERTICES = 4000
_TIMED_VERTICES = 1024
_RUNS = 3

# References take at most this many samples per vertex.
_MOST_SAMPLES = 2048

# Stages of a transfer that grow with its rays and vertices.
_TRACED = ("transport", "interreflection")


class TransportShare(NamedTuple):
    """Time of transport at one bandlimit as a part of that at the highest.

    Attributes
    ----------
    share : float
    spread : float
        Of some runs on a sample of vertices, longest less shortest over the median.
    """

    share: float
    spread: float

    def seconds(self, transfer: Transfer) -> float:
        """What transfer of the highest bandlimit would have taken at this one."""
        return self.share * sum(seconds for stage, seconds in transfer.seconds.items() if stage in _TRACED)


def measure_shares(planned: PlannedScene, bandlimits: Sequence[int]) -> dict[int, TransportShare]:
    """The share of each bandlimit, timed on a sample of vertices."""
    receivers = np.flatnonzero(planned.scene.mesh.receivers.active)
    sample = receivers[:: max(1, receivers.size // _TIMED_VERTICES)]
    times: dict[int, list[float]] = {}
    for bandlimit in bandlimits:
        source = planned.with_settings(bandlimit=bandlimit).estimator()
        source.estimate(sample)
        times[bandlimit] = []
        for _ in range(_RUNS):
            begin = time.perf_counter()
            source.estimate(sample)
            times[bandlimit].append(time.perf_counter() - begin)
    longest = float(np.median(times[max(bandlimits)]))
    return {l: TransportShare(float(np.median(t)) / longest, float(np.ptp(t) / np.median(t))) for l, t in times.items()}


def measure_references(
    planned: PlannedScene, environments: Sequence[Environment], axes: Axes, noise: float
) -> dict[int, MapMetric]:
    """For each bandlimit what errors are measured against, at a sample of the vertices.

    The light of each is projected for its own bandlimit, as it would be for a transfer file: of a map with few rows,
    which is interpolated first, that is not the beginning of a finer projection.
    """
    receivers = np.flatnonzero(planned.scene.mesh.receivers.active)
    rng = np.random.default_rng(planned.settings.seed)
    vertices = np.sort(rng.choice(receivers, min(_REFERENCE_VERTICES, receivers.size), replace=False))
    highest = max(axes.bandlimits)
    metric = MapMetric.of(
        planned,
        environments,
        vertices,
        noise,
        bandlimit=highest,
        bounces=axes.bounces,
        largest_samples=_MOST_SAMPLES,
        seed=0,
    )
    lower = {l: tuple(project_environment(light, l) for light in environments) for l in axes.bandlimits if l < highest}
    return {l: replace(metric, lighting=lower.get(l, metric.lighting)) for l in axes.bandlimits}


@dataclass(frozen=True)
class CompressionTimes:
    """What a setting took with the largest number of rays, and what those with fewer may start from."""

    compress: float
    prepare: float
    relight: float
    start: WarmStart | None

    @classmethod
    def of(cls, point: Point, start: WarmStart | None) -> CompressionTimes:
        """Those that a point holds."""
        return cls(point.compress_seconds, point.prepare_seconds, point.relight_seconds, start)


class SettingMeasurer:
    """Compresses as each setting wants it and measures; later settings use what earlier ones made.

    Settings with the largest number of rays come first: they are compressed by themselves, as a user would have it, and
    timed. Those with fewer rays share bases and projections with their neighbours that differ in the tolerance only,
    and start from the step that was found with the most rays.

    Parameters
    ----------
    metrics : dict of int to MapMetric
        For each bandlimit.
    """

    def __init__(self, metrics: dict[int, MapMetric]) -> None:
        self._metrics = metrics
        self._groupings: dict[int, tuple[Grouping, float]] = {}  # with their seconds, by the number of caps
        self._times: dict[Setting, CompressionTimes] = {}  # by the setting without its rays
        self._shared: tuple[Setting, ToleranceSweep] | None = None  # the last, with the setting but its tolerance

    def measure(self, setting: Setting, transfer: Transfer, transport: TransportShare) -> Point:
        """Measure a setting on transfer of the highest bandlimit."""
        metric, transport_seconds = self._metrics[setting.bandlimit], transport.seconds(transfer)
        transfer = transfer.at_bandlimit(setting.bandlimit)
        times = self._times.get(rays_aside(setting))
        if times is None:
            packed = self._compress(setting, transfer)
            times, vectors = _measure_relighting(packed, metric)
            self._times[rays_aside(setting)] = times
        else:
            packed = self._tolerance_sweep(setting, transfer).compress(setting.tolerance, times.start)
            vectors = packed.reconstruct(metric.vertices)
        return Point(
            setting,
            _errors(metric, vectors),
            _errors(metric, transfer.vectors[metric.vertices]),
            packed.bytes_per_vertex,
            transport_seconds,
            transport.spread,
            times.compress,
            times.prepare,
            times.relight,
        )

    def times_of(self, setting: Setting) -> CompressionTimes:
        """What a setting, or one with more rays, took."""
        return self._times[rays_aside(setting)]

    def know(self, setting: Setting, times: CompressionTimes) -> None:
        """Let settings with other rays start from what another measurer found."""
        self._times[rays_aside(setting)] = times

    def _grouping(self, clusters: int, transfer: Transfer) -> tuple[Grouping, float]:
        """Caps, which no other axis changes, and the seconds that they took."""
        if clusters not in self._groupings:
            begin = time.perf_counter()
            grouping = group_transfer(CompressionSettings(clusters=clusters), transfer)
            self._groupings[clusters] = grouping, time.perf_counter() - begin
        return self._groupings[clusters]

    def _compress(self, setting: Setting, transfer: Transfer) -> CompressedTransfer:
        """Compress by itself, the time for caps included."""
        grouping, seconds = self._grouping(setting.clusters, transfer)
        packed = compress(transfer, setting.basis, tolerance=setting.tolerance, clusters=grouping)
        return replace(packed, seconds={"compress": packed.seconds["compress"] + seconds})

    def _tolerance_sweep(self, setting: Setting, transfer: Transfer) -> ToleranceSweep:
        """What settings share that follow each other and differ in their tolerance."""
        tolerance_aside = replace(setting, tolerance=0.0)
        if self._shared is None or self._shared[0] != tolerance_aside:
            settings = CompressionSettings(basis=setting.basis, clusters=setting.clusters)
            grouping, _ = self._grouping(setting.clusters, transfer)
            self._shared = tolerance_aside, ToleranceSweep(transfer, settings, grouping)
        return self._shared[1]


def rays_aside(setting: Setting) -> Setting:
    """What settings have in common that differ in their rays alone."""
    return replace(setting, samples=0)


def _measure_relighting(packed: CompressedTransfer, metric: MapMetric) -> tuple[CompressionTimes, NDArray]:
    """Times of relighting, and the vectors at the vertices of the metric while they are decoded."""
    begin = time.perf_counter()
    principal_axes = coded_along_principal_axes(packed)  # decodes
    decoded = time.perf_counter()
    vectors = packed.reconstruct(metric.vertices)
    reconstructed = time.perf_counter()
    operator = transfer_operator(packed)
    prepared = time.perf_counter()
    for light in metric.lighting:
        operator.apply(light[None])
    relit = (time.perf_counter() - prepared) / len(metric.lighting)
    start = None if packed.coded is None else WarmStart(packed.coded.tuning, principal_axes)
    prepare = decoded - begin + prepared - reconstructed
    return CompressionTimes(packed.seconds["compress"], prepare, relit, start), vectors


def _errors(metric: MapMetric, vectors: NDArray) -> dict[str, float]:
    """Relative RMS under each map, the noise of the reference in it."""
    errors = np.sqrt(metric.errors(vectors, subtract_noise=False).squared[-1])
    return dict(zip(metric.names, errors.tolist(), strict=True))
