import pytest

from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.evaluation.forecast import Forecast, _Line, _rounds, forecast
from slepian_prt.lighting.environment import make_environment
from slepian_prt.relighting.drawing.camera import aim_camera
from slepian_prt.transport.planned import plan_scene
from slepian_prt.transport.settings import TransportSettings
from tests.conftest import bumpy


def test_a_line_goes_on_and_does_not_fall():
    assert _Line((100.0, 300.0), (1.0, 2.0)).at(1300.0) == 7.0
    assert _Line((100.0, 300.0), (2.0, 1.5)).at(1300.0) == 1.5
    assert _Line((50.0, 50.0), (2.0, 2.5)).at(50.0) == 2.5  # a mesh smaller than the pilot


def test_rounds_are_those_of_references():
    """The first is enough; noise falls as n^-0.7; squares of powers of two for pictures; not beyond the most."""
    assert _rounds(0.009, 0.01, 512, stratified=True) == [32]
    assert _rounds(0.02, 0.01, 512, stratified=True) == [32, 128]
    assert _rounds(0.5, 0.01, 512, stratified=True) == [32, 512]
    first, second = _rounds(0.02, 0.01, 2048, stratified=False)
    assert (first, second) == (32, pytest.approx(1.1 * 32 * 2 ** (1 / 0.7)))


@pytest.mark.parametrize(
    ("seconds", "text"),
    [((0.1, 20.0, 40.2), "about 60 s: transport 1 s, references 20 s, methods 40 s"), ((1, 600, 60), "about 11 min")],
)
def test_a_forecast_in_words(seconds, text):
    assert text in str(Forecast(*seconds))


@pytest.mark.slow
def test_a_forecast_is_positive_and_grows_with_what_is_asked():
    with plan_scene(bumpy(3), TransportSettings(4, 64)) as planned:
        seen = aim_camera(planned.scene, None, 64)
        lights = [make_environment([[[1.0] * 3] * 32] * 16)]
        few, many = (
            forecast(planned, seen, lights, methods, (4, 9), CompressionSettings(clusters=8), noise, 64)
            for methods, noise in ((("sh",), 1.0), (("sh", "adapted"), 1e-4))
        )
    assert 0.0 < few.transport < 10.0
    assert many.references > few.references
    assert many.methods > 2.0 * few.methods
