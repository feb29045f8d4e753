"""Textures of Mitsuba materials as vertices hold them, against sums over random points of the faces."""

import math

import numpy as np
import pytest

from slepian_prt.errors import UserError
from slepian_prt.renderer.variants import mitsuba
from slepian_prt.scene.reflectance.materials import diffuse_reflectance, vertex_reflectance

SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])
UP = np.tile([0.0, 0.0, 1.0], (4, 1))
TILES = {"type": "checkerboard", "color0": {"type": "rgb", "value": [0.9, 0.5, 0.2]}, "color1": 0.1}


@pytest.fixture(scope="module")
def mi():
    with mitsuba() as module:
        yield module


def mesh(mi, bsdf, positions=SQUARE, faces=FACES, uv=None, **attributes):
    """A Mitsuba mesh with normals along z."""
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf) if isinstance(bsdf, dict) else bsdf
    shape = mi.Mesh("m", len(positions), len(faces), properties, has_vertex_texcoords=uv is not None)
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = mi.Float(np.float32(positions).ravel())
    parameters["faces"] = mi.UInt32(np.uint32(faces).ravel())
    if uv is not None:
        parameters["vertex_texcoords"] = mi.Float(np.float32(uv).ravel())
    parameters.update()
    for name, values in attributes.items():
        shape.add_attribute(name, 3, np.float32(values).ravel())
    return shape


def held(mi, shape, positions=SQUARE, faces=FACES, **options):
    normals = np.tile([0.0, 0.0, 1.0], (len(positions), 1))
    return vertex_reflectance(mi, shape, positions, normals, faces, "here", **options)


def traced(mi, shape, count: int = 200_000):
    """Albedo at random points of the square by tracing rays to them, with the points (count, 2)."""
    at = np.random.default_rng(5).random((count, 2))
    origin = np.column_stack([at, np.ones(count)]).astype(np.float32)
    scene = mi.load_dict({"type": "scene", "shape": shape})
    si = scene.ray_intersect(mi.Ray3f(mi.Point3f(origin.T), mi.Vector3f(0.0, 0.0, -1.0)))
    return np.array(si.bsdf().eval_diffuse_reflectance(si)).T, at


def hats(at):
    """(count, 4) what interpolation weighs each corner of the square with."""
    x, y = at.T
    below = y <= x
    return np.column_stack(
        [1 - np.maximum(x, y), np.where(below, x - y, 0), np.minimum(x, y), np.where(below, 0, y - x)]
    )


def test_a_texture_is_averaged_around_a_vertex_and_what_that_loses_is_told(mi):
    """Against the points that rays of Mitsuba meet; the standard error of these sums is below 0.3 %."""
    board = {**TILES, "to_uv": mi.ScalarTransform4f().scale([2.2, 1.4, 1.0])}
    shape = mesh(mi, {"type": "diffuse", "reflectance": board}, uv=SQUARE[:, :2])
    found = held(mi, shape)
    true, at = traced(mi, shape)
    weight = hats(at)
    expected = weight.T @ true / weight.sum(axis=0)[:, None]
    np.testing.assert_allclose(found.albedo, expected, atol=0.01)
    missed = true - weight @ found.albedo
    assert found.lost == pytest.approx(math.sqrt((missed**2).sum() / (true**2).sum()), rel=0.01)
    assert found.lost > 0.3


def test_a_mesh_without_coordinates_is_textured_as_mitsuba_does_it(mi):
    shape = mesh(mi, {"type": "diffuse", "reflectance": TILES})
    true, at = traced(mi, shape)
    weight = hats(at)
    np.testing.assert_allclose(held(mi, shape).albedo, weight.T @ true / weight.sum(axis=0)[:, None], atol=0.01)


def test_colours_of_vertices_are_not_blurred(mi, rng):
    colours = rng.random((4, 3))
    bsdf = {"type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": "vertex_color"}}
    found = held(mi, mesh(mi, bsdf, vertex_color=colours))
    np.testing.assert_allclose(found.albedo, colours, atol=1e-5)
    assert found.lost < 1e-3  # the root of the rounding of float32


def test_colours_of_faces_are_averaged_by_area(mi):
    positions = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [-2, 1, 0]])
    bsdf = {"type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": "face_color"}}
    shape = mesh(mi, bsdf, positions, face_color=[[0.8, 0.6, 0.4], [0.2, 0.0, 0.1]])
    first, second = np.array([0.8, 0.6, 0.4]), np.array([0.2, 0.0, 0.1])  # of areas 0.5 and 1.5
    expected = [(first + 3 * second) / 4, first, (first + 3 * second) / 4, second]
    np.testing.assert_allclose(held(mi, shape, positions).albedo, expected, atol=1e-5)


def test_faces_too_narrow_for_attributes_do_not_count(mi):
    """Mitsuba's barycentric coordinates are NaN on the third face."""
    positions = np.vstack([SQUARE, [[0.5, 0.5, 0.0]]])
    faces = np.vstack([FACES, [[0, 4, 2]]])
    bsdf = {"type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": "vertex_color"}}
    shape = mesh(mi, bsdf, positions, faces, vertex_color=np.full((5, 3), 0.25))
    np.testing.assert_allclose(held(mi, shape, positions, faces).albedo[:4], 0.25, atol=1e-5)


def test_each_side_has_its_material(mi):
    bsdf = {"type": "twosided", "front": {"type": "diffuse", "reflectance": TILES}, "back": {"type": "diffuse"}}
    shape = mesh(mi, bsdf, uv=SQUARE[:, :2])
    back = held(mi, shape, side=-1)
    np.testing.assert_allclose(back.albedo, 0.5, rtol=1e-6)
    assert back.lost < 1e-6
    assert held(mi, shape).lost > 0.1
    values = diffuse_reflectance(mi, shape, SQUARE, UP, FACES, "here", side=-1)
    np.testing.assert_allclose(values, back.albedo, rtol=1e-6)


@pytest.mark.parametrize(
    ("value", "message"), [(math.nan, "negative or not finite"), (-0.5, "negative or not finite"), (1.5, "more than 1")]
)
def test_textures_that_are_no_reflectance(value, message, mi):
    bsdf = {"type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": "vertex_color"}}
    shape = mesh(mi, bsdf, vertex_color=np.full((4, 3), value))
    with pytest.raises(UserError, match=f"here: its reflectance is .*{message}"):
        held(mi, shape)


def test_the_same_bits_each_time(mi):
    shape = mesh(mi, {"type": "plastic", "diffuse_reflectance": TILES}, uv=SQUARE[:, :2])
    first, second = held(mi, shape), held(mi, shape)
    assert first.albedo.tobytes() == second.albedo.tobytes()
    assert first.lost == second.lost
