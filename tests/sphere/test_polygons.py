import dataclasses
import math
from fractions import Fraction
from itertools import combinations, pairwise

import mpmath
import numpy as np
import pytest

from slepian_prt.errors import UserError
from slepian_prt.slepian.region_concentration import region_basis
from slepian_prt.sphere.directions import check_directions
from slepian_prt.sphere.polygons import make_polygon
from slepian_prt.sphere.regions import polygon_region, region_area
from tests.conftest import random_directions


def place(longitudes, latitudes):
    """Unit vectors from degrees."""
    lon, lat = np.radians(longitudes), np.radians(latitudes)
    return np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], -1)


def turned(rng, plane):
    """Points of the plane z = 1 as unit vectors, after a rotation."""
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    return check_directions(np.column_stack([plane, np.ones(len(plane))]) @ turn.T)


def exact_area(vertices):
    """Area modulo 4π in 50 digits: signed triangles from the first vertex (Eriksson 1990)."""
    with mpmath.workdps(50):
        v = [mpmath.matrix([mpmath.mpf(float(x)) for x in vertex]) for vertex in vertices]
        v = [vertex / mpmath.norm(vertex) for vertex in v]
        total = mpmath.mpf(0)
        for b, c in pairwise(v[1:]):
            a, rows = v[0], mpmath.matrix([list(v[0]), list(b), list(c)])
            dots = [sum(x * y for x, y in zip(p, q, strict=True)) for p, q in ((a, b), (b, c), (c, a))]
            total += 2 * mpmath.atan2(mpmath.det(rows), 1 + sum(dots))
        return float(total % (4 * mpmath.pi))


def boxes(width, height):
    return np.array([[-width, -height], [width, -height], [width, height], [-width, height]]) / 2


def stars(rng, size):
    """Star-shaped, between a third of the size and the size."""
    n = int(rng.integers(3, 12))
    angles = 2 * np.pi * (np.arange(n) + 0.6 * rng.random(n)) / n
    radii = size * rng.uniform(0.3, 1.0, n)
    return np.column_stack([radii * np.cos(angles), radii * np.sin(angles)])


# Rings see no arc that a polygon's edge cuts off lower than 1e-16, a few roundings of a direction; its share of the
# area is (1e-16 / size)^1.5, because its length is a square root of its height.
@pytest.mark.parametrize("size", [1e-10, 1e-8, 1.7e-7, 1e-5, 1e-2, 1.0])
@pytest.mark.parametrize("make", [stars, lambda rng, size: boxes(size, size)], ids=["star", "box"])
def test_area_at_every_size(rng, make, size):
    for _ in range(3):
        vertices = turned(rng, make(rng, size))
        region = polygon_region(vertices)
        assert region_area(region) == pytest.approx(exact_area(vertices), rel=1e-13 + (1e-15 / size) ** 1.5, abs=0)
        around = polygon_region(vertices[::-1])
        assert region_area(around) == pytest.approx(4 * math.pi - exact_area(vertices), rel=1e-14, abs=0)
        assert region_area(~around) == pytest.approx(exact_area(vertices), rel=1e-13 + (1e-15 / size) ** 1.5, abs=0)


@pytest.mark.parametrize("width", [1e-12, 1e-10, 1e-8, 5e-8, 1e-7, 1e-5, 1e-3])
def test_area_of_slivers(rng, width):
    for length in (1e-6, 0.7, 30.0):
        vertices = turned(rng, boxes(length, width))
        right = exact_area(vertices)
        directions, weights = polygon_region(vertices).rule(0)
        # The width is a difference of azimuths good to 1e-16; the plane's points are farther out than the sphere's.
        assert weights.sum() == pytest.approx(right, rel=1e-13 + 4e-16 * (1 + length / 2) / width, abs=0)
        assert len(directions) < 5000  # about 2,500


@pytest.mark.parametrize("size", [(1e-5, 1e-5), (1e-6, 1e-6), (40, 1e-5), (40, 5e-6), (1e-6, 80)])
def test_boxes_next_to_the_equator_and_their_basis(size):
    width, height = size
    vertices = place([0, width, width, 0], [0, 0, height, height])
    right = exact_area(vertices)
    assert region_area(polygon_region(vertices)) == pytest.approx(right, rel=1e-7, abs=0)
    basis = region_basis(3, polygon_region(vertices))
    assert basis.eigenvalues.sum() == pytest.approx(16 * right / (4 * math.pi), rel=1e-7, abs=0)
    assert basis.eigenvalues.min() >= 0.0


