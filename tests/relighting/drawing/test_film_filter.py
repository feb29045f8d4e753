"""The reconstruction filter of a film, against its own integrals."""

import numpy as np
import pytest

from slepian_prt.relighting.drawing.film_filter import FilmFilter
from slepian_prt.renderer.variants import mitsuba

FILTERS = ("box", "tent", "gaussian", "mitchell", "catmullrom", "lanczos")


@pytest.fixture(scope="module", params=FILTERS)
def film_filter(request):
    with mitsuba() as mi:
        film = mi.load_dict({"type": "hdrfilm", "filter": {"type": request.param}})
        return request.param, FilmFilter.of_film(mi, film)


def moment(found: FilmFilter, power: int) -> float:
    return float(np.sum(found.values * found.places**power) / np.sum(found.values))


def test_middle_and_corners_have_the_filters_moments(film_filter):
    _, found = film_filter
    weight = found.middle_weight
    if weight is None:
        assert moment(found, 2) < 0.0125 or moment(found, 2) > 0.2625  # as far as five places can be from the middle
        return
    corner = 0.25 * (1.0 - weight)
    x, y = np.array([0.0, -0.5, 0.5, -0.5, 0.5]), np.array([0.0, -0.5, -0.5, 0.5, 0.5])
    weights = np.array([weight, *[corner] * 4])
    assert weights.sum() == pytest.approx(1.0)
    for i in range(4):
        for j in range(4 - i):
            expected = moment(found, i) * moment(found, j)
            assert weights @ (x**i * y**j) == pytest.approx(expected, abs=1e-12)


def test_samples_are_spread_as_the_filter_is(film_filter):
    _, found = film_filter
    places, signs = found.sample((np.arange(100_000) + 0.5) / 100_000)
    magnitude = np.sum(np.abs(found.values)) / np.sum(found.values)
    for power in range(5):
        # The table has steps of 1/4096 of the radius, and places are rounded to float32.
        expected = moment(found, power)
        assert magnitude * np.mean(signs * places.astype(np.float64) ** power) == pytest.approx(expected, abs=2e-3)
    assert np.abs(places).max() <= found.places.max() * 1.001


def test_little_lies_beyond_the_reach(film_filter):
    name, found = film_filter
    magnitude = np.abs(found.values)
    beyond = np.abs(found.places) > found.reach + 0.5
    assert np.sum(magnitude[beyond]) <= 0.006 * np.sum(magnitude)
    assert found.reach == {"box": 0, "tent": 1, "gaussian": 1}.get(name, found.reach)
