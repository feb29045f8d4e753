"""Scenes as authors have them: merged, renamed, changed since."""

import re
from dataclasses import replace

import numpy as np
import pytest
import trimesh

import slepian_prt as sp
from slepian_prt.lighting.projection import project_environment
from slepian_prt.relighting.relight import relight
from tests.conftest import bumpy, sphere
from tests.numerics import assert_exact, assert_rounded
from tests.relighting.mitsuba.scenes import (
    SPP,
    camera,
    envmap,
    loaded,
    messages,
    packed_of,
    painted,
    picture,
    shape,
    sky,
)
from tests.statistics import assert_near

# --- Scenes ----------------------------------------------------------------------------------------------------------


SCENE = """
<scene version="3.0.0">
  <sensor type="perspective"><float name="fov" value="45"/>
    <transform name="to_world"><lookat origin="1, 3, 5" target="0, 0.5, 0" up="0, 1, 0"/></transform>
    <film type="hdrfilm"><integer name="width" value="40"/><integer name="height" value="40"/>
      <rfilter type="box"/></film></sensor>
  <emitter type="constant"><rgb name="radiance" value="1, 0.9, 0.8"/></emitter>
  <bsdf type="diffuse" id="gray"><rgb name="reflectance" value="0.5"/></bsdf>
  <shape type="rectangle" id="floor"><ref id="gray"/>
    <transform name="to_world"><scale value="2"/><rotate x="1" angle="-90"/></transform></shape>
  <shape type="cube" id="box"><transform name="to_world"><scale value="0.4"/><translate x="-0.7" y="0.4"/></transform>
    <ref id="gray"/></shape>
  <shape type="sphere" id="ball"><point name="center" x="0.6" y="0.5" z="0"/><float name="radius" value="0.5"/>
    <bsdf type="diffuse"><rgb name="reflectance" value="0.2, 0.4, 0.6"/></bsdf></shape>
</scene>
"""


@pytest.mark.slow
@pytest.mark.parametrize("optimize", [True, False])
def test_shapes_with_a_formula_and_merged_ones(optimize, mi, tmp_path):
    """Where transport cut shapes finely, and where Mitsuba merged them: against the path tracer."""
    (tmp_path / "scene.xml").write_text(SCENE)
    packed = sp.compress(sp.precompute(tmp_path / "scene.xml", bandlimit=6, samples=1024), tolerance=0.005)
    packed.save(tmp_path / "scene.prt")
    scene = mi.load_file(str(tmp_path / "scene.xml"), optimize=optimize)
    ids = [shape.id() for shape in scene.shapes()]
    assert ("floor" in ids) != optimize
    ours = picture(
        mi, scene, integrator=mi.load_dict({"type": "slepian_prt", "transfer": str(tmp_path / "scene.prt")}), spp=1024
    )
    path = mi.load_dict({"type": "path", "max_depth": packed.bounces + 2})
    theirs = picture(mi, scene, integrator=path, spp=1024)
    # Constant light needs no more than degree 0, so that what differs is noise, coding, and interpolation.
    assert_near(ours, theirs, 0.02)
    assert np.quantile(np.abs(ours - theirs), 0.99) < 0.05
    nothing = mi.load_dict({"type": "scene", "emitter": {"type": "constant"}, "sensor": camera(mi)})
    with pytest.raises(RuntimeError) as caught:
        mi.render(nothing, integrator=mi.load_dict({"type": "slepian_prt", "transfer": str(tmp_path / "scene.prt")}))
    assert "its shape 'floor'" in messages(caught.value)


def test_two_files_in_one_scene(mi, folder, tmp_path):
    ball = replace(sphere(3), name="ball", positions=sphere(3).positions + [2.5, 0.0, 0.0])
    packed = sp.compress(sp.precompute(ball, bandlimit=4, samples=16), clusters=8)
    packed.save(tmp_path / "ball.prt")
    trimesh.Trimesh(ball.positions, ball.faces, vertex_normals=ball.normals, process=False).export(
        tmp_path / "ball.ply"
    )
    scene = loaded(
        mi, folder, integrator={"hide_emitters": True, "transfer_ball": str(tmp_path / "ball.prt")},
        ball={"type": "ply", "filename": str(tmp_path / "ball.ply")},
        sensor=camera(mi) | {"fov": 80},
    )  # fmt: skip
    expected = painted(mi, scene, relight(packed_of(folder), project_environment(sky(), 6)))
    second = painted(mi, scene, relight(packed, project_environment(sky(), 4)), "ball")
    ours = picture(mi, scene)
    assert {"integrator.albedo", "integrator.albedo_ball"} <= set(mi.traverse(scene).keys())
    # Where one is painted the other is black.
    assert expected.max() > 0.3
    assert second.max() > 0.3
    np.testing.assert_allclose(ours, np.maximum(expected, second), atol=0.02)
    assert np.mean(np.abs(ours - np.maximum(expected, second)) > 1e-3) < 0.01