@pytest.mark.parametrize(
    "vertices",
    [
        place(np.arange(0, 360, 30), np.full(12, 60)),  # round a pole
        place(np.arange(360, 0, -30), np.full(12, 60)),  # all south of it, more than a hemisphere
        place([0, 90, 0], [10, 10, 90]),  # a vertex on the pole
        place([0, 90, 180, 270], [-80, 10, 80, 10]),  # through a pole
        place([0, 180, 90], [45, 40, -30]),  # an edge through a pole
        place([170, 190, 190, 170], [-10, -10, 10, 10]),  # across the date line
        place([0, 10, 20, 10], [0, 0, 0, 20]),  # a vertex on an edge
        place([0, 0, 0, 0, 30], [-40, -10, 10, 40, 0]),  # several, on a meridian
        place([*np.arange(0, 91, 3), *np.arange(90, -1, -3)], [30] * 31 + [50] * 31),  # edges along two parallels
        place([0, 120, 240], [-30, -30, -30]),
        place([0, 179.999, 90], [0, 0, 1]),
        place([-20, 20, 100, 180, 180, -100], [0, 0, -30, -20, 20, 40]),  # an edge crosses another's opposite
    ],
)
def test_area_of_polygons_on_the_grid(vertices):
    assert region_area(polygon_region(vertices)) == pytest.approx(exact_area(vertices), rel=2e-12, abs=0)


def test_vertices_all_on_one_great_circle(rng):
    around = np.linspace(0, 2 * math.pi, 12, endpoint=False)
    for axis in random_directions(rng, 5):
        u = np.cross(axis, [0.3, 0.5, 0.8])
        u /= np.linalg.norm(u)
        vertices = np.cos(around)[:, None] * u + np.sin(around)[:, None] * np.cross(axis, u)
        assert region_area(polygon_region(vertices)) == pytest.approx(2 * math.pi, rel=1e-13, abs=0)


@pytest.mark.parametrize(
    ("which", "message"),
    [
        ([0, 1, 2, 3, 0], r"vertices\[4\] and vertices\[0\] are equal; leave out the last vertex of a closed ring"),
        ([0, 0, 1, 2, 3], r"vertices\[0\] and vertices\[1\] are equal; leave out one of them"),
    ],
)
def test_repeated_vertices_are_refused(which, message):
    with pytest.raises(UserError, match=message):
        polygon_region(place([10, 20, 20, 10], [10, 10, 20, 20])[which])


def test_lengths_of_vertices_do_not_matter(rng):
    box = place([10, 20, 20, 10], [10, 10, 20, 20])
    scaled = box * np.array([[1e-200], [3.0], [1e200], [1.0]])
    assert region_area(polygon_region(scaled)) == pytest.approx(exact_area(box), rel=1e-13, abs=0)


def test_contains_agrees_with_the_plane(rng):
    # Gnomonic projection takes great circles to lines; there, count the edges to the right of a point.
    for size in (1e-9, 1e-7, 1e-3, 1.0):
        plane = stars(rng, size)
        points = rng.uniform(-size, size, (500, 2))
        inside = np.zeros(500, dtype=bool)
        nearest = np.full(500, np.inf)
        for a, b in zip(plane, np.roll(plane, -1, axis=0), strict=True):
            along = (points[:, 1] - a[1]) / (b[1] - a[1])
            inside ^= (along >= 0) & (along < 1) & (points[:, 0] < a[0] + along * (b[0] - a[0]))
            t = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
            nearest = np.minimum(nearest, np.linalg.norm(points - a - t[:, None] * (b - a), axis=1))
        clear = nearest > 1e-15
        directions = check_directions(np.column_stack([points, np.ones(500)]))
        polygon = make_polygon(check_directions(np.column_stack([plane, np.ones(len(plane))])))
        assert (polygon.contains(directions) == inside)[clear].all()
        assert not polygon.contains(-directions).any()


def test_opposite_of_a_reference():
    # There the way from the reference is not determined.
    around = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    polygon = make_polygon(np.column_stack([np.cos(around), np.sin(around), np.zeros(12)]))
    for reference in polygon.references:
        assert polygon.contains(-reference[None])[0] == (reference[2] < 0)


def test_paths_through_vertices_change_sides_once():
    box = place([-10, 10, 10, -10], [-10, -10, 10, 10])
    notched = np.insert(box, 3, place([0], [0]), axis=0)  # the notch's tip is the centre
    for vertices, targets in ((box, [[0, 0], [30, 0], [0, 30], [-30, 0]]), (notched, [[0, -5], [0, 5], [0, 30]])):
        polygon = make_polygon(vertices)
        for corner in vertices:
            for target in place(*np.array(targets).T):
                away = corner + (corner - target)  # beyond the corner, on the great circle through both
                reference = away / np.linalg.norm(away)
                side = bool(polygon.contains(reference[None])[0])
                through = dataclasses.replace(polygon, references=np.array([reference, reference]), within=(side, side))
                assert through.contains(target[None])[0] == polygon.contains(target[None])[0]


