"""Pictures of a captured film: its receivers are the pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.lighting.environment import Environment
from slepian_prt.relighting.drawing.backdrop import draw_backdrop
from slepian_prt.relighting.drawing.pictures import Picture
from slepian_prt.scene.film import Film

if TYPE_CHECKING:
    from slepian_prt.relighting.drawing.taking import Taking


@dataclass(frozen=True, eq=False)
class FilmDrawing:
    """Radiance of the pixels (B, V, 3) as pictures."""

    film: Film
    radiance: NDArray[np.float32]

    @property
    def size(self) -> tuple[int, int]:
        """Height and width."""
        return self.film.height, self.film.width

    def picture(self, number: int) -> Picture:
        """What the receivers have, and how much of each pixel the scene covers."""
        return Picture(self.film.picture(self.radiance[number]), self.film.picture(self.film.coverage))

    def backdrop(self, environment: Environment) -> NDArray[np.float32]:
        """(H, W, 3) the map as the pixels show it, blurred by the aperture and coloured by what it is seen through."""
        looks = self.film.looks()
        seen = np.mean([draw_backdrop(environment, directions) for directions in looks], axis=0)
        part = self.film.background
        tint = part / np.maximum(part.mean(axis=1, keepdims=True), 1e-6)
        return np.asarray(seen * self.film.picture(tint), dtype=np.float32)


def check_taking(film: Film, taking: Taking) -> None:
    """Raise UserError for a picture that would need another camera, or other samples, than were captured."""
    asked = {
        "width": taking.width is not None,
        "look_at": taking.aim.look_at is not None,
        "fov": taking.aim.fov is not None,
        "scene": taking.scene is not None,
        "spp": taking.spp is not None,
    }
    if given := [f"`{name}`" for name, is_asked in asked.items() if is_asked]:
        raise UserError(
            f"the file holds the picture of camera '{film.name}', {film.width} x {film.height} pixels, which only "
            f"light can change; leave out {', '.join(given)}, or capture it anew"
        )
