"""Triangles of polygons: their area and winding against the shoelace formula, and every corner used."""

import numpy as np
import pytest

from slepian_prt.errors import UserError
from slepian_prt.scene.formats import polygons
from slepian_prt.scene.formats.polygons import triangulate
from slepian_prt.scene.mesh_files import read_parts
from tests.numerics import assert_exact

BRACKET = np.array(
    [[-2, 1, -2], [-2, 1, 2], [2, 1, 2], [2, 1, 1.9], [-1.9, 1, 1.9], [-1.9, 1, -1.9], [2, 1, -1.9], [2, 1, -2]]
)
ARROW = np.array([[0.0, 0, 0], [1, -1, 0], [0, 2, 0], [-1, -1, 0]])  # its corner 0 turns the other way


def cut(*polygons):
    """Corners of the triangles (T, 3, 3), the triangles as vertices, and their owners."""
    sizes = np.array([len(p) for p in polygons], dtype=np.int64)
    points = np.concatenate(polygons)
    corners = np.arange(len(points), dtype=np.int64)
    triangles, owners = triangulate(points, sizes, corners)
    return points[triangles], triangles, owners


def area(corners):
    return 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def shoelace(polygon):
    return 0.5 * sum(
        np.cross(a - polygon[0], b - polygon[0]) for a, b in zip(polygon, np.roll(polygon, -1, 0), strict=True)
    )


def turned(points, seed=3):
    """Points after a rotation and a shift."""
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return points @ q.T + [5.0, -3.0, 1.0]


def regular(n):
    angle = 2 * np.pi * np.arange(n) / n
    return np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)


def comb(teeth):
    x = np.repeat(np.arange(2 * teeth), 2)[1:-1] * 1.0
    y = np.tile([1.0, 1, 0.1, 0.1], teeth)[: len(x)]
    return np.column_stack([np.append(x, [x[-1], 0]), np.append(y, [0, 0]), np.zeros(len(x) + 2)])


def gear(n, seed):
    """A star-shaped polygon of random radii."""
    angle = 2 * np.pi * np.arange(n) / n
    radius = np.random.default_rng(seed).uniform(0.2, 1, n)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), 0 * angle], axis=1)


SIMPLE = {
    "triangle": regular(3), "square": regular(4), "arrow": ARROW, "bracket": BRACKET, "comb": comb(6),
    "heptagon": regular(7), "thousand": regular(1000),
    "midpoint": np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0]]),
    "keyhole": np.array(
        [[0.0, 0], [4, 0], [4, 4], [0, 4], [0, 0], [1, 1], [1, 3], [3, 3], [3, 1], [1, 1]]
    ) @ np.eye(2, 3),
    "points on a side": np.array(
        [[0.0, 0], [1, 0], [2, 0], [3, 0], [4, 0], [4, 2], [3, 1.5], [2, 1], [1, 1.5], [0, 2], [0, 1]]
    ) @ np.eye(2, 3),
    **{f"gear{n}": gear(n, n) for n in (5, 6, 9, 30)},
}  # fmt: skip


@pytest.mark.parametrize("begin", [0, 1, 2, 3])
@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize("name", SIMPLE)
def test_simple_polygons_are_covered_once(name, backwards, begin):
    polygon = np.roll(SIMPLE[name][:: -1 if backwards else 1], begin, axis=0)
    corners, triangles, _ = cut(turned(polygon))
    areas = area(corners)
    right = shoelace(turned(polygon))
    # As many additions of products of numbers up to 6, squared, as there are corners.
    rounding = 40 * len(polygon) * 36 * np.finfo(float).eps
    np.testing.assert_allclose(areas.sum(axis=0), right, atol=rounding)
    # No triangle runs against the polygon: areas add up without cancelling.
    np.testing.assert_allclose(np.linalg.norm(areas, axis=1).sum(), np.linalg.norm(right), atol=rounding)
    assert_exact(np.unique(triangles), np.arange(len(polygon)), "every corner is a corner of a triangle")


