import numpy as np
import pytest

from slepian_prt.runtime.rounding import round_functions, to_bytes
from tests.numerics import assert_exact


@pytest.mark.parametrize("bits", [2, 5, 8])
def test_coefficients_are_off_by_half_a_step(rng, bits):
    values = (rng.normal(size=(500, 6)) * 10.0 ** np.arange(-3, 3)).astype(np.float32)
    told, zeros, scales = to_bytes(values, bits)
    read = (told / 255.0 - zeros) * scales
    # Half a level, and half a byte where levels lie between bytes.
    step = (0.5 / ((1 << bits) - 1) + (0.5 / 255 if bits < 8 else 0.0)) * np.ptp(values, axis=0)
    assert np.all(np.abs(read - values) <= step * (1.0 + 1e-4))
    assert np.all(np.abs(read - values).max(axis=0) > 0.5 / ((1 << bits) - 1) * 0.9 * np.ptp(values, axis=0))


def test_a_component_without_range():
    told, zeros, scales = to_bytes(np.full((4, 1), 0.25, dtype=np.float32), 8)
    np.testing.assert_allclose((told / 255.0 - zeros) * scales, 0.25)


def test_functions_are_multiples_that_float16_holds(rng):
    functions = rng.normal(size=(5, 40)) * 0.1
    step = 3e-4
    rounded = round_functions(functions, step)
    assert np.abs(rounded - functions).max() <= 0.5 * step
    assert_exact(rounded.astype(np.float16).astype(float), rounded, "rounded to float16")
    unit = 2.0**-12  # the largest power of two that is not above the step
    assert_exact(np.rint(rounded / unit) * unit, rounded, "multiples of a power of two")


def test_no_step_is_finer_than_float16():
    assert np.all(np.isfinite(round_functions(np.array([1e-6, 1.0]), 1e-30)))
