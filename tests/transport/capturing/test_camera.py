"""Where the rays of pixels go, and with what weights: moments of filters by quadrature."""

import numpy as np
import pytest

from slepian_prt.transport.capturing.camera import CameraRays
from slepian_prt.transport.capturing.pixel_paths import pixels_of_lanes, stratified_sampler
from tests.transport.capturing.scenes import film, llvm_mitsuba

WIDTH, HEIGHT, PER_PIXEL = 7, 6, 64 * 64


@pytest.fixture(scope="module")
def mi():
    return llvm_mitsuba()


def orthographic(mi, rfilter, **more):
    size = {"crop_offset_x": 2, "crop_offset_y": 1, "crop_width": WIDTH, "crop_height": HEIGHT}
    return mi.load_dict({"type": "orthographic", "film": film(12, rfilter={"type": rfilter}, **size, **more)})


def places(mi, rays, ray):
    """(lanes, 2) where rays start on the film, in pixels of the window: told by those of the middles of two pixels."""
    corner = np.array(rays.middles(mi.UInt32([0, WIDTH * HEIGHT - 1])).o)[:2]
    step = (corner[:, 1] - corner[:, 0]) / [WIDTH - 1, HEIGHT - 1]
    return (np.array(ray.o)[:2].T - corner[:, 0]) / step + 0.5


def moments_of(mi, sensor, place, size, beyond):
    """Mean, over the filter about a place inside a film of that size, of 1, x and x²."""
    rfilter = sensor.film().rfilter()
    radius = float(rfilter.radius())
    x = place + (np.arange(20000) + 0.5) / 20000 * 2.0 * radius - radius
    values = np.array(rfilter.eval(mi.Float((x - place).astype(np.float32))), dtype=np.float64)
    if not beyond:
        values[(x < 0.0) | (x > size)] = 0.0
    return np.array([values.sum(), values @ x, values @ x**2]) / values.sum()


@pytest.mark.parametrize("beyond", [False, True])
@pytest.mark.parametrize("rfilter", ["box", "gaussian", "mitchell", "lanczos"])
def test_moments_of_filters(rfilter, beyond, mi):
    """The mean of weights is 1, and of places times weights what the filter's is; cut at the borders of the film."""
    sensor = orthographic(mi, rfilter, sample_border=beyond)
    rays = CameraRays(mi, sensor)
    pixels = np.arange(WIDTH * HEIGHT)
    sampler = stratified_sampler(mi, PER_PIXEL, pixels, 1)
    ray, weight = rays.sample(sampler, pixels_of_lanes(mi, pixels, PER_PIXEL))
    place = places(mi, rays, ray).reshape(HEIGHT, WIDTH, PER_PIXEL, 2)
    weight = np.array(weight)[0].reshape(HEIGHT, WIDTH, PER_PIXEL)
    for axis, size in ((0, WIDTH), (1, HEIGHT)):
        powers = place[..., axis, None] ** np.arange(3)
        found = (weight[..., None] * powers).mean(axis=2)
        for middle in range(size):
            wanted = moments_of(mi, sensor, middle + 0.5, size, beyond)
            of_pixel = found[:, middle] if axis == 0 else found[middle]
            over = np.abs(of_pixel - wanted) - 1e-4 * np.abs(wanted)
            spread = (weight[..., None] * powers).std(axis=2)
            error = 4.0 * (spread[:, middle] if axis == 0 else spread[middle]) / np.sqrt(PER_PIXEL)
            assert (over <= error).all()  # four standard errors of independent rays; stratified ones have less


@pytest.mark.parametrize("kind", ["perspective", "thinlens"])
def test_directions_of_the_grid_are_those_of_rays(kind, mi):
    """What a film keeps, interpolated, against rays through the middles of pixels and of the aperture."""
    lens = {"aperture_radius": 0.1, "focus_distance": 3.0} if kind == "thinlens" else {}
    sensor = mi.load_dict({"type": kind, "fov": 50, **lens, "film": film(12, crop_width=WIDTH, crop_height=HEIGHT)})
    rays = CameraRays(mi, sensor)
    corners = rays.directions()
    assert corners.shape == ((16 if lens else 1), 2, 2, 3)
    x, y = (np.arange(WIDTH) + 0.5) / WIDTH, ((np.arange(HEIGHT) + 0.5) / HEIGHT)[:, None]
    top, bottom = (
        corners[:, row, 0, None] * (1 - x[:, None]) + corners[:, row, 1, None] * x[:, None] for row in (0, 1)
    )
    looks = top[:, None] * (1 - y[:, :, None]) + bottom[:, None] * y[:, :, None]
    looks /= np.linalg.norm(looks, axis=-1, keepdims=True)
    middle = np.array(rays.middles(mi.UInt32(np.arange(WIDTH * HEIGHT))).d).T.reshape(HEIGHT, WIDTH, 3)
    if not lens:
        np.testing.assert_allclose(looks[0], middle, atol=1e-6)
    else:
        assert np.abs(looks.mean(axis=0) - middle).max() < 0.01  # a lens seen from its middle, and all over
        assert looks.std(axis=0).max() > 0.01


@pytest.mark.parametrize("pixels", [[0], [5, 6, 7], list(range(WIDTH * HEIGHT))])
def test_lanes_of_pixels(pixels, mi):
    lanes = np.array(pixels_of_lanes(mi, np.array(pixels), 3))
    np.testing.assert_allclose(lanes, np.repeat(pixels, 3))


def test_pixels_and_passes_have_numbers_of_their_own(mi):
    """Also beyond 2³² lanes, which count modulo that."""
    far = np.array([(1 << 20) - 1, 1 << 20])
    drawn = [
        np.array(stratified_sampler(mi, 4096, pixels, 3, number).next_2d())
        for pixels in (far, far + 7)
        for number in (0, 1, 2)
    ]
    for one, first in enumerate(drawn):
        assert np.abs(np.corrcoef(first[0, :4096], first[0, 4096:])[0, 1]) < 0.07  # of 4,096 pairs: 4.5 deviations
        for other in drawn[one + 1 :]:
            assert np.abs(np.corrcoef(first[0], other[0])[0, 1]) < 0.05
