import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slepian_prt.slepian.concentration import cap_basis
from slepian_prt.slepian.region_concentration import region_basis
from slepian_prt.sphere.caps import cap_area
from slepian_prt.sphere.harmonics import real_sh
from slepian_prt.sphere.quadrature import spherical_fibonacci
from slepian_prt.sphere.regions import cap_region, mask_region, polygon_region, region_area, region_boundary
from tests.conftest import random_directions
from tests.numerics import assert_exact


@given(st.integers(0, 2**32 - 1), st.floats(0.0, math.pi))
@settings(max_examples=40, deadline=None)
def test_area_of_a_cap_anywhere(seed, half_angle):
    center = random_directions(np.random.default_rng(seed), 1)[0]
    region = cap_region(center, half_angle)
    assert region_area(region) == pytest.approx(cap_area(half_angle), abs=1e-12)
    assert region_area(~region) == pytest.approx(4 * math.pi - cap_area(half_angle), abs=1e-12)


@pytest.mark.slow
@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_unions_and_differences_add_up(seed):
    rng = np.random.default_rng(seed)
    a, b = (cap_region(random_directions(rng, 1)[0], rng.uniform(0.1, 2.0)) for _ in range(2))
    union, common, rest = region_area(a | b), region_area(a & b), region_area(a - b)
    assert union + common == pytest.approx(region_area(a) + region_area(b), abs=1e-11)
    assert rest + common == pytest.approx(region_area(a), abs=1e-11)


@pytest.mark.parametrize(
    ("vertices", "area"),
    [
        (np.eye(3), math.pi / 2),  # an octant
        (np.eye(3)[::-1], 4 * math.pi - math.pi / 2),  # the other way round: what is left of it
        ([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]], 2 * math.pi),  # the upper hemisphere
    ],
)
def test_area_of_polygons(vertices, area):
    assert region_area(polygon_region(vertices)) == pytest.approx(area, abs=1e-12)


def test_polygon_with_a_dent_by_its_angles():
    # A star-shaped, not convex polygon: area = sum of interior angles - (n - 2)π (Girard).
    azimuth = np.linspace(0, 2 * math.pi, 10, endpoint=False)
    polar = np.where(np.arange(10) % 2 == 0, 0.9, 0.4)
    v = np.column_stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)])
    turn = np.array([[0.8, 0, 0.6], [0, 1, 0], [-0.6, 0, 0.8]])
    v = v @ turn.T
    total = 0.0
    for i in range(10):
        before, here, after = v[i - 1], v[i], v[(i + 1) % 10]
        to_before, to_after = (p - (p @ here) * here for p in (before, after))
        angle = math.atan2(np.cross(to_after, to_before) @ here, to_after @ to_before)
        total += angle % (2 * math.pi)
    region = polygon_region(v)
    assert region_area(region) == pytest.approx(total - 8 * math.pi, abs=1e-11)
    directions = spherical_fibonacci(100_000)
    assert region.contains(directions).mean() * 4 * math.pi == pytest.approx(total - 8 * math.pi, abs=5e-3)


@pytest.mark.parametrize("bandlimit", [0, 3, 11, 20])
def test_a_cap_as_a_region_has_the_caps_spectrum(bandlimit):
    center, half_angle = [0.3, -0.5, 0.6], 0.7
    cap, region = cap_basis(bandlimit, half_angle, center), region_basis(bandlimit, cap_region(center, half_angle))
    np.testing.assert_allclose(region.eigenvalues, cap.eigenvalues, atol=2e-14)
    # Leakages keep their digits too, as far as the rule's own rounding of 1e-16 relative to the largest allows.
    small = cap.leakages < 0.5
    np.testing.assert_allclose(region.leakages[small], cap.leakages[small], rtol=1e-6, atol=1e-18)
    np.testing.assert_allclose(region.functions.T @ region.functions, np.eye(len(region)), atol=1e-13)


@pytest.mark.parametrize("make", ["polygon", "two caps", "ring", "mask"])
def test_localisation_matrix_against_brute_force(make):
    bandlimit = 6
    region = {
        "polygon": polygon_region(np.eye(3)),
        "two caps": cap_region([0, 0, 1], 0.5) | cap_region([1, 0, 0], 0.6),
        "ring": cap_region([0.1, 0.2, 1], 1.2) - cap_region([0.1, 0.2, 1], 0.8),
        "mask": mask_region(np.arange(32 * 64).reshape(32, 64) % 7 < 3),
    }[make]
    basis = region_basis(bandlimit, region)
    directions = spherical_fibonacci(400_000)
    y = real_sh(bandlimit, directions[region.contains(directions)])
    brute = y.T @ y * (4 * math.pi / 400_000)
    ours = basis.functions @ np.diag(basis.eigenvalues) @ basis.functions.T
    np.testing.assert_allclose(ours, brute, atol=2e-3)  # the brute force resolves the boundary to about N^-3/4
    assert basis.eigenvalues.sum() == pytest.approx(
        (bandlimit + 1) ** 2 * region_area(region) / (4 * math.pi), rel=1e-12
    )
    np.testing.assert_allclose(basis.eigenvalues + basis.leakages, 1.0, atol=1e-13)
    assert (np.diff(basis.eigenvalues) <= 1e-13).all()


