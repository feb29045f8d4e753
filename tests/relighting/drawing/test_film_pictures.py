"""Pictures of captured films: pixels are pixels, before a map or a colour, and nothing but light changes."""

from dataclasses import replace

import numpy as np
import pytest

from slepian_prt.compression.stream import compress
from slepian_prt.errors import UserError
from slepian_prt.lighting.environment import make_environment
from slepian_prt.relighting.drawing.backdrop import look_up
from slepian_prt.relighting.drawing.render import render_picture
from slepian_prt.relighting.mitsuba.bound_transfer import BoundTransfer
from slepian_prt.relighting.mitsuba.held_files import HeldFile
from slepian_prt.relighting.relight import relight
from slepian_prt.scene.film import Film, film_mesh
from slepian_prt.transport.transfer import Transfer
from tests.numerics import assert_rounded

WIDTH, HEIGHT = 20, 16


@pytest.fixture
def half_seen(rng) -> Transfer:
    """A picture whose left half shows the scene, and whose right half what is behind, a fifth of it red glass."""
    count = WIDTH * HEIGHT
    right = np.arange(count) % WIDTH >= WIDTH // 2
    vectors = rng.random((count, 3, 9)).astype(np.float32)
    vectors[right] = 0.0
    background = np.zeros((count, 3), np.float32)
    background[right] = 1.0
    background[right & (np.arange(count) < count // 5)] = [0.6, 0.3, 0.0]
    x, y = np.meshgrid([0.3, -0.3], [0.2, -0.2])
    corners = np.stack([x, y, -np.ones_like(x)], axis=-1)[None].astype(np.float32)
    axes = np.where(right[:, None], 0.0, [0.0, 0.0, 1.0])
    film = Film(
        "eye", WIDTH, HEIGHT, (0, 0), (WIDTH, HEIGHT), background, corners, np.zeros(count, np.float32), np.zeros(3)
    )
    mesh = film_mesh("eye", WIDTH, HEIGHT, axes)
    return Transfer(vectors, axes, mesh, (), 2, 4, 0, (), 0, 0, toward_view=True, film=film)


@pytest.fixture
def sky():
    """A map that changes slowly."""
    v, u = np.meshgrid(np.linspace(0.0, 3.0, 64), np.linspace(0.0, 6.0, 128), indexing="ij")
    return make_environment(
        np.stack([1.5 + np.sin(u), 1.5 + np.cos(v), 1.5 + np.sin(u + v)], axis=-1).astype(np.float32)
    )


def test_pixels_are_relit_radiance_before_the_map(half_seen, sky):
    radiance = half_seen.film.picture(relight(half_seen, sky))
    shown = render_picture(half_seen, sky, background="map", scene_linear=True)
    assert shown.shape == (HEIGHT, WIDTH, 4)
    assert_rounded(shown[:, : WIDTH // 2, :3], radiance[:, : WIDTH // 2], 4)
    looked = look_up(sky, half_seen.film.looks()[0])
    difference = np.abs(shown[..., :3] - looked * half_seen.film.picture(half_seen.film.background))[:, WIDTH // 2 :]
    assert difference.max() < 2e-3 * looked.max()  # the mean over a pixel of a map that changes slowly
    alpha = render_picture(half_seen, sky, scene_linear=True)[..., 3]
    np.testing.assert_allclose(alpha[0, WIDTH // 2 :], 0.7, atol=1e-6)
    np.testing.assert_allclose(alpha[-1, [0, -1]], [1.0, 0.0], atol=1e-6)


def test_an_aperture_blurs_the_map(half_seen, sky):
    """The mean over the points of the aperture."""
    corners = half_seen.film.directions
    film = replace(
        half_seen.film, directions=np.concatenate([corners + [0.2, 0, 0], corners - [0.2, 0, 0]]).astype(np.float32)
    )
    blurred = render_picture(replace(half_seen, film=film), sky, background="map", scene_linear=True)
    apart = [
        render_picture(
            replace(half_seen, film=replace(film, directions=film.directions[k : k + 1])),
            sky,
            background="map",
            scene_linear=True,
        )
        for k in (0, 1)
    ]
    assert_rounded(blurred, np.mean(apart, axis=0).astype(np.float32), 8)


def test_compressed_or_not(half_seen, sky):
    packed = compress(half_seen, "none", coding="float32")
    assert_rounded(
        render_picture(packed, sky, scene_linear=True), render_picture(half_seen, sky, scene_linear=True), 64
    )


@pytest.mark.parametrize(
    "asked", [{"width": 64}, {"look_at": ((0, 0, 1), (0, 0, 0))}, {"fov": 30.0}, {"spp": 4}, {"scene": "box.xml"}]
)
def test_only_light_can_change(asked, half_seen, sky):
    with pytest.raises(UserError, match=f"camera 'eye', 20 x 16 pixels, .*leave out `{next(iter(asked))}`"):
        render_picture(half_seen, sky, **asked)


def test_the_integrator_refuses_films(half_seen):
    packed = compress(half_seen, "none", coding="float32")
    with pytest.raises(UserError, match=r"^eye.prt: holds the pixels of a camera"):
        BoundTransfer(None, HeldFile("eye.prt", packed, None, None), lambda _: np.ones(3))
