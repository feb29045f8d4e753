"""All stages under CUDA beside the same under LLVM; skipped where there is no device."""

import numpy as np
import pytest

import slepian_prt as sp
from slepian_prt.cli import main
from slepian_prt.renderer.variants import chosen_variant
from slepian_prt.scene.loading import open_scene
from slepian_prt.transport.device.visibility import DeviceTracer
from slepian_prt.transport.directions import direction_set
from tests.conftest import bumpy, sphere
from tests.numerics import assert_exact
from tests.relighting.mitsuba.scenes import camera, sky
from tests.transport.device.scenes import all_kinds

pytestmark = pytest.mark.usefixtures("cuda")

# Hits may differ where rays graze an edge, which rounding decides: of what a receiver gets, so much at most.
GRAZING = 2e-3

RED = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.3, 0.2]}}
# A floor that mirrors, a ball of glass on it, fog, a lamp and a sky: every stage of transport.
ROOM = """<scene version="3.0.0">
<integrator type="path"/><emitter type="constant"/>
<sensor type="perspective" id="eye"><transform name="to_world"><lookat origin="0,3,6" target="0,0,0" up="0,1,0"/>
</transform><film type="hdrfilm"><integer name="width" value="16"/><integer name="height" value="12"/></film></sensor>
<shape type="rectangle" id="floor"><transform name="to_world"><rotate x="1" angle="-90"/><scale value="3"/></transform>
<bsdf type="roughplastic"/></shape>
<shape type="cube" id="box"><transform name="to_world"><scale value="0.4"/><translate x="-1" y="0.4"/></transform>
<bsdf type="diffuse"><rgb name="reflectance" value="0.8,0.3,0.2"/></bsdf></shape>
<shape type="sphere" id="ball"><point name="center" x="1" y="0.6" z="0"/><float name="radius" value="0.5"/>
<bsdf type="dielectric"/></shape>
<shape type="rectangle" id="lamp"><transform name="to_world"><scale value="0.3"/><rotate x="1" angle="90"/>
<translate y="3"/></transform><emitter type="area"><rgb name="radiance" value="5,5,5"/></emitter></shape>
</scene>"""


def under_llvm(work):
    with chosen_variant("llvm_ad_rgb"):
        return work()


def relative(found, wanted):
    return np.linalg.norm(np.asarray(found, dtype=np.float64) - wanted) / np.linalg.norm(wanted)


def test_no_ray_meets_what_it_starts_from():
    """A convex body shades nothing: its own faces least of all."""
    with open_scene(sphere(4)) as scene:
        found = DeviceTracer(scene, direction_set(400), 0).trace(np.arange(len(scene.receivers)))
        assert not np.array(found.blocked).any()


def test_shadows():
    found = sp.precompute(all_kinds(), 10, 400, effects="direct")
    wanted = under_llvm(lambda: sp.precompute(all_kinds(), 10, 400, effects="direct"))
    assert relative(found.vectors, wanted.vectors) < GRAZING
    dark = ~wanted.vectors.any(axis=(1, 2))
    assert dark.any()
    assert_exact(~found.vectors.any(axis=(1, 2)), dark, "closed rooms are exactly dark")


def test_the_same_seed_gives_the_same_bits():
    results = [sp.precompute(bumpy(3), 6, 200, seed=3).vectors for _ in range(2)]
    assert_exact(results[1], results[0], "sums are added up in a fixed order")


def test_light_between_surfaces(tmp_path):
    (tmp_path / "box.xml").write_text(ROOM)
    kinds = {"effects": "shadows,interreflection,colour", "bounces": 3}
    found = sp.precompute(tmp_path / "box.xml", 3, 400, **kinds)
    wanted = under_llvm(lambda: sp.precompute(tmp_path / "box.xml", 3, 400, **kinds))
    assert relative(found.vectors, wanted.vectors) < GRAZING


@pytest.mark.slow
def test_paths_and_lamps(tmp_path):
    """Noise of paths is that of the same samplers, whose numbers are alike: few take another way."""
    (tmp_path / "room.xml").write_text(ROOM)
    found = sp.precompute(tmp_path / "room.xml", 2, 256)
    wanted = under_llvm(lambda: sp.precompute(tmp_path / "room.xml", 2, 256))
    assert found.noise is not None
    assert relative(found.vectors, wanted.vectors) < 2.0 * wanted.noise
    assert relative(found.fixed.direct, wanted.fixed.direct) < 0.02


@pytest.mark.slow
def test_a_camera_whose_pixels_are_receivers(tmp_path):
    (tmp_path / "room.xml").write_text(ROOM)
    found = sp.capture(tmp_path / "room.xml", bandlimit=2, samples=64)
    wanted = under_llvm(lambda: sp.capture(tmp_path / "room.xml", bandlimit=2, samples=64))
    assert relative(found.vectors, wanted.vectors) < 3.0 * wanted.noise


def picture(mi, packed, path, shape):
    """Of a file in a scene with a shape of its own, which is found by its place, and its gradient."""
    import drjit as dr

    sp.register()
    packed.save(path / "file.prt")
    scene = mi.load_dict({
        "type": "scene", "thing": shape, "emitter": {"type": "envmap", "bitmap": mi.Bitmap(sky())},
        "floor": {"type": "rectangle", "to_world": mi.ScalarTransform4f().translate([0, 0, -3]), "bsdf": RED},
        "integrator": {"type": "slepian_prt", "transfer": str(path / "file.prt")}, "sensor": camera(mi),
    })  # fmt: skip
    parameters = mi.traverse(scene)
    leaf = mi.TensorXf(parameters["emitter.data"])
    dr.enable_grad(leaf)
    parameters["emitter.data"] = leaf
    parameters.update()
    pixels = mi.render(scene, parameters, spp=64, seed=1)
    dr.backward(dr.sum(pixels, axis=None))
    return np.array(pixels), np.array(dr.grad(leaf))


@pytest.mark.parametrize("by_place", [False, True])
def test_the_integrator_and_its_gradients(by_place, cuda, tmp_path):
    """Also of shapes that are found by their places, which OptiX traces beside those of the scene."""
    import trimesh

    ball = sphere(3)
    trimesh.Trimesh(ball.positions, ball.faces, process=False).export(tmp_path / "thing.ply")
    shape = {"type": "sphere"} if by_place else {"type": "ply", "filename": str(tmp_path / "thing.ply")}
    packed = sp.compress(sp.precompute(ball, bandlimit=4, samples=16), tolerance=0.05, clusters=4)
    found = picture(cuda, packed, tmp_path, shape)
    with chosen_variant("llvm_ad_rgb"):
        wanted = picture(cuda, packed, tmp_path, shape)
    for one, other in zip(found, wanted, strict=True):
        assert relative(one, other) < 0.02  # the noise of 64 samples at edges


def test_the_command(tmp_path, capsys):
    import trimesh

    ball = bumpy(3)
    trimesh.Trimesh(ball.positions, ball.faces, process=False).export(tmp_path / "ball.ply")
    out = tmp_path / "ball.prt"
    asked = ["precompute", str(tmp_path / "ball.ply"), "-o", str(out), "--variant", "cuda_ad_rgb", "--samples", "100"]
    assert main(asked) == 0, capsys.readouterr().err
    assert sp.load(out).vertex_count == len(ball.positions)