def test_a_convex_quadrilateral_is_cut_from_its_first_corner():
    _, triangles, owners = cut(turned(regular(4)), regular(3), turned(regular(5)))
    expected = [[0, 1, 2], [0, 2, 3], [4, 5, 6], [7, 8, 9], [7, 9, 10], [7, 10, 11]]
    assert_exact(triangles, expected, "indices")
    assert_exact(owners, [0, 0, 1, 2, 2, 2], "indices")


def test_no_sliver_where_a_corner_of_a_quadrilateral_is_straight():
    corners, _, _ = cut(np.array([[0.0, 0, 0], [1, 1e-8, 0], [2, 0, 0], [1, 2, 0]]))
    assert np.linalg.norm(area(corners), axis=1).min() > 0.9


@pytest.mark.parametrize("n", [3, 4, 5, 8])
def test_a_bent_polygon_keeps_its_boundary(n):
    polygon = regular(n) + np.random.default_rng(0).normal(scale=0.1, size=(n, 3))
    _, triangles, _ = cut(polygon)
    sides = [(t[k], t[(k + 1) % 3]) for t in triangles.tolist() for k in range(3)]
    boundary = {side for side in sides if side[::-1] not in sides}
    assert boundary == {(k, (k + 1) % n) for k in range(n)}


def all_ways(i, j):
    """Triangulations of the corners i to j of a polygon, each a list of triangles."""
    if j - i < 2:
        yield []
    for k in range(i + 1, j):
        for before in all_ways(i, k):
            for after in all_ways(k, j):
                yield [(i, k, j), *before, *after]


@pytest.mark.parametrize("seed", [0, 1, 3])
def test_a_bent_polygon_that_crosses_itself_in_its_plane_is_spanned_with_least_area(seed):
    # A square of which one side goes up and back, beyond the corner at its end as one sees it.
    polygon = np.array([[-5.0, 0, 5], [5, 0, 5], [5, 0, -5], [-5, 0, -5], [0, 5, -5]])
    polygon += np.random.default_rng(seed).normal(scale=0.1 * (seed > 0), size=polygon.shape)
    corners, triangles, _ = cut(turned(polygon))
    sides = [(t[k], t[(k + 1) % 3]) for t in triangles.tolist() for k in range(3)]
    boundary = {side for side in sides if side[::-1] not in sides}
    assert boundary == {(k, (k + 1) % len(polygon)) for k in range(len(polygon))}
    ways = [np.linalg.norm(area(polygon[np.array(way)]), axis=1).sum() for way in all_ways(0, len(polygon) - 1)]
    # Sums of a few triangles of products up to 10².
    np.testing.assert_allclose(np.linalg.norm(area(corners), axis=1).sum(), min(ways), rtol=1e-13)


@pytest.mark.parametrize(
    "polygon",
    [
        np.zeros((6, 3)),
        np.column_stack([np.arange(6.0), np.zeros(6), np.zeros(6)]),
        np.array([[0.0, 0, 0], [1, 1, 0], [1, 0, 0], [0, 1, 0]]),
        regular(5)[[0, 2, 4, 1, 3]],
        np.full((5, 3), np.nan),
        np.full((7, 3), np.inf),
        ARROW * 1e300,
        regular(6)[[0, 1, 2, 1, 3, 4]] * 1e-300,
    ],
)
def test_polygons_that_are_none_do_no_harm(polygon):
    _, triangles, owners = cut(polygon, regular(3))
    assert 1 < len(triangles) <= len(polygon) - 1
    assert triangles.max() == len(polygon) + 2
    assert owners[-1] == 1


def test_no_part_of_a_star_runs_backwards():
    corners, triangles, _ = cut(regular(5)[[0, 2, 4, 1, 3]])
    assert len(triangles) > 1
    assert area(corners)[:, 2].min() > 0.9


def test_repeated_corners_count_once():
    points = regular(4)
    corners = np.array([0, 1, 1, 2, 3, 0, 0, 1, 1, 0, 2, 2, 2, 2, 0, 1, 2])
    triangles, owners = triangulate(points, np.array([6, 4, 4, 3, 0]), corners)
    assert_exact(corners[triangles], [[0, 1, 2], [0, 2, 3], [0, 1, 2]], "indices")
    assert_exact(owners, [0, 0, 3], "the second and third have fewer than three corners")


