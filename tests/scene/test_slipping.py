"""Rays that slip between triangles: how many at most, by counting them, and where none may."""

import re
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.stats import poisson

from slepian_prt.scene.loading import open_scene
from slepian_prt.scene.mesh import make_mesh
from slepian_prt.scene.slipping import find_slipping, too_many_slip
from slepian_prt.transport.survey import Survey
from tests.hard.test_geometry import bumpy, grid, inside_out, joined, sphere

RAYS = 1 << 22


def out_of(scene, center=(0.0, 0.0, 0.0), radius=0.2) -> int:
    """How many of RAYS rays leave a closed shape that they start in, within a ball of its own units."""
    import drjit as dr

    mi = scene.mi
    dice = mi.PCG32(RAYS, 5)
    first, second, third = (mi.Point2f(dice.next_float32(), dice.next_float32()) for _ in range(3))
    start = mi.warp.square_to_uniform_sphere(first) * dr.cbrt(third.x) * radius / scene.scale
    middle = mi.Point3f(((np.array(center) - scene.origin) / scene.scale).tolist())
    ray = mi.Ray3f(middle + start, mi.warp.square_to_uniform_sphere(second))
    return int(np.count_nonzero(~np.array(scene.geometry.ray_test(ray))))


def cylinder(sections: int):
    """Needles all around, and two fans of them."""
    shape = trimesh.creation.cylinder(0.5, 1.0, sections=sections)
    return make_mesh(np.array(shape.vertices), np.array(shape.faces))


@pytest.mark.parametrize(
    "mesh", [sphere(2), sphere(6), cylinder(100), cylinder(3000)], ids=["coarse", "fine", "wedges", "needles"]
)
def test_no_more_slip_than_is_said(mesh):
    """Also where robust mode would be chosen; in that mode none does. Less likely by chance than 1e-6."""
    with open_scene(mesh) as scene:
        expected = RAYS * find_slipping(scene).mean()
        assert out_of(replace(scene, robust=False)) <= poisson.ppf(1.0 - 1e-6, expected)
        assert out_of(replace(scene, robust=True)) == 0


@pytest.mark.parametrize(("sections", "robust"), [(1000, False), (30_000, True)])
def test_needles_that_are_too_thin(sections, robust):
    with open_scene(cylinder(sections)) as scene:
        assert scene.is_robust == robust


@pytest.mark.parametrize(("floor", "robust"), [(10.0, False), (1e3, True), (1e6, True)])
def test_a_model_on_a_floor(floor, robust):
    """Its own rays find it through rounding of the size of the floor; in robust mode none leaves a ball on it."""
    ball = sphere(4)
    ground, triangles = grid(4, floor)
    p, f = joined((ball.positions + [0.0, 0.0, 1.0], ball.faces), (ground, triangles))
    with open_scene(make_mesh(p, f)) as scene:
        assert scene.is_robust == robust
        leaks = out_of(scene, center=(0.0, 0.0, 1.0))
        assert leaks <= (0 if robust else poisson.ppf(1.0 - 1e-6, RAYS * scene.slipping.mean()))


def test_both_sides_of_the_decision():
    """A little more everywhere is too much, and so is much at one vertex."""
    few = np.full(1000, 0.9e-5)
    assert not too_many_slip(few)
    assert too_many_slip(few * 1.2)
    few[3] = 0.9e-4
    assert not too_many_slip(few)
    few[3] = 1.1e-4
    assert too_many_slip(few)


def test_interiors_are_traced_in_robust_mode():
    """However coarse; and where rays start is not found anew."""
    with open_scene(inside_out(sphere(3))) as room, open_scene(bumpy(3)) as model:
        assert not room.is_robust
        traced = Survey.of(room)
        assert traced.scene.is_robust
        assert traced.scene.ray_origins is room.ray_origins
        assert "none slips between triangles" in traced.plan(2, 64).shadows.reason
        assert out_of(traced.scene, radius=0.5) == 0
        reason = Survey.of(model).plan(2, 64).shadows.reason
        said = int(re.search(r"fewer than one in ([\d,]+) slips", reason).group(1).replace(",", ""))
        assert said <= 1.0 / model.slipping.mean() < 2.0 * said


def test_scenes_of_shapes_are_traced_in_robust_mode(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text('<scene version="3.0.0"><shape type="sphere"><bsdf type="diffuse"/></shape></scene>')
    with open_scene(path) as scene:
        assert scene.is_robust
