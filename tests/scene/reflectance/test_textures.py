"""Filtered textures against sums over texels in float64."""

import io
import logging
import math
import tracemalloc
import warnings

import numpy as np
import pytest
from PIL import Image

from slepian_prt.errors import UserError
from slepian_prt.scene.formats.parts import Texture
from slepian_prt.scene.reflectance.textures import FilteredTexture, image_size

ROUNDING = 1e-6  # of values up to 1 in float32, through a pyramid of about ten levels: 10 x 6e-8


def encoded(array: np.ndarray, mode: str | None = None, kind: str = "PNG", **options) -> bytes:
    file = io.BytesIO()
    image = Image.fromarray(array)
    (image if mode is None else image.convert(mode)).save(file, kind, **options)
    return file.getvalue()


def texture(array: np.ndarray, *, is_srgb: bool = False, finest: int = 0, wrap=("repeat", "repeat"), **how):
    return FilteredTexture(Texture("t", encoded(array, **how), wrap), is_srgb=is_srgb, finest=finest)


def looked_up(filtered: FilteredTexture, uv, area: float = 0.0) -> np.ndarray:
    points = np.atleast_2d(np.asarray(uv, dtype=np.float64))
    return filtered.mean(points, np.full(len(points), area))


def noise(rng, height: int, width: int) -> np.ndarray:
    return rng.integers(0, 256, (height, width, 3), dtype=np.uint8)


