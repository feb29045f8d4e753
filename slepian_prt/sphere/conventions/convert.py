"""Coefficients of one tool as those of another."""

from __future__ import annotations

import logging
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.errors import UserError, check_choice
from slepian_prt.sphere.conventions.layouts import PROPERTIES, Layout, cut_or_filled
from slepian_prt.sphere.conventions.neighbours import NEIGHBOURS, OURS, QUANTITIES, Form, Neighbour
from slepian_prt.sphere.harmonics import bandlimit_of
from slepian_prt.sphere.rotation import rotate_sh

log = logging.getLogger(__name__)

DIRECTIONS, MAP = "directions", "map"


def convert_sh(
    coefficients: ArrayLike,
    *,
    source: str = OURS,
    target: str = OURS,
    quantity: str | None = None,
    keep: str = DIRECTIONS,
) -> NDArray[Any]:
    """Spherical harmonic coefficients of one tool as another has them: order, signs, factors and arrays.

    Ours, ``slepian_prt``: index l² + l + m, orthonormal, with the Condon–Shortley phase, polar axis z, transfer with
    1/π; arrays (…, (L+1)²), light (3, (L+1)²). The others are in the table of the page *Coming from other tools*.
    Functions stay what they are in x, y, z; only how they are written changes.

    Parameters
    ----------
    coefficients : array, or pyshtools.SHCoeffs
        In the layout of the source: (…, n²), (…, 3, n²), (…, n², 3), (…, 2, L+1, L+1) of SHTOOLS, or (…, 3n²) of the
        properties f_dc and f_rest of splats.
    source, target : str
        slepian_prt, d3dx, pifu, three, filament, filament-irradiance, filament-shader, games202, google, deca, shtools,
        sphericart, gaussian-splatting or khr-gaussian-splatting.
    quantity : "transfer", "lighting" or "function", optional
        What the numbers are. Needed where a tool has other factors for transfer than for light: PIFu and GAMES202 leave
        1/π out of transfer.
    keep : "directions" or "map"
        Whether light is to come from where it came; or, of light that was made from an equirectangular map, from where
        the other tool puts the same map: three.js has its middle column at +x, we at +z.

    Returns
    -------
    array in the layout of the target, float32 if the source was, else float64
        Degrees that the target cannot hold are left out, with a remark; those that it must have are filled with zeros.

    Raises
    ------
    UserError
        A tool or quantity that there is not; an array of another shape, or of degrees that the source cannot have;
        numbers that are complex, masked or not finite, or that do not fit the type of the result.

    Examples
    --------
    >>> import numpy as np, slepian_prt as sp
    >>> lighting = np.arange(27.0).reshape(3, 9)
    >>> probe = sp.convert_sh(lighting, target="three")  # (9, 3), for LightProbe.sh.fromArray
    >>> probe[1]
    array([ -1., -10., -19.])
    """
    check_choice(source, "source", NEIGHBOURS)
    check_choice(target, "target", NEIGHBOURS)
    check_choice(keep, "keep", (DIRECTIONS, MAP))
    theirs, wanted = NEIGHBOURS[source], NEIGHBOURS[target]
    quantity = _quantity(source, target, quantity)
    form, written = theirs.forms[quantity], wanted.forms[quantity]
    given = _checked(coefficients, source, form)
    kind = np.float32 if given.dtype == np.float32 else np.float64
    with np.errstate(over="ignore", invalid="ignore"):  # what is too large for float64 is found below
        rows = _fitted(_read(given, theirs, form), target, wanted)
        if keep == MAP and theirs.map_turn != wanted.map_turn:
            rows = rotate_sh(rows, _about_y(wanted.map_turn - theirs.map_turn))
        if written.layout.colours and (rows.ndim < 2 or rows.shape[-2] != 3):
            raise UserError(
                f"{target} holds red, green and blue; give coefficients of three colours, not {given.shape}"
            )
        values = _write(rows, wanted, written)
    if not np.abs(values).max(initial=0.0) <= np.finfo(kind).max:
        remedy = "give them as float64, or scale them down" if kind is np.float32 else "scale them down"
        raise UserError(f"coefficients are too large: as {target} has them they do not fit {kind.__name__}; {remedy}")
    return values.astype(kind)


def _quantity(source: str, target: str, quantity: str | None) -> str:
    """What the numbers are, where that is said or makes no difference."""
    both = [NEIGHBOURS[name].forms for name in (source, target)]
    common = [one for one in QUANTITIES if all(one in forms for forms in both)]
    if quantity is not None:
        check_choice(quantity, "quantity", QUANTITIES)
        for name, forms in zip((source, target), both, strict=True):
            if quantity not in forms:
                raise UserError(f"{name} has no {quantity}, but {' and '.join(forms)}")
        return quantity
    if not common:
        raise UserError(
            f"{source} has {' and '.join(both[0])}, and {target} {' and '.join(both[1])}: nothing in common"
        )
    if any(forms[one] != forms[common[0]] for forms in both for one in common):
        name = next(n for n, forms in zip((source, target), both, strict=True) if forms[common[0]] != forms[common[1]])
        raise UserError(f"quantity must say what the numbers are, {' or '.join(common)}, as they differ in {name}")
    return common[0]


