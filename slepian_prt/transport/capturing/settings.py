"""What is asked of a capture."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from slepian_prt.errors import UserError, check_bandlimit, check_integer
from slepian_prt.scene.mitsuba.parameters import scene_parameters
from slepian_prt.transport.settings import LARGEST_BANDLIMIT, LARGEST_SAMPLES, check_seed

DEFAULT_SAMPLES = 256

# Passes that a fixed number of samples is divided into, whose differences tell the noise: two, which stratify better,
# and four of many samples.
_FEW_PASSES, _PASSES, _MANY = 2, 4, 256

# Samples of a pass where nobody knows how many there will be.
_OPEN = 16


@dataclass(frozen=True)
class CaptureSettings:
    """What is asked of a capture; see `capture`.

    Attributes
    ----------
    sensor : id or number of a camera, or None for the first
    bandlimit : int in [0, 50]
    samples : int or None
        Paths of each pixel.
    max_error : float in (0, 1) or None
        Instead: until the noise is no more than this, relative to the picture.
    max_seconds : float or None
        Instead, or beside ``max_error``: for so long.
    seed : int
    parameters : dict of str to number, bool or str, or None
        Of an .xml scene; kept as strings.
    smooth : bool
        Whether noise is taken out along the picture.

    Raises
    ------
    UserError
        A number out of range, or samples beside an error or a time.
    """

    sensor: str | int | None = None
    bandlimit: int = 10
    samples: int | None = None
    max_error: float | None = None
    max_seconds: float | None = None
    seed: int = 0
    parameters: Mapping[str, object] | None = None
    smooth: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "bandlimit", check_bandlimit(self.bandlimit, largest=LARGEST_BANDLIMIT))
        object.__setattr__(self, "seed", check_seed(self.seed))
        if self.samples is not None:
            object.__setattr__(self, "samples", check_integer(self.samples, "samples", 2, LARGEST_SAMPLES))
            if self.is_open:
                raise UserError("`samples` says how many paths are traced; leave out `max_error` and `max_seconds`")
        if self.max_error is not None and not (_is_number(self.max_error) and 0.0 < self.max_error < 1.0):
            raise UserError(f"max_error must be a number in (0, 1), not {self.max_error!r}")
        if self.max_seconds is not None and not (_is_number(self.max_seconds) and 0.0 < self.max_seconds < math.inf):
            raise UserError(f"max_seconds must be a positive number, not {self.max_seconds!r}")
        if self.parameters is not None:
            object.__setattr__(self, "parameters", scene_parameters(self.parameters))

    @property
    def is_open(self) -> bool:
        """Whether passes go on until a goal is met."""
        return self.max_error is not None or self.max_seconds is not None

    @property
    def passes(self) -> int:
        """How many passes there are at least, and without a goal at most."""
        if self.is_open:
            return _FEW_PASSES
        return _PASSES if self._wanted >= _MANY else _FEW_PASSES

    @property
    def per_pass(self) -> int:
        """Samples of a pixel in a pass: at least as many as are wanted, in a grid that is nearly a square."""
        if self.is_open:
            return _OPEN
        fewest = -(-self._wanted // self.passes)
        return next(n for n in range(fewest, 2 * fewest + 4) if math.isqrt(n) * -(-n // math.isqrt(n)) == n)

    @property
    def most_passes(self) -> int:
        """So many that samples stay below what is allowed."""
        return LARGEST_SAMPLES // self.per_pass if self.is_open else self.passes

    @property
    def _wanted(self) -> int:
        return DEFAULT_SAMPLES if self.samples is None else self.samples


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and not math.isnan(value)
