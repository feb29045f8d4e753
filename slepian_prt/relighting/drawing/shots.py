"""Pictures of one model under several lights: drawn from the file alone, or gathered in its scene."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from slepian_prt.lighting.environment import Environment
from slepian_prt.relighting.drawing.backdrop import draw_backdrop
from slepian_prt.relighting.drawing.camera import Camera
from slepian_prt.relighting.drawing.pictures import MAP, Finish, Picture, exposure

if TYPE_CHECKING:
    from slepian_prt.relighting.drawing.scene_pictures import Light, SceneCamera

# Gathered pictures from which on it is worth saying how long they take.
_MANY = 100


class Drawing(Protocol):
    """Pictures by the number of their light, against an empty background."""

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in pixels."""

    def picture(self, number: int) -> Picture:
        """The model under one light."""

    def backdrop(self, environment: Environment) -> NDArray[np.float32]:
        """(H, W, 3) what the pixels would show of a map if nothing stood before it."""


@dataclass(frozen=True, eq=False)
class VertexDrawing:
    """Radiance of the vertices (B, V, 3), seen by a camera; for unit albedo if that is textured."""

    camera: Camera
    radiance: NDArray[np.float32]

    @property
    def size(self) -> tuple[int, int]:
        """Height and width."""
        height, width = self.camera.directions.shape[:2]
        return int(height), int(width)

    def picture(self, number: int) -> Picture:
        """One sparse product."""
        return self.camera.picture(self.radiance[number])

    def backdrop(self, environment: Environment) -> NDArray[np.float32]:
        """Seen through the middles of the pixels."""
        return draw_backdrop(environment, self.camera.directions)


@dataclass(frozen=True, eq=False)
class SceneDrawing:
    """A scene gathered under each light, once; several pictures wait in a file for their common exposure.

    What of the scene is not drawn is reported, each thing once.
    """

    camera: SceneCamera
    lights: tuple[Light, ...]
    report: Callable[[str], None] = lambda _: None
    _drawn: set[int] = field(default_factory=set)
    _told: set[str] = field(default_factory=set)

    @cached_property
    def directions(self) -> NDArray[np.float32]:
        """As of the camera."""
        return self.camera.directions

    @property
    def size(self) -> tuple[int, int]:
        """Height and width."""
        height, width = self.directions.shape[:2]
        return int(height), int(width)

    def backdrop(self, environment: Environment) -> NDArray[np.float32]:
        """Seen through the middles of the pixels."""
        return draw_backdrop(environment, self.directions)

    @cached_property
    def _kept(self) -> NDArray[np.float32]:
        """(B, H, W, 4) radiance and alpha, on disk where there are several."""
        shape = (len(self.lights), *self.directions.shape[:2], 4)
        if len(self.lights) == 1:
            return np.empty(shape, dtype=np.float32)
        with tempfile.TemporaryFile() as file:  # the map of it outlives it
            return np.memmap(file, dtype=np.float32, mode="w+", shape=shape)

    def picture(self, number: int) -> Picture:
        """Gathered, or as it was when it was asked for before."""
        if number not in self._drawn:
            started = time.perf_counter()
            picture, remarks = self.camera.picture(self.lights[number])
            self._kept[number] = np.dstack(picture)
            for remark in remarks:
                if remark not in self._told:
                    self._told.add(remark)
                    self.report(remark)
            seconds = (time.perf_counter() - started) * len(self.lights)
            if not self._drawn and len(self.lights) > _MANY:
                self.report(f"{len(self.lights)} pictures are gathered, which takes about {seconds / 60.0:.1f} minutes")
            self._drawn.add(number)
        return Picture(np.array(self._kept[number, ..., :3]), np.array(self._kept[number, ..., 3]))


@dataclass(frozen=True, eq=False)
class Shots:
    """Pictures, and how they are shown.

    Attributes
    ----------
    drawing : Drawing
    count : int
        Of the lights.
    finish : Finish
    environments : tuple of Environment
        One for each light, where the background is the map.
    """

    drawing: Drawing
    count: int
    finish: Finish
    environments: tuple[Environment, ...] = ()

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in pixels."""
        return self.drawing.size

    def take(self, number: int) -> tuple[Picture, float]:
        """The picture under one light, with the environment behind it, and what exposes it by itself."""
        picture = self.drawing.picture(number)
        scale = exposure(picture)
        if self.finish.background == MAP:
            picture = picture.over(self.drawing.backdrop(self.environments[number]))
        return picture, scale

    def common_exposure(self) -> float:
        """One exposure for all lights: that of the brightest."""
        return min(exposure(self.drawing.picture(number)) for number in range(self.count))
