"""Meshes and scenes of trimesh in memory, against the same arrays handed over by hand."""

import subprocess
import sys

import numpy as np
import pytest
import trimesh

import slepian_prt as sp
from slepian_prt.scene.trimesh_objects import is_of_trimesh, mesh_from_trimesh
from tests.numerics import assert_exact, assert_rounded


def ball(subdivisions: int = 1) -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions)


def test_geometry_and_computed_normals():
    """What the object does not hold is ours, and nothing is computed in it."""
    thing = ball()
    mesh = mesh_from_trimesh(thing)
    assert_exact(mesh.positions, thing.vertices, "copied")
    assert_exact(mesh.faces, thing.faces, "copied")
    assert_exact(mesh.normals, sp.make_mesh(thing.vertices, thing.faces).normals, "the same sums of the same numbers")
    assert mesh.notes == ()
    assert not mesh.known_albedo
    assert "vertex_normals" not in thing._cache


def test_normals_that_it_holds(rng):
    thing = ball()
    given = thing.vertices + 0.1 * rng.normal(size=thing.vertices.shape)
    given /= np.linalg.norm(given, axis=1, keepdims=True)
    held = trimesh.Trimesh(thing.vertices, thing.faces, vertex_normals=given, process=False)
    np.testing.assert_allclose(mesh_from_trimesh(held).normals, given, atol=1e-15)
    held.vertices *= 2.0  # after which trimesh no longer holds them
    assert np.abs(mesh_from_trimesh(held).normals - given).max() > 0.01


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_a_scene_stands_as_its_graph_has_it(mirror):
    """Twice the same surface, one turned, stretched and mirrored: by hand, with normals of the stretched ellipsoid."""
    thing = ball(2)
    thing.vertex_normals  # noqa: B018 - from here on it holds them
    turn = trimesh.transformations.rotation_matrix(0.7, [1.0, 2.0, 3.0], [0.5, 0.0, 0.0])
    stretch = np.diag([3.0 * mirror, 1.0, 0.5, 1.0])
    scene = trimesh.Scene()
    scene.add_geometry(thing, geom_name="ball")
    scene.add_geometry(trimesh.creation.box(), geom_name="box", transform=trimesh.transformations.scale_matrix(0.1))
    scene.graph.update(frame_to="other", geometry="ball", matrix=turn @ stretch)
    mesh = mesh_from_trimesh(scene)
    count = len(thing.vertices)
    assert len(mesh.positions) == 2 * count + 8
    assert_exact(mesh.positions[:count], thing.vertices, "times the unit matrix, plus zero")
    placed = np.c_[thing.vertices, np.ones(count)] @ (turn @ stretch).T
    assert_rounded(mesh.positions[-count:], placed[:, :3], terms=8, size=10.0)
    # The gradient of (x/3)² + y² + (z/.5)² on the ellipsoid, turned: outward, whatever the mirror did. Its triangles'
    # normals are those of the ball only to the angle of a facet.
    local = np.array([1.0 / (3.0 * mirror), 1.0, 2.0]) * thing.vertices
    outward = local / np.linalg.norm(local, axis=1, keepdims=True) @ turn[:3, :3].T
    assert np.einsum("ij,ij->i", mesh.normals[-count:], outward).min() > 0.99
    corners = mesh.positions[mesh.faces[-len(thing.faces) :]]
    facets = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    middle = mesh.positions[-count:].mean(axis=0)
    assert np.einsum("ij,ij->i", facets, corners.mean(axis=1) - middle).min() > 0.0


def test_names():
    thing = ball()
    assert mesh_from_trimesh(thing).name == "mesh"
    thing.metadata["file_name"] = "folder/pot.ply"
    assert mesh_from_trimesh(thing).name == "pot"
    thing.metadata["name"] = "teapot"
    assert mesh_from_trimesh(thing).name == "teapot"


def test_the_name_of_its_file(tmp_path):
    ball().export(tmp_path / "globe.ply")
    assert mesh_from_trimesh(trimesh.load(tmp_path / "globe.ply")).name == "globe"


def test_what_is_left_out_is_said(caplog):
    thing = ball()
    thing.visual.vertex_colors = np.full((len(thing.vertices), 4), 128, dtype=np.uint8)
    scene = trimesh.Scene([thing, trimesh.PointCloud(np.eye(3))])
    with caplog.at_level("INFO"):
        mesh = mesh_from_trimesh(scene)
    assert "1 of 2 parts have no faces and are left out" in caplog.text
    assert "its colours and materials are left out; give an `albedo`" in caplog.text
    assert len(mesh.positions) == len(thing.vertices)


def test_objects_without_surfaces_are_refused():
    for thing in (
        trimesh.PointCloud(np.eye(3)),
        trimesh.Scene(),
        trimesh.load_path([[0, 0], [1, 1]]),
        trimesh.Trimesh(),
    ):
        with pytest.raises(sp.UserError, match=r"needs? surfaces|has no vertices") as refused:
            sp.precompute(thing)
        assert "\n" not in str(refused.value)
    for thing in (3, None, [1, 2], np.eye(3)):
        with pytest.raises(sp.UserError, match="must be the path of a file, a Mesh, or a mesh or scene of trimesh"):
            sp.precompute(thing)


def test_transfer_is_that_of_the_arrays():
    thing = trimesh.creation.torus(1.0, 0.4, 12, 8)
    by_hand = sp.precompute(sp.make_mesh(thing.vertices, thing.faces), 3, 64)
    transfer = sp.precompute(thing, 3, 64)
    assert_rounded(transfer.vectors, by_hand.vectors, terms=64, size=1.0)
    assert transfer.source == thing.metadata.get("name", "mesh")
    assert sp.precompute(trimesh.primitives.Box(), 2, 16).rays_traced == 0


def test_classes_derived_from_theirs():
    class Scan(trimesh.Trimesh):
        pass

    assert is_of_trimesh(Scan())
    assert not is_of_trimesh("ball.ply")
    assert not is_of_trimesh(sp.make_mesh(np.eye(3), [[0, 1, 2]]))


def test_trimesh_is_not_imported_for_it():
    code = """
import sys, slepian_prt as sp
sp.precompute(sp.make_mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]), 1, 16)
print("trimesh" in sys.modules)
"""
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.strip() == "False"
