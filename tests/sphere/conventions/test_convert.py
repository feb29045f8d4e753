"""Each function of each tool is a function of ours, and the other way round."""

import logging
import math
from dataclasses import replace

import numpy as np
import pyshtools
import pytest

import slepian_prt as sp
from slepian_prt.errors import UserError
from slepian_prt.sphere.conventions import convert
from slepian_prt.sphere.conventions.convert import convert_sh
from slepian_prt.sphere.conventions.neighbours import FUNCTION, LIGHTING, NEIGHBOURS, OURS, TRANSFER
from slepian_prt.sphere.quadrature import cap_rule
from tests.conftest import random_directions
from tests.numerics import assert_exact
from tests.sphere.conventions import their_formulas as theirs

# Constants of Google's have six digits.
SIX_DIGITS = 1e-5


def of_light(coefficients, directions):
    """(n, 3) what comes from directions, by our harmonics."""
    return sp.real_sh(math.isqrt(coefficients.shape[-1]) - 1, directions) @ coefficients.T


def of_surfaces(coefficients, normals):
    """(n, 3) radiance of unblocked white surfaces: A_l = 1, 2/3, 1/4 (Ramamoorthi & Hanrahan 2001)."""
    return of_light(coefficients * np.repeat([1.0, 2.0 / 3.0, 0.25], [1, 3, 5]), normals)


# Tool: what it makes of its coefficients, what we make of ours that is the same, bandlimit, tolerance.
TOOLS = {
    "d3dx": (theirs.d3dx, of_light, 3, 1e-13),
    "pifu": (theirs.pifu, of_light, 4, 1e-13),
    "three": (theirs.three, of_light, 2, 1e-13),
    "filament": (theirs.filament, of_light, 4, 1e-13),
    "filament-irradiance": (theirs.filament_irradiance, of_surfaces, 2, 1e-13),
    "filament-shader": (theirs.filament_shader, of_surfaces, 2, 1e-13),
    "games202": (lambda c, d: theirs.google(c.T, d), of_light, 2, SIX_DIGITS),
    "google": (theirs.google, of_light, 4, SIX_DIGITS),
    "deca": (theirs.deca, of_surfaces, 2, 1e-13),
    "shtools": (theirs.shtools, of_light, 4, 1e-13),
    "sphericart": (theirs.sphericart, of_light, 4, 1e-13),
    "gaussian-splatting": (theirs.gaussian_splatting, of_light, 3, 1e-13),
    "khr-gaussian-splatting": (theirs.khr_gaussian_splatting, of_light, 3, 1e-13),
}


def quantity_of(tool):
    return LIGHTING if LIGHTING in NEIGHBOURS[tool].forms else FUNCTION


def test_every_tool_is_tested():
    assert {*TOOLS, OURS} == set(NEIGHBOURS)


@pytest.mark.parametrize("tool", TOOLS)
def test_each_function_of_ours_is_theirs(tool, rng):
    """One-hot, one after the other, in a colour each."""
    evaluate, expected, bandlimit, tolerance = TOOLS[tool]
    directions = random_directions(rng, 40)
    for i in range((bandlimit + 1) ** 2):
        ours = np.zeros((3, (bandlimit + 1) ** 2))
        ours[i % 3, i] = 1.0
        converted = convert_sh(ours, target=tool, quantity=quantity_of(tool))
        np.testing.assert_allclose(
            evaluate(converted, directions), expected(ours, directions), rtol=0.0, atol=tolerance, err_msg=f"{tool} {i}"
        )


@pytest.mark.parametrize("tool", TOOLS)
def test_each_number_of_theirs_is_a_function_of_ours(tool, rng):
    evaluate, expected, bandlimit, tolerance = TOOLS[tool]
    quantity, directions = quantity_of(tool), random_directions(rng, 40)
    zero = convert_sh(np.zeros((3, (bandlimit + 1) ** 2)), target=tool, quantity=quantity)
    for place in np.ndindex(zero.shape):
        if tool == "shtools" and _is_left_empty(place):
            continue
        one = np.zeros(zero.shape)
        one[place] = 1.0
        ours = convert_sh(one, source=tool, quantity=quantity)
        np.testing.assert_allclose(
            evaluate(one, directions),
            expected(ours, directions),
            rtol=0.0,
            atol=tolerance * 4.0,
            err_msg=f"{tool} {place}",
        )


def _is_left_empty(place):
    """Places that SHTOOLS does not use: m > l, and sines of m = 0."""
    _, part, l, m = place
    return m > l or (part == 1 and m == 0)


