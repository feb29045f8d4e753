"""What is read of a mesh is the mesh: the same vertices and faces, near enough to where they were."""

from dataclasses import replace

import numpy as np
import pytest

from slepian_prt.compression.files import container
from slepian_prt.compression.stored_mesh.stored import read_mesh, store_mesh
from slepian_prt.scene.formats.joining import join_equal
from slepian_prt.scene.mesh import make_mesh
from slepian_prt.scene.scene import Part
from tests.compression.stored_mesh.meshes import (
    both_sides,
    cycles,
    joined,
    mesh_of,
    soup,
    stored_and_read,
    turned_by,
    whole,
)
from tests.conftest import bumpy, sphere
from tests.format_mesh import mesh_of_file
from tests.numerics import assert_exact


def hard_meshes() -> dict:
    rng = np.random.default_rng(3)
    ball = sphere(2)
    scattered = mesh_of(rng.normal(size=(30, 3)) * 10.0, rng.integers(0, 30, (60, 3)))
    corners = ball.positions[ball.faces].reshape(-1, 3)
    fan = mesh_of(rng.normal(size=(30, 3)), [[0, i, i + 1] for i in range(1, 29)] + [[0, 1, i] for i in range(2, 29)])
    speck = mesh_of(rng.normal(size=(20, 3)) * 1e-9 + 3.0, rng.integers(0, 20, (9, 3)))
    return {
        "one face": mesh_of(np.eye(3), [[0, 1, 2]]),
        "one vertex": mesh_of([[1.0, 2.0, 3.0]], []),
        "no face": mesh_of(rng.random((9, 3)), []),
        "all faces without area": mesh_of(np.zeros((4, 3)), [[0, 1, 2], [1, 2, 3], [0, 0, 1]]),
        "a face twice": mesh_of(np.eye(3), [[0, 1, 2], [1, 2, 0], [0, 1, 2]]),
        "a face and its back": mesh_of(np.eye(3), [[0, 1, 2], [0, 2, 1]]),
        "unused vertices": mesh_of(rng.random((50, 3)), [[10, 20, 30], [30, 20, 40]]),
        "an unused vertex far away": mesh_of([*np.eye(3), [1e40, 0, 0]], [[0, 1, 2]]),
        "ball": ball,
        "faces without neighbours": mesh_of(corners, np.arange(len(corners))),
        "many faces at an edge": fan,
        "scattered": scattered,
        "a part that is all but a point": joined((ball, whole(ball)), (speck, whole(speck)))[0],
        "far from the origin": replace(ball, positions=ball.positions * 1e-3 + 1e6),
        "large": replace(ball, positions=ball.positions * 1e58),
        "small": replace(ball, positions=ball.positions * 1e-200),
        "flat": mesh_of(rng.random((40, 3)) * [1, 1, 0], rng.integers(0, 40, (50, 3))),
    }  # fmt: skip


HARD = hard_meshes()


def step_of(stored, part: int = 0) -> float:
    return stored.entry["step"] / 2.0 ** stored.entry["pieces"][part]["shift"]


@pytest.mark.parametrize("exact", [False, True])
@pytest.mark.parametrize("name", HARD)
def test_hard_meshes_come_back(name, exact):
    mesh = HARD[name]
    stored, _ = stored_and_read(mesh, whole(mesh), exact=exact)
    if stored.entry["exact"]:
        assert_exact(stored.mesh.positions, mesh.positions, because="bits are kept")
        assert_exact(stored.mesh.normals, mesh.normals.astype(np.float32), because="bits of float32 are kept")
        return
    assert not exact
    used = np.unique(mesh.faces) if mesh.faces.size else np.arange(len(mesh.positions))
    side = np.ptp(mesh.positions[used], axis=0).max()
    allowed = 0.5 * step_of(stored) + 4.0 * np.spacing(np.abs(mesh.positions).max())
    assert np.abs(stored.mesh.positions - mesh.positions).max() <= (allowed if side > 0.0 else 0.0)
    assert step_of(stored) <= max(side / 65_535, 2.0**-1000) * (1 + 1e-12) or side == 0.0
    assert turned_by(stored.mesh.normals, mesh.normals).max(initial=0.0) <= 0.25


