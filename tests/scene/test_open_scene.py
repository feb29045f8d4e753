"""What `open_scene` is asked beside the file: hard edges."""

import numpy as np
import pytest
import trimesh

from slepian_prt.errors import UserError
from slepian_prt.scene.loading import open_scene
from tests.conftest import sphere


@pytest.fixture
def cube(tmp_path):
    """A cube of eight vertices, as a file without normals."""
    trimesh.creation.box().export(tmp_path / "cube.off")
    return tmp_path / "cube.off"


@pytest.mark.parametrize(("angle", "vertices"), [(None, 8), (180.0, 8), (91.0, 8), (89.0, 24), (0.0, 24)])
def test_edges_sharper_than_an_angle_are_hard(angle, vertices, cube):
    """Faces of a cube meet at 90°: then each corner stands once for each of its three faces."""
    with open_scene(cube, crease_angle=angle) as scene:
        normals = scene.mesh.normals
        assert len(normals) == vertices
    largest = np.abs(normals).max(axis=1)
    np.testing.assert_allclose(largest, 1.0 if vertices == 24 else 1.0 / np.sqrt(3.0), atol=1e-12)


@pytest.mark.parametrize("angle", [-1.0, 181.0, float("nan")])
def test_angles_that_make_no_sense(angle, cube):
    with (
        pytest.raises(UserError, match=r"^crease_angle must be a number of degrees in \[0, 180\]"),
        open_scene(cube, crease_angle=angle),
    ):
        pass


def test_where_normals_are_known(tmp_path):
    (tmp_path / "scene.xml").write_text(
        '<scene version="3.0.0"><shape type="cube"><bsdf type="diffuse"/></shape></scene>'
    )
    for scene, message in (
        (tmp_path / "scene.xml", r"scene\.xml: its shapes say themselves .*; leave out the crease angle"),
        (sphere(1), r"sphere: a mesh in memory has normals; leave out the crease angle"),
        (trimesh.creation.box(), r"a mesh in memory has normals; leave out the crease angle"),
    ):
        with pytest.raises(UserError, match=message), open_scene(scene, crease_angle=30.0):
            pass