def test_polygons_of_one_size_are_cut_each_in_its_way():
    corners, _, owners = cut(
        *[turned(gear(9, k), seed=k) for k in range(40)], *[turned(regular(9), k) for k in range(9)]
    )
    sums = np.zeros((49, 3))
    np.add.at(sums, owners, area(corners))
    right = [shoelace(turned(gear(9, k), seed=k)) for k in range(40)] + [
        shoelace(turned(regular(9), k)) for k in range(9)
    ]
    np.testing.assert_allclose(sums, right, atol=40 * 9 * 36 * np.finfo(float).eps)


def read_face(path, face, vertices="v 0 0 0\nv 1 0 0\nv 0 1 0\n"):
    path.write_text(f"{vertices}f {face}\n")
    return read_parts(path)


@pytest.mark.parametrize("rounds", [5000 // 3, 1_000_000 // 3])
def test_a_face_that_goes_round_again_and_again_is_refused_unclipped(rounds, tmp_path, monkeypatch):
    monkeypatch.setattr(polygons.mapbox_earcut, "triangulate_float64", lambda *_: pytest.fail("clipped"))
    with pytest.raises(UserError, match=f"round.obj: line 4: face 0 has {3 * rounds} corners, .*; export triangles$"):
        read_face(tmp_path / "round.obj", "1 2 3 " * rounds)


@pytest.mark.parametrize("number", [5000, 1_000_000])
def test_a_face_that_goes_to_and_fro_is_not_clipped(number, tmp_path, monkeypatch):
    monkeypatch.setattr(polygons.mapbox_earcut, "triangulate_float64", lambda *_: pytest.fail("clipped"))
    assert read_face(tmp_path / "fro.obj", "1 2 " * (number // 2) + "3 3 2").parts


def test_clipping_of_what_crosses_itself_is_bounded_for_all_of_a_file(monkeypatch):
    done = []
    monkeypatch.setattr(
        polygons.mapbox_earcut, "triangulate_float64",
        lambda flat, ends: done.append(len(flat)) or np.zeros(3 * len(flat) - 6, dtype=np.uint32),
    )  # fmt: skip
    rounds = np.tile(regular(3), (300, 1)) + 1e-3 * np.random.default_rng(1).random((900, 3)) * [1, 1, 0]
    with pytest.raises(polygons.TangledError) as caught:
        cut(*[rounds] * 100)
    assert caught.value.size == 900
    assert sum(n**3 for n in done) <= polygons._MOST_CLIPPING


def keyhole(n):
    """A disc with a round hole, which a bridge leads to: its two ends are named twice."""
    outer, inner = regular(n), 0.5 * regular(n)[::-1]
    inner = np.roll(inner, 1, axis=0)
    return np.concatenate([outer, outer[:1], inner, inner[:1]])


@pytest.mark.parametrize("polygon", [keyhole(1500), comb(1200), turned(gear(4000, 2))], ids=["keyhole", "comb", "gear"])
def test_long_polygons_that_do_not_cross_themselves_are_cut(polygon):
    triangles, _, _ = cut(polygon)
    parts = area(triangles)
    np.testing.assert_allclose(parts.sum(axis=0), shoelace(polygon), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(parts, axis=1).sum(), np.linalg.norm(shoelace(polygon)), rtol=1e-9)


def test_a_bent_polygon_that_is_too_long_to_be_clipped_becomes_a_fan(monkeypatch):
    monkeypatch.setattr(polygons.mapbox_earcut, "triangulate_float64", lambda *_: pytest.fail("clipped"))
    rounds = np.tile(regular(3), (1000, 1))
    rounds[:, 2] = np.linspace(0, 1, 3000)
    _, triangles, _ = cut(rounds)
    assert triangles.shape == (2998, 3)
    assert not triangles[:, 0].any()