@pytest.mark.parametrize("exact", [False, True])
@pytest.mark.parametrize("seed", range(12))
def test_soups_come_back(seed, exact):
    rng = np.random.default_rng(seed)
    meshes = [soup(rng, *sizes) for sizes in ((40, 90, 4), (3, 1, 2), (12, 30, 2), (300, 500, 9))]
    parts = [(mesh, whole(mesh)) if rng.random() < 0.5 else both_sides(mesh) for mesh in meshes]
    mesh, own = joined(*parts)
    stored, _ = stored_and_read(mesh, own, exact=exact)
    if not exact:
        assert np.abs(stored.mesh.positions - mesh.positions).max() <= 0.5000001 * stored.entry["step"]
        assert turned_by(stored.mesh.normals, mesh.normals).max() <= 0.25


@pytest.mark.parametrize("name", [*HARD, "scene"])
@pytest.mark.parametrize("exact", [False, True])
def test_a_reader_written_from_the_page_gets_the_same(name, exact):
    rng = np.random.default_rng(0)
    mesh = HARD.get(name)
    parts = () if mesh is None else whole(mesh)
    if mesh is None:
        tinted = replace(sphere(1), albedo=rng.random((42, 3)).astype(np.float32))
        mesh, parts = joined(both_sides(soup(rng)), (tinted, whole(tinted)))
    stored, read = stored_and_read(mesh, parts, exact=exact)
    theirs = mesh_of_file(stored.entry, stored.arrays)
    for key, ours in (("positions", read.positions), ("normals", read.normals.astype(np.float32)),
                      ("faces", read.faces), ("albedo", read.albedo)):  # fmt: skip
        assert_exact(theirs[f"mesh/{key}"], ours, because="operations that IEEE 754 rounds alike everywhere")


def test_the_numbering_of_the_source_changes_nothing(rng):
    for mesh in (bumpy(3), soup(rng), HARD["faces without neighbours"]):
        order = rng.permutation(len(mesh.positions))
        number = np.argsort(order)
        faces = np.roll(rng.permutation(number[mesh.faces]), 1, axis=1).astype(np.int32)
        other = replace(mesh, positions=mesh.positions[order], normals=mesh.normals[order], faces=faces,
                        albedo=mesh.albedo[order])  # fmt: skip
        one, two = stored_and_read(mesh, whole(mesh))[1], stored_and_read(other, whole(other))[1]
        rows = [read.positions[np.lexsort(read.positions.T)] for read in (one, two)]
        assert_exact(*rows, because="a place does not depend on others")
        places = [
            join_equal(np.concatenate([one.positions, read.positions]))[1][-len(rows[0]) :] for read in (one, two)
        ]
        assert cycles(places[0][one.faces]) == cycles(places[1][two.faces])


def test_parts_meet_where_they_met_and_small_ones_stay_round(rng):
    """Places that parts of about one size share stay shared; a part of 1e-7 of the scene has 16 bits of its own."""
    x, y = np.meshgrid(np.linspace(0.0, 1.0, 30), np.linspace(0.0, 1.0, 30))
    i = (np.arange(29)[:, None] * 30 + np.arange(29)).ravel()
    faces = np.concatenate([np.stack([i, i + 1, i + 30], 1), np.stack([i + 1, i + 31, i + 30], 1)])
    bent = 0.1 + 0.3 * rng.random(30)  # heights along the edge that two walls share
    floor = mesh_of(np.stack([x.ravel(), y.ravel(), np.tile(bent, 30) * y.ravel()], 1), faces)
    wall = mesh_of(np.stack([x.ravel(), 1.0 + 0 * x.ravel(), np.tile(bent, 30) + y.ravel()], 1), faces)
    speck = replace(sphere(3), positions=sphere(3).positions * 1e-7 + 0.5)
    mesh, parts = joined((floor, whole(floor)), (wall, whole(wall)), (speck, whole(speck)))
    stored, _ = stored_and_read(mesh, parts)
    assert stored.entry["pieces"][0]["shift"] == stored.entry["pieces"][1]["shift"]
    a, b = stored.mesh.positions[870:900], stored.mesh.positions[900:930]
    assert_exact(a, b, because="one place is one number")
    last = slice(parts[2].first, parts[2].end)
    apart = np.abs(stored.mesh.positions[last] - mesh.positions[last]).max()
    assert apart <= 2e-7 / 65_535 * 1.01 + 2 * np.spacing(
        0.5
    )  # its steps are at most twice as wide as if it were alone
    assert turned_by(stored.mesh.normals[last], mesh.normals[last]).max() <= 0.25


