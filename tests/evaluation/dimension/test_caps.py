"""The caps of a file: counts against those of the concentration problem, dimensions against singular values."""

import itertools
import math
from types import SimpleNamespace

import numpy as np
import pytest

import slepian_prt as sp
from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.files.container import Contents, write
from slepian_prt.evaluation.dimension.caps import cap_dimensions, count_concentrations, describe_count
from slepian_prt.scene.mesh import Mesh
from tests.conftest import bumpy
from tests.format_reader import read
from tests.fuzzing.prt_files import pack


@pytest.fixture(scope="module")
def packed(tmp_path_factory) -> CompressedTransfer:
    transfer = sp.precompute(bumpy(3), bandlimit=4, samples=64)
    path = tmp_path_factory.mktemp("caps") / "bumpy.prt"
    sp.compress(transfer, tolerance=0.02, clusters=12).save(path)
    return sp.load(path)


def test_each_cap_has_the_dimension_of_its_vectors(packed):
    """Smallest number of singular values, areas from the corners' cross products, by hand."""
    positions, faces = packed.mesh.positions, packed.mesh.faces
    areas = np.zeros(len(positions))
    for a, b, c in faces:
        third = np.linalg.norm(np.cross(positions[b] - positions[a], positions[c] - positions[a])) / 6.0
        areas[[a, b, c]] += third
    vectors = packed.reconstruct().reshape(len(positions), -1).astype(np.float64)
    rows = cap_dimensions(packed, 0.1)
    assert sorted(row.cap for row in rows) == list(range(12))
    assert [row.dimension for row in rows] == sorted((row.dimension for row in rows), reverse=True)
    for row in rows:
        members = packed.clusters.members[row.cap]
        energies = np.linalg.svd(np.sqrt(areas[members])[:, None] * vectors[members], compute_uv=False) ** 2
        smallest = next(k for k in range(26) if energies[k:].sum() <= 0.01 * energies.sum())
        assert math.ceil(row.dimension) == smallest
        assert row.vertices == members.size
        assert row.half_angle == packed.clusters.caps[row.cap].half_angle
        assert row.expected == sp.concentration_count(4, row.half_angle, 0.01)
        assert row.coherence == 1.0 - row.dimension / 25


def test_vertices_that_no_face_uses_are_not_counted():
    mesh = bumpy(2)
    stray = sp.make_mesh(np.concatenate([mesh.positions, [[3.0, 0.0, 0.0]]]), mesh.faces)
    packed = sp.compress(sp.precompute(stray, bandlimit=2, samples=16), tolerance=0.1, clusters=4)
    assert sum(row.vertices for row in cap_dimensions(packed, 0.05)) == len(mesh.positions)


def test_pixels_count_alike():
    """Of a film the weights are ones, whatever areas its flat mesh has."""
    packed = sp.compress(sp.precompute(bumpy(2), bandlimit=2, samples=16), tolerance=0.1, clusters=1)
    whole = cap_dimensions(packed, 0.05)[0].dimension
    object.__setattr__(packed, "film", SimpleNamespace())
    row = cap_dimensions(packed, 0.05)[0]
    alike = row.dimension
    energies = np.linalg.svd(packed.reconstruct().reshape(-1, 9).astype(np.float64), compute_uv=False) ** 2
    assert math.ceil(alike) == next(k for k in range(10) if energies[k:].sum() <= 0.05**2 * energies.sum())
    assert alike != whole
    assert row.expected is None  # their caps are of no normals


@pytest.mark.parametrize("bandlimit", [0, 3, 10, 25])
@pytest.mark.parametrize("degrees", [0.0, 3.0, 13.0, 90.0, 180.0])
def test_counting_without_scipy(bandlimit, degrees):
    """As the tridiagonal problem counts; no concentration of these is within rounding of the threshold."""
    half_angle = math.radians(degrees)
    assert count_concentrations(bandlimit, half_angle) == sp.concentration_count(bandlimit, half_angle, 0.01)


