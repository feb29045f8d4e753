"""What is asked for, an error, a time, or both, and the light that it is about."""

from __future__ import annotations

import math
from dataclasses import dataclass

from slepian_prt.errors import UserError
from slepian_prt.lighting.environment import Environment
from slepian_prt.lighting.projection import project_environment
from slepian_prt.lighting.spectrum import LightPrior, falling_prior, measured_prior

# Finer errors than this cannot be verified with references of a reasonable size.
SMALLEST_ERROR = 0.002


@dataclass(frozen=True)
class Goal:
    """A largest error, a longest time, or both.

    Attributes
    ----------
    error : float or None
        Relative RMS error of relit radiance, at most.
    seconds : float or None
        From the first to the last, at most.
    samples, bandlimit : int or None
        Not to be chosen, because they were given.
    """

    error: float | None = None
    seconds: float | None = None
    samples: int | None = None
    bandlimit: int | None = None

    def check(self) -> None:
        """
        Raises
        ------
        UserError
            A number that cannot be met by anything, or none.
        """
        if self.error is None and self.seconds is None:
            raise UserError("a goal needs a largest error or a largest time")
        if self.error is not None and not SMALLEST_ERROR <= self.error < 1.0:
            raise UserError(f"`max_error` must be a number from {SMALLEST_ERROR:g} to below 1, not {self.error:g}")
        if self.seconds is not None and not (math.isfinite(self.seconds) and self.seconds > 0.0):
            raise UserError(f"`max_seconds` must be a positive number, not {self.seconds:g}")


@dataclass(frozen=True)
class Light:
    """What relit radiance is measured under.

    Attributes
    ----------
    environments : tuple of Environment
        Errors are measured under each.
    spectrum : str
        What compression is made for, and without environments what errors are measured under: light that falls as
        1/(l+1), or that of the mean spectrum of ``maps``. Empty for that of the environments.
    maps : tuple of Environment
    """

    environments: tuple[Environment, ...] = ()
    spectrum: str = ""
    maps: tuple[Environment, ...] = ()

    def prior(self, bandlimit: int) -> LightPrior:
        """What compression is made for."""
        known = self.maps or (() if self.spectrum else self.environments)
        if not known:
            return falling_prior(bandlimit)
        lighting = [project_environment(light, bandlimit) for light in known]
        return measured_prior(lighting, bandlimit, ", ".join(light.name for light in known))
