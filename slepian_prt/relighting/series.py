"""One transfer file under one light or many, from maps to files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.errors import UserError
from slepian_prt.lighting.environment import about_up, check_names
from slepian_prt.lighting.projection import project_checked
from slepian_prt.lighting.windowing import window
from slepian_prt.relighting import outputs
from slepian_prt.relighting import pictures as picture
from slepian_prt.relighting.damping import damp
from slepian_prt.relighting.relight import negative_part, relight
from slepian_prt.scene.loading import open_scene
from slepian_prt.sphere.rotation import rotate_sh

LARGEST_TURNTABLE = 3600

# Of a picture where the scene has no camera, in pixels.
_WIDTH = 800

Note = Callable[[str], None]


@dataclass(frozen=True)
class Lights:
    """What to relight under.

    Attributes
    ----------
    maps : paths of environment maps; none for the scene's own light
    rotate : float
        Degrees about the up axis.
    turntable : int or None
        Number of results, the light turned once about the up axis.
    window : str or None
        Name of a window against ringing.
    window_width : float or None
        None for one that leaves hardly anything negative.
    clamp_negative : bool
    """

    maps: tuple[str, ...] = ()
    rotate: float = 0.0
    turntable: int | None = None
    window: str | None = None
    window_width: float | None = None
    clamp_negative: bool = False

    @property
    def several(self) -> bool:
        """Whether there is more than one."""
        return self.turntable is not None or len(self.maps) > 1

    def check(self) -> None:
        """
        Raises
        ------
        UserError
            Options that exclude each other, or are outside their range.
        """
        about_up(self.rotate)
        if self.turntable is not None:
            if not 1 <= self.turntable <= LARGEST_TURNTABLE:
                raise UserError(f"turntable must be between 1 and {LARGEST_TURNTABLE} results, not {self.turntable}")
            if len(self.maps) > 1:
                raise UserError("turntable turns one map; give one `environment`")
        check_names(self.maps)
        if self.window is not None and self.window_width is not None:
            window(self.window, 0, self.window_width)
        elif self.window_width is not None:
            raise UserError("a width needs a window; give `window=hann` or lanczos")


@dataclass(frozen=True)
class Series:
    """Attributes
    ----------
    names : for files
    radiance : (B, V, 3) float32
    """

    names: tuple[str, ...]
    radiance: NDArray[np.float32]


def relit_series(packed: CompressedTransfer, lights: Lights, file: str, note: Note) -> Series:
    """Radiance under all lights, as one product; what is worth a remark is noted."""
    names, lighting = _lighting(packed, lights, file, note)
    if lights.window is not None:
        damped = [damp(packed, light, lights.window, lights.window_width) for light in lighting]
        for name, one in zip(names, damped, strict=True):
            note(
                f"{name}: window {lights.window} of width {one.width:.3g} changes radiance by {one.change:.2%} "
                f"(relative RMS); negative vertices {one.before:.2%} without, {one.after:.2%} with it"
            )
        lighting = np.stack([one.lighting for one in damped])
    if lights.turntable is not None:
        turns = np.arange(lights.turntable) * 360.0 / lights.turntable
        lighting = np.stack([rotate_sh(lighting[0], about_up(float(turn))) for turn in turns])
        names = tuple(f"{number:04d}" for number in range(lights.turntable))
    radiance = relight(packed, lighting)
    negative = max(negative_part(one) for one in radiance)
    if negative > 0.0:
        most = "at most " if len(radiance) > 1 else ""
        remedy = "" if lights.window else "; `window` damps it"
        note(
            f"{most}{negative:.2%} of the vertices are negative (ringing of small bright lights at this bandlimit"
            f"{remedy})"
        )
    return Series(names, radiance)


def _lighting(
    packed: CompressedTransfer, lights: Lights, file: str, note: Note
) -> tuple[tuple[str, ...], NDArray[np.float64]]:
    if not lights.maps:
        if packed.lighting is None:
            raise UserError(f"{file}: the scene has no light of its own; name a map with `environment`")
        return ("scene",), rotate_sh(packed.lighting, about_up(lights.rotate))[None]
    found = []
    for path in lights.maps:
        lighting, clamped = project_checked(
            path, packed.bandlimit, rotate=lights.rotate, clamp_negative=lights.clamp_negative
        )
        if clamped:
            note(f"{path}: {clamped} negative texels set to zero")
        found.append(lighting)
    return tuple(Path(path).stem for path in lights.maps), np.stack(found)


def write_relit(
    output: str, packed: CompressedTransfer, series: Series, suffix: str, width: int | None, note: Note
) -> None:
    """Write to what `outputs.check_output` has found good; files of a folder end in ``suffix``."""
    own = Path(output).suffix.lower()
    if own == ".npz":
        radiance = series.radiance if len(series.names) > 1 else series.radiance[0]
        outputs.write_radiance(output, packed.mesh, radiance)
    elif own == ".ply":
        scale = outputs.write_coloured_mesh(output, packed.mesh, series.radiance[0])
        note(f"{output}: colours are radiance x {scale:.4g}, tone-mapped")
    elif own in (".png", ".exr"):
        picture.write_picture(output, _camera(output, packed, width, note).picture(series.radiance[0]))
    elif own == outputs.FILM:
        outputs.write_film(output, _camera(output, packed, width, note), series.radiance)
    else:
        camera = _camera(output, packed, width, note) if suffix in (".png", ".exr") else None
        outputs.write_series(output, series.names, packed.mesh, series.radiance, suffix, camera)


def _camera(output: str, packed: CompressedTransfer, width: int | None, note: Note) -> picture.Camera:
    with open_scene(packed.mesh) as scene:
        scene = replace(scene, view=packed.view)
        if packed.view is None and width is None:
            width = _WIDTH
        camera = picture.trace_camera(scene, width)
    if not camera.alpha.any():
        note(f"{output}: the camera sees no front of any surface; the picture is empty")
    return camera
