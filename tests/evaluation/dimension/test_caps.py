"""The caps of a file: counts against those of the concentration problem, dimensions against singular values."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

import slepian_prt as sp
from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.evaluation.dimension.caps import cap_dimensions, count_concentrations
from tests.conftest import bumpy


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


def test_a_typical_cap_is_told_without_decoding(packed, tmp_path):
    """Of sites that of their cells, which the few normals here do not fill; of what the file holds, exactly."""
    true = float(np.median([cap.half_angle for cap in packed.clusters.caps]))
    assert "mesh" not in vars(sp.load(packed._contents.path))
    told = sp.load(packed._contents.path).typical_half_angle
    assert true < told < 1.3 * true
    patches = sp.compress(
        sp.precompute(bumpy(2), bandlimit=2, samples=16), tolerance=0.1, clusters=6, group_by="surface"
    )
    patches.save(tmp_path / "patches.prt")
    loaded = sp.load(tmp_path / "patches.prt")
    assert loaded.typical_half_angle == patches.typical_half_angle
    assert "clusters" not in vars(loaded)
