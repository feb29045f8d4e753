"""A planned scene that workers have, and what they make of it once."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeVar

from slepian_prt.transport.effects import Plan
from slepian_prt.transport.planned import PlannedScene
from slepian_prt.transport.portable import PortableScene, make_portable
from slepian_prt.transport.settings import TransportSettings

if TYPE_CHECKING:
    from distributed import Future

    from slepian_prt.distributed.crew import Crew, Shared
    from slepian_prt.scene.loading import SceneSource

Tool = TypeVar("Tool")

# Tells settings apart that a scene is asked for with.
_numbers = itertools.count(1)


# --- On workers ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Asked:
    """Settings of a scene, and the plan for them.

    Attributes
    ----------
    number : int
        By which they are told from others.
    settings : TransportSettings
    plan : Plan
    """

    number: int
    settings: TransportSettings
    plan: Plan


@dataclass(frozen=True, eq=False)
class SceneJob:
    """What workers are given once."""

    scene: PortableScene

    @contextmanager
    def open(self) -> Iterator[OpenScene]:
        """The scene in a worker."""
        with self.scene.open() as planned:
            yield OpenScene(planned)


class OpenScene:
    """A scene in a worker, with the tools that were made for the last settings asked for."""

    def __init__(self, planned: PlannedScene) -> None:
        self._planned, self._number = planned, 0
        self._tools: dict[Callable[[PlannedScene], Any], Any] = {}

    def tool(self, asked: Asked | None, make: Callable[[PlannedScene], Tool]) -> Tool:
        """What a function of a module makes of the scene as it is planned; made once."""
        number = 0 if asked is None else asked.number
        if number != self._number:
            self._number = number
            self._tools.clear()
        if make not in self._tools:
            self._tools[make] = make(self.planned(asked))
        tool: Tool = self._tools[make]
        return tool

    def planned(self, asked: Asked | None) -> PlannedScene:
        """The scene as it is planned for these settings, or for those that it came with."""
        return self._planned if asked is None else replace(self._planned, settings=asked.settings, plan=asked.plan)


def _keep(_scene: OpenScene, asked: Asked) -> Asked:
    return asked


# --- On the client ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class RemoteScene:
    """A planned scene that a crew has.

    Attributes
    ----------
    crew : Crew
    job : Shared
        A `SceneJob`.
    asked : Future or None
        Other settings than those it was sent with, as `Asked`.
    """

    crew: Crew
    job: Shared
    asked: Future | None = None

    def with_plan(self, settings: TransportSettings, plan: Plan) -> RemoteScene:
        """The same scene, planned otherwise."""
        (asked,) = self.crew.submit(_keep, [Asked(next(_numbers), settings, plan)], self.job)
        return replace(self, asked=asked)

    def submit(self, function: Callable[[Any, Any], Any], items: Sequence[Any]) -> list[Future]:
        """A task ``function(scene, (asked, item))`` for each item; see `OpenScene.tool`."""
        return self.crew.submit(function, [(self.asked, item) for item in items], self.job)

    def in_order(self, futures: Sequence[Future]) -> Iterator[Any]:
        """Results in the order of the tasks, as soon as all before them are there."""
        waiting: dict[int, Any] = {}
        following = 0
        for number, result in self.crew.results(futures):
            waiting[number] = result
            while following in waiting:
                yield waiting.pop(following)
                following += 1


@contextmanager
def by_workers(planned: PlannedScene, crew: Crew | None, scene: SceneSource) -> Iterator[PlannedScene]:
    """The planned scene, whose transport is done by a crew inside of the with-block; as it is without one.

    Parameters
    ----------
    planned : PlannedScene
    crew : Crew or None
    scene : as of `precompute`
        What was planned.

    Raises
    ------
    UserError
        A scene that cannot be sent.
    """
    if crew is None:
        yield planned
        return
    job = crew.share(SceneJob(make_portable(planned, scene)))
    try:
        yield replace(planned, remote=RemoteScene(crew, job))
    finally:
        crew.release(job)