def linear(codes: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1."""
    c = codes / 255.0
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def mean_over(codes: np.ndarray, left: float, right: float, top: float, bottom: float) -> np.ndarray:
    """Of squares of constant colour, over a box in parts of the image: by how much of each texel it covers."""

    def covered(count: int, low: float, high: float) -> np.ndarray:
        at = np.arange(count)
        return np.clip(np.minimum(at + 1, high * count) - np.maximum(at, low * count), 0.0, None)

    weights = np.outer(covered(codes.shape[0], top, bottom), covered(codes.shape[1], left, right))
    return np.einsum("yx,yxc->c", weights, codes) / weights.sum()


SHAPES = [(64, 64), (1, 1), (1, 7), (5, 1), (37, 23), (3, 3), (100, 9), (2, 1000)]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("is_srgb", [False, True])
@pytest.mark.parametrize("finest", [0, 1, 3, 20])
def test_the_mean_of_all_is_exact(shape, is_srgb, finest, rng):
    """Also of images whose sides are no powers of two, and when only coarse levels are kept."""
    codes = noise(rng, *shape)
    values = linear(codes) if is_srgb else codes / 255.0
    result = looked_up(texture(codes, is_srgb=is_srgb, finest=finest), [0.3, 0.8], 1.0)[0]
    np.testing.assert_allclose(result, values.mean(axis=(0, 1)), atol=ROUNDING)


@pytest.mark.parametrize("finest", [0, 1, 2])
def test_a_level_is_the_mean_over_its_squares(finest, rng):
    """At the middle of one of 8 x 8 squares, over its area, whatever the size of the image."""
    for shape in ((64, 64), (32, 128)):
        codes = noise(rng, *shape)
        filtered = texture(codes, finest=finest)
        rows, columns = (max(1, size // 8) for size in shape)
        for y, x in ((0, 0), (3, 5), (7, 7)):
            texels = codes[y * rows : (y + 1) * rows, x * columns : (x + 1) * columns] / 255.0
            uv = [(x + 0.5) / 8, (y + 0.5) / 8]
            # Levels are halved in both directions: an image of four times the width has squares of 2 x 0.5.
            if shape[0] == shape[1]:
                np.testing.assert_allclose(looked_up(filtered, uv, 1 / 64)[0], texels.mean(axis=(0, 1)), atol=ROUNDING)
    smooth = texture(np.repeat(np.arange(0, 256, 2, dtype=np.uint8)[None, :, None], 3, axis=2).repeat(128, axis=0))
    u = np.array([0.25, 0.5, 0.7])
    np.testing.assert_allclose(
        looked_up(smooth, np.column_stack([u, u]), 1 / 256)[:, 0], (u * 256 - 1) / 255, atol=ROUNDING
    )


def test_levels_of_odd_sizes_stay_in_place(rng):
    """Of 37 columns 19 pieces are made, each of 37/19 columns: none is shifted, none counts twice."""
    codes = noise(rng, 37, 37)
    filtered = texture(codes, finest=1)
    for place in (0, 9, 18):
        uv = [(place + 0.5) / 19, 0.5 / 19]
        expected = mean_over(codes / 255.0, place / 19, (place + 1) / 19, 0.0, 1 / 19)
        np.testing.assert_allclose(looked_up(filtered, uv)[0], expected, atol=ROUNDING)


def test_between_levels_it_is_interpolated():
    """A single white texel in 2 x 2: 1 over a quarter of the image, 1/4 over all of it, in between by the logarithm."""
    codes = np.zeros((2, 2, 3), dtype=np.uint8)
    codes[0, 0] = 255
    filtered = texture(codes)
    values = [looked_up(filtered, [0.25, 0.25], area)[0, 0] for area in (0.1, 0.25, 0.5, 1.0, 100.0)]
    np.testing.assert_allclose(values, [1.0, 1.0, 0.625, 0.25, 0.25], atol=ROUNDING)


def test_a_long_strip_is_filtered_along_it(rng):
    """Where a side has one texel only the other one is halved: a 32nd of a strip is a 32nd of its texels."""
    codes = noise(rng, 1, 1024)
    expected = codes[0, 320:352].mean(axis=0) / 255.0
    np.testing.assert_allclose(looked_up(texture(codes), [10.5 / 32, 0.5], 1 / 32)[0], expected, atol=ROUNDING)


@pytest.mark.parametrize(
    ("mode", "outside"),
    [("repeat", [0.0, 1.0, 2.0, 3.0]), ("clamp", [0.0, 0.0, 0.0, 3.0]), ("mirror", [3.0, 2.0, 1.0, 0.0])],
)
def test_beyond_the_borders(mode, outside):
    """Four texels of 0, 1, 2, 3 in a row; one row is looked up an image further left, and two further right."""
    codes = np.repeat(np.arange(4, dtype=np.uint8)[None, :, None], 3, axis=2)
    u = (np.arange(4) + 0.5) / 4
    for image, wrap, uv in (
        (codes, (mode, "clamp"), lambda u: [u, 0.5 + 0 * u]),
        (codes.transpose(1, 0, 2), ("clamp", mode), lambda u: [0.5 + 0 * u, u]),
    ):
        filtered = texture(image, wrap=wrap)
        inside, left = (looked_up(filtered, np.transpose(uv(u - shift)))[:, 0] * 255 for shift in (0.0, 1.0))
        far = looked_up(filtered, np.transpose(uv(u + 4.0)))[:, 0] * 255
        np.testing.assert_allclose(inside, [0.0, 1.0, 2.0, 3.0], atol=1e-4)
        np.testing.assert_allclose(left, outside if mode != "clamp" else 0.0, atol=1e-4)
        np.testing.assert_allclose(far, 3.0 if mode == "clamp" else [0.0, 1.0, 2.0, 3.0], atol=1e-4)
        # On the border itself the two texels on its sides are mixed.
        border = looked_up(filtered, np.transpose(uv(np.array([0.0]))))[0, 0] * 255
        assert border == pytest.approx({"repeat": 1.5, "clamp": 0.0, "mirror": 0.0}[mode], abs=1e-4)


def test_bilinear_between_texels():
    codes = np.array([[[0] * 3, [100] * 3], [[200] * 3, [40] * 3]], dtype=np.uint8)
    result = looked_up(texture(codes, wrap=("clamp", "clamp")), [0.25 + 0.5 * 0.3, 0.25 + 0.5 * 0.6])[0, 0] * 255
    top, bottom = 0.7 * 0 + 0.3 * 100, 0.7 * 200 + 0.3 * 40
    assert result == pytest.approx(0.4 * top + 0.6 * bottom, abs=1e-4)


def test_srgb_of_every_code():
    codes = np.repeat(np.arange(256, dtype=np.uint8)[None, :, None], 3, axis=2)
    u = (np.arange(256) + 0.5) / 256
    uv = np.column_stack([u, np.full(256, 0.5)])
    np.testing.assert_allclose(looked_up(texture(codes, is_srgb=True), uv)[:, 0], linear(np.arange(256)), atol=ROUNDING)


GRAY = np.array([[0, 64, 128, 255]], dtype=np.uint8)


@pytest.mark.parametrize(
    ("content", "tolerance"),
    [
        (encoded(GRAY), 0.0),
        (encoded(GRAY, "LA"), 0.0),
        (encoded(GRAY, "RGBA"), 0.0),
        (encoded(GRAY, "P"), 0.0),
        (encoded(np.array([[0, 64 * 257, 128 * 257, 65535]], dtype=np.uint16)), 0.0),
        (encoded(np.repeat(GRAY, 16, axis=1).repeat(16, axis=0), kind="JPEG", quality=100), 3 / 255),
        (encoded(np.repeat(GRAY, 16, axis=1).repeat(16, axis=0), "CMYK", kind="JPEG", quality=100), 3 / 255),
        (encoded(GRAY, kind="BMP"), 0.0),
        (encoded(GRAY, kind="TGA"), 0.0),
        (encoded(np.array(GRAY / 255.0, dtype=np.float32), kind="TIFF"), 0.0),
        (encoded(GRAY, "RGB", kind="WEBP", lossless=True), 0.0),
        (b"P5 4 1 65535\n" + np.array([0, 64 * 257, 128 * 257, 65535], dtype=">u2").tobytes(), 0.0),
    ],
    ids=["gray", "alpha", "rgba", "palette", "16 bits", "jpeg", "cmyk", "bmp", "tga", "float", "webp", "pgm"],
)
def test_kinds_of_images(content, tolerance):
    filtered = FilteredTexture(Texture("t", content), is_srgb=False)
    uv = np.column_stack([(np.arange(4) + 0.5) / 4, np.full(4, 0.5)])
    np.testing.assert_allclose(looked_up(filtered, uv), np.repeat(GRAY.T / 255.0, 3, axis=1), atol=tolerance + ROUNDING)


def test_a_dark_image_of_16_bits_stays_dark():
    """White is 65,535, even if no code is above 255."""
    dark = encoded(np.full((2, 2), 200, dtype=np.uint16))
    value = looked_up(FilteredTexture(Texture("t", dark), is_srgb=False), [0.5, 0.5])[0, 0]
    assert value == pytest.approx(200 / 65535, abs=0.5 / 255)  # kept in 8 bits


def test_a_palette_with_transparent_entries_is_read_without_a_warning():
    image = Image.fromarray(GRAY).convert("P")
    file = io.BytesIO()
    image.save(file, "PNG", transparency=bytes([0, 128, 255, 255]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        filtered = FilteredTexture(Texture("t", file.getvalue()), is_srgb=False)
    assert looked_up(filtered, [7 / 8, 0.5])[0, 0] == pytest.approx(1.0)


def test_what_is_no_image_is_one_line(tmp_path):
    whole = encoded(np.zeros((64, 64, 3), dtype=np.uint8) + np.arange(64, dtype=np.uint8)[:, None, None])
    (tmp_path / "folder.png").mkdir()
    for source, message in [
        (tmp_path / "none.png", "texture wood.png: there is no file"),
        (tmp_path / "folder.png", "there is no file"),
        (b"", "is no image of a kind that is known"),
        (b"hello", "is no image of a kind that is known"),
        (whole[:60], "cannot be read as an image|is no image"),
        (whole[:-40], "cannot be read as an image"),
    ]:
        with pytest.raises(UserError, match=message) as caught:
            FilteredTexture(Texture("wood.png", source), is_srgb=True)
        assert "\n" not in str(caught.value)
        assert "object at 0x" not in str(caught.value)
    with pytest.raises(UserError, match="there is no file"):
        image_size(Texture("wood.png", tmp_path / "none.png"))


def test_a_very_large_image_is_refused_in_one_line(monkeypatch, caplog):
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 100)
    large = Texture("wood.png", encoded(np.zeros((30, 30), dtype=np.uint8)))
    with caplog.at_level(logging.INFO), pytest.raises(UserError, match="has more than 200 texels"):
        FilteredTexture(large, is_srgb=True)
    between = Texture("wood.png", encoded(np.zeros((12, 12), dtype=np.uint8)))  # Pillow warns of it
    assert image_size(between) == (12, 12)
    FilteredTexture(between, is_srgb=True)


def test_a_coarse_level_of_a_large_image_takes_little_memory():
    """In float32 all texels would take 50 MB; the image itself is 12 MB, and Pillow's own copy is not counted."""
    size = 2048
    content = encoded(np.full((size, size, 3), 128, dtype=np.uint8))
    tracemalloc.start()
    filtered = FilteredTexture(Texture("t", content), is_srgb=False, finest=6)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 3 * size * size * 3 + 2 * 4 * (1 << 22)
    np.testing.assert_allclose(looked_up(filtered, [0.5, 0.5]), 128 / 255, atol=ROUNDING)


def test_a_patch_against_many_samples(rng):
    """Random patches of a smooth image: the filtered mean is that of the patch, to second order in its size."""
    at = (np.arange(256) + 0.5) / 256
    wave = 0.5 + 0.25 * np.sin(2 * math.pi * at)[None, :] + 0.25 * np.cos(2 * math.pi * at)[:, None]
    codes = np.repeat(np.round(255 * wave)[:, :, None], 3, axis=2).astype(np.uint8)
    filtered = texture(codes)
    size = 1 / 16
    for u, v in rng.uniform(size, 1.0 - size, (16, 2)):
        expected = mean_over(codes / 255.0, u - size / 2, u + size / 2, v - size / 2, v + size / 2)
        # Of the mean over a box of width h a bilinear lookup among such means differs by less than h²/8 of the second
        # derivatives, 2 x 0.25 (2π)².
        tolerance = size**2 / 8 * 2 * 0.25 * (2 * math.pi) ** 2
        np.testing.assert_allclose(looked_up(filtered, [u, v], size**2)[0], expected, atol=tolerance + ROUNDING)
