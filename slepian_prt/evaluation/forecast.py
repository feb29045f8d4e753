"""How long a comparison will take, from a pilot of it on a part of the vertices and of the pixels."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.grouping import group_transfer
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.compression.stream import compress
from slepian_prt.evaluation.methods import COST_TERMS, DEFAULT_TERMS, FULL_SH, METHODS
from slepian_prt.evaluation.metrics import relative_rms
from slepian_prt.evaluation.reference import path_bounces, render_reference, vertex_reference
from slepian_prt.lighting.environment import Environment
from slepian_prt.scene.receivers import morton
from slepian_prt.scene.scene import Part, Scene
from slepian_prt.scene.sensors import sensor
from slepian_prt.sphere.harmonics import num_coefficients
from slepian_prt.transport.estimator import Estimator
from slepian_prt.transport.planned import PlannedScene
from slepian_prt.transport.transfer import Transfer

# Samples of the first round of a reference, which a pilot takes too, and the most of one of a picture and of vertices.
_FIRST = 32
_MOST_OF_PICTURES, _MOST_OF_VERTICES = 512, 2048

# Two sizes of a pilot: vertices of transport and references, vertices of compression, and pixels across a picture. What
# both take does not grow.
_TRACED = (500, 2000)
_COMPRESSED = (1000, 3000)
_WIDTHS = (32, 96)
_RUNS = 3

# Bounces of light between surfaces, where they are followed until they do not matter.
_BOUNCES = 6


@dataclass(frozen=True)
class Forecast:
    """Seconds that the parts of a comparison will take.

    Attributes
    ----------
    transport, references, methods : float
    """

    transport: float
    references: float
    methods: float

    def __str__(self) -> str:
        parts = {"transport": self.transport, "references": self.references, "methods": self.methods}
        told = ", ".join(f"{name} {_in_words(seconds)}" for name, seconds in parts.items())
        return f"this takes about {_in_words(sum(parts.values()))}: {told}"


def _in_words(seconds: float) -> str:
    return f"{max(seconds, 1.0):.0f} s" if seconds < 100.0 else f"{seconds / 60.0:.0f} min"


class _Line(NamedTuple):
    """Seconds against work, measured at two amounts of it."""

    work: tuple[float, float]
    seconds: tuple[float, float]

    def at(self, work: float) -> float:
        """Along a line that does not fall, and is not below what a pilot took."""
        more = max(self.seconds[1] - self.seconds[0], 0.0)
        slope = more / (self.work[1] - self.work[0]) if self.work[1] > self.work[0] else 0.0
        return self.seconds[1] + slope * max(work - self.work[1], 0.0)


def forecast(
    planned: PlannedScene,
    seen: Scene,
    environments: Sequence[Environment],
    methods: Sequence[str],
    terms: Sequence[int],
    grouping: CompressionSettings,
    noise: float,
    width: int | None,
) -> Forecast:
    """Measure a pilot: rays, paths and compression of some vertices, and small pictures under each light.

    Parameters
    ----------
    planned : PlannedScene
    seen : Scene
        With the camera of the pictures.
    environments, methods, terms, grouping, noise, width
        As of `compare`.
    """
    count, estimator = len(planned.scene.receivers), planned.estimator()
    estimator.estimate(_some_vertices(planned.scene, _WIDTHS[0]))  # compiles
    transport = _time(_TRACED, count, lambda size: estimator.estimate(_some_vertices(planned.scene, size)))
    compressed = _compress(planned, estimator, grouping).at(count)
    runs = FULL_SH.cost + sum(METHODS[method].cost * len(terms) / len(DEFAULT_TERMS) for method in methods)
    bounces = _likely_bounces(planned)
    references = _pictures(seen, environments, noise, width, bounces) + _vertices(planned, environments, noise, bounces)
    return Forecast(transport.at(count), references, runs * compressed)


def _time(sizes: tuple[int, int], largest: int, work: Callable[[int], Any]) -> _Line:
    """The shortest of some runs of each size: what others do on the machine only adds."""
    amounts = [min(size, largest) for size in sizes]
    shortest = []
    for amount in amounts:
        begins = [time.perf_counter()]
        for _ in range(_RUNS):
            work(amount)
            begins.append(time.perf_counter())
        shortest.append(float(np.diff(begins).min()))
    return _Line((float(amounts[0]), float(amounts[1])), (shortest[0], shortest[1]))


def _some_vertices(scene: Scene, size: int) -> NDArray[np.int64]:
    """Vertices beside each other, from the middle of their order in space."""
    order = np.argsort(morton(scene.traced_positions), kind="stable")
    first = max(0, (len(order) - size) // 2)
    return order[first : first + size]


def _pilot_transfer(planned: PlannedScene, estimator: Estimator[Any], size: int) -> Transfer:
    """Transfer of some vertices, without light between surfaces, as of a mesh of its own."""
    settings, mesh, vertices = planned.settings, planned.scene.mesh, _some_vertices(planned.scene, size)
    place = np.full(len(mesh.positions), -1)
    place[vertices] = np.arange(size)
    faces = place[mesh.faces]
    part = replace(
        mesh,
        positions=mesh.positions[vertices],
        normals=mesh.normals[vertices],
        faces=faces[(faces >= 0).all(axis=1)].astype(np.int32),
        albedo=mesh.albedo[vertices],
    )
    return Transfer(
        vectors=estimator.estimate(vertices).vectors,
        axes=estimator.axes[vertices],
        mesh=part,
        parts=(Part("pilot", 0, size),),
        bandlimit=settings.bandlimit,
        samples=settings.samples,
        seed=settings.seed,
        effects=(),
        bounces=0,
        rays_traced=0,
    )


def _compress(planned: PlannedScene, estimator: Estimator[Any], grouping: CompressionSettings) -> _Line:
    """Seconds of one run of spherical harmonics, the unit of `Method.cost`, against the number of vertices."""
    sizes = tuple(min(size, len(planned.scene.receivers)) for size in _COMPRESSED)
    transfers = {size: _pilot_transfer(planned, estimator, size) for size in sizes}

    def run(size: int) -> None:
        transfer = transfers[min(size, sizes[1])]
        packed = compress(
            transfer,
            "sh",
            terms=min(COST_TERMS, num_coefficients(transfer.bandlimit)),
            coding="float16",
            clusters=group_transfer(grouping, transfer),
        )
        relative_rms(packed.reconstruct(), transfer.vectors)

    run(sizes[0])  # what is made once
    return _time(_COMPRESSED, sizes[1], run)


def _pictures(seen: Scene, environments: Sequence[Environment], noise: float, width: int | None, bounces: int) -> float:
    """Seconds of the path-traced pictures: at the rate under the first light, and with the noise of each."""
    columns, rows = (int(n) for n in sensor(seen, width).film().size())

    def pixels(width: float) -> float:
        return width * max(1.0, round(width * rows / columns))

    def pilot(environment: Environment, width: int) -> float:
        return render_reference(seen, environment, width=width, noise=math.inf, bounces=bounces).noise

    reached = [pilot(environment, _WIDTHS[0]) for environment in environments]
    line = _time(_WIDTHS, columns, lambda width: pilot(environments[0], width))
    by_samples = _Line((_FIRST * pixels(line.work[0]), _FIRST * pixels(line.work[1])), line.seconds)
    rounds = [samples for one in reached for samples in _rounds(one, noise, _MOST_OF_PICTURES, stratified=True)]
    return sum(by_samples.at(samples * pixels(columns)) for samples in rounds)


def _vertices(planned: PlannedScene, environments: Sequence[Environment], noise: float, bounces: int) -> float:
    """Seconds of the references at the vertices, likewise."""
    scene, view = planned.scene, planned.plan.view
    count = len(scene.receivers)

    def pilot(environment: Environment, size: int) -> float:
        some = _some_vertices(scene, size)
        return vertex_reference(scene, environment, noise=math.inf, bounces=bounces, view=view, vertices=some).noise

    reached = [pilot(environment, min(_TRACED[0], count)) for environment in environments]
    line = _time(_TRACED, count, lambda size: pilot(environments[0], size))
    # Those toward a camera are traced for all vertices, whichever are wanted.
    work = (0.0, float(_FIRST * count)) if view is not None else (_FIRST * line.work[0], _FIRST * line.work[1])
    by_samples = _Line(work, (0.0, line.seconds[1]) if view is not None else line.seconds)
    rounds = [samples for one in reached for samples in _rounds(one, noise, _MOST_OF_VERTICES, stratified=False)]
    return sum(by_samples.at(samples * count) for samples in rounds)


def _likely_bounces(planned: PlannedScene) -> int:
    """How many will be followed; without a wish that is only known when transfer is there."""
    bounces = _BOUNCES if planned.settings.bounces is None else planned.settings.bounces
    return path_bounces(bounces if planned.plan.interreflection else 0, planned.plan.effects)


def _rounds(reached: float, noise: float, most: int, *, stratified: bool) -> list[float]:
    """Samples of each round of a reference whose first has a noise of ``reached``, as `reference` chooses them."""
    if reached <= noise:
        return [_FIRST]
    wanted = 1.1 * _FIRST * (reached / noise) ** (1.0 / 0.7)
    if stratified:
        wanted = max(2.0 * 4.0 ** math.ceil(math.log(wanted / 2.0, 4.0)), 4.0 * _FIRST)
    return [_FIRST, min(float(most), max(wanted, 2.0 * _FIRST))]