def test_ten_numbers_that_are_stored(rng):
    """A table of a few albedos is exact, others are near, and what varies not is there once."""
    ball = sphere(3)
    count = len(ball.positions)
    few = rng.integers(0, 256, (count, 3)).astype(np.float32) / np.float32(255)
    many = rng.random((count, 3)).astype(np.float32)
    bright = many * np.float32(1e6)
    gray = np.repeat(many[:, :1], 3, axis=1)
    small = many * np.float32(1e-6)
    one = np.full((count, 3), 0.5, dtype=np.float32)
    kinds = ((few, "table"), (many, "float16"), (bright, "float32"), (gray, "float16"), (small, "float16"))
    for albedo, kind in (*kinds, (one, "constant")):
        mesh = replace(ball, albedo=albedo)
        for exact in (False, True):
            stored, _ = stored_and_read(mesh, whole(mesh), exact=exact)
            assert stored.entry["albedo"]["kind"] == ("float32" if exact and kind == "float16" else kind)
            assert ("mesh/albedo" in stored.arrays) == (kind != "constant")
            bound = 0.0 if exact or kind != "float16" else 1.0
            apart = np.abs(stored.mesh.albedo.astype(np.float64) - albedo)
            assert np.all(apart <= bound * np.maximum(albedo * 2.0**-11, 2.0**-25))


def test_colours_of_parts_are_there_once():
    ball = sphere(2)
    red, blue = (replace(ball, albedo=np.tile(np.float32(c), (162, 1))) for c in ([1, 0, 0], [0.1, 0.2, 1]))
    mesh, parts = joined((red, whole(red)), both_sides(replace(blue, albedo=blue.albedo)), (red, whole(red)))
    back = parts[1].first + parts[1].count
    mesh.albedo[back : parts[1].end] = 0.25
    stored, _ = stored_and_read(mesh, parts)
    assert stored.entry["albedo"]["kind"] == "constant"
    assert np.array(stored.entry["albedo"]["colors"]).shape == (4, 3)
    assert_exact(stored.mesh.albedo, mesh.albedo, because="JSON keeps the digits")


def test_given_normals_are_kept_where_they_are_others(rng):
    """Hard edges, seams, smooth normals of flat faces, none at all."""
    ball = sphere(3)
    corners = ball.positions[ball.faces].reshape(-1, 3)
    flat = mesh_of(corners, np.arange(len(corners)))
    smooth = replace(flat, normals=corners / np.linalg.norm(corners, axis=1, keepdims=True))
    leaning = replace(ball, normals=ball.normals + 0.1 * rng.normal(size=ball.normals.shape))
    leaning = replace(leaning, normals=leaning.normals / np.linalg.norm(leaning.normals, axis=1, keepdims=True))
    none = replace(ball, normals=ball.normals * (rng.random((len(ball.normals), 1)) < 0.5))
    against = replace(ball, normals=-ball.normals)
    for mesh, stored_normals in ((flat, 0), (smooth, None), (leaning, 642), (none, 0), (against, 642)):
        stored, _ = stored_and_read(mesh, whole(mesh))
        assert turned_by(stored.mesh.normals, mesh.normals).max() <= 0.25
        packed = stored.arrays.get("mesh/normals", np.zeros((2, 1, 0)))
        if stored_normals is not None:
            assert stored_normals * 0.9 <= packed.shape[2] <= stored_normals
        exact, _ = stored_and_read(mesh, whole(mesh), exact=True)
        assert_exact(exact.mesh.normals, mesh.normals.astype(np.float32), because="kept to the bit")
    # Flat faces of a smooth ball: what all faces at a place have in common is the normal.
    ways = store_mesh(smooth, whole(smooth)).arrays["mesh/normal_ways"]
    assert np.mean(ways == 1) > 0.6


