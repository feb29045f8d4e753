"""One transfer file under one light or many: from maps to radiance of the receivers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.errors import UserError
from slepian_prt.lighting.environment import Environment, about_up, check_names, read_environment
from slepian_prt.lighting.fitting import each_remark_once
from slepian_prt.lighting.fixed_lights import lamp_scales
from slepian_prt.lighting.light_text import is_light_text
from slepian_prt.lighting.projection import project_checked
from slepian_prt.lighting.windowing import window
from slepian_prt.relighting.damping import damp
from slepian_prt.relighting.relight import negative_fraction, relight
from slepian_prt.scene.view import up_rotation
from slepian_prt.sphere.harmonics import num_coefficients
from slepian_prt.sphere.rotation import rotate_sh

LARGEST_TURNTABLE = 3600

# Part of the vertices from which on negative radiance is worth a remark: what is said with two digits.
_WORTH_SAYING = 5e-5


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
    up : "y" or "z"
        The axis of the model that what is above in a map shines from. The scene's own light stays as it is.
    shown : bool
        Whether the maps are seen in pictures too.
    fixed_lights : number, or mapping of names to numbers
        What the light of the scene's lamps is multiplied by, as of `relight`.
    turn_directional : bool
        Whether ``directional`` lamps turn with the map, as lights of the bandlimit.

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
    up: str = "y"
    shown: bool = False
    fixed_lights: float | Mapping[str, float] = 1.0
    turn_directional: bool = False

    def __post_init__(self) -> None:
        about_axis(self.up, self.rotate)
        if self.shown and not self.maps:
            raise UserError(
                "the light of the scene is kept as spherical harmonics, which are no background; name its map with "
                "`environment`"
            )
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

    @property
    def names(self) -> tuple[str, ...]:
        """Of the results, for files."""
        if self.turntable is not None:
            return tuple(f"{number:04d}" for number in range(self.turntable))
        return tuple(Path(path).stem for path in self.maps) or ("scene",)

    @property
    def turns(self) -> list[NDArray[np.float64]]:
        """Rotation matrices of the turntable."""
        count = self.turntable or 1
        return [about_axis(self.up, number * 360.0 / count) for number in range(count)]

    @property
    def own_turns(self) -> list[NDArray[np.float64]]:
        """Rotation matrices of a light that stands as its scene has it, one for each result."""
        return [turn @ about_axis(self.up, self.rotate) for turn in self.turns]

    @property
    def stand(self) -> NDArray[np.float64]:
        """The rotation that maps are put up with."""
        return up_rotation(self.up) @ about_up(self.rotate)


def about_axis(up: str, degrees: float) -> NDArray[np.float64]:
    """Rotation matrix about the axis ``up`` by an angle in degrees, counter-clockwise seen from above."""
    stand = up_rotation(up)
    return stand @ about_up(degrees) @ stand.T


@dataclass(frozen=True)
class Series:
    """Radiance under several lights.

    Attributes
    ----------
    names : for files
    radiance : (B, V, 3) float32
    lighting : (B, 3, (L+1)²)
        Distant light that it is the radiance of.
    fixed_lights : dict of str to float
        What lamps it has beside that light, by their names, each times a number.
    environments : tuple of Environment
        The lights as they stand, if they are to be seen.
    lights : Lights or None
        What was asked for.
    """

    names: tuple[str, ...]
    radiance: NDArray[np.float32]
    lighting: NDArray[np.float64]
    fixed_lights: dict[str, float]
    environments: tuple[Environment, ...] = ()
    lights: Lights | None = None


@each_remark_once()
def relight_series(
    packed: CompressedTransfer, lights: Lights, file: str, report: Callable[[str], None] = lambda _: None
) -> Series:
    """Radiance under all lights, as one product, with that of the scene's lamps in each.

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
        A map that cannot be used, no light at all, or a lamp that is not there.
    """
    scales = lamp_scales(packed.fixed, lights.fixed_lights)
    lighting = _project_lights(packed, lights, scales, file, report)
    if packed.fixed is not None and lights.turn_directional:
        lighting = lighting + packed.fixed.turned(scales, about_axis(lights.up, lights.rotate), packed.bandlimit)
        scales = np.where(packed.fixed.can_turn, 0.0, scales)
    for line in _remarks_on_lamps(packed, lights, file):
        report(line)
    if lights.window is not None:
        named = lights.names if lights.turntable is None else [Path(path).stem for path in lights.maps] or ["scene"]
        lighting = _damp_lights(packed, named, lighting, lights.window, lights.window_width, report)
    if lights.turntable is not None:
        lighting = np.stack([rotate_sh(lighting[0], turn) for turn in lights.turns])
    fixed = {} if packed.fixed is None else dict(zip(packed.fixed.names, scales.tolist(), strict=True))
    radiance = relight(packed, lighting, fixed_lights=fixed)
    negative = max(negative_fraction(one) for one in radiance)
    if negative >= _WORTH_SAYING:
        most = "at most " if len(radiance) > 1 else ""
        what = "vertices" if packed.film is None else "pixels"
        remedy = "" if lights.window else "; `window` damps it"
        report(
            f"{most}{negative:.2%} of the {what} are negative (ringing of small bright lights at this bandlimit"
            f"{remedy})"
        )
    environments = read_environments(lights) if lights.shown else ()
    return Series(lights.names, radiance, lighting, fixed, environments, lights)


def _remarks_on_lamps(packed: CompressedTransfer, lights: Lights, file: str) -> list[str]:
    """What was asked of lamps and changes nothing, or may not do what is expected."""
    fixed, remarks = packed.fixed, []
    if fixed is None and lights.fixed_lights != 1.0:
        remarks.append(f"{file} holds the light of no lamps; `fixed_lights` changes nothing")
    if lights.turn_directional and (fixed is None or not fixed.can_turn.any()):
        remarks.append(f"{file} has no directional lamp; `turn_directional` changes nothing")
    turning = lights.turntable is not None or lights.rotate % 360.0 != 0.0
    if turning and fixed is not None and not lights.turn_directional:
        remedy = "; `turn_directional` turns directional ones" if fixed.can_turn.any() else ""
        remarks.append(f"the lamps of the scene stand still while distant light turns{remedy}")
    return remarks


def read_environments(lights: Lights) -> tuple[Environment, ...]:
    """The maps as they stand, one for each result; none where a light is harmonics without a map and none is shown."""
    if not lights.shown and any(is_light_text(path) for path in lights.maps):
        return ()
    stood = [read_environment(path, clamp_negative=lights.clamp_negative).turned(lights.stand) for path in lights.maps]
    if lights.turntable is None:
        return tuple(stood)
    return tuple(stood[0].turned(turn) for turn in lights.turns)


def _project_lights(
    packed: CompressedTransfer,
    lights: Lights,
    scales: NDArray[np.float64],
    file: str,
    report: Callable[[str], None],
) -> NDArray[np.float64]:
    """Distant lighting (B, 3, (L+1)²); zero where the lamps of the scene are all its light."""
    if not lights.maps:
        if packed.lighting is None and scales.any():
            return np.zeros((1, 3, num_coefficients(packed.bandlimit)))
        if packed.lighting is None:
            off = "its lamps are off, and " if scales.size else ""
            raise UserError(f"{file}: {off}the scene has no light of its own; name a map with `environment`")
        return rotate_sh(packed.lighting, about_axis(lights.up, lights.rotate))[None]
    projected = []
    for path in lights.maps:
        lighting, clamped = project_checked(
            path, packed.bandlimit, rotate=lights.stand, clamp_negative=lights.clamp_negative, fitted_to="the transfer"
        )
        if clamped:
            report(f"{path}: {clamped} negative texels set to zero")
        projected.append(lighting)
    return np.stack(projected)


def _damp_lights(
    packed: CompressedTransfer,
    names: Sequence[str],
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
