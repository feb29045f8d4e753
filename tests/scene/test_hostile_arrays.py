"""Meshes given from Python that are none: one line, without warnings."""

import numpy as np
import pytest

import slepian_prt as sp
from slepian_prt.errors import UserError
from slepian_prt.scene.trimesh_objects import mesh_from_trimesh

trimesh = pytest.importorskip("trimesh")

POSITIONS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=np.float64)
FACES = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])


def with_first(value):
    positions = POSITIONS.copy()
    positions[0, 0] = value
    return positions


BAD_POSITIONS = {
    "NaN": (with_first(np.nan), "1 vertices have NaN or infinite"),
    "infinite": (with_first(np.inf), "1 vertices have NaN or infinite"),
    "large": (with_first(1e70), "coordinates above 1e"),
    "of two": (POSITIONS[:, :2], r"the shape \(4, 2\)"),
    "of four": (np.ones((4, 4)), r"the shape \(4, 4\)"),
    "flat": (POSITIONS.ravel(), r"the shape \(12,\)"),
    "stacked": (POSITIONS[None], r"the shape \(1, 4, 3\)"),
    "objects": (np.full((4, 3), None, dtype=object), "must be real numbers"),
    "text": (np.full((4, 3), "a"), "must be real numbers"),
    "complex": (POSITIONS * 1j, "must be real numbers"),
}
BAD_FACES = {
    "of four": (np.ones((2, 4), dtype=int), r"the shape \(2, 4\)"),
    "of two": (np.ones((2, 2), dtype=int), r"the shape \(2, 2\)"),
    "flat": (FACES.ravel(), r"the shape \(12,\)"),
    "stacked": (FACES[None], r"the shape \(1, 4, 3\)"),
    "one number": (np.array(3), r"the shape \(1?,?\)"),
    "huge": (np.full((1, 3), 10**12), "vertices that do not exist"),
    "beyond int64": (np.full((1, 3), 2**63, dtype=np.uint64), "must be whole numbers"),
    "negative": (-FACES - 1, "vertices that do not exist"),
    "fractions": (FACES + 0.5, "must be whole numbers"),
    "NaN": (np.full((1, 3), np.nan), "must be whole numbers"),
    "objects": (np.full((1, 3), None, dtype=object), "must be whole numbers"),
}
CASES = [(*case, "vertices") for case in BAD_POSITIONS.values()] + [(*case, "faces") for case in BAD_FACES.values()]
NAMES = [f"positions {name}" for name in BAD_POSITIONS] + [f"faces {name}" for name in BAD_FACES]


@pytest.mark.parametrize(("values", "message", "which"), CASES, ids=NAMES)
def test_what_is_no_mesh_is_refused(values, message, which, recwarn):
    """Arrays, and an object of trimesh that was changed behind its back, alone and in a scene."""
    arrays = (values, FACES) if which == "vertices" else (POSITIONS, values)
    with pytest.raises(UserError, match=message):
        sp.make_mesh(*arrays)
    changed = trimesh.Trimesh(POSITIONS, FACES, process=False)
    scene = trimesh.Scene(changed)
    for thing in (changed, scene):
        held = thing if thing is changed else next(iter(scene.geometry.values()))
        held._data[which] = values
        if held._data[which].dtype.kind != "O" or which == "faces":  # trimesh's own floats: of None, NaN
            with pytest.raises(UserError, match=message):
                mesh_from_trimesh(thing)
    assert not recwarn.list


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e200])
def test_scenes_of_trimesh_that_put_meshes_nowhere(value, recwarn):
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.Trimesh(POSITIONS, FACES, process=False), transform=np.diag([value, 1, 1, 1]))
    with pytest.raises(UserError, match=r"NaN or infinite|coordinates above"):
        mesh_from_trimesh(scene)
    assert not [warning for warning in recwarn.list if "trimesh" not in warning.filename]


@pytest.mark.parametrize("normals", [np.ones((3, 3)), np.ones((4, 2)), np.full((4, 3), np.nan)])
def test_normals_that_trimesh_holds_and_that_are_none(normals):
    changed = trimesh.Trimesh(POSITIONS, FACES, process=False)
    assert changed.vertex_normals.shape == (4, 3)
    changed._cache.cache["vertex_normals"] = normals
    expected = sp.make_mesh(POSITIONS, FACES).normals
    np.testing.assert_allclose(mesh_from_trimesh(changed).normals, expected, atol=1e-12)


@pytest.mark.parametrize("albedo", [np.nan, -0.1, np.inf, np.ones((4, 2)), np.ones((5, 3)), np.ones((1,) * 9)])
def test_albedos_that_are_none(albedo):
    with pytest.raises(UserError, match="albedo"):
        sp.make_mesh(POSITIONS, FACES, albedo=albedo)


def test_one_face_may_stand_alone():
    assert len(sp.make_mesh(POSITIONS, [0, 1, 2]).faces) == 1
