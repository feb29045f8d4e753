"""What is known of the light beforehand: its power in each degree.

Averaged over all rotations of an environment, the expected squared radiance that a difference δ of transfer vectors
makes is Σ_l p_l Σ_m δ_lm², where p_l = Σ_m e_lm² / (2l + 1) is the environment's power per harmonic. Bases that are
made for vectors scaled by √p_l minimise the error of relit radiance instead of that of the transfer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.errors import UserError, check_bandlimit
from slepian_prt.lighting.fitting import each_remark_once, lights_of, one_light
from slepian_prt.sphere.harmonics import bandlimit_of, degrees

FALLING = "1/(l+1)"

# Degrees that an environment does not hold count for this part of the strongest: a constant map says nothing about
# what else the transfer will be lit with, and weights are divided by.
_FAINTEST = 1e-2


@dataclass(frozen=True)
class LightPrior:
    """Attributes
    ----------
    name : str
    weights : (L+1,)
        √p_l, the largest being one.
    """

    name: str
    weights: NDArray[np.float64]


def light_power(lighting: ArrayLike) -> NDArray[np.float64]:
    """(L+1,) power per harmonic of lighting (..., (L+1)²), channels added."""
    squares = np.asarray(lighting, dtype=np.float64) ** 2
    squares = squares.reshape(-1, squares.shape[-1]).sum(axis=0)
    bandlimit = bandlimit_of(squares.size)
    sums = np.bincount(degrees(bandlimit), squares)
    return np.asarray(sums / (2.0 * np.arange(bandlimit + 1) + 1.0))


def falling_prior(bandlimit: int) -> LightPrior:
    """Weights 1/(l+1): skies and overcast light, without suns or lamps."""
    return LightPrior(FALLING, 1.0 / np.arange(1.0, check_bandlimit(bandlimit) + 2.0))


def expected_power(lighting: ArrayLike | None, bandlimit: int) -> NDArray[np.float64]:
    """(L+1,) power per harmonic of lighting (…, n²) at a bandlimit; without one, of light that falls as 1/(l+1)²."""
    if lighting is None:
        return falling_prior(bandlimit).weights ** 2
    return light_power(lights_of(lighting, bandlimit))


@each_remark_once()
def measured_prior(lighting: Sequence[NDArray], bandlimit: int, name: str) -> LightPrior:
    """Weights from the mean spectrum of environments, each (3, n²), brightness left out.

    Those of another bandlimit are cut, or dark in the degrees that they have not, with a remark.

    Raises
    ------
    UserError
        No environment, or one that is black or of another shape.
    """
    if len(lighting) == 0:
        raise UserError("a light prior needs at least one environment")
    spectra = []
    for light in lighting:
        power = light_power(one_light(light, bandlimit, "the prior"))
        if not power.max() > 0.0:
            raise UserError(f"{name}: is black and says nothing about light; choose another map")
        spectra.append(power / power[0] if power[0] > _FAINTEST * power.max() else power / power.max())
    weights = np.sqrt(np.mean(spectra, axis=0))
    weights /= weights.max()
    return LightPrior(name, np.maximum(weights, _FAINTEST))
