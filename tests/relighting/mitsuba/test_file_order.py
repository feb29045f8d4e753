"""Shapes of a scene are found by a file that numbers vertices otherwise, wherever they were moved."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

import slepian_prt as sp
from slepian_prt.relighting.mitsuba.shape_matching import match_shapes
from slepian_prt.scene.mesh import make_mesh
from tests.conftest import bumpy
from tests.numerics import assert_exact


def in_mitsuba(mi, mesh, name: str, moved=None):
    shape = mi.Mesh(name, len(mesh.positions), len(mesh.faces))
    parameters = mi.traverse(shape)
    positions = mesh.positions if moved is None else moved(mesh.positions)
    parameters["vertex_positions"] = mi.Float(positions.astype(np.float32).ravel())
    parameters["faces"] = mi.UInt32(mesh.faces.astype(np.uint32).ravel())
    parameters.update()
    return shape


def with_seam(mesh):
    """The same surface, parted along a plane: vertices there are two of one place."""
    upper = mesh.positions[mesh.faces].mean(axis=1)[:, 1] > 0.0
    both = np.intersect1d(mesh.faces[upper], mesh.faces[~upper])
    number = np.arange(len(mesh.positions))
    number[both] = len(mesh.positions) + np.arange(len(both))
    faces = mesh.faces.copy()
    faces[upper] = number[faces[upper]]
    more = np.concatenate([np.arange(len(mesh.positions)), both])
    return make_mesh(mesh.positions[more], faces, normals=mesh.normals[more], name=mesh.name)


def turned(positions):
    angle = np.radians(50.0)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    return 3.0 * positions @ turn.T + [10.0, -4.0, 2.0]


@pytest.mark.parametrize("moved", [None, turned])
@pytest.mark.parametrize("seam", [False, True])
def test_each_face_has_its_own_vertices(seam, moved, mi, tmp_path):
    """Also where two vertices are at one place, and faces of the scene start with another corner."""
    mesh = replace(bumpy(2), name="bumpy")
    mesh = with_seam(mesh) if seam else mesh
    packed = sp.compress(sp.precompute(mesh, bandlimit=1, samples=16, effects="none"), clusters=2)
    packed.save(tmp_path / "bumpy.prt")
    read = sp.load(tmp_path / "bumpy.prt")
    assert np.any(packed.stored.order != np.arange(len(mesh.positions)))
    scene = mi.load_dict({"type": "scene", "bumpy": in_mitsuba(mi, mesh, "bumpy", moved)})
    (matched,) = match_shapes(mi, scene, read, "bumpy.prt").meshes
    assert_exact(packed.stored.order[matched.faces], mesh.faces, because="integers")
    (in_memory,) = match_shapes(mi, scene, packed, "bumpy").meshes
    assert_exact(in_memory.faces, mesh.faces, because="integers")


def test_what_was_changed_since_is_refused(mi, tmp_path):
    mesh = replace(bumpy(2), name="bumpy")
    sp.compress(sp.precompute(mesh, bandlimit=1, samples=16, effects="none"), clusters=2).save(tmp_path / "bumpy.prt")
    read = sp.load(tmp_path / "bumpy.prt")
    dented = mesh.positions.copy()
    dented[np.setdiff1d(np.arange(len(dented)), read.stored.entry["pieces"][0]["landmarks"][1])[5]] *= 0.9
    scene = mi.load_dict({"type": "scene", "bumpy": in_mitsuba(mi, replace(mesh, positions=dented), "bumpy")})
    with pytest.raises(sp.UserError, match=r"bumpy\.prt: shape 'bumpy' of the scene .* changed since"):
        match_shapes(mi, scene, read, "bumpy.prt")


def test_surfaces_are_found_though_their_vertices_were_rounded(mi, tmp_path):
    """A tilted plane that the file has cut finer: its vertices are off the plane by half a step of 1/65,535."""
    square = np.array([[-1.0, 0.0, -1.0], [-1.0, 0.0, 1.0], [1.0, 0.0, 1.0], [1.0, 0.0, -1.0]])
    cut, faces = trimesh.remesh.subdivide(*trimesh.remesh.subdivide(square, np.array([[0, 1, 2], [0, 2, 3]])))
    tilt = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    mesh = make_mesh(cut @ tilt.T, faces, name="sheet")
    packed = sp.compress(sp.precompute(mesh, bandlimit=1, samples=16, effects="none"), clusters=1)
    packed.save(tmp_path / "sheet.prt")
    coarse = make_mesh(mesh.positions[:4], [[0, 1, 2], [0, 2, 3]])
    scene = mi.load_dict({"type": "scene", "sheet": in_mitsuba(mi, coarse, "sheet")})
    (placed,) = match_shapes(mi, scene, sp.load(tmp_path / "sheet.prt"), "sheet.prt").by_place
    off = np.abs((packed.mesh.positions @ tilt)[:, 1]).max()
    assert off > 64.0 * np.spacing(np.float32(1.0))  # more than rounding to float32 would explain
    assert off <= placed.moved < placed.reach <= 10.0 * off
