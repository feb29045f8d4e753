"""How much memory a capture takes, told before its paths are traced."""

from __future__ import annotations

from slepian_prt.machine.memory import check_estimate
from slepian_prt.sphere.harmonics import num_coefficients

_MIB = 1 << 20

# Measured at 230,400 pixels and bandlimits 4 and 8: Python with Mitsuba and SciPy, paths in flight, and a pixel with
# its neighbours and what guides smoothing; bytes for each of its coefficients, whose two copies on disk count while
# they are read and written, and for each of a block.
_BASE = 205 * _MIB
_PATHS = 250 * _MIB
_PIXEL = 1500
_COPIES, _OF_BLOCK = 4, 2


def check_capture_memory(pixels: int, per_block: int, bandlimit: int, smooth: bool) -> None:
    """Raise UserError for pictures that clearly do not fit in the memory that is allowed.

    Parameters
    ----------
    pixels, per_block, bandlimit : int
    smooth : bool
        Whether noise is taken out along the picture: all of it is held then.
    """
    vector = 4 * 3 * num_coefficients(bandlimit)
    need = _BASE + _PATHS + pixels * (_PIXEL + _COPIES * vector) + _OF_BLOCK * per_block * vector
    least = _BASE + pixels * (_PIXEL // 2 + (vector if smooth else 0))
    check_estimate(
        need, f"capturing {pixels} pixels at bandlimit {bandlimit}", "lower `bandlimit` or make the film smaller", least
    )
