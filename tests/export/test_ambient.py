"""What engines have a place for, against integrals over directions that are worked out one by one."""

import math

import numpy as np
import pytest

from slepian_prt.export.ambient import (
    Y0,
    Y1,
    ambient_part,
    fading_polynomial,
    keep_bent_normals,
    keep_first_degree,
    keep_occlusion,
    keep_sky_visibility,
    visible_moments,
)
from slepian_prt.export.kinds import BENT_NORMALS, FIRST_DEGREE, OCCLUSION, SKY_VISIBILITY
from slepian_prt.sphere.harmonics import degrees, real_sh
from slepian_prt.sphere.quadrature import spherical_fibonacci
from slepian_prt.sphere.rotation import rotate_sh
from tests.conftest import random_directions
from tests.export.conftest import BANDLIMIT
from tests.numerics import assert_exact

DIRECTIONS = spherical_fibonacci(40_000)
EACH = 4.0 * math.pi / len(DIRECTIONS)

# Sums over so many directions are off by the part of them along an edge of the visibility: some 1/200 of them.
SUMMED = 5e-3


def transfer_of(visible: np.ndarray, normal: np.ndarray, bandlimit: int) -> np.ndarray:
    """((L+1)²,) transfer of unit albedo, by the sum over directions that defines it."""
    weight = visible * np.maximum(DIRECTIONS @ normal, 0.0) / math.pi
    return EACH * weight @ real_sh(bandlimit, DIRECTIONS)


def wall(normal: np.ndarray, beside: np.ndarray) -> np.ndarray:
    """What a vertex sees whose sky is open on one side alone."""
    return ((DIRECTIONS @ beside > 0.0) & (DIRECTIONS @ normal > 0.0)).astype(float)


def open_transfer(normals: np.ndarray, bandlimit: int) -> np.ndarray:
    return np.stack([transfer_of(np.ones(len(DIRECTIONS)), normal, bandlimit) for normal in normals])


def test_nothing_is_lost_where_nothing_is_hidden(rng):
    """All but degree 1 are exact for an open hemisphere, whatever its normal."""
    normals = random_directions(rng, 5)
    vectors = open_transfer(normals, 6)[:, None]
    for keep in (keep_occlusion, keep_bent_normals, keep_sky_visibility):
        np.testing.assert_allclose(keep(vectors, normals).vectors, vectors, atol=SUMMED)
    np.testing.assert_allclose(keep_occlusion(vectors, normals).values, 1.0, atol=SUMMED)
    np.testing.assert_allclose(keep_bent_normals(vectors, normals).values[:, 0], normals, atol=SUMMED)


def test_bent_normals_point_where_light_comes_from(rng):
    normal, beside = np.array([0.0, 0.6, 0.8]), np.array([1.0, 0.0, 0.0])
    visible = wall(normal, beside)
    kept = keep_bent_normals(transfer_of(visible, normal, 3)[None, None], normal[None])
    toward = (visible * (DIRECTIONS @ normal)) @ DIRECTIONS
    np.testing.assert_allclose(kept.values[0, 0], toward / np.linalg.norm(toward), atol=SUMMED)
    assert kept.values[0, 0] @ beside > 0.3
    dark = keep_bent_normals(np.zeros((1, 1, 16)), normal[None])
    assert_exact(dark.values[0, 0], normal, "where no light comes from it is the normal, copied")