@pytest.mark.parametrize("source", NEIGHBOURS)
def test_any_pair_goes_by_way_of_ours(source, rng):
    quantity = quantity_of(source)
    start = convert_sh(rng.normal(size=(3, 9)), target=source, quantity=quantity)
    ours = convert_sh(start, source=source, quantity=quantity)
    for target, neighbour in NEIGHBOURS.items():
        if quantity in neighbour.forms:
            there = convert_sh(start, source=source, target=target, quantity=quantity)
            np.testing.assert_allclose(there, convert_sh(ours, target=target, quantity=quantity), atol=1e-14)
            back = convert_sh(there, source=target, target=source, quantity=quantity)
            np.testing.assert_allclose(back, start, rtol=0.0, atol=1e-14)


# --- Transfer --------------------------------------------------------------------------------------------------------


def their_transfer(tool, normal, d, weights):
    """∫ (n·ω)₊ Y dω, without 1/π, as the programs sum it up over their samples."""
    cosine = np.maximum(d @ normal, 0.0) * weights
    if tool == "pifu":
        return cosine @ theirs.pifu_harmonics(2, *theirs.pifu_angles(d))
    return np.array([cosine @ theirs.google(row[None], d)[:, 0] for row in np.eye(9)])


@pytest.mark.parametrize("tool", ["pifu", "games202"])
def test_transfer_of_theirs(tool, rng):
    """Of unblocked receivers: a rule that is exact on the half sphere above."""
    for normal in random_directions(rng, 3):
        d, weights = cap_rule(3, 0.5 * math.pi, normal)
        t = their_transfer(tool, normal, d, weights)
        ours = np.repeat([1.0, 2.0 / 3.0, 0.25], [1, 3, 5]) * sp.real_sh(2, normal[None])[0]
        np.testing.assert_allclose(convert_sh(t, source=tool, quantity=TRANSFER), ours, rtol=0.0, atol=SIX_DIGITS)
        np.testing.assert_allclose(convert_sh(ours, target=tool, quantity=TRANSFER), t, rtol=0.0, atol=3 * SIX_DIGITS)


@pytest.mark.parametrize("tool", ["pifu", "games202"])
def test_their_products_of_light_and_transfer_are_pi_times_ours(tool, rng):
    light, vectors = rng.normal(size=(3, 9)), rng.normal(size=(5, 9))
    theirs = [convert_sh(x, target=tool, quantity=q) for x, q in ((light, LIGHTING), (vectors, TRANSFER))]
    np.testing.assert_allclose(theirs[1] @ theirs[0], math.pi * vectors @ light.T, rtol=1e-13)


# --- Maps ------------------------------------------------------------------------------------------------------------


def test_three_js_puts_the_middle_of_a_map_at_x(rng):
    """A smooth map summed up by ``equirectUv`` of three.js: u = atan2(z, x)/2π + ½, v = asin(y)/π + ½ from below."""
    height = 64
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(2 * height) + 0.5) / (2 * height), indexing="ij")
    texels = 1.0 + np.cos(2 * math.pi * (u - 0.6)) * np.sin(math.pi * v) + v
    colours = texels[..., None] * [1.0, 0.5, 0.25]
    azimuth, elevation = 2.0 * math.pi * (u - 0.5), math.pi * (0.5 - v)
    d = np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.sin(elevation), np.cos(elevation) * np.sin(azimuth)], axis=-1
    ).reshape(-1, 3)
    area = np.cos(elevation).ravel() * (math.pi / height) ** 2
    basis = np.stack([theirs.three(np.eye(9)[i][:, None] * np.ones(3), d)[:, 0] for i in range(9)])
    probe = (basis * area) @ colours.reshape(-1, 3)
    ours = sp.project_environment(colours.astype(np.float32), 2)
    size = np.abs(probe).max()
    # Rows at centres against rows on the poles: 1.6 % at 64 rows.
    np.testing.assert_allclose(convert_sh(ours, target="three", keep="map"), probe, rtol=0.0, atol=0.02 * size)
    np.testing.assert_allclose(convert_sh(probe, source="three", keep="map"), ours, rtol=0.0, atol=0.02 * size)
    assert np.abs(convert_sh(ours, target="three") - probe).max() > 0.1 * size


