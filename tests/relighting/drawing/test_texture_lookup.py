"""Reflectance at points of textured faces, against a lookup written out here."""

import io

import numpy as np
import pytest
from PIL import Image

from slepian_prt.relighting.drawing.texture_lookup import TextureLookup
from slepian_prt.renderer.variants import mitsuba
from slepian_prt.scene.formats.parts import Texture
from slepian_prt.scene.reflectance.surface_detail import SurfaceDetail


def image(rng, height, width) -> tuple[np.ndarray, bytes]:
    texels = rng.integers(0, 256, (height, width, 3)).astype(np.uint8)
    stream = io.BytesIO()
    Image.fromarray(texels).save(stream, "PNG")
    return texels / 255.0, stream.getvalue()


def linear(values: np.ndarray) -> np.ndarray:
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def texel(values: np.ndarray, wrap: tuple[str, str], column: int, row: int) -> np.ndarray:
    index = []
    for at, size, way in ((row, values.shape[0], wrap[1]), (column, values.shape[1], wrap[0])):
        if way == "repeat":
            index.append(at % size)
        elif way == "clamp":
            index.append(min(max(at, 0), size - 1))
        else:
            index.append([*range(size), *range(size - 1, -1, -1)][at % (2 * size)])
    return values[index[0], index[1]]


def bilinear(values: np.ndarray, wrap: tuple[str, str], u: float, v: float) -> np.ndarray:
    x, y = u * values.shape[1] - 0.5, v * values.shape[0] - 0.5
    left, top = int(np.floor(x)), int(np.floor(y))
    a, b = x - left, y - top
    return (
        (1 - a) * (1 - b) * texel(values, wrap, left, top)
        + a * (1 - b) * texel(values, wrap, left + 1, top)
        + (1 - a) * b * texel(values, wrap, left, top + 1)
        + a * b * texel(values, wrap, left + 1, top + 1)
    )


@pytest.mark.parametrize("wrap", [("repeat", "repeat"), ("clamp", "mirror"), ("mirror", "repeat")])
def test_reflectance_is_colour_times_texture_times_what_is_no_metal(wrap, rng):
    colour, colour_file = image(rng, 5, 7)
    metal, metal_file = image(rng, 3, 4)
    faces = 6
    choice = np.array([0, 0, 0, -1, 0, -1], dtype=np.int32)
    metallic_choice = np.array([1, -1, 1, -1, 1, 1], dtype=np.int32)
    detail = SurfaceDetail(
        (Texture("colour", colour_file, wrap), Texture("metal", metal_file, wrap)),
        choice,
        rng.uniform(-2.0, 3.0, (faces, 3, 2)).astype(np.float32),
        rng.random((faces, 3, 3)).astype(np.float32),
        rng.random(faces).astype(np.float32),
        metallic_choice,
        rng.uniform(-2.0, 3.0, (faces, 3, 2)).astype(np.float32),
    )
    face = rng.integers(0, faces, 300)
    weights = rng.dirichlet(np.ones(3), 300)
    with mitsuba() as mi:
        lookup = TextureLookup(mi, detail)
        u, v = (mi.Float(weights[:, k].astype(np.float32)) for k in (1, 2))
        found = np.array(lookup.reflectance(mi.UInt32(face), u, v, mi.Bool(True))).T
    expected = []
    for f, w in zip(face, weights, strict=True):
        value = w @ detail.colors[f]
        if choice[f] >= 0:
            value = value * bilinear(linear(colour), wrap, *(w @ detail.uv[f]))
        share = detail.metallic[f]
        if metallic_choice[f] >= 0:
            share = share * bilinear(metal, wrap, *(w @ detail.metallic_uv[f]))[2]
        expected.append(value * (1.0 - share))
    # Coordinates up to 3 x 7 texels in float32, between texels that differ by up to one.
    np.testing.assert_allclose(found, expected, atol=40 * np.finfo(np.float32).eps * 21)


def test_a_model_without_textures_has_the_colours_of_its_corners(rng):
    colors = rng.random((2, 3, 3)).astype(np.float32)
    none, nowhere = np.full(2, -1, dtype=np.int32), np.zeros((2, 3, 2), dtype=np.float32)
    detail = SurfaceDetail((), none, nowhere, colors, np.zeros(2, np.float32), none, nowhere)
    with mitsuba() as mi:
        lookup = TextureLookup(mi, detail)
        found = np.array(
            lookup.reflectance(mi.UInt32([0, 1]), mi.Float([0.0, 1.0]), mi.Float([0.0, 0.0]), mi.Bool(True))
        )
    np.testing.assert_allclose(found.T, [colors[0, 0], colors[1, 1]], atol=1e-7)


def test_textures_too_large_to_keep_are_halved(monkeypatch):
    from slepian_prt.relighting.drawing import texture_lookup

    stream = io.BytesIO()
    Image.fromarray(np.full((16, 16, 3), 128, np.uint8)).save(stream, "PNG")
    zero, nowhere = np.zeros(1, np.int32), np.full((1, 3, 2), 0.5, np.float32)
    detail = SurfaceDetail(
        (Texture("gray", stream.getvalue()),), zero, nowhere, np.ones((1, 3, 3), np.float32), np.zeros(1, np.float32),
        np.full(1, -1, np.int32), nowhere,
    )  # fmt: skip
    monkeypatch.setattr(texture_lookup, "_MOST_TEXELS", 20)
    with mitsuba() as mi:
        lookup = TextureLookup(mi, detail)
        found = np.array(lookup.reflectance(mi.UInt32([0]), mi.Float([0.2]), mi.Float([0.2]), mi.Bool(True))).ravel()
        assert len(lookup._texels) == 3 * 16
    np.testing.assert_allclose(found, linear(np.array([128 / 255.0] * 3)), rtol=1e-6)


@pytest.mark.parametrize("wrap", ["repeat", "clamp", "mirror"])
@pytest.mark.parametrize("away", [2.0**22 + 0.5, -(2.0**22) - 1.5, 2.0**24, -(2.0**24)])
def test_coordinates_far_away_are_continued_exactly(wrap, away, rng):
    """As far as float32 tells where in an image they are; indices of texels there would not fit 32 bits."""
    colour, colour_file = image(rng, 5, 1500)
    none = np.full(1, -1, dtype=np.int32)
    uv = np.full((1, 3, 2), away, dtype=np.float32)
    white, zero = np.ones((1, 3, 3), dtype=np.float32), np.zeros(1, dtype=np.float32)
    texture = Texture("colour", colour_file, (wrap, wrap))
    detail = SurfaceDetail((texture,), np.zeros(1, dtype=np.int32), uv, white, zero, none, np.zeros_like(uv))
    with mitsuba() as mi:
        lookup = TextureLookup(mi, detail)
        found = np.array(lookup.reflectance(mi.UInt32(0), mi.Float(0.0), mi.Float(0.0), mi.Bool(True))).ravel()
    expected = bilinear(linear(colour), (wrap, wrap), away, away)
    np.testing.assert_allclose(found, expected, rtol=1e-5)