def test_degree_one_is_in_the_order_of_the_axes(rng):
    """Light of one direction d has the coefficients y_lm(d): transfer of degree 1 is looked up by Y₀ and Y₁ d alone."""
    vectors = rng.normal(size=(3, 2, 25))
    kept = keep_first_degree(vectors, np.zeros((3, 3)))
    for d in random_directions(rng, 4):
        expected = vectors[..., :4] @ real_sh(1, d[None])[0]
        np.testing.assert_allclose(kept.values @ np.array([Y0, *(Y1 * d)]), expected, rtol=0, atol=1e-14)
        np.testing.assert_allclose(kept.vectors @ real_sh(4, d[None])[0], expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize("bandlimit", [2, 3, 6, 10])
def test_moments_of_open_hemispheres_are_exact(rng, bandlimit):
    normals = random_directions(rng, 4)
    vectors = open_transfer(normals, bandlimit)
    # 2π of solid angle, and ∫ ω dω = π n; amplified is what summing lost, at most by what c_l are in all.
    bound = np.abs(fading_polynomial(min(bandlimit, 8))).sum() * math.pi * 2e-4
    expected = np.column_stack([np.full(4, 2.0), normals]) * math.pi
    np.testing.assert_allclose(visible_moments(vectors, normals), expected, atol=bound)


def test_sky_visibility_is_that_of_unity(rng):
    """Near the zenith, where nothing fades, against V summed over directions as its shader does it."""
    normal = random_directions(rng, 1)[0]
    axis = np.cross(normal, [0.3, 0.5, -0.7])
    middle = normal + 0.3 * axis / np.linalg.norm(axis)
    middle /= np.linalg.norm(middle)
    visible = (DIRECTIONS @ middle > math.cos(math.radians(55.0))).astype(float)
    kept = keep_sky_visibility(transfer_of(visible, normal, 10)[None, None], normal[None])
    moments = EACH * np.array([Y0, Y1, Y1, Y1]) * (visible @ np.column_stack([np.ones(len(DIRECTIONS)), DIRECTIONS]))
    expected = moments * [1.0, 2 / 3, 2 / 3, 2 / 3]
    # The polynomial is within a fourth of 1 between 35 degrees above the horizon and the zenith; it swings about it.
    np.testing.assert_allclose(kept.values[0, 0], expected, atol=0.1 * expected[0])
    shade = np.array([Y0, *(Y1 * normal)]) @ kept.values[0, 0]
    np.testing.assert_allclose(kept.vectors[0, 0, 0], shade * Y0, rtol=1e-12)


@pytest.mark.parametrize("what", [OCCLUSION, BENT_NORMALS, SKY_VISIBILITY, FIRST_DEGREE])
def test_what_is_lost_is_the_mean_over_rotations_of_the_light(packed, coloured, light, rng, what):
    """The loss that is told, against vectors that are made again from the numbers that are written."""
    for one in (packed, coloured):
        ambient = ambient_part(one, what, {"now": light})
        vectors = one.reconstruct().astype(float)
        again = vectors_again(what, ambient.values.astype(float), ambient.occlusion.astype(float), one.mesh.normals)
        off, size = (radiance_squared(v, light) for v in (again - vectors, vectors))
        np.testing.assert_allclose(ambient.measured["now"], math.sqrt(off / size), rtol=1e-5)
        lost = np.bincount(degrees(BANDLIMIT), np.sum((again - vectors) ** 2, axis=(0, 1)))
        np.testing.assert_allclose(ambient.expected.lost, lost, rtol=1e-4, atol=1e-6 * lost.sum())
        # Light of this power in all directions: squared errors of many rotations, whose mean is known to some percent.
        power = (1.0 / np.arange(1.0, BANDLIMIT + 2.0)) ** 2
        one_light = np.zeros((3, (BANDLIMIT + 1) ** 2))
        one_light[:] = rng.normal(size=one_light.shape)
        by_degree = np.bincount(degrees(BANDLIMIT), (one_light**2).sum(axis=0))
        one_light *= np.sqrt(3.0 * (2 * np.arange(BANDLIMIT + 1) + 1) * power / by_degree)[degrees(BANDLIMIT)]
        turned = [rotate_sh(one_light, rotation) for rotation in rotations(rng, 200)]
        off = np.mean([radiance_squared(again - vectors, each) for each in turned])
        size = np.mean([radiance_squared(vectors, each) for each in turned])
        if one.channels == 1:  # of three, colours of the light count differently
            np.testing.assert_allclose(ambient.error(), math.sqrt(off / size), rtol=0.1)


def vectors_again(what: str, values: np.ndarray, occlusion: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """What a reader of the numbers makes of them, as the guide says it."""
    cosine = np.array([1.0, 2 / 3, 1 / 4, 0.0, -1 / 24])[degrees(BANDLIMIT)]
    if what == FIRST_DEGREE:
        vectors = np.zeros((*values.shape[:2], (BANDLIMIT + 1) ** 2))
        vectors[..., [0, 3, 1, 2]] = values * [1.0, -1.0, -1.0, 1.0]
        return vectors
    axes = values[:, 0] if what == BENT_NORMALS else normals
    shade = occlusion
    if what == SKY_VISIBILITY:
        shade = (Y0 * values[:, 0, 0] + Y1 * np.sum(values[:, 0, 1:] * normals, axis=1))[:, None]
    return shade[:, :, None] * (real_sh(BANDLIMIT, axes) * cosine)[:, None] * np.ones((1, occlusion.shape[1], 1))


def radiance_squared(vectors: np.ndarray, lighting: np.ndarray) -> float:
    return float(sum(np.sum((vectors[:, c % vectors.shape[1]] @ lighting[c]) ** 2) for c in range(3)))


def rotations(rng: np.random.Generator, count: int) -> list[np.ndarray]:
    """Uniform ones."""
    found = []
    for _ in range(count):
        q, r = np.linalg.qr(rng.normal(size=(3, 3)))
        q = q * np.sign(np.diag(r))
        found.append(q * np.linalg.det(q))
    return found
