"""What is asked of transport."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from numpy.typing import ArrayLike

from slepian_prt.errors import UserError, check_bandlimit, check_integer
from slepian_prt.scene.mesh_files import check_crease_angle
from slepian_prt.scene.mitsuba.parameters import scene_parameters
from slepian_prt.transport.effects import wanted_effects

LARGEST_BANDLIMIT = 50
LARGEST_SAMPLES = 1 << 16
LARGEST_BOUNCES = 1000

# Of a seed; as many as generators of random numbers begin with.
_SEED_BITS = 128


def check_seed(seed: Any) -> int:
    """Return ``seed`` as an int; raise UserError unless it is a whole number of at most 128 bits."""
    number = check_integer(seed, "seed", 0)
    if number.bit_length() > _SEED_BITS:
        raise UserError(f"seed must be below 2^{_SEED_BITS}, not a number of {number.bit_length()} bits")
    return number


@dataclass(frozen=True)
class TransportSettings:
    """What is asked of transport; see `precompute`.

    Attributes
    ----------
    bandlimit : int in [0, 50]
    samples : int
        Rays per receiver, on average.
    effects : str
    bounces : int or None
    albedo : one or three numbers, or None
    view : id or number of a camera, or None
    seed : int
    crease_angle : float in [0, 180] or None
        Of a mesh file without normals.
    parameters : dict of str to number, bool or str, or None
        Of an .xml scene; kept as strings.
    smooth : bool
        Whether noise of paths is taken out along the surface.

    Raises
    ------
    UserError
        A number out of range, an unknown effect, or parameters that cannot be written in XML.
    """

    bandlimit: int = 10
    samples: int = 1024
    effects: str = "auto"
    bounces: int | None = None
    albedo: ArrayLike | None = None
    view: str | int | None = None
    seed: int = 0
    crease_angle: float | None = None
    parameters: Mapping[str, object] | None = None
    smooth: bool = True

    def __post_init__(self) -> None:
        numbers = {
            "bandlimit": check_bandlimit(self.bandlimit, largest=LARGEST_BANDLIMIT),
            "samples": check_integer(self.samples, "samples", 1, LARGEST_SAMPLES),
            "seed": check_seed(self.seed),
        }
        if self.bounces is not None:
            numbers["bounces"] = check_integer(self.bounces, "bounces", 0, LARGEST_BOUNCES)
        if self.crease_angle is not None:
            check_crease_angle(self.crease_angle)
        for name, number in numbers.items():
            object.__setattr__(self, name, number)
        if self.parameters is not None:
            object.__setattr__(self, "parameters", scene_parameters(self.parameters))
        wanted_effects(self.effects)
