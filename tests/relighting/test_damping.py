import numpy as np
import pytest

from slepian_prt.compression.stream import compress
from slepian_prt.errors import UserError
from slepian_prt.lighting.projection import project_environment
from slepian_prt.lighting.windowing import WINDOWS, window, windowed
from slepian_prt.relighting.damping import damp
from slepian_prt.relighting.relight import negative_fraction, relight
from slepian_prt.transport.transfer import precompute
from tests.conftest import bumpy, sphere
from tests.numerics import assert_exact


@pytest.fixture(scope="module")
def sun():
    texels = np.full((256, 512, 3), 0.001)
    texels[60:64, 100:104] = 500.0
    return project_environment(texels, 3)


@pytest.fixture(scope="module")
def transfer():
    return precompute(bumpy(4), bandlimit=3, samples=512)


@pytest.mark.parametrize("name", WINDOWS)
def test_windows_are_one_at_first_and_fall(name):
    factors = window(name, 10, 7.5)
    assert factors[0] == 1.0
    assert np.all(np.diff(factors[:8]) < 0.0)
    assert not factors[8:].any()
    np.testing.assert_allclose(window(name, 10, 1e9), 1.0, atol=1e-12)


def test_closed_forms():
    np.testing.assert_allclose(window("hann", 4, 8.0)[4], 0.5)
    np.testing.assert_allclose(window("lanczos", 4, 8.0)[4], 2.0 / np.pi)


@pytest.mark.parametrize("name", WINDOWS)
def test_as_wide_as_leaves_hardly_anything_negative(name, transfer, sun):
    packed = compress(transfer, tolerance=0.01, clusters=12)
    done = damp(packed, sun, name)
    assert done.negative_before > 0.01
    assert done.negative_after <= 1e-3
    np.testing.assert_allclose(done.lighting, windowed(sun, name, done.width))
    plain, damped = relight(packed, sun), relight(packed, done.lighting)
    assert negative_fraction(damped) == done.negative_after
    assert done.change == pytest.approx(np.linalg.norm(damped - plain) / np.linalg.norm(plain))
    # A little wider is too wide.
    assert negative_fraction(relight(packed, windowed(sun, name, 1.03 * done.width))) > 1e-3


def test_light_without_ringing_is_left_alone():
    light = project_environment(np.ones((64, 128, 3)), 4)
    done = damp(precompute(sphere(2), bandlimit=4, samples=16), light, "hann")
    assert_exact(done.lighting, light, because="a copy")
    assert done.change == 0.0


def test_a_given_width_is_used(transfer, sun):
    done = damp(transfer, sun, "hann", 2.0)
    assert done.width == 2.0
    assert not done.lighting[:, 4:].any()
    assert_exact(done.lighting[:, 0], sun[:, 0], because="the factor of degree 0 is one")


@pytest.mark.parametrize("width", [0.0, -1.0, np.nan, np.inf])
def test_wrong_windows(width):
    with pytest.raises(UserError, match="width of the window"):
        window("hann", 4, width)
    with pytest.raises(UserError, match="window must be one of hann, lanczos, not 'box'"):
        window("box", 4, 3.0)


def test_no_light_at_all(transfer):
    done = damp(transfer, np.zeros((3, 16)), "hann", 3.0)
    assert (done.change, done.negative_before, done.negative_after) == (0.0, 0.0, 0.0)
