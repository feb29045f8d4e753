"""The vertices that a goal is chosen by and verified on, and the error metric at them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.accuracy.goal import Goal, Light
from slepian_prt.accuracy.tuning import TUNING, SearchTuning
from slepian_prt.errors import UserError
from slepian_prt.evaluation.vertex_error import ErrorMetric, MapMetric, SpectrumMetric
from slepian_prt.scene.receivers import morton
from slepian_prt.scene.scene import Scene
from slepian_prt.transport.interior import sees_backs
from slepian_prt.transport.planned import PlannedScene


def draw_vertices(
    planned: PlannedScene, seed: int, size: int, known: NDArray | None = None
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Vertices to choose by and others to verify on, one of each from every part of the mesh, at random.

    Parameters
    ----------
    planned : PlannedScene
    seed : int
    size : int
        Number of parts, if there are vertices enough.
    known : (n,), optional
        Vertices to leave out. Both are empty if there are no others.
    """
    receivers = np.flatnonzero(planned.scene.mesh.receivers.active)
    if known is not None:
        receivers = np.setdiff1d(receivers, known)
    if receivers.size < 2:
        return receivers, receivers
    order = receivers[np.argsort(morton(planned.scene.traced_positions[receivers]), kind="stable")]
    parts = min(size, order.size // 2)
    rng = np.random.default_rng(seed)
    bounds = np.linspace(0, order.size, parts + 1).astype(np.int64)
    # Two different places in each part.
    first = (bounds[:-1] + rng.random(parts) * np.diff(bounds)).astype(np.int64)
    step = 1 + (rng.random(parts) * (np.diff(bounds) - 1)).astype(np.int64)
    second = bounds[:-1] + (first - bounds[:-1] + step) % np.diff(bounds)
    return np.sort(order[first]), np.sort(order[second])


def draw_others(
    planned: PlannedScene, light: Light, known: NDArray, tuning: SearchTuning = TUNING
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """About as many vertices as a pilot has that are not ``known``, and those that `leave_out_interior` took from them.

    None if there are too few.
    """
    first, second = draw_vertices(planned, planned.settings.seed + 1, tuning.pilot_vertices, known)
    drawn = np.union1d(first, second)
    drawn = drawn[:: max(1, (2 * first.size) // tuning.pilot_vertices)]
    others = leave_out_interior(planned, light, drawn, tuning)
    return others if others.size >= tuning.fewest_held_out else others[:0], np.setdiff1d(drawn, others)


def leave_out_interior(
    planned: PlannedScene, light: Light, vertices: NDArray, tuning: SearchTuning = TUNING
) -> NDArray[np.int64]:
    """Vertices without those inside other geometry, which see nothing of the sky and have the transfer of neighbours.

    Under maps all stay: there such vertices show by being black in the reference (`count_left_out`).
    """
    if light.environments or not planned.by_blocks or vertices.size == 0:
        return vertices
    quick = planned.with_settings(samples=tuning.interior_samples, bandlimit=1)
    return vertices[quick.estimator().estimate(vertices).blocked < 1.0]


class NotCounted(NamedTuple):
    """Vertices held out that do not count in an error, (lights,) int each.

    Attributes
    ----------
    inside : inside other geometry, where transfer is that of neighbours outside, if there are any
    black : black in the reference all the same; many where a map has black parts
    """

    inside: NDArray[np.int64]
    black: NDArray[np.int64]


def count_left_out(planned: PlannedScene, metric: ErrorMetric, unseen: NDArray) -> NotCounted:
    """What of the vertices held out does not count in the errors of a metric.

    That costs next to nothing: what is black is known from the references, and only those vertices look around, with
    48 rays each, whether they see the backs of surfaces, as `find_interior` does.

    Parameters
    ----------
    planned : PlannedScene
    metric : ErrorMetric
    unseen : (n,)
        Vertices held out that are not in the metric, because they see nothing of the sky.
    """
    dark = [unseen] * len(metric.names)
    if isinstance(metric, MapMetric):
        black = [metric.vertices[~reference.radiance.any(axis=1)] for reference in metric.references]
        dark = [np.union1d(unseen, found) for found in black]
    interior = _inside(planned.scene, np.unique(np.concatenate(dark)).astype(np.int64))
    inside = np.array([np.isin(found, interior).sum() for found in dark], dtype=np.int64)
    return NotCounted(inside, np.array([found.size for found in dark], dtype=np.int64) - inside)


def _inside(scene: Scene, dark: NDArray[np.int64]) -> NDArray[np.int64]:
    """Those of some vertices that are inside other geometry, whether they have neighbours outside or not."""
    if dark.size == 0:
        return dark  # without the geometry, which convex scenes do not need
    inside = scene.is_hidden[dark]
    inside[~inside] = sees_backs(scene, dark[~inside])
    return dark[inside]


def measure_references(
    planned: PlannedScene, goal: Goal, light: Light, vertices: NDArray, tuning: SearchTuning = TUNING
) -> ErrorMetric:
    """The metric of a goal at some vertices.

    Raises
    ------
    UserError
        Light of a spectrum has no reference where receivers depend on each other.
    """
    if light.environments:
        noise = tuning.usual_noise if goal.error is None else tuning.noise_share * goal.error
        return MapMetric.of(planned, light.environments, vertices, noise)
    if not planned.by_blocks:
        raise UserError("a goal for light of a spectrum needs direct light only; name maps with `environment`")
    bandlimit = tuning.spectrum_bandlimit if light.maps else tuning.falling_bandlimit
    seed = planned.settings.seed
    exact = [
        planned.with_settings(samples=tuning.spectrum_samples, bandlimit=bandlimit, seed=seed + 1 + half)
        for half in (0, 1)
    ]
    first, second = (half.estimator().estimate(vertices).vectors[:, 0] for half in exact)
    normals = planned.scene.mesh.normals[vertices]
    return SpectrumMetric.of(light.prior(bandlimit), vertices, (first, second), normals)
