import math

import numpy as np
import pytest

from scripts.paper.lobe_symmetry import best_symmetry, falls_below, lobe_toward, symmetric_part


def phong(axis, exponent=40.0):
    center = np.array([math.sin(axis), 0.0, math.cos(axis)])
    return lambda directions: np.maximum(directions @ center, 0.0) ** exponent


def test_a_symmetric_lobe_is_all_symmetric():
    assert symmetric_part(phong(0.7), 0.7).part == pytest.approx(1.0, abs=1e-12)
    found = best_symmetry(phong(0.7), 0.5)
    assert found.part == pytest.approx(1.0, abs=1e-4)
    assert found.axis == pytest.approx(0.7, abs=2e-3)


def test_linear_functions_in_closed_form():
    """Of 1 + x, the mean over circles about z is 1: 4π of 4π + 4π/3; about x nothing is lost; x alone has none."""
    assert symmetric_part(lambda d: 1.0 + d[:, 0], 0.0).part == pytest.approx(0.75, abs=1e-12)
    assert symmetric_part(lambda d: 1.0 + d[:, 0], math.pi / 2).part == pytest.approx(1.0, abs=1e-12)
    assert symmetric_part(lambda d: d[:, 0], 0.0).part == pytest.approx(0.0, abs=1e-12)


def test_a_stretched_lobe_is_not():
    """exp(-a x² - b y²) near z: means of exp(-2 r² s) with s between a and b; in the plane 2√(ab) Σ … in closed form.

    With the lobe so narrow that the sphere is a plane, ‖g‖² = π/(2√(ab)), and g's mean over circles is
    exp(-r²(a+b)/2) I₀(r²(a-b)/2), whose squared norm is by series.
    """
    from scipy.integrate import quad
    from scipy.special import i0e

    a, b = 4000.0, 1000.0
    energy, _ = quad(
        lambda r: 2 * math.pi * r * (math.exp(-r * r * b) * i0e(0.5 * r * r * (a - b))) ** 2, 0.0, 0.4, limit=200
    )
    expected = energy / (math.pi / (2.0 * math.sqrt(a * b)))
    lobe = symmetric_part(lambda d: np.exp(-a * d[:, 0] ** 2 - b * d[:, 1] ** 2) * (d[:, 2] > 0), 0.0)
    assert lobe.part == pytest.approx(expected, rel=1e-3)  # of the curvature of the sphere
    assert 0.5 < lobe.part < 0.95


def test_where_a_curve_falls_below():
    angles = np.array([0.0, 10.0, 20.0])
    assert falls_below(angles, np.array([1.0, 0.96, 0.94]), 0.95) == pytest.approx(15.0)
    assert falls_below(angles, np.array([1.0, 0.99, 0.96]), 0.95) is None
    assert falls_below(angles, np.array([0.9, 0.8, 0.7]), 0.95) == 0.0


def test_lobes_of_mitsuba_are_symmetric_toward_the_normal():
    from slepian_prt.renderer.variants import mitsuba

    with mitsuba() as mi:
        bsdf = mi.load_dict({"type": "roughconductor", "material": "none", "alpha": 0.3, "distribution": "ggx"})
        parts = [symmetric_part(lobe_toward(mi, bsdf, angle), angle).part for angle in (0.0, 0.5, 1.2)]
        wrong = symmetric_part(lobe_toward(mi, bsdf, 0.5), -0.5).part
    assert parts[0] == pytest.approx(1.0, abs=1e-5)  # float32
    assert parts[0] > parts[1] > 0.97 > parts[2]
    assert wrong < 0.5  # the lobe lies on the other side of the normal
