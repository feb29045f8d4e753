"""What a relit camera sees of surfaces with receivers on both sides."""

from dataclasses import replace

import numpy as np
import pytest

from slepian_prt.relighting.drawing.camera import back_vertices, is_back, relit_camera
from slepian_prt.scene.mesh import make_mesh
from slepian_prt.scene.scene import Part
from slepian_prt.scene.view import Aim
from slepian_prt.transport.transfer import precompute
from tests.numerics import assert_exact

SHEET = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])


@pytest.fixture(scope="module")
def sheet():
    """A square of which each side has vertices of its own, as a scene has it, beside one with a front alone."""
    beside = SHEET + [3.0, 0, 0]
    mesh = make_mesh(np.vstack([SHEET, SHEET, beside]), np.vstack([FACES, FACES[:, ::-1] + 4, FACES + 8]))
    transfer = precompute(mesh, bandlimit=1, samples=16)
    return replace(transfer, parts=(Part("sheet", 0, 4, sides=2), Part("beside", 8, 4)))


def test_backs_are_those_behind_fronts(sheet):
    assert_exact(back_vertices(sheet.parts, 12), [4, 5, 6, 7, *[-1] * 8], "indices")
    assert_exact(is_back(sheet.parts, sheet.mesh.faces), [False, False, True, True, False, False], "comparisons")


@pytest.mark.parametrize(("eye", "side"), [(5.0, 0.25), (-5.0, 0.75)])
def test_each_side_shows_its_own_light(sheet, eye, side):
    radiance = np.repeat([0.25, 0.75, 0.5], 4)[:, None] * np.ones((12, 3))
    picture = relit_camera(sheet, 32, Aim(((0.0, 0.0, eye), (0.0, 0.0, 0.0)), 10.0)).picture(radiance)
    # 25 rays whose weights sum to one in float32.
    np.testing.assert_allclose(picture.radiance, side, rtol=1e-5)
    np.testing.assert_allclose(picture.alpha, 1.0, rtol=1e-5)


def test_the_back_of_a_surface_with_one_side_is_left_out(sheet):
    camera = relit_camera(sheet, 32, Aim(((3.0, 0.0, -5.0), (3.0, 0.0, 0.0)), 10.0))
    assert not camera.alpha.any()
    np.testing.assert_allclose(camera.behind, 1.0, rtol=1e-5)