@pytest.mark.parametrize("change", ["remeshed", "reordered", "mirrored", "gone"])
def test_shapes_that_are_not_those_of_the_file_are_refused_by_name(change, mi, folder, tmp_path):
    mesh = bumpy(2) if change == "remeshed" else bumpy(3)
    positions, faces = mesh.positions.copy(), mesh.faces
    if change == "reordered":
        order = np.random.default_rng(1).permutation(len(positions))
        positions, faces = positions[order], np.argsort(order)[faces]
    if change == "mirrored":
        positions[:, 0] *= -1.0
    trimesh.Trimesh(positions, faces, process=False).export(tmp_path / "bumpy.ply")
    if change == "gone":
        scene = mi.load_dict({
            "type": "scene", "integrator": {"type": "slepian_prt", "transfer": str(folder / "bumpy.prt")},
            "other": {"type": "sphere", "radius": 0.1}, "emitter": {"type": "constant"}, "sensor": camera(mi),
        })  # fmt: skip
    else:
        scene = loaded(mi, folder, bumpy=shape(mi, tmp_path))
    with pytest.raises(RuntimeError) as caught:
        mi.render(scene)
    wanted = {
        "remeshed": "shape 'bumpy' has 642 vertices there and 162 in the scene",
        "reordered": "shape 'bumpy' of the scene .* in another order",
        "mirrored": "shape 'bumpy' of the scene .* at other places",
        "gone": r"shape 'bumpy' \(642 vertices\) is not in the scene, which has the shapes 'other'",
    }[change]
    assert re.search(wanted, messages(caught.value)), messages(caught.value)


def test_a_mesh_of_another_name_is_found_by_its_vertices(mi, folder):
    scene = mi.load_dict({
        "type": "scene", "integrator": {"type": "slepian_prt", "transfer": str(folder / "bumpy.prt")},
        "whatever": shape(mi, folder), "emitter": envmap(mi), "sensor": camera(mi),
    })  # fmt: skip
    assert_rounded(picture(mi, scene), picture(mi, loaded(mi, folder)), terms=SPP + 49)


def test_parameters_that_are_wrong(mi, folder, tmp_path):
    for given, wanted in [
        ({"colour": 3.0}, "unreferenced property"),
        ({"albedo": "both"}, "must be 'auto', 'file' or 'scene', not 'both'"),
        ({"transfer": str(tmp_path / "none.prt")}, "no such file"),
    ]:
        with pytest.raises(RuntimeError, match=wanted):
            loaded(mi, folder, integrator=given)


def test_texels_that_are_not_finite(mi, folder):
    scene = loaded(mi, folder)
    parameters = mi.traverse(scene)
    texels = np.array(parameters["emitter.data"])
    texels[5, 6] = np.nan
    parameters["emitter.data"] = mi.TensorXf(texels)
    parameters.update()
    with pytest.raises(RuntimeError) as caught:
        mi.render(scene)
    assert "NaN or infinite" in messages(caught.value)


def test_a_black_map_and_no_light(mi, folder):
    black = loaded(mi, folder, envmap(mi, np.zeros((16, 32, 3), np.float32)))
    assert_exact(picture(mi, black), 0.0, because="nothing adds light")
    scene = mi.load_dict({
        "type": "scene", "integrator": {"type": "slepian_prt", "transfer": str(folder / "bumpy.prt")},
        "bumpy": shape(mi, folder), "sensor": camera(mi),
    })  # fmt: skip
    level = mi.log_level()
    mi.set_log_level(mi.LogLevel.Error)
    assert_exact(picture(mi, scene), 0.0, because="nothing adds light")
    mi.set_log_level(level)


def test_inside_an_aov_integrator(mi, folder):
    """Which calls `sample` but not `render`."""
    scene = loaded(mi, folder)
    nested = mi.load_dict(
        {"type": "aov", "aovs": "d:depth", "own": {"type": "slepian_prt", "transfer": str(folder / "bumpy.prt")}}
    )
    np.testing.assert_allclose(picture(mi, scene, integrator=nested)[..., :3], picture(mi, scene), atol=1e-5)
