"""What a relit camera sees: surfaces with receivers on both sides, and with few rays what many would show."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from slepian_prt.relighting.drawing import camera
from slepian_prt.relighting.drawing.camera import back_vertices, is_back, relit_camera, relit_view
from slepian_prt.relighting.drawing.pixel_rays import widened
from slepian_prt.scene.loading import open_scene
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


@pytest.mark.parametrize("aim", [Aim(), Aim(((0.0, 1.0, 5.0), (0.0, 0.0, 0.0)), 20.0), Aim(up="z")], ids=str)
def test_the_view_is_that_which_is_traced(sheet, aim, monkeypatch):
    traced = []
    monkeypatch.setattr(camera, "trace_camera", lambda scene, *_args, **_options: traced.append(scene.view))
    relit_camera(sheet, 64, aim)
    assert traced == [relit_view(sheet, aim, 64)]


def many_rays(camera_scene, **options):
    """The same camera with hundreds of rays through every pixel, as an independent reference has them."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(camera.FilmFilter, "middle_weight", None)
        return camera.trace_camera(camera_scene, strata=20, **options)


@pytest.fixture(scope="module")
def things():
    """A ball before a larger one, a cube of hard edges, and a thin rod."""
    ball = trimesh.creation.icosphere(4)
    behind = trimesh.creation.icosphere(4, radius=1.6).apply_translation([0.6, 0.4, -3.0])
    cube = trimesh.creation.box([1, 1, 1]).apply_transform(trimesh.transformations.rotation_matrix(0.7, [1, 1, 0.3]))
    cube.apply_translation([2.2, -1.0, 0.0])
    rod = trimesh.creation.cylinder(0.01, 4.0).apply_transform(
        trimesh.transformations.rotation_matrix(1.2, [1, 0.4, 0])
    )
    rod.apply_translation([-1.8, 0.0, 0.0])
    cube = trimesh.Trimesh(cube.triangles.reshape(-1, 3), np.arange(36).reshape(-1, 3), process=False)
    parts = [(np.array(part.vertices), np.array(part.faces)) for part in (ball, behind, cube, rod)]
    firsts = np.cumsum([0, *(len(vertices) for vertices, _ in parts[:-1])])
    positions = np.concatenate([vertices for vertices, _ in parts])
    faces = np.concatenate([faces + first for first, (_, faces) in zip(firsts, parts, strict=True)])
    mesh = make_mesh(positions, faces)
    with open_scene(mesh) as scene:
        yield camera.aim_camera(scene, Aim(((0.5, 0.0, 9.0), (0.3, 0.0, 0.0)), 40.0), 120)


@pytest.mark.slow
def test_few_rays_show_what_many_do(things):
    """Edges of one thing before another, of a cube and of a rod far thinner than a pixel: nothing is missed."""
    few, many = camera.trace_camera(things), many_rays(things)
    x, y, z = things.mesh.positions.T
    radiance = np.stack([1.0 + 0.5 * np.sin(2.0 * x), 1.0 + 0.5 * np.sin(2.0 * y), 1.0 + 0.5 * np.sin(2.0 * z)], axis=1)
    # Whatever stands before another thing is of another colour.
    radiance[z < -1.2] *= 0.2
    ours, theirs = few.picture(radiance), many.picture(radiance)
    alpha_error, error = ours.alpha - theirs.alpha, ours.radiance - theirs.radiance
    # A pixel on an edge has 36 rays, in strata: a standard deviation of about 0.03, of 0.07 on a rod so thin.
    assert np.sqrt(np.mean(alpha_error**2)) <= 0.006
    assert np.abs(alpha_error).max() <= 0.28
    assert np.sqrt(np.mean(error**2)) <= 0.01
    assert np.abs(error).max() <= 1.5 * 0.28
    # No edge is drawn in or out, and nothing is lost.
    assert abs(alpha_error.mean()) <= 3e-4
    assert np.all(ours.alpha[theirs.alpha > 0.1] > 0.0)
    assert_exact(ours.alpha[theirs.alpha == 0.0], 0.0, "nothing is there")
    whole = theirs.alpha > 1.0 - 1e-5
    np.testing.assert_allclose(ours.alpha[whole], 1.0, rtol=0.0, atol=1e-5)
    # Inside, but for the edges of one thing before another, there is no speckle.
    assert np.mean(np.abs(error[whole]).max(axis=1) < 0.01) > 0.93
    assert np.sqrt(np.mean(error[whole] ** 2)) < 0.01


def test_few_rays_are_few(things, monkeypatch):
    """Most of a picture has nothing that ends in it."""
    traced = []
    meet = camera.CameraRays._meet

    def counted(self, x, y):
        traced.append(x.numpy().size)
        return meet(self, x, y)

    monkeypatch.setattr(camera.CameraRays, "_meet", counted)
    found = camera.trace_camera(things)
    assert sum(traced) < 0.5 * 25 * found.alpha.size


def test_rows_of_a_camera_sum_to_its_coverage(things):
    found = camera.trace_camera(things)
    sums = np.asarray(found.weights[0].sum(axis=1)).reshape(found.alpha.shape)
    np.testing.assert_allclose(sums, found.alpha, rtol=0.0, atol=1e-5)
    assert found.alpha.max() <= 1.0
    assert not found.behind.any()
    np.testing.assert_allclose(np.linalg.norm(found.directions, axis=2), 1.0, rtol=1e-6)


def test_masks_are_widened_by_their_reach():
    mask = np.zeros((5, 7), dtype=bool)
    mask[0, 0] = mask[3, 4] = True
    wide = widened(mask, 1)
    rows, columns = np.nonzero(mask)
    near = [[bool(np.any((abs(rows - r) <= 1) & (abs(columns - c) <= 1))) for c in range(7)] for r in range(5)]
    assert_exact(wide, near, "comparisons")
    assert_exact(widened(mask, 0), mask, "copied")


def test_an_edge_before_a_parallel_plane_is_an_edge():
    """The part of each pixel that a sheet covers of another, which is turned the same way, by its place alone."""
    front, behind = SHEET * [0.537, 1.0, 1.0], SHEET * [3.0, 3.0, 1.0] - [0.0, 0.0, 0.4]
    mesh = make_mesh(np.vstack([front, behind]), np.vstack([FACES, FACES + 4]))
    eye, pixels, angle = 5.0, 32, 20.0
    with open_scene(mesh) as scene:
        aimed = camera.aim_camera(scene, Aim(((0.0, 0.0, eye), (0.0, 0.0, 0.0)), angle), pixels)
        seen = camera.trace_camera(aimed, pixels)
    picture = seen.picture(np.repeat([1.0, 0.0], 4)[:, None] * np.ones((8, 3)))
    np.testing.assert_allclose(picture.alpha, 1.0, rtol=0.0, atol=1e-5)
    middle = len(picture.radiance) // 2
    row = picture.radiance[middle - 4 : middle + 4, :, 0].mean(axis=0)
    edges = np.linspace(-1.0, 1.0, pixels + 1) * eye * np.tan(np.radians(0.5 * angle))
    covered = np.clip((0.537 - edges[:-1]) / np.diff(edges), 0, 1) - np.clip(
        (-0.537 - edges[:-1]) / np.diff(edges), 0, 1
    )
    assert np.count_nonzero((covered > 0.05) & (covered < 0.95)) == 2
    # Of 36 rays six lie in strata that the edge goes through: a standard deviation of 0.034, of 8 rows 0.012.
    np.testing.assert_allclose(row, covered, rtol=0.0, atol=4 * 0.012)
