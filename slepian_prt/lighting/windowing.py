"""Windows over degrees, which damp the ringing of small bright lights.

Projected on few degrees, a sun rings: radiance oscillates and turns negative away from it. A window falls with the
degree and damps that (Sloan, "Stupid Spherical Harmonics Tricks", 2008). How much, is the width: the degree that the
window falls to zero at, which may be beyond the bandlimit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError, check_choice
from slepian_prt.sphere.harmonics import bandlimit_of, degrees

WINDOWS = ("hann", "lanczos")


def window(name: str, bandlimit: int, width: float) -> NDArray[np.float64]:
    """(L+1,) factors of degrees 0..L.

    Parameters
    ----------
    name : str
        ``hann``, (1 + cos πl/w)/2, or ``lanczos``, sin(πl/w)/(πl/w); both zero from degree w.
    bandlimit : int
    width : float
        w, larger than 0.

    Raises
    ------
    UserError
        An unknown name, or a width that is not positive.
    """
    check_choice(name, "window", WINDOWS)
    if not 0.0 < width < np.inf:
        raise UserError(f"width of the window must be larger than 0 degrees, not {width}")
    l = np.arange(bandlimit + 1)
    if name == "hann":
        return np.where(l < width, 0.5 * (1.0 + np.cos(np.pi * l / width)), 0.0)
    return np.where(l < width, np.sinc(l / width), 0.0)


def windowed(lighting: NDArray, name: str, width: float) -> NDArray[np.float64]:
    """Lighting (…, (L+1)²) with each degree damped."""
    bandlimit = bandlimit_of(lighting.shape[-1])
    return np.asarray(lighting * window(name, bandlimit, width)[degrees(bandlimit)])