def test_masks_that_wrap_and_fill_rows():
    mask = np.zeros((8, 12), dtype=bool)
    mask[2, [0, 1, 10, 11]] = True
    mask[5] = True
    polar = np.pi * np.arange(9) / 8
    exact = (math.cos(polar[2]) - math.cos(polar[3])) * 2 * math.pi * 4 / 12
    exact += (math.cos(polar[5]) - math.cos(polar[6])) * 2 * math.pi
    assert region_area(mask_region(mask)) == pytest.approx(exact, rel=1e-13)
    assert region_area(~mask_region(mask)) == pytest.approx(4 * math.pi - exact, rel=1e-13)


@pytest.mark.parametrize("kind", [bool, np.uint8, int, np.float32, float])
def test_any_number_but_zero_is_inside(kind):
    cells = np.array([[0, 2, 0, 1], [1, 0, 0, 0]])
    region = mask_region(cells.astype(kind))
    assert_exact(region.mask, cells > 0, "truth values")
    assert region_area(region) == pytest.approx(3 * math.pi / 2, rel=1e-13)


def test_fractions_and_negative_numbers_are_inside():
    assert_exact(mask_region([[0.25, -3.0, 0.0, -0.0]]).mask, [[True, True, False, False]], "truth values")


def test_a_mask_is_not_changed_from_outside():
    cells = np.ones((2, 2), dtype=bool)
    region = mask_region(cells)
    cells[:] = False
    assert region.mask.all()


@pytest.mark.parametrize("shape", [(1, 1), (1, 6), (6, 1), (2, 3)])
def test_masks_of_few_rows_and_columns(shape):
    full, none = mask_region(np.ones(shape)), mask_region(np.zeros(shape))
    assert region_area(full) == region_area(~none) == pytest.approx(4 * math.pi, rel=1e-14)
    assert region_area(none) == region_area(~full) == 0.0
    first = np.zeros(shape)
    first[0, 0] = 1
    share = (1 - math.cos(math.pi / shape[0])) / 2 / shape[1]
    basis = region_basis(4, mask_region(first))
    assert basis.eigenvalues.sum() == pytest.approx(25 * share, rel=1e-12)


@pytest.mark.parametrize("half_angle", [1e-9, 1e-8, 1e-5, 0.5 * math.pi, math.pi - 2.0**-30])
def test_areas_of_tiny_caps_keep_their_digits(rng, half_angle):
    cap = cap_region(random_directions(rng, 1)[0], half_angle)
    assert region_area(cap) == pytest.approx(cap_area(half_angle), rel=1e-14, abs=0)
    assert region_area(~cap) == pytest.approx(cap_area(math.pi - half_angle), rel=1e-14, abs=0)


@pytest.mark.parametrize("outer", [1e-3, 0.3, 1.0, 2.5])
@pytest.mark.parametrize("width", [1e-4, 1e-7, 1e-9])
def test_areas_of_thin_rings(outer, width):
    inner = outer - width
    ring = cap_region((0.36, -0.48, 0.8), outer) - cap_region((0.36, -0.48, 0.8), inner)
    exact = 4 * math.pi * math.sin(0.5 * (outer + inner)) * math.sin(0.5 * (outer - inner))
    assert abs(region_area(ring) - exact) <= 1e-14 * region_boundary(ring)


@pytest.mark.parametrize("size", [1e-9, 1e-7, 1e-3])
def test_tiny_regions_add_up(rng, size):
    # A direction is good to 1e-16, so a boundary is to 1e-16 / size of it; a few roundings go into each.
    plane = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    a, b = (
        polygon_region(np.column_stack([size * (plane * scale + shift), np.ones(4)]) @ turn.T)
        for scale, shift in ((1.0, 0.0), ((0.9, 0.7), (0.5, 0.4)))
    )
    cap = cap_region(turn[:, 2] + size * turn[:, 0], size)
    far = cap_region(-turn[:, 1], size)
    area = region_area(a)
    for other in (b, cap, far):
        union, common, rest = region_area(a | other), region_area(a & other), region_area(a - other)
        assert union + common == pytest.approx(area + region_area(other), rel=3e-15 / size + 1e-11, abs=0)
        assert rest + common == pytest.approx(area, rel=3e-15 / size + 1e-11, abs=0)
    assert region_area(a & far) == 0.0
    # In a larger region it is seen from its own middle, and loses nothing.
    around = cap_region(turn[:, 2] + 0.3 * turn[:, 1], 0.5)
    assert region_area(a & around) == pytest.approx(area, rel=1e-13 + (1e-15 / size) ** 1.5, abs=0)
    assert region_area(around & a) == pytest.approx(area, rel=1e-13 + (1e-15 / size) ** 1.5, abs=0)
    # Overlap of squares in the plane, but for the curvature of the sphere.
    assert region_area(a & b) / area == pytest.approx((1.4 * 1.3) / 4, rel=3e-15 / size + 3 * size**2, abs=0)
    assert region_area(a & cap) / area == pytest.approx(math.pi / 2 / 4, rel=3e-15 / size + 3 * size**2, abs=0)


