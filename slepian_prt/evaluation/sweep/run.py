"""The sweep itself: transport once for each number of rays and bounces, every setting measured on it.

Errors are those of relit radiance at a sample of the vertices, against Monte Carlo without a bandlimit whose own noise
is stated. Rays are traced at the highest bandlimit; transfer of a lower one is its first coefficients.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from slepian_prt.distributed.given import given_crew
from slepian_prt.errors import UserError
from slepian_prt.evaluation.lights import check_lights, lights_of
from slepian_prt.evaluation.sweep.axes import Axes, Setting
from slepian_prt.evaluation.sweep.by_workers import Found, Level, measure_by_workers
from slepian_prt.evaluation.sweep.checkpoint import SweepCheckpoint
from slepian_prt.evaluation.sweep.measure import CompressionTimes, SettingMeasurer, measure_references, measure_shares
from slepian_prt.evaluation.sweep.results import Point, Sweep
from slepian_prt.evaluation.vertex_error import MapMetric
from slepian_prt.lighting.environment import Environment
from slepian_prt.machine.threads import one_blas_thread
from slepian_prt.transport.by_workers.scene import by_workers
from slepian_prt.transport.effects import Effect
from slepian_prt.transport.planned import PlannedScene, plan_scene
from slepian_prt.transport.settings import TransportSettings
from slepian_prt.transport.transfer import compute_transfer

if TYPE_CHECKING:
    from slepian_prt.scene.loading import SceneSource


@one_blas_thread()
def sweep(
    scene: SceneSource,
    environments: Sequence[Environment],
    axes: Axes,
    transport: TransportSettings,
    *,
    noise: float = 0.005,
    checkpoint: Path | None = None,
    report: Callable[[str], None] = lambda _: None,
    advance: Callable[[int, int], None] = lambda _done, _total: None,
    on_plan: Callable[[tuple[Effect, ...]], None] = lambda _: None,
    client: Any = None,
) -> Sweep:
    """Measure every setting.

    Parameters
    ----------
    scene : as of `precompute`
    environments : maps; without any, the light of a Mitsuba scene itself
    axes : Axes
    transport : TransportSettings
        Of it the effects, albedo, view, parameters and seed count.
    noise : wanted relative RMS noise of the references
    checkpoint : path
        Where finished settings are kept until all are done; those found there are not measured again.
    report : given the name of each step as it begins
    advance : given (settings finished since the last call, settings in all)
    on_plan, client : as of `precompute`; seconds are those of the client's workers, which measure settings side by side

    Raises
    ------
    UserError
    """
    axes.check()
    check_lights(scene, environments)
    if not 0.0 < noise < 1.0:
        raise UserError(f"noise must be a number in (0, 1), not {noise!r}")
    settings = list(axes.settings())
    finest = replace(transport, samples=max(axes.samples), bandlimit=max(axes.bandlimits), bounces=axes.bounces[0])
    with (
        given_crew(client) as crew,
        plan_scene(scene, finest, on_plan, lamps=False) as planned,
        by_workers(planned, crew, scene) as shared_out,
    ):
        environments = lights_of(planned.scene, environments)
        kept = SweepCheckpoint(checkpoint, planned, environments, noise, crew is not None)
        again = _to_measure(settings, kept.points)
        points = {setting: kept.points[setting] for setting in settings if setting not in again}
        if points:
            report(f"{len(points)} of {len(settings)} settings were measured before and are kept")
            advance(len(points), len(settings))
        shared = {**planned.clock.seconds, "kernels": _compile_kernels(planned)}
        report("references")
        metrics = measure_references(planned, environments, axes, noise)
        references = next(iter(metrics.values())).references
        shared["references"] = sum(reference.seconds for reference in references)
        left = [setting for setting in settings if setting not in points]
        levels = _trace_levels(planned, shared_out, axes, left, report)
        known = [(point, CompressionTimes.of(point, kept.starts[setting])) for setting, point in points.items()]
        for point, times in (
            _measure_here(levels, metrics, known, report)
            if crew is None
            else measure_by_workers(crew, list(levels), metrics, known)
        ):
            points[point.setting] = point
            kept.add(point, times.start)
            advance(1, len(settings))
    kept.remove()
    return Sweep(
        planned.scene.path,
        len(planned.scene.mesh.positions),
        tuple(environment.name for environment in environments),
        {light.name: reference.noise for light, reference in zip(environments, references, strict=True)},
        tuple(points[setting] for setting in settings),
        shared,
        planned.plan.effects,
    )


def _to_measure(settings: Sequence[Setting], kept: Container[Setting]) -> set[Setting]:
    """Settings that are left, and with fewer rays than the most those that differ in the tolerance only.

    These share what the finest of them made; without it they would be coded a little differently.
    """
    most = max(setting.samples for setting in settings)
    left = {setting for setting in settings if setting not in kept}
    families = {replace(setting, tolerance=0.0) for setting in left if setting.samples < most}
    return left | {setting for setting in settings if replace(setting, tolerance=0.0) in families}


def _trace_levels(
    planned: PlannedScene, shared_out: PlannedScene, axes: Axes, left: Sequence[Setting], report: Callable[[str], None]
) -> Iterator[Level]:
    """Transport for each number of rays and bounces that is left, by whoever does it for ``shared_out``."""
    for samples, bounces in product(sorted(axes.samples, reverse=True), axes.bounces):
        own = tuple(s for s in left if (s.samples, s.bounces) == (samples, bounces))
        if not own:
            continue
        report(f"transport, {samples} rays, L = {planned.settings.bandlimit}")
        shares = measure_shares(planned.with_settings(samples=samples, bounces=bounces), axes.bandlimits)
        yield Level(own, compute_transfer(shared_out.with_settings(samples=samples, bounces=bounces)), shares)


def _measure_here(
    levels: Iterable[Level], metrics: dict[int, MapMetric], known: Found, report: Callable[[str], None]
) -> Iterator[tuple[Point, CompressionTimes]]:
    measurer = SettingMeasurer(metrics)
    for point, times in known:
        measurer.know(point.setting, times)
    for level in levels:
        for setting in level.settings:
            report(setting.label)
            point = measurer.measure(setting, level.transfer, level.shares[setting.bandlimit])
            yield point, measurer.times_of(setting)


def _compile_kernels(planned: PlannedScene) -> float:
    """Seconds that the first few vertices take."""
    begin = time.perf_counter()
    planned.estimator().estimate(np.flatnonzero(planned.scene.mesh.receivers.active)[:64])
    return time.perf_counter() - begin
