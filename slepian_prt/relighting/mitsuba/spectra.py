"""Linear sRGB as what any variant draws."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

# Wavelengths, in nm, between which spectra are integrated.
_FROM, _TO = 360.0, 830.0

# Rec. 709 luminance.
_LUMINANCE = (0.212671, 0.715160, 0.072169)


def srgb_to_spectrum(mi: Any, srgb: Any, wavelengths: Any, spectra: list[list[float]] | None) -> Any:
    """Linear sRGB (Color3f) as an unpolarized spectrum of the variant.

    Parameters
    ----------
    mi : Mitsuba, in that variant
    srgb : Color3f
    wavelengths : of the rays, in nm
    spectra : nested lists, (3, 3)
        `smooth_spectra`, in a spectral variant.
    """
    if mi.is_rgb:
        return srgb
    if spectra is None:
        return mi.Color1f(sum(part * weight for part, weight in zip(srgb, _LUMINANCE, strict=True)))
    coefficients = [sum(weight * srgb[c] for c, weight in enumerate(row)) for row in spectra]
    spectrum = mi.UnpolarizedSpectrum(0.0)
    for i, wavelength in enumerate(wavelengths):
        basis = smooth_basis(wavelength)
        spectrum[i] = sum(coefficient * part for coefficient, part in zip(coefficients, basis, strict=True))
    return spectrum


def without_polarization(mi: Any, spectrum: Any) -> Any:
    """An unpolarized spectrum as a ``Spectrum`` of the variant, polarized or not."""
    if not mi.is_polarized:
        return mi.Spectrum(spectrum)
    mueller = mi.Spectrum(0.0)
    mueller[0, 0] = spectrum
    return mueller


def smooth_spectra(mi: Any) -> NDArray[np.float64]:
    """(3, 3) from linear sRGB to the coefficients of `smooth_basis` that give a spectrum of that colour.

    It is linear in the colour, so that negative radiance (ringing) and gradients are as in RGB, and smooth, so that
    reflectances change its colour about as they do in RGB.
    """
    wavelengths = np.arange(_FROM, _TO + 0.5, 1.0)
    matching = np.array([np.array(part) for part in mi.cie1931_xyz(mi.Float(wavelengths.astype(np.float32)))])
    to_xyz = np.array([np.array(mi.srgb_to_xyz(mi.Color3f(*unit))).ravel() for unit in np.eye(3).tolist()]).T
    return np.asarray(np.linalg.solve(matching.astype(np.float64) @ np.stack(smooth_basis(wavelengths)).T, to_xyz))


def smooth_basis(wavelength: Any) -> list[Any]:
    """Polynomials of the wavelength in nm up to degree two."""
    x = (wavelength - 0.5 * (_FROM + _TO)) / (0.5 * (_TO - _FROM))
    return [0.0 * x + 1.0, x, x * x]