def _checked(coefficients: ArrayLike, source: str, form: Form) -> NDArray:
    """The numbers, if they are real, finite and of a shape that the source has."""
    if hasattr(coefficients, "normalization") and hasattr(coefficients, "csphase"):
        coefficients = _of_pyshtools(coefficients, source)
    if np.ma.is_masked(coefficients):
        raise UserError("coefficients must not be masked; fill in what is hidden, say with `filled(0.0)`")
    try:
        values = np.asarray(coefficients)
    except ValueError:
        raise UserError("coefficients must be an array: their rows differ in length") from None
    if values.dtype.kind not in "iuf":
        raise UserError(f"coefficients must be real numbers, not {values.dtype}")
    if not np.isfinite(values).all():
        raise UserError("coefficients must be finite; look where they were computed")
    bandlimit = form.layout.bandlimit(values.shape)
    if bandlimit is None:
        advice = _reshaped(values, form.layout)
        raise UserError(f"coefficients of {source} must have shape {form.layout.shape}, not {values.shape}{advice}")
    neighbour = NEIGHBOURS[source]
    if bandlimit < neighbour.lowest or (neighbour.highest is not None and bandlimit > neighbour.highest):
        raise UserError(
            f"coefficients of {source} have bandlimit {neighbour.bandlimits}, and {values.shape} is {bandlimit}; cut "
            "them, or name the tool that they are of"
        )
    return values


def _of_pyshtools(coefficients: Any, source: str) -> NDArray:
    """The array of an ``SHCoeffs``, which says itself what it holds."""
    form = coefficients.normalization, coefficients.csphase, coefficients.kind
    if source != "shtools" or form != ("4pi", 1, "real"):
        raise UserError(
            f"coefficients of pyshtools are those of source 'shtools' with normalization 4pi, csphase 1, real, not of "
            f"{source!r} with {form[0]}, {form[1]}, {form[2]}; give `.convert(normalization='4pi', csphase=1)`"
        )
    return np.asarray(coefficients.coeffs)


def _reshaped(values: NDArray, layout: Layout) -> str:
    """What may have been meant by an array of another shape."""
    if values.ndim == 2 and layout.bandlimit(values.T.shape) is not None:
        return "; transpose it, or name the tool that it is of"
    size = values.size // 3
    if values.ndim == 1 and 3 * size == values.size and layout.bandlimit((size, 3)) is not None and layout.colours:
        return f"; reshape it to ({size}, 3)"
    if values.ndim >= 3 and layout is PROPERTIES:
        return "; with the colours last they are those of khr-gaussian-splatting"
    return ""


def _read(values: NDArray, neighbour: Neighbour, form: Form) -> NDArray[np.float64]:
    """Rows (…, n²) of ours."""
    given = form.layout.to_rows(values).astype(np.float64)
    bandlimit = bandlimit_of(given.shape[-1])
    rows = np.empty_like(given)
    rows[..., neighbour.permutation(bandlimit)] = given
    rows /= form.factor(bandlimit)
    rows[..., 0] += form.offset * math.sqrt(4.0 * math.pi)
    return rows


def _write(rows: NDArray[np.float64], neighbour: Neighbour, form: Form) -> NDArray:
    """Rows (…, n²) of ours as a tool has them."""
    bandlimit = bandlimit_of(rows.shape[-1])
    written = rows.copy()
    written[..., 0] -= form.offset * math.sqrt(4.0 * math.pi)
    written *= form.factor(bandlimit)
    return np.ascontiguousarray(form.layout.from_rows(written[..., neighbour.permutation(bandlimit)]))


def _fitted(rows: NDArray[np.float64], name: str, neighbour: Neighbour) -> NDArray[np.float64]:
    """Rows of a bandlimit that a tool can hold."""
    bandlimit, highest = bandlimit_of(rows.shape[-1]), neighbour.highest
    if highest is not None and bandlimit > highest:
        left = f"{bandlimit} is" if bandlimit == highest + 1 else f"{highest + 1} to {bandlimit} are"
        log.warning("%s holds degrees up to %d; %s left out", name, highest, left)
        return cut_or_filled(rows, highest)
    return cut_or_filled(rows, neighbour.lowest) if bandlimit < neighbour.lowest else rows


def _about_y(degrees: float) -> NDArray[np.float64]:
    """Rotation about y, counter-clockwise seen from above."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