def terrain() -> Mesh:
    """Gentle hills: normals are up to 20 degrees from the vertical, which leaves most of the sphere without any."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 9)))
    a = (np.arange(8)[:, None] * 9 + np.arange(8)).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + 10], 1), np.stack([a, a + 10, a + 9], 1)])
    return sp.make_mesh(np.stack([x, y, 0.06 * np.sin(5 * x) * np.cos(4 * y + 0.3)], axis=1), faces)


def smallest_cap(normals: np.ndarray) -> float:
    """Half-angle, from all caps that two or three normals are on the rim of."""
    if len(normals) == 1:
        return 0.0
    pairs = [a + b for a, b in itertools.combinations(normals, 2)]
    triples = [side * np.cross(b - a, c - a) for a, b, c in itertools.combinations(normals, 3) for side in (-1, 1)]
    centers = np.array([center for center in (*pairs, *triples) if np.linalg.norm(center) > 1e-12])
    centers /= np.linalg.norm(centers, axis=1, keepdims=True)
    chords = np.linalg.norm(centers[:, None] - normals, axis=2).max(axis=1)
    return 2.0 * math.asin(chords.min() / 2.0)


@pytest.mark.parametrize(
    "options", [{}, {"coding": "float16", "terms": 4}, {"group_by": "surface"}, {"exact_mesh": True}], ids=str
)
def test_a_typical_cap_is_told_without_decoding(options, tmp_path):
    """As wide as caps are about the normals that the file has, where those leave much of the sphere empty."""
    options = {"tolerance": 0.1} | options if "terms" not in options else options
    packed = sp.compress(sp.precompute(terrain(), bandlimit=3, samples=16), clusters=9, **options)
    packed.save(tmp_path / "terrain.prt")
    loaded = sp.load(tmp_path / "terrain.prt")
    told = loaded.typical_half_angle
    assert "mesh" not in vars(loaded)
    assert "clusters" not in vars(loaded)
    assert told == packed.typical_half_angle
    assert told == np.median([row.half_angle for row in cap_dimensions(loaded, 0.05)])
    file = read(tmp_path / "terrain.prt")
    assert file.manifest["half_angle"] == told
    normals = file.arrays["mesh/normals"].astype(np.float64)
    widths = [smallest_cap(normals[cap.members]) for cap in file.caps]
    # Normals in float32 are of unit length to rounding alone, which angles and chords take differently.
    assert told == pytest.approx(np.median(widths), abs=4.0 * 2.0**-23)
    assert told < math.radians(20.0)


def test_older_files_do_not_tell(packed, tmp_path):
    """And whoever saves them again has it."""
    old = Contents(packed._contents.path)
    manifest = {name: value for name, value in old.manifest.items() if name != "half_angle"}
    write(tmp_path / "old.prt", manifest, old.arrays())
    loaded = sp.load(tmp_path / "old.prt")
    assert loaded.typical_half_angle is None
    loaded.save(tmp_path / "again.prt")
    assert sp.load(tmp_path / "again.prt").typical_half_angle == packed.typical_half_angle


@pytest.mark.parametrize("half_angle", [math.nan, -0.1, 3.2, "wide", None, [0.1]])
def test_half_angles_that_are_none(packed, tmp_path, half_angle):
    contents = Contents(packed._contents.path)
    spoiled = pack({**contents.manifest, "half_angle": half_angle}, contents.arrays())
    (tmp_path / "spoiled.prt").write_bytes(spoiled)
    with pytest.raises(sp.UserError, match=r"spoiled\.prt: .* \(.*\); precompute it again$"):
        sp.load(tmp_path / "spoiled.prt", check=False)


def test_counts_in_words():
    assert describe_count(6, math.radians(13.24)) == "6 concentrations above 0.01 in caps of 13.2 degrees"
    assert describe_count(1, math.radians(0.5)) == "1 concentration above 0.01 in caps of 0.5 degrees"
    assert describe_count(0, math.radians(0.02)) == "no concentration above 0.01 in caps of 0.02 degrees"
    assert describe_count(0, 1e-7) == "no concentration above 0.01 in caps of one normal"
