"""One transfer file under one light or many: from maps to radiance of the receivers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.errors import UserError
from slepian_prt.lighting.environment import about_up, check_names
from slepian_prt.lighting.projection import project_checked
from slepian_prt.lighting.windowing import window
from slepian_prt.relighting.damping import damp
from slepian_prt.relighting.relight import negative_fraction, relight
from slepian_prt.sphere.rotation import rotate_sh

LARGEST_TURNTABLE = 3600


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
        Whether negative texels that matter are set to zero; they are refused otherwise.

    Raises
    ------
    UserError
        Options that exclude each other, or are outside their range.
    """

    maps: tuple[str, ...] = ()
    rotate: float = 0.0
    turntable: int | None = None
    window: str | None = None
    window_width: float | None = None
    clamp_negative: bool = False

    def __post_init__(self) -> None:
        about_up(self.rotate)
        if self.turntable is not None:
            if not 1 <= self.turntable <= LARGEST_TURNTABLE:
                raise UserError(f"turntable must be between 1 and {LARGEST_TURNTABLE} results, not {self.turntable}")
            if len(self.maps) > 1:
                raise UserError(f"turntable turns one map; give one `environment`, not {len(self.maps)}")
        check_names(self.maps)
        if self.window is not None and self.window_width is not None:
            window(self.window, 0, self.window_width)
        elif self.window_width is not None:
            raise UserError("a width needs a window; give `window=hann` or lanczos")

    @property
    def several(self) -> bool:
        """Whether there is more than one."""
        return self.turntable is not None or len(self.maps) > 1


@dataclass(frozen=True)
class Series:
    """Radiance under several lights.

    Attributes
    ----------
    names : for files
    radiance : (B, V, 3) float32
    """

    names: tuple[str, ...]
    radiance: NDArray[np.float32]


def relight_series(
    packed: CompressedTransfer, lights: Lights, file: str, report: Callable[[str], None] = lambda _: None
) -> Series:
    """Radiance under all lights, as one product.

    Parameters
    ----------
    packed : CompressedTransfer
    lights : Lights
    file : str
        Where the transfer is from, for messages.
    report : callable
        Given a line about each thing worth knowing: clamped texels, what a window does, negative radiance.

    Raises
    ------
    UserError
        A map that cannot be used, or no light at all.
    """
    names, lighting = _project_lights(packed, lights, file, report)
    if lights.window is not None:
        lighting = _damp_lights(packed, names, lighting, lights.window, lights.window_width, report)
    if lights.turntable is not None:
        turns = np.arange(lights.turntable) * 360.0 / lights.turntable
        lighting = np.stack([rotate_sh(lighting[0], about_up(float(turn))) for turn in turns])
        names = tuple(f"{number:04d}" for number in range(lights.turntable))
    radiance = relight(packed, lighting)
    negative = max(negative_fraction(one) for one in radiance)
    if negative > 0.0:
        most = "at most " if len(radiance) > 1 else ""
        remedy = "" if lights.window else "; `window` damps it"
        report(
            f"{most}{negative:.2%} of the vertices are negative (ringing of small bright lights at this bandlimit"
            f"{remedy})"
        )
    return Series(names, radiance)


def _project_lights(
    packed: CompressedTransfer, lights: Lights, file: str, report: Callable[[str], None]
) -> tuple[tuple[str, ...], NDArray[np.float64]]:
    """Names, and lighting (B, 3, (L+1)²)."""
    if not lights.maps:
        if packed.lighting is None:
            raise UserError(f"{file}: the scene has no light of its own; name a map with `environment`")
        return ("scene",), rotate_sh(packed.lighting, about_up(lights.rotate))[None]
    projected = []
    for path in lights.maps:
        lighting, clamped = project_checked(
            path, packed.bandlimit, rotate=lights.rotate, clamp_negative=lights.clamp_negative
        )
        if clamped:
            report(f"{path}: {clamped} negative texels set to zero")
        projected.append(lighting)
    return tuple(Path(path).stem for path in lights.maps), np.stack(projected)


def _damp_lights(
    packed: CompressedTransfer,
    names: tuple[str, ...],
    lighting: NDArray[np.float64],
    window: str,
    width: float | None,
    report: Callable[[str], None],
) -> NDArray[np.float64]:
    """Each light under the window; what that changes is reported."""
    damped = [damp(packed, light, window, width) for light in lighting]
    for name, one in zip(names, damped, strict=True):
        report(
            f"{name}: window {window} of width {one.width:.3g} changes radiance by {one.change:.2%} (relative RMS); "
            f"negative vertices {one.negative_before:.2%} without, {one.negative_after:.2%} with it"
        )
    return np.stack([one.lighting for one in damped])
