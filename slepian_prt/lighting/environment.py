"""Environment maps as distant light, checked, and projected on spherical harmonics as Mitsuba would light with them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.arrays import real_numbers
from slepian_prt.errors import UserError
from slepian_prt.lighting.map_files import file_rows
from slepian_prt.lighting.map_rows import Checked, Rows, array_rows
from slepian_prt.machine.memory import check_memory
from slepian_prt.summary import Summarised


@dataclass(frozen=True, repr=False)
class Environment(Summarised):
    """A distant light: radiance by direction, on a latitude-longitude grid.

    Attributes
    ----------
    name : str
    texels : (H, W, 3) float32
        Linear RGB radiance, none negative, all finite, H >= 3.
    to_world : (3, 3)
        Rotation from the map's frame (y up) to the world.
    clamped : int
        Number of negative texels that were set to zero.
    """

    name: str
    texels: NDArray[np.float32]
    to_world: NDArray[np.float64]
    clamped: int = 0

    def rotated(self, degrees: float) -> Environment:
        """Turned counter-clockwise about the world's up axis y."""
        return self.turned(about_up(degrees))

    def turned(self, rotation: NDArray[np.float64]) -> Environment:
        """Turned by a rotation (3, 3) of the world."""
        return replace(self, to_world=rotation @ self.to_world)

    def _summary(self) -> dict[str, object]:
        angle = math.degrees(math.acos(min(1.0, max(-1.0, (float(np.trace(self.to_world)) - 1.0) / 2.0))))
        return {
            "name": self.name,
            "texels": f"{self.texels.shape[1]} x {self.texels.shape[0]}",
            "brightest": float(self.texels.max()),
            "turned": f"{angle:.4g}°" if angle > 1e-3 else None,
            "clamped": self.clamped or None,
        }


def about_up(degrees: float) -> NDArray[np.float64]:
    """Rotation matrix about y by an angle in degrees, counter-clockwise seen from above."""
    angle = real_numbers(degrees, "rotation")
    if angle.ndim or not math.isfinite(angle):
        raise UserError(f"rotation must be a finite number of degrees, not {degrees!r}")
    c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def read_environment(path: str | Path, *, clamp_negative: bool = False) -> Environment:
    """Read a latitude-longitude map, of the kind that the file's content tells, whatever its name.

    - .exr: any compression, scanlines or tiles, of one part or several; the map is the display window. Where it holds
      several images, `choose_layer` says which is the light.
    - .hdr: the radiance that the picture was made from, with its exposure and colour correction divided out.
    - .pfm: as it is, times its scale.
    - .png, .jpg, .webp, .bmp, .tga, .gif, .ppm: decoded from sRGB, or from what the file says of its encoding, and
      turned upright.

    Small negative texels, which encoders leave, are set to zero and counted: `Checked` has the rule.

    Raises
    ------
    UserError
        Missing or unreadable file, a shape other than 2:1, NaN, infinite or absurdly bright texels, or (unless
        ``clamp_negative``) negative texels that matter.
    """
    return checked_environment(file_rows(path), clamp_negative)


def check_names(paths: Sequence[str | Path]) -> None:
    """Raise UserError unless results under maps can be told apart by the names of their files."""
    names = [Path(path).stem for path in paths]
    if len(set(names)) < len(names):
        raise UserError(f"environments must have different names, not {', '.join(names)}; rename one of the files")


def make_environment(
    texels: ArrayLike, *, name: str = "environment", origin: str = "environment", clamp_negative: bool = False
) -> Environment:
    """Check an array (H, W) or (H, W, 3), W = 2H, of linear radiance and wrap it; see `read_environment`.

    Floating point of any precision and byte order is taken as it is. Integers are refused: a picture that was decoded
    to 0 … 255 is encoded for a screen, and has to be made linear first.

    Raises
    ------
    UserError
        As `read_environment`, or texels of another type or shape.
    """
    return checked_environment(array_rows(texels, name, origin), clamp_negative)


def checked_environment(rows: Rows, clamp_negative: bool) -> Environment:
    """All rows of a map, checked; at least the three that Mitsuba takes."""
    checked = Checked(rows, clamp_negative)
    check_memory(24 * rows.height * rows.width, f"{rows.origin}: the map", "make it smaller")
    image = np.concatenate(list(checked))
    if len(image) < 3:  # the smallest that Mitsuba takes: it repeats the last row
        image = np.concatenate([image, *[image[-1:]] * (3 - len(image))])
    return Environment(rows.name, image, np.eye(3), checked.clamped)
