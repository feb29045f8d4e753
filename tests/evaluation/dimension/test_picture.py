"""The scale of a picture of the effective dimension: its range, its numbers, and what has no colour on it."""

import io

import numpy as np
import pytest
from PIL import Image

from slepian_prt.evaluation.dimension.estimate import EffectiveDimension
from slepian_prt.evaluation.dimension.picture import ColourScale, draw_dimension, encode_picture
from slepian_prt.relighting.drawing.pictures import Finish


def result_of(*dimension: float) -> EffectiveDimension:
    count = len(dimension)
    return EffectiveDimension(np.array(dimension), 121, 0.05, 1.0, 0.05, np.ones(count), 20)


class Camera:
    """Sees one vertex in each pixel, or a mean of two."""

    def __init__(self, shares: np.ndarray) -> None:
        self.shares, self.alpha = shares, shares.sum(axis=2)
        self.directions = np.tile([0.0, 0.0, -1.0], (*shares.shape[:2], 1))

    def picture(self, values: np.ndarray) -> "Camera":
        self.radiance = self.shares @ values
        return self


def test_what_no_light_reaches_is_grey_and_takes_no_part_in_interpolation():
    """Two vertices, one dark: the pixel between them has the colour of the one that is nearer, and no other."""
    scale = ColourScale(1.0, 16.0)
    shares = np.array([[[1.0, 0.0], [0.6, 0.4], [0.4, 0.6], [0.0, 1.0]]])
    pixels = draw_dimension(Camera(shares), np.tile([0.0, 0.0, 1.0], (2, 1)), result_of(4.0, 0.0), scale)[0]
    np.testing.assert_allclose(pixels[0, :3], np.array([0x21, 0x91, 0x8C]) / 255.0, atol=0.5 / 255.0)
    np.testing.assert_allclose(pixels[1], pixels[0], rtol=1e-12)
    np.testing.assert_allclose(pixels[2:], np.tile([0.5, 0.5, 0.5, 1.0], (2, 1)), rtol=1e-12)


def test_a_scale_has_a_least_range():
    """Rounding is spread over no colours: half as much again at least."""
    scale = ColourScale.of(result_of(4.0, 4.0 + 1e-9))
    assert (scale.low, scale.high) == (4.0, 6.0)
    spread = scale.colours(np.array([4.0, 4.0 + 1e-9]))
    np.testing.assert_allclose(spread[0], spread[1], rtol=1e-12)
    wide = ColourScale.of(result_of(*np.linspace(2.0, 50.0, 9)))
    assert (wide.low, wide.high) == (2.0, 50.0)


@pytest.mark.parametrize(
    ("low", "high", "ticks"),
    [
        (1.0, 60.0, [1, 2, 3, 5, 7, 10, 15, 20, 30, 50]),
        (2.0, 3.0, [2, 3]),
        (3.2, 4.8, [3.2, 4.8]),
        (7.1, 10.65, [7.1, 10.65]),
        (7.123456, 10.6789, [7.123456, 10.6789]),
    ],
)
def test_a_scale_has_numbers(low, high, ticks):
    """Round ones, or where fewer than two are on it, those of its ends."""
    assert ColourScale(low, high).ticks() == ticks


def test_pictures_have_the_pixels_that_were_drawn():
    """Widths of which n / 100 · 100 is less than n: nothing is cut off, moved or smoothed."""
    rng = np.random.default_rng(2)
    lost = [n for n in range(64, 800) if int(n / 100 * 100) < n]
    assert lost
    for width, height in ((lost[0], 70), (113, 113), (100, 64)):
        pixels = np.ones((height, width, 4))
        pixels[..., :3] = rng.integers(0, 256, size=(height, width, 3)) / 255.0
        result = result_of(3.0, 9.0)
        made = np.asarray(
            Image.open(io.BytesIO(encode_picture(pixels, result, ColourScale.of(result), Finish("white"))))
        )
        assert made.shape[1] == width
        np.testing.assert_allclose(made[:height, :, :3] / 255.0, pixels[..., :3], atol=1.0 / 255.0)