@pytest.mark.parametrize(
    ("vertices", "message"),
    [
        (place([0, 30, 0, 30], [0, 20, 20, 0]), r"from vertices\[0\] and vertices\[2\] cross"),
        (place([0, 1e-5, 0, 1e-5], [0, 1e-5, 1e-5, 0]), r"from vertices\[0\] and vertices\[2\] cross"),
        (place([0, 20, 20, 30, 20, 0], [0, 0, 10, 10, 10, 20]), r"from vertices\[1\] and vertices\[4\] touch"),
        (place([0, 20, 20, 30, 25], [0, 0, 10, 0, 0]), r"from vertices\[0\] and vertices\[4\] touch"),
        (place([0, 20, 20, 10, 0], [0, 0, 20, 0, 20]), r"from vertices\[0\] and vertices\[3\] touch"),  # on an edge
        (place([0, 10, 10, 0, -10, -10], [0, 0, 10, 0, 10, 0]), r"touch"),  # two lobes at one vertex
        (place([0, 0, 0], [0, 20, 10]), r"from vertices\[0\] and vertices\[1\] touch or overlap"),  # no area
        (place([0, 0, 0, 30], [0, 20, 10, 0]), r"from vertices\[0\] and vertices\[1\] touch or overlap"),  # a spike
        (place([0, 20, 20, 0, 0, 20, 20, 0], [0, 0, 20, 20, 0, 0, 20, 20]), "touch or overlap"),  # twice round
        (place([0, 40, 20], [0, 0, 5e-13]), "within 1e-14 rad"),
        (place([0, 1e-13, 1e-13, 0], [0, 0, 1e-13, 1e-13]), r"vertices\[0\] and vertices\[1\] are equal"),
        (np.ones((5, 3)), r"vertices\[0\] and vertices\[1\] are equal"),
        (np.zeros((0, 3)), "at least three directions"),
        ([[1, 0, 0], [-1, 0, 0], [0, 1, 0]], r"vertices\[0\] and vertices\[1\] must not be opposite"),
        ([[0, 1, 0], [1, 0, 0], [0, -1, 1e-11]], r"vertices\[2\] and vertices\[0\] must not be opposite"),
        ([[1, 0, 0], [0, np.nan, 0], [0, 1, 0]], r"vertices\[1\] must be finite"),
        ([["east", 0, 0]] * 3, "real numbers"),
        (np.ones((20_001, 3)), "at most 20000 directions, not 20001"),
    ],
)
def test_what_is_no_polygon(vertices, message):
    with pytest.raises(UserError, match=message) as raised:
        polygon_region(vertices)
    assert "\n" not in str(raised.value)


def crosses(vertices):
    """Whether any two edges cross, in exact arithmetic."""
    exact = [[Fraction(float(x)) for x in vertex] for vertex in vertices]

    def side(a, b, c):
        determinant = sum(a[i] * (b[(i + 1) % 3] * c[(i + 2) % 3] - b[(i + 2) % 3] * c[(i + 1) % 3]) for i in range(3))
        return (determinant > 0) - (determinant < 0)

    n = len(exact)
    for i, j in combinations(range(n), 2):
        a, b, c, d = exact[i], exact[(i + 1) % n], exact[j], exact[(j + 1) % n]
        if side(a, b, c) * side(a, b, d) < 0 and side(c, d, a) == side(a, b, d) == -side(c, d, b):
            return True
    return False


def test_random_vertices_are_refused_where_their_edges_cross(rng):
    outcomes = []
    for _ in range(60):
        size = 10.0 ** rng.uniform(-9, 0)
        vertices = turned(rng, size * rng.normal(size=(int(rng.integers(3, 7)), 2)))
        outcomes.append(crosses(vertices))
        if outcomes[-1]:
            with pytest.raises(UserError, match="cross"):
                polygon_region(vertices)
            continue
        region, right = polygon_region(vertices), exact_area(vertices)
        if right > 2 * math.pi:
            region, right = ~region, exact_area(vertices[::-1])
        assert region_area(region) == pytest.approx(right, rel=1e-6, abs=0)
    assert 10 < sum(outcomes) < 50


def test_crossings_between_distant_edges_of_many():
    around = np.linspace(0, 2 * np.pi, 10_000, endpoint=False)
    radii = 0.4 * (1 + 0.3 * np.sin(5 * around))
    plane = np.column_stack([radii * np.cos(around), radii * np.sin(around), np.ones(10_000)])
    polygon = make_polygon(plane)
    assert polygon.contains(np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])).tolist() == [True, False]
    plane[[2000, 7000]] = plane[[7000, 2000]]
    with pytest.raises(UserError, match="cross"):
        make_polygon(plane)
