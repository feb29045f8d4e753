"""Pixels as receivers: where they lie, who is beside them, where they look."""

import numpy as np
import pytest

from slepian_prt.scene.film import Film, film_mesh, pack_axes, stored_axes, unpack_axes
from tests.conftest import random_directions
from tests.numerics import assert_exact, assert_rounded

# Half a step in both coordinates moves a point of the octahedron by (1, 1, 2) half steps, no nearer to 0 than 1/√3.
ONE_STEP = np.degrees(np.sqrt(6.0) * np.sqrt(3.0) * 0.5 / 127.0)


def film_of(width=6, height=4, directions=None, background=None):
    count = width * height
    return Film(
        name="eye",
        width=width,
        height=height,
        crop=(0, 0),
        size=(width, height),
        background=np.zeros((count, 3), np.float32) if background is None else background,
        directions=np.ones((1, 2, 2, 3), np.float32) if directions is None else directions,
        noise=np.zeros(count, np.float32),
        noise_power=np.zeros(3),
    )


def test_neighbours_of_pixels():
    mesh = film_mesh("eye", 4, 3, np.zeros((12, 3)))
    pairs = {tuple(pair) for pair in mesh.receivers.neighbours.tolist()}
    wanted = set()
    for row in range(3):
        for column in range(4):
            pixel = 4 * row + column
            wanted |= {(pixel, pixel + 1)} if column < 3 else set()
            wanted |= {(pixel, pixel + 4)} if row < 2 else set()
            wanted |= {(pixel, pixel + 3)} if row < 2 and column > 0 else set()  # the diagonal
    assert pairs == wanted
    assert_exact(mesh.positions[7], [3.0, 1.0, 0.0], "whole numbers")


@pytest.mark.parametrize(("width", "height"), [(1, 1), (5, 1), (1, 5)])
def test_films_of_a_single_row_have_no_faces(width, height):
    mesh = film_mesh("eye", width, height, np.zeros((width * height, 3)))
    assert mesh.faces.shape == (0, 3)
    assert mesh.receivers.neighbours.shape == (0, 2)


def test_axes_of_16_bits(rng):
    axes = np.concatenate([random_directions(rng, 5000), np.eye(3), -np.eye(3), np.zeros((1, 3))])
    packed = pack_axes(axes)
    assert packed.dtype == np.uint8
    read = unpack_axes(packed)
    cosine = np.clip(np.sum(read * axes, axis=1)[:-1], -1.0, 1.0)
    assert np.degrees(np.arccos(cosine)).max() < ONE_STEP
    assert_exact(read[-1], np.zeros(3), "no axis is none")
    assert_exact(pack_axes(stored_axes(axes)), packed, "what was stored once stays")
    np.testing.assert_allclose(read[-7:-1], axes[-7:-1], atol=1e-15)


def test_looks_of_a_pinhole():
    """Directions to a plane are linear in the place on the film, however few the nodes of the grid."""
    tangent = 0.4

    def along(u, v):
        return np.stack([u, v, np.ones_like(u)], axis=-1)

    x, y = ((np.arange(n) + 0.5) / n * 2.0 - 1.0 for n in (40, 20))
    exact = along(*np.meshgrid(tangent * x, tangent * y))
    exact /= np.linalg.norm(exact, axis=-1, keepdims=True)
    for nodes in (2, 5):
        u = np.linspace(-tangent, tangent, nodes)
        film = film_of(40, 20, along(*np.meshgrid(u, u))[None].astype(np.float32))
        looks = film.looks()
        assert looks.shape == (1, 20, 40, 3)
        assert_rounded(looks[0], exact, 8)


def test_pictures_of_values():
    film = film_of(3, 2)
    values = np.arange(2 * 6 * 3).reshape(2, 6, 3)
    assert film.picture(values).shape == (2, 2, 3, 3)
    assert film.picture(values[0]).shape == (2, 3, 3)
    assert_exact(film.picture(values[0])[1, 0], values[0, 3], "row by row")
    assert film.picture(values[0, :, 0]).shape == (2, 3)


def test_noise_relative_to_what_is_no_noise():
    film = film_of()
    object.__setattr__(film, "noise_power", np.array([1.0, 2.0, 3.0]))
    power = np.array([1.0, 0.5, 0.25])
    energy = np.array([10.0, 6.0, 4.0])
    assert film.relative_noise(energy, power) == pytest.approx(np.sqrt(2.75 / (14.0 - 2.75)))
    assert film.relative_noise(np.array([1.0, 1.0, 1.0]), power) == 1.0  # all of it can be noise
    assert film_of().relative_noise(energy, power) == 0.0
