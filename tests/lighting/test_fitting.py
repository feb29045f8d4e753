"""Lighting of another bandlimit."""

import numpy as np
import pytest

import slepian_prt as sp
from slepian_prt.errors import UserError
from slepian_prt.lighting.fitting import each_remark_once, fit_lighting, is_lighting, one_light
from slepian_prt.relighting.series import Lights, relight_series
from tests.conftest import sphere
from tests.numerics import assert_exact


def test_higher_degrees_are_cut(rng, caplog):
    light = rng.normal(size=(2, 3, 36))
    assert_exact(fit_lighting(light, 2), light[..., :9], "a copy")
    assert caplog.messages == ["lighting of bandlimit 5 is cut to 2, that of the transfer"]


def test_degrees_that_are_not_there_are_dark(rng, caplog):
    light = rng.normal(size=(3, 9)).astype(np.float32)
    fitted = fit_lighting(light, 4)
    assert fitted.dtype == np.float32
    assert_exact(fitted, np.concatenate([light, np.zeros((3, 16))], axis=1), "a copy")
    assert caplog.messages == [
        "lighting of bandlimit 2 counts as dark in degrees 3 to 4 of the transfer; project its map at bandlimit 4 for "
        "all of its light"
    ]


def test_lighting_that_fits_is_left_alone(rng, caplog):
    light = rng.normal(size=(3, 9))
    assert fit_lighting(light, 2) is light
    assert caplog.messages == []


def test_the_lights_of_one_call_say_it_once(rng, caplog):
    """And the next call says it again: of another model, or in the next cell of a notebook."""
    for calls in (1, 2):
        with each_remark_once():
            for _ in range(5):
                fit_lighting(rng.normal(size=(3, 9)), 1)
        assert len(caplog.messages) == calls
    with each_remark_once():
        fit_lighting(rng.normal(size=(3, 9)), 1)
        with each_remark_once():
            fit_lighting(rng.normal(size=(3, 9)), 1)
        fit_lighting(rng.normal(size=(3, 9)), 1)
        fit_lighting(rng.normal(size=(3, 9)), 3)
    assert len(caplog.messages) == 4


def test_every_call_says_it(rng, caplog):
    """Two models in one session."""
    transfer = sp.precompute(sphere(1), bandlimit=1, samples=4)
    light = rng.normal(size=(3, 9))
    for model in (transfer, sp.compress(transfer, "none")):
        caplog.clear()
        sp.relight(model, light)
        assert caplog.messages == ["lighting of bandlimit 2 is cut to 1, that of the transfer"]
    caplog.clear()
    sp.relight(transfer, np.stack([light, light]))
    assert len(caplog.messages) == 1


def test_a_series_says_it_once(tmp_path, caplog):
    for name in "abc":
        (tmp_path / f"{name}.txt").write_text("1 1 1\n")
    packed = sp.compress(sp.precompute(sphere(1), bandlimit=1, samples=4), "none")
    for lights in (
        Lights(tuple(str(tmp_path / f"{name}.txt") for name in "abc")),
        Lights((str(tmp_path / "a.txt"),), turntable=12),
    ):
        caplog.clear()
        relight_series(packed, lights, "a.prt")
        assert [message.split(";")[0] for message in caplog.messages] == [
            "lighting of bandlimit 0 counts as dark in degree 1 of the transfer"
        ]


def test_what_it_is_fitted_to_is_named(tmp_path, rng, caplog):
    """There may be no transfer."""
    (tmp_path / "light.txt").write_text("1 1 1\n" * 4)
    sp.project_environment(tmp_path / "light.txt", 2)
    sp.project_environment(tmp_path / "light.txt", 0)
    sp.measured_prior([rng.normal(size=(3, 9))] * 2, 1, "skies")
    assert caplog.messages == [
        "lighting of bandlimit 1 counts as dark in degree 2 of the projection; project its map at bandlimit 2 for all "
        "of its light",
        "lighting of bandlimit 1 is cut to 0, that of the projection",
        "lighting of bandlimit 2 is cut to 1, that of the prior",
    ]


@pytest.mark.parametrize("shape", [(3, 1), (3, 9), (1, 3, 4), (7, 3, 121)])
def test_shapes_of_lighting(shape):
    assert is_lighting(shape)


@pytest.mark.parametrize("shape", [(), (9,), (9, 3), (3, 8), (3, 0), (0, 3, 9), (2, 9), (1, 1, 3, 9), (16, 32, 3)])
def test_shapes_of_other_things(shape):
    assert not is_lighting(shape)
    with pytest.raises(UserError, match=r"lighting must have shape \(3, n²\)"):
        one_light(np.zeros(shape), 2)


def test_one_light_is_finite():
    with pytest.raises(UserError, match="lighting must be finite"):
        one_light(np.full((3, 9), np.nan), 2)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.full((3, 4), 1.0 + 1.0j), "^lighting must be real numbers, not an array of complex128$"),
        (np.full((3, 4), 1e300), r"^lighting must be within 1e\+30, which is more than pictures hold; scale it down$"),
        (np.full((3, 4), -1e31, dtype=np.float32), r"^lighting must be within 1e\+30"),
        (np.full((3, 4), -np.inf), "^lighting must be finite"),
    ],
)
def test_numbers_that_are_no_light(values, message):
    """Without a warning of NumPy on the way, which tests take for errors."""
    transfer = sp.precompute(sphere(1), bandlimit=1, samples=4)
    packed = sp.compress(transfer, "none")
    for call in (
        lambda: one_light(values, 1),
        lambda: sp.relight(transfer, values),
        lambda: sp.relight(packed, np.stack([values, values])),
        lambda: sp.gpu_transfer(packed, 8).light(values),
        lambda: sp.gpu_transfer(packed, 8).error(values),
    ):
        with pytest.raises(UserError, match=message):
            call()


def test_the_greatest_light_stays_within_floats():
    transfer = sp.precompute(sphere(1), bandlimit=1, samples=4)
    for model in (transfer, sp.compress(transfer, "none")):
        assert np.isfinite(sp.relight(model, np.full((3, 4), 1e30))).all()
