"""Normals that are computed are those of the source, and those that are stored are near them."""

import numpy as np
import pytest

from slepian_prt.compression.stored_mesh import surface_normals
from slepian_prt.compression.stored_mesh.surface_normals import Surface, computed_normals, pack_normals, unpack_normals
from slepian_prt.scene.normals import angle_weighted_normals
from tests.compression.stored_mesh.meshes import soup, turned_by
from tests.conftest import bumpy


def test_the_arc_cosine_is_within_its_bound():
    x = np.linspace(-1.0, 1.0, 200_001)
    assert np.abs(surface_normals._acos(x) - np.arccos(x)).max() <= 2.3e-8
    assert surface_normals._acos(np.array([1.0 + 1e-15, -1.0 - 1e-15])) == pytest.approx([0.0, np.pi], abs=1e-7)


@pytest.mark.parametrize("scale", [1.0, 1e-9, 1e9])
def test_computed_normals_are_weighted_by_angle(scale, rng):
    for mesh in (bumpy(3), soup(rng)):
        ours = computed_normals(mesh.positions * scale, mesh.faces)
        theirs = angle_weighted_normals(mesh.positions * scale, mesh.faces)
        # Sums of faces that all but cancel are as far off as they are short; a soup has such.
        far = np.linalg.norm(ours - theirs, axis=1) > 2e-7
        assert far.mean() <= (0.0 if mesh.positions.shape[0] == 642 else 0.2)


def test_octahedral_points_are_within_their_bound(rng):
    normals = rng.normal(size=(100_000, 3))
    normals = np.concatenate(
        [normals, np.eye(3), -np.eye(3), [[1.0, 1.0, 0.0], [-1.0, 0.0, -1.0], [1e-9, -1.0, -1e-9]]]
    )
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    back = surface_normals._from_octahedron(surface_normals._to_octahedron(normals))
    assert turned_by(back, normals).max() <= 0.06
    assert np.abs(np.linalg.norm(back, axis=1) - 1.0).max() <= 1e-15


@pytest.mark.parametrize("degrees", [0.2, 0.3])
def test_what_is_near_enough_is_not_stored(degrees):
    mesh = bumpy(3)
    places = mesh.positions
    own = computed_normals(places, mesh.faces)
    across = np.cross(own, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    angle = np.radians(degrees)
    leaning = np.cos(angle) * own + np.sin(angle) * across
    surface = Surface(places, mesh.faces, np.zeros(len(places), dtype=np.int64))
    arrays = pack_normals(leaning, surface, exact=False)
    assert ("mesh/normals" in arrays) == (degrees > 0.25)
    assert turned_by(unpack_normals(arrays, surface, exact=False), leaning).max() <= (
        0.2001 if degrees < 0.25 else 0.06
    )
