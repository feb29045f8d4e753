"""What rays meet, without Mitsuba's virtual calls: the same as Mitsuba says."""

import numpy as np
import pytest

from slepian_prt.scene.face_table import interactions
from slepian_prt.scene.loading import open_scene
from slepian_prt.transport.transfer import precompute
from tests.numerics import assert_exact, assert_rounded

PLACED = '<transform name="to_world"><rotate y="1" angle="20"/><translate x="{}" y="0" z="{}"/></transform>'
DIFFUSE = '<bsdf type="diffuse"/>'
FLOOR = f'<shape type="rectangle" id="floor"><transform name="to_world"><scale value="6"/></transform>{DIFFUSE}</shape>'
FLIPPED = '<boolean name="flip_normals" value="true"/>'
MIRROR = '<bsdf type="conductor"/>'
LAMP = '<emitter type="area"><rgb name="radiance" value="3"/></emitter>'
# A cube with its faces inward, one with them outward, a mirror ball turned inside out, and a lamp.
BODY = (
    f'{FLOOR}<shape type="cube" id="inward">{PLACED.format(-3, 2)}{FLIPPED}{DIFFUSE}</shape>'
    f'<shape type="cube" id="outward">{PLACED.format(0, 2)}{DIFFUSE}</shape>'
    f'<shape type="sphere" id="mirror">{PLACED.format(3, 2)}{FLIPPED}{MIRROR}</shape>'
    f'<shape type="sphere" id="lamp">{PLACED.format(0, 5)}{LAMP}</shape>'
)
INSTANCES = (
    '<shape type="shapegroup" id="g"><shape type="sphere"><float name="radius" value="0.1"/><bsdf type="{}"/></shape>'
    "</shape>"
) + "".join(
    f'<shape type="instance"><ref id="g"/><transform name="to_world"><translate x="{x}" y="1.5" z="0.2"/></transform>'
    "</shape>"
    for x in range(-5, 6)
)


def write(folder, body: str):
    path = folder / "scene.xml"
    path.write_text(f'<scene version="3.0.0">{body}</scene>')
    return path


@pytest.fixture
def rays(tmp_path, rng):
    with open_scene(write(tmp_path, BODY + INSTANCES.format("dielectric"))) as scene:
        mi = scene.mi
        begin, end = rng.uniform([-5, -2, 0.1], [5, 2, 6], (2, 20_000, 3))
        way = (end - begin) / np.linalg.norm(end - begin, axis=1, keepdims=True)
        ray = mi.Ray3f(mi.Point3f(begin.T.astype(np.float32)), mi.Vector3f(way.T.astype(np.float32)))
        yield scene, ray, scene.geometry.ray_intersect_preliminary(ray), scene.geometry.ray_intersect(ray)


def test_normals_of_faces_are_those_that_mitsuba_has(rays):
    scene, _, met, right = rays
    face = scene.hit_faces(met)
    held = np.array(face) >= 0
    assert 0.3 < held.mean() < 0.95
    # Corners are float32 here and there.
    np.testing.assert_allclose(
        np.array(scene.face_table.normals(face)).T[held], np.array(right.n).T[held], atol=1e-4, err_msg="normals"
    )
    no_normals = np.array(scene.face_table.normals(face)).T[~held]
    assert_exact(no_normals, np.zeros_like(no_normals), "nothing was met")


def test_backs_of_meshes_and_of_mirrors(rays):
    scene, ray, met, right = rays
    back = np.array(scene.meets_dark_back(ray, met))
    seen_from_behind = np.einsum("ji,ji->i", np.array(right.n), np.array(ray.d)) > 1e-3
    of_instance = np.array(met.instance != None)  # noqa: E711
    wanted = np.array(met.is_valid()) & seen_from_behind & ~of_instance
    assert 0.02 < wanted.mean() < 0.5
    unsure = np.abs(np.einsum("ji,ji->i", np.array(right.n), np.array(ray.d))) <= 1e-3
    assert np.all((back == wanted) | unsure)


def test_interactions_with_some_shapes(rays):
    scene, ray, met, right = rays
    mi = scene.mi
    lamp = [shape for shape in scene.shapes if shape.is_emitter()]
    mirror = [shape for shape in scene.occluders if shape.id() == "mirror"]
    found = interactions(mi, [*lamp, *mirror], ray, met, mi.RayFlags.All)
    valid = np.array(found.is_valid())
    outside = np.abs(np.array(right.p).T - [3, 0, 2]) > 1.001
    assert valid.sum() > 500
    assert not valid[outside.any(axis=1) & (np.array(right.p.z) < 3.9)].any()  # neither on the mirror nor on the lamp
    for name in ("p", "n", "uv"):
        assert_rounded(np.array(getattr(found, name)).T[valid], np.array(getattr(right, name)).T[valid], 4)
    assert_rounded(np.array(found.t)[valid], np.array(right.t)[valid], 4)
    np.testing.assert_allclose(np.array(found.wi.z)[valid], np.array(right.wi.z)[valid], atol=1e-6)
    assert not np.array(interactions(mi, [], ray, met, mi.RayFlags.All).is_valid()).any()


@pytest.mark.slow
def test_transport_asks_no_shape_by_a_virtual_call(tmp_path, monkeypatch):
    """Each would be traced for every instance, with all shapes again: a minute for a thousand."""
    path = write(tmp_path, BODY + INSTANCES.format("dielectric"))
    with open_scene(path) as scene:
        mi = scene.mi

    def refuse(*_, **__):
        raise AssertionError("a virtual call")

    monkeypatch.setattr(mi.Scene, "ray_intersect", refuse)
    monkeypatch.setattr(mi.PreliminaryIntersection3f, "compute_surface_interaction", refuse)
    transfer = precompute(path, 1, 16)
    assert len(transfer.fixed.names) == 1
