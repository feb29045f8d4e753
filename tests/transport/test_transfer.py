"""Transfer vectors against closed forms and brute force."""

import math

import numpy as np
import pytest
import trimesh

from slepian_prt.errors import UserError
from slepian_prt.scene.loading import open_scene
from slepian_prt.scene.mesh import Mesh, make_mesh
from slepian_prt.slepian.kernels import cosine_lobe
from slepian_prt.sphere.harmonics import degrees, real_sh
from slepian_prt.sphere.quadrature import spherical_fibonacci
from slepian_prt.transport.transfer import precompute
from slepian_prt.transport.visibility import shadowed_vertices
from tests.conftest import bumpy, inside_out, sphere
from tests.numerics import assert_exact, assert_rounded

AMBIENT = math.sqrt(4 * math.pi)  # the lighting coefficient of a constant environment of radiance 1


def test_convex_mesh_is_exact_and_traces_no_ray():
    mesh = sphere(4)
    transfer = precompute(mesh, bandlimit=8, samples=64)
    assert transfer.rays_traced == 0
    expected = real_sh(8, mesh.normals) * cosine_lobe(8)[degrees(8)]
    np.testing.assert_allclose(transfer.vectors[:, 0], expected, atol=1e-6)
    np.testing.assert_allclose(transfer.vectors[:, 0, 0] * AMBIENT, 1.0, atol=1e-5)
    assert [e.verdict for e in transfer.effects if e.name == "shadows"] == ["omitted"]


def test_box_with_shared_corners_is_convex_too():
    box = trimesh.creation.box()
    assert precompute(make_mesh(box.vertices, box.faces), bandlimit=2, samples=16).rays_traced == 0


def test_closed_room_is_exactly_black():
    transfer = precompute(inside_out(sphere(3)), bandlimit=6, samples=1024)
    # 1 - (sum of all blocked parts): what is left is rounding of a float32 sum over 1024 directions, plus the
    # quadrature error of the direction set, which has no room to hide here.
    assert np.abs(transfer.vectors[:, 0, 0]).max() * AMBIENT <= 1e-5
    assert np.abs(transfer.vectors).max() <= 2e-3


def test_a_mesh_inside_out_is_remarked_on(caplog):
    with caplog.at_level("INFO"):
        precompute(inside_out(bumpy(3)), bandlimit=1, samples=64)
    assert "faces point inward" in caplog.text
    caplog.clear()
    with caplog.at_level("INFO"):
        precompute(bumpy(3), bandlimit=1, samples=64)
    assert not caplog.text


@pytest.mark.slow
def test_hemispherical_bowl_has_the_known_sky():
    """At the bottom of a hemispherical bowl with rim at 90°, all of the sky is seen; on its wall at polar angle α the
    rim blocks, and the cosine-weighted open part is (1 + cos α)/2 for the vertex at angle α from the bottom."""
    ball = trimesh.creation.icosphere(5)
    faces = ball.faces[(ball.vertices[ball.faces][:, :, 2] <= 1e-9).all(axis=1)]
    bowl = make_mesh(ball.vertices, faces[:, ::-1])
    transfer = precompute(bowl, bandlimit=0, samples=4096)
    used = bowl.receivers.active
    alpha = np.arccos(np.clip(-bowl.positions[used, 2], -1, 1))
    # Inside a sphere every surface element receives equally from every other: the open part is the open area
    # fraction 1/2 of the sphere, at every point (the same closed form that gives the bounces).
    inner = alpha < 1.3  # away from the rim, whose polygon edge is not the circle
    measured = transfer.vectors[used, 0, 0] * AMBIENT
    assert np.abs(measured[inner] - 0.5).max() < 0.03  # facets of 2° and 4096 rays
    assert measured[inner].mean() == pytest.approx(0.5, abs=0.01)


