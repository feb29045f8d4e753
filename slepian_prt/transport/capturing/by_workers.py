"""Captures by workers: a task is a pass over a block of pixels, or a picture of a lamp.

Means come to the client, which keeps them as if it had traced them, in the same order.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.lighting.lamps import Lamp
from slepian_prt.renderer.variants import chosen_variant
from slepian_prt.scene.loading import open_mitsuba
from slepian_prt.transport.capturing.camera import CameraRays, find_camera
from slepian_prt.transport.capturing.passes import Job, fingerprint, lamp_picture
from slepian_prt.transport.capturing.pixel_means import BlockMeans
from slepian_prt.transport.capturing.settings import CaptureSettings
from slepian_prt.transport.portable import can_be_pickled

if TYPE_CHECKING:
    from distributed import Future

    from slepian_prt.distributed.crew import Crew, Shared
    from slepian_prt.scene.loading import SceneSource

# Tasks for each worker that are sent at a time; the next are sent before these are all there.
_AT_ONCE = 2


@dataclass(frozen=True, eq=False)
class _CaptureJob:
    """What workers are given once.

    Attributes
    ----------
    source : absolute path of an .xml, or dict of a Mitsuba scene
    settings : CaptureSettings
    name : str
        Its `fingerprint`.
    variant : str
        Of Mitsuba.
    """

    source: str | dict[str, Any]
    settings: CaptureSettings
    name: str
    variant: str

    @contextmanager
    def open(self) -> Iterator[Job]:
        """The job in a worker."""
        opened = open_mitsuba(self.source, self.settings.parameters)
        with chosen_variant(self.variant), opened as (mi, loaded, name):
            camera = find_camera(loaded.sensors(), self.settings.sensor, name)
            job = Job(mi, loaded, name, camera, CameraRays(mi, camera), self.settings)
            if fingerprint(job) != self.name:
                raise UserError(
                    f"{name}: is not the same on all machines; put the scene and its files into a folder that all of "
                    "them share"
                )
            yield job


def _trace(job: Job, item: tuple[int, int, int]) -> BlockMeans:
    begin, end, number = item
    return job.paths.trace(np.arange(begin, end), number)


def _picture(job: Job, item: tuple[Lamp, int, int]) -> NDArray[np.float32]:
    return lamp_picture(job, *item)


@dataclass(frozen=True, eq=False)
class _TracerByWorkers:
    """See `Tracer`."""

    crew: Crew
    handle: Shared

    def blocks(self, items: Sequence[tuple[NDArray[np.int64], int]]) -> Iterator[BlockMeans]:
        """As of `Tracer`."""
        return self._in_order(_trace, [(int(pixels[0]), int(pixels[-1]) + 1, number) for pixels, number in items])

    def lamp_pictures(self, lamps: Sequence[Lamp], passes: int) -> Iterator[NDArray[np.float32]]:
        """As of `Tracer`."""
        items = [(lamp, one, 1 + number) for number, lamp in enumerate(lamps) for one in range(passes)]
        return self._in_order(_picture, items)

    def _in_order(self, function: Callable[[Job, Any], Any], items: Sequence[Any]) -> Iterator[Any]:
        """Results in the order of the items, of which no more than some are underway: they are big."""
        sent: deque[list[Future]] = deque()
        size = _AT_ONCE * max(1, self.crew.count)
        for begin in range(0, len(items), size):
            sent.append(self.crew.submit(function, items[begin : begin + size], self.handle))
            if len(sent) > 1:
                yield from self.crew.gather(sent.popleft())
        while sent:
            yield from self.crew.gather(sent.popleft())


@contextmanager
def open_tracer(job: Job, crew: Crew, scene: SceneSource, name: str) -> Iterator[_TracerByWorkers]:
    """What traces by workers, inside of the with-block.

    Parameters
    ----------
    job : Job
    crew : Crew
    scene : as of `capture`
    name : str
        The fingerprint of the job.

    Raises
    ------
    UserError
        A scene that cannot be sent.
    """
    if isinstance(scene, str | Path):
        source: str | dict[str, Any] = str(Path(scene).resolve())
    elif isinstance(scene, dict) and can_be_pickled(scene):
        source = scene
    else:
        raise UserError(
            f"{job.name}: objects of Mitsuba cannot be sent to workers; give the path of an .xml scene, or a dict"
        )
    handle = crew.share(_CaptureJob(source, job.settings, name, job.mi.variant()))
    try:
        yield _TracerByWorkers(crew, handle)
    finally:
        crew.release(handle)
