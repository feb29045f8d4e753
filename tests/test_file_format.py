"""docs/file-format.md tells all that a reader must know: one that was written from it alone gets the same."""

from __future__ import annotations

import re
import zlib
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

import slepian_prt as sp
from slepian_prt.compression.clustering import Clusters, cluster_surface
from slepian_prt.scene.mitsuba.two_sides import with_back
from slepian_prt.scene.scene import Part
from tests import format_coefficients, format_lanes
from tests.agreement import assert_readers_agree
from tests.conftest import bumpy, sphere
from tests.format_lanes import token_frequencies
from tests.format_reader import File, transfer_vectors
from tests.numerics import assert_rounded

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "file-format.md"
BANDLIMIT = 3


def test_reader_shares_no_code():
    for path in (ROOT / "tests").glob("format_*.py"):
        assert "slepian_prt" not in re.sub(r'"[^"]*"', "", path.read_text()), path


def test_page_gives_the_checksum_of_the_models():
    tables = np.array(token_frequencies(), dtype="<u4")
    assert tables.shape == (168, 33)
    assert set(tables.sum(axis=1).tolist()) == {2**12}
    assert f"`{zlib.crc32(tables.tobytes()):08x}`" in PAGE.read_text()


# --- All kinds of files ----------------------------------------------------------------------------------------------