def test_polygons_that_share_edges():
    def box(west, east):
        lon, lat = np.radians([west, east, east, west]), np.radians([10, 10, 20, 20])
        return polygon_region(np.column_stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)]))

    a, b = box(10, 20), box(20, 30)
    assert region_area(a | b) == pytest.approx(region_area(a) + region_area(b), rel=1e-14)
    assert region_area(a & b) == pytest.approx(0.0, abs=1e-16)
    assert region_area(a - a) == 0.0
    assert region_area(a | a) == pytest.approx(region_area(a), rel=1e-14)
    assert region_area(a | ~a) == pytest.approx(4 * math.pi, rel=1e-14)


def test_threshold():
    region = cap_region([0, 0, 1], 0.5)
    assert len(region_basis(10, region, threshold=0.01)) == int((cap_basis(10, 0.5).eigenvalues > 0.01).sum())


def test_whole_sphere():
    basis = region_basis(5, mask_region(np.ones((4, 8))))
    np.testing.assert_allclose(basis.eigenvalues, 1.0, atol=1e-13)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: region_basis(3, mask_region(np.zeros((4, 8)))), "region must have an area above zero"),
        (lambda: region_basis(3, cap_region([0, 0, 1], 0.3) - cap_region([0, 0, 1], 0.4)), "area above zero"),
        (lambda: polygon_region([[1, 0, 0], [0, 1, 0]]), "at least three directions, not 2"),
        (lambda: polygon_region([[1, 0, 0], [0, 0, 0], [0, 1, 0]]), r"vertices\[1\] must be finite and not zero"),
        (lambda: mask_region(np.zeros(4)), r"mask must have shape \(H, W\)"),
        (lambda: mask_region(np.zeros((4, 8, 3))), r"mask must have shape \(H, W\)"),
        (lambda: mask_region(np.zeros((0, 8))), r"mask must have shape \(H, W\)"),
        (lambda: mask_region([[1, 2], [3]]), "its rows differ in length"),
        (lambda: mask_region([[0.0, 1.0], [1.0, np.nan]]), r"mask\[1, 1\] must be finite"),
        (lambda: mask_region([[-np.inf, 1.0]]), r"mask\[0, 0\] must be finite"),
        (lambda: mask_region(np.ma.array([[1.0, 2.0]], mask=[[False, True]])), r"mask\[0, 1\] must not be hidden"),
        (lambda: mask_region([["inside"]]), "true and false, or numbers"),
        (lambda: mask_region([[1j]]), "true and false, or numbers, not complex"),
        (lambda: cap_region([0, 0, 1], 4.0), "half_angle must be"),
    ],
)
def test_bad_regions(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize("extend", [False, True])
def test_samples_of_shtools_are_cells_about_their_points(extend, rng):
    """A mask as SHTOOLS has it, taken by `mask_region` as its help says: points next to each sample have its value."""
    pysh = pytest.importorskip("pyshtools")
    grid = pysh.SHGrid.from_zeros(5, grid="DH", sampling=2, extend=extend)
    mask = rng.random(grid.data.shape) < 0.5
    if extend:  # the last column is the first, and a pole is one point
        mask[:, -1], mask[-1] = mask[:, 0], mask[-1, 0]
    height, width = len(mask) - extend, mask.shape[1] - extend
    rows = np.minimum((np.arange(2 * height) + 1) // 2, len(mask) - 1)
    columns = (np.arange(2 * width) + 1) // 2 % width
    region = mask_region(mask[np.ix_(rows, columns)])
    latitudes, longitudes = np.radians(grid.lats()), np.radians(grid.lons())
    inside = slice(1, None if not extend else -1)  # poles have no sides
    for down, right in ((0.4, 0.4), (-0.4, 0.4), (0.4, -0.4), (-0.4, -0.4)):
        latitude, longitude = np.meshgrid(
            latitudes[inside] - down * math.pi / height, longitudes + right * 2.0 * math.pi / width, indexing="ij"
        )
        d = np.stack(
            [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)], axis=-1
        )
        assert_exact(region.contains(d.reshape(-1, 3)), mask[inside].ravel(), "truth values")


def test_cells_are_not_the_samples_of_shtools():
    """One sample on the equator, as a cell: the middle of the region is half a cell down and to the right of it."""
    mask = np.zeros((12, 24))
    mask[6, 3] = 1.0
    directions, weights = mask_region(mask).rule(1)
    middle = weights @ directions
    assert np.degrees(np.arctan2(middle[1], middle[0])) == pytest.approx(3.5 * 15.0, abs=1e-9)
    assert np.degrees(np.arcsin(middle[2] / np.linalg.norm(middle))) == pytest.approx(-7.5, abs=0.03)