def test_degrees_that_a_tool_does_not_hold_are_not_turned(monkeypatch, rng):
    """Rotations of many degrees take long, and each degree is turned by itself."""
    turned = []

    def rotate(rows, rotation):
        turned.append(rows.shape)
        return sp.rotate_sh(rows, rotation)

    monkeypatch.setattr(convert, "rotate_sh", rotate)
    light = rng.normal(size=(3, 31**2))
    probe = convert_sh(light, target="three", keep="map")
    assert turned == [(3, 9)]
    whole = sp.rotate_sh(light, [[0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    np.testing.assert_allclose(probe, convert_sh(whole, target="three"), rtol=0.0, atol=1e-13)


# --- What is refused, and what is said --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"target": "unity"}, "^target must be one of slepian_prt, d3dx, .* not 'unity'$"),
        ({"source": "three.js"}, "^source must be one of .*, not 'three.js'; did you mean three[?]$"),
        ({"source": "pySHTOOLS"}, "; did you mean shtools[?]$"),
        ({"target": "pifu"}, "^quantity must say .* transfer or lighting, as they differ in pifu$"),
        ({"target": "three", "quantity": "transfer"}, "^three has no transfer, but lighting and function$"),
        ({"target": "three", "quantity": "colour"}, "^quantity must be one of transfer, .*, not .colour."),
        ({"target": "three", "keep": "up"}, "^keep must be one of directions, map, not 'up'$"),
        ({"source": "deca", "target": "gaussian-splatting"}, "^deca has lighting, and .* function: nothing in common$"),
        ({"source": "three"}, r"^coefficients of three must .* \(…, n², 3\), not \(3, 9\); transpose it, or"),
        ({"source": "shtools"}, r"^coefficients of shtools must have shape \(…, 2, L\+1, L\+1\), not \(3, 9\)$"),
    ],
)  # fmt: skip
def test_what_is_refused(arguments, message):
    with pytest.raises(UserError, match=message):
        convert_sh(np.zeros((3, 9)), **arguments)


def test_objects_of_pyshtools_say_what_they_hold(rng):
    theirs = convert_sh(rng.normal(size=16), target="shtools")
    coefficients = pyshtools.SHCoeffs.from_array(theirs)
    assert_exact(convert_sh(coefficients, source="shtools"), convert_sh(theirs, source="shtools"), "the same numbers")
    other = coefficients.convert(normalization="ortho", csphase=-1)
    with pytest.raises(UserError, match=r"of 'shtools' with ortho, -1, real; give `[.]convert\("):
        convert_sh(other, source="shtools")
    with pytest.raises(UserError, match="not of 'sphericart' with 4pi, 1, real"):
        convert_sh(coefficients, source="sphericart")


@pytest.mark.parametrize(
    ("values", "arguments", "message"),
    [
        (np.zeros(8), {}, r"must have shape \(…, n²\), not \(8,\)"),
        (np.zeros((3, 0)), {}, r"not \(3, 0\)"),
        (3.0, {}, r"not \(\)"),
        ([[1.0], [1.0, 2.0]], {}, "rows differ in length"),
        (np.zeros(9, dtype=complex), {}, "must be real numbers, not complex128"),
        (np.zeros((3, 9), dtype=complex), {"target": "three"}, "must be real numbers, not complex128"),
        (["a"], {}, "must be real numbers"),
        (np.full(9, np.nan), {}, "^coefficients must be finite; look where"),
        (
            np.full((3, 9), -np.inf, dtype=np.float32),
            {"target": "three", "keep": "map"},
            "^coefficients must be finite",
        ),
        (np.ma.masked_greater(np.arange(9.0), 4.0), {}, "^coefficients must not be masked; fill in what is hidden"),
        (np.zeros((16, 3)), {"source": "three"}, r"of three have bandlimit 2, and \(16, 3\) is 3; cut them"),
        (np.zeros((4, 3)), {"source": "deca"}, r"of deca have bandlimit 2, and \(4, 3\) is 1"),
        (np.zeros(75), {"source": "gaussian-splatting"}, r"have bandlimit 0 to 3, and \(75,\) is 4"),
        (np.zeros(27), {"source": "three"}, r"not \(27,\); reshape it to \(9, 3\)$"),
        (np.zeros((9, 3)), {}, r"must have shape \(…, n²\), not \(9, 3\); transpose it, or name the tool"),
        (
            np.zeros((7, 16, 3)),
            {"source": "gaussian-splatting"},
            "colours last they are .* khr-gaussian-splatting",
        ),
        (np.zeros(9), {"target": "three"}, r"three holds red, green and blue; give .* three colours, not \(9,\)"),
        (np.zeros((4, 9)), {"target": "gaussian-splatting"}, "three colours"),
    ],
)
def test_arrays_that_are_refused(values, arguments, message):
    with pytest.raises(UserError, match=message):
        convert_sh(values, **arguments)


def test_results_fit_their_type():
    """π times what float32 holds is more than it holds, and no warning of NumPy; in float64 there is room."""
    large = np.full((2, 9), 3e38, dtype=np.float32)
    pifu = {"target": "pifu", "quantity": TRANSFER}
    with pytest.raises(
        UserError, match=r"^coefficients are too large: as pifu has them they do not fit float32; give th"
    ):
        convert_sh(large, **pifu)
    expected = math.pi * large.astype(float) * np.array([1, -1, 1, -1, 1, -1, 1, -1, 1])
    np.testing.assert_allclose(convert_sh(large.astype(float), **pifu), expected, rtol=1e-15)
    assert convert_sh(large, target="google").dtype == np.float32
    with pytest.raises(UserError, match=r"they do not fit float64; scale them down$"):
        convert_sh(np.full(9, 1e308), **pifu)


def test_a_mask_that_hides_nothing_is_no_matter():
    values = np.arange(9.0)
    assert_exact(convert_sh(np.ma.masked_array(values)), values, "the same numbers")


def test_whether_there_are_colours_is_not_read_from_text(monkeypatch):
    """The text of a layout is for readers."""
    (form,) = set(NEIGHBOURS["filament"].forms.values())
    named = replace(form, layout=replace(form.layout, shape="(…, n², RGB)"))
    tool = replace(NEIGHBOURS["filament"], forms={LIGHTING: named})
    monkeypatch.setattr(convert, "NEIGHBOURS", {**NEIGHBOURS, "filament": tool})
    with pytest.raises(UserError, match=r"filament holds red, green and blue; give .* three colours, not \(9,\)"):
        convert_sh(np.zeros(9), target="filament", quantity=LIGHTING)


def test_degrees_that_a_tool_does_not_hold_are_left_out_and_said(rng, caplog):
    caplog.set_level(logging.INFO)
    long = rng.normal(size=(3, 36))
    assert_exact(convert_sh(long, target="three"), convert_sh(long[:, :9], target="three"), "the same numbers")
    convert_sh(long[:, :16], target="three")
    told = "three holds degrees up to 2; 3 "
    assert caplog.messages == [f"{told}to 5 are left out", f"{told}is left out"]


def test_degrees_that_a_tool_must_have_are_zero(rng, caplog):
    caplog.set_level(logging.INFO)
    short = rng.normal(size=(3, 4))
    probe = convert_sh(short, target="three")
    assert probe.shape == (9, 3)
    assert not probe[4:].any()
    assert caplog.messages == []


def test_leading_axes_and_types_stay(rng):
    vectors = rng.normal(size=(5, 4, 16)).astype(np.float32)
    there = convert_sh(vectors, target="sphericart")
    assert there.dtype == np.float32
    assert there.shape == vectors.shape
    assert convert_sh(np.arange(16), target="google").dtype == np.float64
    splats = convert_sh(rng.normal(size=(7, 48)), source="gaussian-splatting")
    assert splats.shape == (7, 3, 16)
    assert convert_sh(rng.normal(size=(7, 3, 16)), target="shtools").shape == (7, 3, 2, 4, 4)


def test_what_is_given_is_not_changed(rng):
    light = rng.normal(size=(3, 9))
    before = light.copy()
    converted = convert_sh(light)
    converted += 1.0
    convert_sh(light, target="gaussian-splatting", quantity="function")
    assert_exact(light, before, "untouched")


def test_splats_without_harmonics_are_gray():
    """The colour of zeros is ½, which is the constant function ½ here."""
    ours = convert_sh(np.zeros(48), source="gaussian-splatting")
    np.testing.assert_allclose(of_light(ours, np.eye(3)), 0.5, rtol=1e-14)
    assert np.abs(ours[:, 1:]).max() == 0.0


# --- Against their own code -------------------------------------------------------------------------------------------


def test_against_pyshtools(rng):
    pysh = pytest.importorskip("pyshtools")
    ours = rng.normal(size=49)
    grid = pysh.SHCoeffs.from_array(convert_sh(ours, target="shtools"), normalization="4pi", csphase=1)
    d = random_directions(rng, 30)
    latitude, longitude = np.degrees(np.arcsin(d[:, 2])), np.degrees(np.arctan2(d[:, 1], d[:, 0]))
    np.testing.assert_allclose(grid.expand(lat=latitude, lon=longitude), sp.real_sh(6, d) @ ours, atol=1e-12)
    np.testing.assert_allclose(convert_sh(grid.coeffs, source="shtools"), ours, atol=1e-14)