def rotate_to(functions: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Functions about z, turned to stand about an axis: Rz(φ) Ry(θ)."""
    x, y, z = axis
    s = np.hypot(x, y)
    c, d = (x / s, y / s) if s > 0.0 else (1.0, 0.0)
    return sp.rotate_sh(functions, np.array([[c * z, -d, x], [d * z, c, y], [-s, 0.0, z]]))


@pytest.fixture(scope="module")
def ball() -> sp.Mesh:
    """A dented ball of several colours, 642 vertices."""
    ball = trimesh.creation.icosphere(3)
    positions = ball.vertices * (1.0 + 0.4 * np.prod(np.sin(4.0 * ball.vertices), axis=1, keepdims=True))
    return sp.make_mesh(positions, ball.faces, albedo=0.5 + 0.4 * np.sign(positions))


@pytest.fixture(scope="module")
def transfers(ball) -> dict[str, sp.Transfer]:
    return {
        "one channel": sp.precompute(ball, bandlimit=4, samples=64, effects="direct"),
        "three channels": sp.precompute(ball, bandlimit=4, samples=64, effects="all"),
    }


@pytest.mark.parametrize("channels", ["one channel", "three channels"])
@pytest.mark.parametrize(
    "options",
    [
        {"tolerance": 0.03},
        {"tolerance": 0.03, "refine": True},
        {"tolerance": 1e-4, "refine": False},  # float32 functions, many lanes
        {"tolerance": 0.05, "group_by": "bent", "occlusion_classes": 3},
        {"tolerance": 0.05, "group_by": "surface", "exact_mesh": True},
        {"tolerance": 0.05, "light_prior": sp.falling_prior(4)},
        {"tolerance": 0.05, "basis": "cpca"},
        {"tolerance": 0.99},  # nothing is left but the mean
        {"terms": 6},
        {"terms": 6, "coding": "float16"},
        {"terms": 6, "coding": "float16", "refine": True},
        {"terms": 6, "basis": "slepian"},
        {"basis": "none"},
    ],
    ids=str,
)
def test_independent_reader_agrees(transfers, channels, options, tmp_path):
    """Integers and stored floats bit for bit, transfer vectors to rounding."""
    sp.compress(transfers[channels], clusters=5, **options).save(tmp_path / "ball.prt")
    packed, file = assert_readers_agree(tmp_path / "ball.prt")
    vectors = packed.reconstruct()
    theirs = transfer_vectors(file, sp.real_sh, rotate_to).reshape(vectors.shape)
    # Sums of at most 25 functions after 75 principal axes, of numbers below the largest vector.
    assert_rounded(theirs.astype(np.float32), vectors, terms=100)


# --- Hard ones -------------------------------------------------------------------------------------------------------


def made_up(mesh: sp.Mesh, rng: np.random.Generator, channels: int = 1, sides: int = 1) -> sp.Transfer:
    """Waves with noise of heavy tails, which no light makes: all that the format can tell of, without tracing."""
    size = channels * (BANDLIMIT + 1) ** 2
    waves = np.sin(mesh.positions @ rng.normal(size=(3, size)) + np.arange(size)) * 0.8 ** np.arange(size)
    vectors = (waves + 0.02 * rng.standard_t(2, size=waves.shape)).astype(np.float32)
    part = Part(mesh.name, 0, len(mesh.positions) // sides, sides)
    vectors = vectors.reshape(len(waves), channels, -1)
    return sp.Transfer(vectors, mesh.normals, mesh, (part,), BANDLIMIT, 64, 0, (), 0, 0)


def counted(monkeypatch, module, name: str) -> Counter:
    """How often a function of the reader gave what, from now on."""
    found, function = Counter(), getattr(module, name)

    def counting(*arguments):
        result = function(*arguments)
        found[result if isinstance(result, int) else len(result)] += 1
        return result

    monkeypatch.setattr(module, name, counting)
    return found


def agreed_on(made: sp.CompressedTransfer, folder: Path) -> tuple[sp.CompressedTransfer, File]:
    """Both readers' views of what was coded."""
    assert made.coded is not None
    made.save(folder / "made.prt")
    return assert_readers_agree(folder / "made.prt")


@pytest.mark.parametrize("count", [250, 251, 3001])
def test_fans_of_very_many_triangles(count, rng, tmp_path, monkeypatch):
    """With 250 triangles, second neighbours on the rim are just few enough to count. The hub of many has more sources
    than count, not all of the coarsest levels among them, and on its rim the curve stands in."""
    angle = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    rim = np.stack([np.cos(angle), np.sin(angle), 0.1 * np.sin(9.0 * angle)], axis=1)
    faces = [[0, 1 + i, 1 + (i + 1) % count] for i in range(count)]
    fan = sp.make_mesh([[0.03, 0.02, 0.2], *rim], faces)
    sources = counted(monkeypatch, format_coefficients, "sources_of")
    agreed_on(sp.compress(made_up(fan, rng), clusters=1, terms=3, coding="coded"), tmp_path)
    if count > 1000:
        assert sources[64] == 1
        assert sources[0] > 100


def test_magnitudes_of_any_size(rng, tmp_path, monkeypatch):
    """Outliers where the models foretell small numbers, and beyond the largest token of a range."""
    transfer = made_up(bumpy(2), rng)
    vectors = transfer.vectors.copy()
    vectors[::17] *= 1e4 * rng.standard_t(1, size=(len(vectors[::17]), 1, 1))
    tokens = counted(monkeypatch, format_lanes, "extra_bits")
    made = sp.compress(replace(transfer, vectors=vectors.astype(np.float32)), clusters=2, tolerance=1e-5)
    _, file = agreed_on(made, tmp_path)
    assert tokens[32] > 10
    assert max(np.abs(cap.numbers).max() for cap in file.caps) > 16 * 131086
    assert file.arrays["coded/caps"][0].min() > 1  # lanes


@pytest.mark.parametrize("clusters", [42, 20])
@pytest.mark.parametrize("group_by", ["normal", "surface"])
def test_caps_of_one_vertex(clusters, group_by, rng, tmp_path):
    made = sp.compress(made_up(sphere(1), rng), clusters=clusters, group_by=group_by, tolerance=0.02)
    packed, _ = agreed_on(made, tmp_path)
    assert 1 in packed.clusters.sizes


def test_empty_and_dark_caps(rng, tmp_path):
    """A cap without a vertex, one of a single vertex, and one that no light reaches."""
    mesh = bumpy(2)
    grouped = cluster_surface(mesh.receivers, mesh.normals, 5)
    index = np.where(grouped.index == 2, 1, grouped.index)
    index[np.flatnonzero(index == 3)[1:]] = 0
    transfer = made_up(mesh, rng)
    vectors = transfer.vectors.copy()
    vectors[index == 4] = 0.0
    clusters = Clusters.of_one_class(index, grouped.caps)
    made = sp.compress(replace(transfer, vectors=vectors), clusters=clusters, tolerance=0.02)
    _, file = agreed_on(made, tmp_path)
    assert [file.caps[2].members.size, file.caps[3].members.size] == [0, 1]
    assert file.arrays["coded/caps"][:4, 2].tolist() == [0, 0, 0, 0]


@pytest.mark.parametrize("exact_mesh", [False, True])
def test_two_sides(exact_mesh, rng, tmp_path):
    """Front and back are at one place, so that only their numbers tell them apart on the curve."""
    mesh = bumpy(2)
    both = with_back(mesh, np.full_like(mesh.albedo, 0.25))
    options = {"clusters": 6, "tolerance": 0.05, "exact_mesh": exact_mesh}
    agreed_on(sp.compress(made_up(both, rng, 3, sides=2), **options), tmp_path)


def test_principal_axes(rng, tmp_path):
    """Many coefficients of few numbers on one side of a ball, noise on the other."""
    mesh = sphere(3)
    transfer = made_up(mesh, rng, channels=3)
    vectors = transfer.vectors.reshape(len(mesh.positions), -1)[:, :4] @ rng.normal(size=(4, 48))
    other = mesh.positions[:, 2] > 0.0
    vectors[other] = rng.normal(size=(np.count_nonzero(other), 48))
    vectors = vectors.astype(np.float32).reshape(transfer.vectors.shape)
    made = sp.compress(replace(transfer, vectors=vectors), clusters=6, tolerance=0.02)
    _, file = agreed_on(made, tmp_path)
    assert {cap.axes is None for cap in file.caps} == {False, True}


@pytest.mark.parametrize("size", [1e-290, 1e58])
def test_meshes_of_any_size(size, rng, tmp_path):
    """A ball with a vertex of no face, which has no normal."""
    ball = sphere(2)
    mesh = sp.Mesh(
        "ball",
        np.append(ball.positions, [[0.0, 0.5, 0.5]], axis=0),
        np.append(ball.normals, [[0.0, 0.0, 0.0]], axis=0),
        ball.faces,
        np.append(ball.albedo, ball.albedo[:1], axis=0),
    )
    transfer = made_up(mesh, rng)
    scaled = replace(mesh, positions=mesh.positions * size)
    made = sp.compress(replace(transfer, mesh=scaled, axes=scaled.normals), clusters=3, tolerance=0.02)
    agreed_on(made, tmp_path)


def test_vertices_of_many_edges(rng, tmp_path):
    """Surroundings of surroundings, which count on coarse levels: more than 2048 inside, fewer at the border."""
    side = 24
    column, row = (axis.ravel() for axis in np.meshgrid(np.arange(side), np.arange(side)))
    faces = []
    for reach in (1, 2):
        inside = (column < side - reach) & (row < side - reach)
        corners = [(row * side + column)[inside], (row * side + column + reach)[inside]]
        faces.append(np.stack([*corners, ((row + reach) * side + column)[inside]], axis=1))
    heights = np.sin(column / 3.0) * np.cos(row / 5.0)
    sheet = sp.make_mesh(np.stack([column, row, heights], axis=1), np.concatenate(faces))
    agreed_on(sp.compress(made_up(sheet, rng), clusters=1, terms=3, coding="coded"), tmp_path)


def test_caps_wider_than_those_of_the_sample(rng, tmp_path, monkeypatch):
    """What all caps are coded with is fitted to some; here to the one of the fewest functions."""
    options = {"basis": "pca", "clusters": 8, "tolerance": 0.02}
    transfer = made_up(bumpy(3), rng)
    counts = [basis.count for basis in sp.compress(transfer, **options).bases]
    assert min(counts) < max(counts)
    narrowest = int(np.argmin(counts))
    monkeypatch.setattr("slepian_prt.compression.encoder.sample_caps", lambda learned, receivers: [narrowest])
    agreed_on(sp.compress(transfer, **options), tmp_path)


@pytest.mark.parametrize(("far", "used"), [(100.0, True), (1000.0, False), (1e9, False)])
def test_edges_of_any_length(far, used, rng, tmp_path):
    """A plane and a vertex far away: so far that edges are a few units, or none. Some faces have one corner twice."""
    side = 24
    column, row = np.meshgrid(np.arange(side), np.arange(side))
    places = np.stack([column.ravel() / side, row.ravel() / side, np.zeros(side**2)], axis=1)
    first = (row * side + column)[:-1, :-1].ravel()
    faces = [*np.stack([first, first + 1, first + side], axis=1), *([i, i, i + 1] for i in range(200))]
    faces += [[0, 1, side**2]] if used else []
    positions = np.append(places, [[far, far, 0.0]], axis=0)
    normals = np.tile([0.0, 0.0, 1.0], (side**2 + 1, 1))
    plane = sp.Mesh("plane", positions, normals, np.array(faces, np.int32), np.ones(positions.shape, np.float32))
    transfer = replace(made_up(replace(plane, positions=4.0 * rng.random(positions.shape)), rng), mesh=plane)
    agreed_on(sp.compress(replace(transfer, axes=normals), clusters=2, terms=4, coding="coded"), tmp_path)