def hits_any(mesh: Mesh, origin: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Möller–Trumbore against all triangles: (n,) True where a ray hits one."""
    a, b, c = (mesh.positions[mesh.faces[:, k]] for k in range(3))
    e1, e2, s = b - a, c - a, origin - a
    q = np.cross(s, e1)
    hit = np.zeros(len(directions), dtype=bool)
    for i, d in enumerate(directions):
        p = np.cross(d, e2)
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = 1.0 / np.einsum("ij,ij->i", e1, p)
            u = np.einsum("ij,ij->i", s, p) * inverse
            v = q @ d * inverse
            t = np.einsum("ij,ij->i", e2, q) * inverse
        hit[i] = np.any((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0))
    return hit


@pytest.mark.slow
def test_brute_force(rng):
    """Visibility by testing every triangle, and a plain sum over uniform directions."""
    mesh = bumpy(3)
    chosen = rng.choice(len(mesh.positions), 12, replace=False)
    directions = spherical_fibonacci(4000)
    harmonics = real_sh(4, directions)
    offset = 1e-4 * np.linalg.norm(np.ptp(mesh.positions, axis=0))
    transfer = precompute(mesh, bandlimit=4, samples=4096)
    for vertex in chosen:
        n = mesh.normals[vertex]
        cosine = np.maximum(directions @ n, 0.0)
        up = cosine > 0
        blocked = np.zeros(len(directions), dtype=bool)
        blocked[up] = hits_any(mesh, mesh.positions[vertex] + offset * n, directions[up])
        expected = (harmonics * (cosine * ~blocked)[:, None]).sum(axis=0) * (4 / len(directions))
        # Both sets are near-uniform: the error is that of the boundary of visibility, about N^-3/4 of the unit signal.
        np.testing.assert_allclose(transfer.vectors[vertex, 0], expected, atol=3 * 4000**-0.75)


@pytest.mark.slow
def test_error_falls_as_rays_are_added():
    mesh = bumpy(3)
    reference = precompute(mesh, bandlimit=6, samples=16384).vectors
    errors = [
        np.linalg.norm(precompute(mesh, bandlimit=6, samples=n, seed=3).vectors - reference) / np.linalg.norm(reference)
        for n in (64, 256, 1024)
    ]
    # A plain Monte Carlo estimate would gain a factor 2 per step; a good direction set gains more.
    assert errors[1] < 0.5 * errors[0]
    assert errors[2] < 0.5 * errors[1]


def test_same_seed_same_rays():
    mesh = bumpy(3)
    first, second, other = (precompute(mesh, bandlimit=5, samples=256, seed=seed) for seed in (7, 7, 8))
    assert first.rays_traced == second.rays_traced != other.rays_traced
    # Of up to 256 rays, and a rotation; vectors are shorter than one.
    assert_rounded(first.vectors, second.vectors, terms=256 + 11, size=1.0)
    assert np.abs(first.vectors - other.vectors).max() > 1e-3


def test_vertices_may_be_reordered(rng):
    """The turns about the normals go by number, so that another order is another seed, and nothing else."""
    mesh = bumpy(3)
    order = rng.permutation(len(mesh.positions))
    shuffled = make_mesh(mesh.positions[order], np.argsort(order)[mesh.faces], normals=mesh.normals[order])
    found = precompute(shuffled, bandlimit=5, samples=256).vectors[np.argsort(order)]
    one, other = (precompute(mesh, bandlimit=5, samples=256, seed=seed).vectors for seed in (0, 1))
    noise = np.linalg.norm(one - other)
    assert noise < 0.05 * np.linalg.norm(one)
    # Squares over some 600 vertices: their sum varies by 6 %, its root by half of that.
    assert np.linalg.norm(found - one) == pytest.approx(noise, rel=0.2)


@pytest.mark.parametrize(("scale", "shift"), [(1e-3, 0.0), (1e4, 0.0), (1.0, 1e4), (1e-3, 5.0)])
def test_scale_and_translation_do_not_matter(scale, shift):
    mesh = bumpy(3)
    moved = make_mesh(mesh.positions * scale + shift * np.array([1.0, -2.0, 0.5]), mesh.faces)
    base, other = (precompute(m, bandlimit=4, samples=256).vectors for m in (mesh, moved))
    # Positions differ by rounding only; a ray that grazes an edge may change its mind.
    changed = np.abs(base - other).max(axis=(1, 2)) > 1e-5
    assert changed.mean() < 0.02
    assert np.linalg.norm(base - other) <= 2e-3 * np.linalg.norm(base)


def test_supporting_planes():
    mesh = bumpy(4)
    with open_scene(mesh) as scene:
        shadowed, limit = shadowed_vertices(scene), 0.5 * scene.ray_heights * scene.scale
    # Brute force over all vertices.
    heights = (mesh.normals @ mesh.positions.T).max(axis=1) - np.einsum("ij,ij->i", mesh.normals, mesh.positions)
    assert_exact(shadowed, heights > limit, because="one or the other, and none is near the limit")
    assert 0 < shadowed.mean() < 1


def test_vertices_without_faces_get_nothing():
    ball = trimesh.creation.icosphere(1)
    mesh = make_mesh(np.concatenate([ball.vertices, [[9.0, 9, 9]]]), ball.faces)
    assert not precompute(mesh, bandlimit=3, samples=16).vectors[-1].any()


def test_single_triangle():
    mesh = make_mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    transfer = precompute(mesh, bandlimit=3, samples=16)
    assert transfer.rays_traced == 0
    np.testing.assert_allclose(transfer.vectors[:, 0, 0] * AMBIENT, 1.0, atol=1e-5)


CORNELL = """<scene version="3.0.0">
  <shape type="sphere" id="ball"><float name="radius" value="0.5"/><bsdf type="diffuse"/></shape>
  <shape type="cube" id="floor"><transform name="to_world"><scale x="3" y="0.1" z="3"/><translate y="-1"/></transform>
    <bsdf type="diffuse"><rgb name="reflectance" value="0.8, 0.4, 0.2"/></bsdf></shape>
  <shape type="cube" id="mirror"><transform name="to_world"><scale value="0.2"/><translate x="2"/></transform>
    <bsdf type="conductor"/></shape>
  <emitter type="constant"/>
</scene>"""


def test_mitsuba_scene(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text(CORNELL)
    transfer = precompute(path, bandlimit=2, samples=1024)
    assert [part.name for part in transfer.parts] == ["ball", "floor"]
    ball, floor = (slice(part.first, part.first + part.count) for part in transfer.parts)
    np.testing.assert_allclose(transfer.mesh.albedo[ball], 0.5, atol=1e-6)
    np.testing.assert_allclose(transfer.mesh.albedo[floor] - np.float32([0.8, 0.4, 0.2]), 0.0, atol=1e-6)
    verdicts = {effect.name.split(" of ")[0]: effect.verdict for effect in transfer.effects}
    assert verdicts["mirror reflection"] == "gathered"
    assert verdicts["mirrors"] == "omitted"  # it is small, and two units away
    # The floor's upper side is flat and open but for the ball and the mirror.
    top = np.zeros(len(transfer.positions), dtype=bool)
    top[floor] = transfer.normals[floor, 1] > 0.99
    ambient = transfer.vectors[top, 0, 0] * AMBIENT
    assert (ambient > 0.68).all()
    assert (ambient < 1.0).any()


@pytest.mark.parametrize(
    "light",
    [
        '<emitter type="point"><point name="position" x="0" y="0" z="3"/></emitter>',
        '<emitter type="directional"/>',
    ],
)
def test_lights_that_are_not_distant_are_named(light, tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text(f'<scene version="3.0.0">{light}<shape type="cube"><bsdf type="diffuse"/></shape></scene>')
    effects = precompute(path, bandlimit=1, samples=16).effects
    assert sum(effect.name.startswith("light of") for effect in effects) == 1


def test_rectangles_are_receivers(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text(
        """<scene version="3.0.0"><shape type="rectangle" id="ground"><transform name="to_world"><scale value="2"/>
        </transform><bsdf type="diffuse"><rgb name="reflectance" value="0.2, 0.8, 0.2"/></bsdf></shape></scene>"""
    )
    transfer = precompute(path, bandlimit=2, samples=16)
    assert len(transfer.positions) > 1000  # cut finely enough to show shadows
    np.testing.assert_allclose(np.abs(transfer.positions[:, :2]).max(axis=0), 2.0, atol=1e-6)
    np.testing.assert_allclose(transfer.normals - [0.0, 0, 1], 0.0, atol=1e-6)
    np.testing.assert_allclose(transfer.mesh.albedo - np.float32([0.2, 0.8, 0.2]), 0.0, atol=1e-6)
    np.testing.assert_allclose(transfer.vectors[:, 0, 0] * AMBIENT, 1.0, atol=1e-5)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("<scene", "Mitsuba cannot load the scene"),
        ('<scene version="3.0.0"></scene>', "nothing in the scene can be lit"),
        (
            '<scene version="3.0.0"><shape type="cube"><bsdf type="conductor"/></shape></scene>',
            r"nothing in the scene can be lit \(mirror reflection of shape 'shape_0' \(metal\)\)",
        ),
        ('<scene version="3.0.0"><shape type="ply"><string name="filename" value="no.ply"/></shape></scene>', "no.ply"),
    ],
)
def test_bad_mitsuba_scenes(content, message, tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text(content)
    with pytest.raises(UserError, match=message) as caught:
        precompute(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"bandlimit": 51}, r"bandlimit must be an integer in \[0, 50\], not 51"),
        ({"samples": 0}, "samples must be an integer"),
        ({"samples": 1.5}, "samples must be an integer"),
    ],
)
def test_bad_numbers(options, message):
    with pytest.raises(ValueError, match=message):
        precompute(sphere(1), **options)


@pytest.mark.slow
def test_ambient_occlusion_of_real_meshes(data):
    """Mean ambient occlusion as measured for the design: skull 0.72, nefertiti 0.95; no vertex of nefertiti black."""
    for name, expected in (("skull", 0.72), ("nefertiti", 0.95)):
        transfer = precompute(data / "meshes" / f"{name}.ply", bandlimit=0, samples=256)
        ambient = transfer.vectors[:, 0, 0] * AMBIENT
        assert ambient.mean() == pytest.approx(expected, abs=0.01)
        assert ambient.max() <= 1.0 + 1e-5
        assert ambient.min() >= -1e-5
