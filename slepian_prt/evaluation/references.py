"""The references of a comparison: a picture and radiance at the vertices under each environment.

By workers each half of each of them is a task.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.distributed.held import value_of
from slepian_prt.evaluation.reference import (
    LARGEST_PICTURE_SAMPLES,
    LARGEST_VERTEX_SAMPLES,
    Converged,
    PictureHalf,
    ReferencePicture,
    ReferenceVertices,
    VertexHalf,
    converge,
    picture_of,
    render_reference,
    vertex_reference,
    vertices_of,
)
from slepian_prt.lighting.environment import Environment
from slepian_prt.relighting.drawing.camera import aim_camera
from slepian_prt.scene.scene import Scene
from slepian_prt.scene.view import Aim
from slepian_prt.transport.by_workers.scene import Asked, OpenScene, RemoteScene
from slepian_prt.transport.planned import PlannedScene

if TYPE_CHECKING:
    from slepian_prt.distributed.crew import Shared

References = tuple[ReferencePicture, ReferenceVertices]


class WantedReferences(NamedTuple):
    """What references are wanted.

    Attributes
    ----------
    environments : sequence of Environment
    aim : Aim or None
    framed : int
        Width of a picture that frames the scene.
    width : int or None
        Of the pictures.
    noise : float
    bounces : int
    toward_view : bool
        Whether vertices are looked at from the camera of the scene.
    """

    environments: Sequence[Environment]
    aim: Aim | None
    framed: int
    width: int | None
    noise: float
    bounces: int
    toward_view: bool


def find_references(
    planned: PlannedScene, seen: Scene, wanted: WantedReferences, report: Callable[[str], None]
) -> Iterable[References]:
    """The references under each environment, in their order.

    Parameters
    ----------
    planned : PlannedScene
        By whose workers they are found, if it has any.
    seen : Scene
        The same with the camera of the pictures.
    wanted : WantedReferences
    report : callable
        Given the name of each step as it begins.
    """
    if planned.remote is None:
        return _references_here(planned, seen, wanted, report)
    report(f"references under {', '.join(environment.name for environment in wanted.environments)}")
    return _references_by_workers(planned.remote, planned.scene, wanted)


def _references_here(
    planned: PlannedScene, seen: Scene, wanted: WantedReferences, report: Callable[[str], None]
) -> Iterator[References]:
    view = planned.scene.view if wanted.toward_view else None
    for environment in wanted.environments:
        report(f"path-traced reference under {environment.name}")
        noise, bounces = wanted.noise, wanted.bounces
        picture = render_reference(seen, environment, width=wanted.width, noise=noise, bounces=bounces)
        report(f"reference at the vertices under {environment.name}")
        yield picture, vertex_reference(planned.scene, environment, noise=noise, bounces=bounces, view=view)


def _half(scene: OpenScene, item: tuple[Asked | None, tuple[Shared, int, bool, int, int]]) -> NDArray[np.float64]:
    """Half of a picture, or of radiance at the vertices, under one of the environments."""
    asked, (handle, number, is_picture, samples, seed) = item
    wanted: WantedReferences = value_of(handle)
    own, environment = scene.planned(asked).scene, wanted.environments[number]
    if is_picture:
        seen = aim_camera(own, wanted.aim, wanted.framed, toward_view=wanted.toward_view)
        return PictureHalf(seen, environment, wanted.width, wanted.bounces)(samples, seed)
    view = own.view if wanted.toward_view else None
    return VertexHalf(own, environment, None, wanted.bounces, view)(samples, seed)


def _references_by_workers(remote: RemoteScene, scene: Scene, wanted: WantedReferences) -> list[References]:
    """As `_references_here`, all of them together."""
    started, crew = time.perf_counter(), remote.crew
    rounds = {}
    for number in range(len(wanted.environments)):
        rounds[number, True] = converge(wanted.noise, LARGEST_PICTURE_SAMPLES, channels=3)
        rounds[number, False] = converge(wanted.noise, LARGEST_VERTEX_SAMPLES, stratified=False)
    view = scene.view if wanted.toward_view else None
    asked = {which: next(own) for which, own in rounds.items()}
    found: dict[Any, Any] = {}
    handle = crew.share(wanted)
    try:
        while asked:
            items = [(handle, *which, *half) for which, halves in asked.items() for half in halves]
            results = iter(crew.gather(remote.submit(_half, items)))
            halves_of = {which: [next(results) for _ in halves] for which, halves in asked.items()}
            asked = {}
            for which, halves in halves_of.items():
                try:
                    asked[which] = rounds[which].send(halves)
                except StopIteration as end:
                    converged: Converged = end.value
                    is_picture = which[1]
                    found[which] = (
                        picture_of(converged, started) if is_picture else vertices_of(scene, converged, started, view)
                    )
    finally:
        crew.release(handle)
    return [(found[number, True], found[number, False]) for number in range(len(wanted.environments))]