def test_it_is_made_once_and_small():
    mesh = bumpy(5)
    stored = store_mesh(mesh, whole(mesh))
    assert store_mesh(mesh, whole(mesh)) is stored
    assert store_mesh(mesh, whole(mesh), exact=True) is not stored
    size = sum(container.sizes_of({"mesh": stored.entry}, stored.arrays).values())
    assert size / len(mesh.positions) <= 4.5


def test_finer_places_where_edges_are_short():
    """Computed normals of a fine mesh would be noise on 65,536 places."""
    mesh = sphere(6)
    mesh = replace(mesh, positions=mesh.positions * [1.0, 1.0, 8.0])
    mesh = mesh_of(mesh.positions, mesh.faces)
    stored, _ = stored_and_read(mesh, whole(mesh))
    edges = np.linalg.norm(np.diff(mesh.positions[mesh.faces[:, :2]], axis=1), axis=2).mean()
    assert edges / stored.entry["step"] > 200.0 or stored.entry["pieces"][0]["shift"] >= 1
    assert np.mean(stored.arrays.get("mesh/normal_ways", np.zeros(1)) == 2) < 0.1


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ((Part("a", 0, 100),), "all its vertices"),
        ((Part("a", 0, 81), Part("b", 81, 81)), "may join two parts"),
        ((Part("a", 0, 81, 2),), "must be those of the front"),
        ((Part("a", 1, 161),), "all its vertices"),
    ],
)
def test_parts_that_do_not_fit(parts, message):
    with pytest.raises(ValueError, match=message):
        store_mesh(sphere(2), parts)


@pytest.mark.parametrize("seed", range(4))
def test_spoilt_bytes_of_draco_do_no_harm(seed):
    """Checksums keep them from getting here; if they do, what they give fits together or is refused."""
    rng = np.random.default_rng(seed)
    mesh = bumpy(2)
    stored = store_mesh(mesh, whole(mesh))
    for _ in range(200):
        data = stored.arrays["mesh/draco"].copy()
        places = rng.integers(0, len(data), 1 + rng.integers(4))
        data[places] = rng.integers(0, 256, places.size)
        try:
            read = read_mesh(stored.entry, {**stored.arrays, "mesh/draco": data}, "mesh", ())
        except ValueError:
            continue
        assert read.positions.shape == mesh.positions.shape
        assert read.faces.max() < len(read.positions)
        assert np.isfinite(read.normals).all()


def test_details_of_something_large_keep_their_shape():
    """A trench of 10 cm through 5 km: its vertices move by less than a sixteenth of its shortest edges, 2 cm."""
    across = np.array([-2500.0, -1250.0, -0.07, -0.05, -0.025, 0.0, 0.025, 0.05, 0.07, 1250.0, 2500.0])
    depth = np.where(np.abs(across) <= 0.05, -0.1, 0.0)
    along = np.linspace(-2500.0, 2500.0, 9)
    positions = np.array([[x, y, z] for x, y in zip(across, depth, strict=True) for z in along])
    corner = np.arange(len(positions)).reshape(len(across), len(along))
    a, b, c, d = (part.ravel() for part in (corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]))
    mesh = make_mesh(positions, np.concatenate([np.stack([a, c, b], axis=1), np.stack([a, d, c], axis=1)]))
    stored = store_mesh(mesh, (Part("terrain", 0, len(positions)),))
    assert np.abs(stored.mesh.positions - mesh.positions).max() < 0.02 / 16.0
