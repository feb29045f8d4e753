"""Pictures against references that have noise: equal unless chance says otherwise, and kept to be looked at if not.

As in Mitsuba's own tests (src/render/tests/test_renders.py): each value is compared by its standard error, and the
level is corrected for how many are compared (Šidák), so that a right program fails once in a thousand runs, however
many pixels there are.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student_t

from slepian_prt.evaluation.metrics import relative_rms
from slepian_prt.renderer.variants import bitmap_module

OUTPUT = Path(__file__).parent.parent / "test-output"
SIGNIFICANCE = 1e-3


def in_blocks(values: NDArray, size: int) -> NDArray[np.float64]:
    """Means over squares of pixels, (..., h, w, channels) to (..., h/size, w/size, channels): nearer to normal, and
    with less noise, which lets smaller biases be seen."""
    *runs, height, width, channels = values.shape
    rows, columns = height // size, width // size
    cut = values[..., : rows * size, : columns * size, :].astype(np.float64)
    return cut.reshape(*runs, rows, size, columns, size, channels).mean(axis=(-4, -2))


def assert_agree(ours: NDArray, reference: NDArray, *, bias: NDArray | float = 0.0) -> None:
    """Z-test of the means of independent runs, value by value.

    Parameters
    ----------
    ours, reference : (runs, ...)
        Their variance is that between runs; one run of ours is taken as free of noise. Values that never vary, in
        either, must be equal to rounding. Pictures (runs, h, w, 3) are written to a folder if they do not agree.
    bias : float or (...)
        What ours may be off, noise apart: a bound on what is known not to be the same.
    """
    ours, reference = ours.astype(np.float64), reference.astype(np.float64)
    means = [values.mean(axis=0) for values in (ours, reference)]
    variances = [
        values.var(axis=0, ddof=1) / len(values) if len(values) > 1 else np.zeros(values.shape[1:])
        for values in (ours, reference)
    ]
    rounding = 1e-5 * np.abs(reference).max()
    over = np.maximum(np.abs(means[0] - means[1]) - bias - rounding, 0.0)
    error = np.sqrt(variances[0] + variances[1])
    z = np.divide(over, error, out=np.where(over > 0.0, np.inf, 0.0), where=error > 0.0)
    # Welch's degrees of freedom are at least those of the shorter series.
    freedom = min(len(values) for values in (ours, reference) if len(values) > 1) - 1
    level = 1.0 - (1.0 - SIGNIFICANCE) ** (1.0 / z.size)
    p = 2.0 * student_t.sf(z, freedom)
    if p.min() > level:
        return
    worst = np.unravel_index(int(np.argmin(p)), p.shape)
    told = (
        f"{int(np.sum(p <= level))} of {p.size} values differ by more than chance and bias allow; the worst, "
        f"{means[0][worst]:.5g} against {means[1][worst]:.5g}, by {z[worst]:.1f} standard errors"
    )
    if z.ndim == 3 and z.shape[-1] == 3:
        told += f"; see {kept_pictures(picture=means[0], reference=means[1], error=np.abs(means[0] - means[1]))}"
    raise AssertionError(told)


def assert_same_picture(ours: NDArray, reference: NDArray, atol: float) -> None:
    """No pixel is off by more than ``atol``; else picture, reference and error map are kept."""
    error = np.abs(ours.astype(np.float64) - reference)
    if error.max(initial=0.0) > atol:
        kept = kept_pictures(picture=ours, reference=reference, error=error)
        raise AssertionError(f"pixels are off by up to {error.max():.3g}, and {atol:.3g} is allowed; see {kept}")


def assert_near(ours: NDArray, reference: NDArray, relative: float) -> None:
    """Where what is known to differ decides, not chance: the relative RMS difference is at most ``relative``."""
    found = relative_rms(ours, reference)
    if not found <= relative:
        error = np.abs(ours.astype(np.float64) - reference)
        kept = kept_pictures(picture=ours, reference=reference, error=error)
        raise AssertionError(f"relative RMS difference {found:.4g}, and {relative:.4g} is allowed; see {kept}")


def kept_pictures(**pictures: NDArray) -> Path:
    """Write pictures (h, w, 3) as .exr and .png to the folder of the test that is running, which is returned."""
    name = os.environ.get("PYTEST_CURRENT_TEST", "unknown").split(" ")[0]
    folder = OUTPUT / re.sub(r"[^\w.\-\[\]]+", "-", name)
    folder.mkdir(parents=True, exist_ok=True)
    mi = bitmap_module()
    for stem, pixels in pictures.items():
        bitmap = mi.Bitmap(np.ascontiguousarray(pixels[..., :3], dtype=np.float32))
        bitmap.write(str(folder / f"{stem}.exr"))
        encoded = bitmap.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.UInt8, srgb_gamma=True)
        encoded.write(str(folder / f"{stem}.png"))
    return folder
