"""The integrator that fills films with coefficients, against `path` under a map that these tell."""

import numpy as np
import pytest

import slepian_prt as sp
from slepian_prt.lighting.environment import make_environment
from slepian_prt.lighting.formats.coefficient_layers import channel_names
from slepian_prt.lighting.projection import project_environment
from tests.statistics import assert_agree
from tests.transport.capturing.scenes import BANDLIMIT, camera, film, llvm_mitsuba, open_box, smooth_map, under
from tests.variants import VARIANT, sibling

RUNS, SAMPLES = 8, 64


@pytest.fixture(scope="module")
def mi():
    module = llvm_mitsuba()
    sp.register()
    return module


def render(mi, scene, seed, **asked):
    integrator = mi.load_dict({"type": "slepian_prt_capture", **asked})
    return np.array(mi.render(scene, integrator=integrator, spp=SAMPLES, seed=seed))


@pytest.mark.slow
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_channels_relit_are_the_picture(rfilter, mi):
    """Of a window of the film that shows nothing of the map right behind."""
    window = film(24, rfilter={"type": rfilter}, crop_offset_x=6, crop_offset_y=8, crop_width=10, crop_height=8)
    texels = smooth_map(3)
    lighting = project_environment(make_environment(texels), BANDLIMIT)
    scene = under(mi, open_box(mi, eye=camera(mi, film_of=window)), texels)
    ours = []
    for seed in range(RUNS):
        channels = render(mi, scene, seed, bandlimit=BANDLIMIT)[..., -30:-3]
        ours.append(np.einsum("hwmc,cm->hwc", channels.reshape(8, 10, 9, 3), lighting))
    path = mi.load_dict({"type": "path"})
    reference = [np.array(mi.render(scene, integrator=path, spp=SAMPLES, seed=50 + run)) for run in range(RUNS)]
    assert_agree(np.stack(ours), np.stack(reference)[..., :3], bias=1e-3 * texels.max())


def test_names_and_the_picture_itself(mi):
    scene = mi.load_dict(
        {"type": "scene", "eye": camera(mi, film_of=film(8)), "ball": {"type": "sphere", "radius": 0.8}}
    )
    integrator = mi.load_dict({"type": "slepian_prt_capture", "bandlimit": 1})
    assert integrator.aov_names() == [*channel_names(1), "background.R", "background.G", "background.B"]
    assert str(integrator) == "SlepianCapture[bandlimit=1, max_depth=-1, rr_depth=5]"
    pixels = render(mi, scene, 0, bandlimit=1)
    assert pixels.shape[2] == 3 + len(integrator.aov_names())
    # Under a sky of 1, whose only coefficient is √4π: what is reflected, and what is right behind.
    shown, reflected, behind = pixels[..., :3], pixels[..., -15:-12] * np.sqrt(4.0 * np.pi), pixels[..., -3:]
    np.testing.assert_allclose(shown, reflected + behind, atol=1e-5)
    np.testing.assert_allclose(behind[0, 0], 1.0, atol=1e-6)


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        ({"bandlimit": 51}, r"bandlimit must be an integer in \[0, 50\], not 51"),
        ({"rr_depth": 0}, "rr_depth must be an integer in"),
        ({"max_depth": -2}, "max_depth must be an integer in"),
    ],
)
def test_numbers_out_of_range(asked, told, mi):
    with pytest.raises(RuntimeError, match=told):
        mi.load_dict({"type": "slepian_prt_capture", **asked})


def test_other_variants(mi):
    for variant in ("scalar_rgb", sibling("ad_spectral")):
        if variant in mi.variants():
            mi.set_variant(variant)
            try:
                with pytest.raises(RuntimeError, match="slepian_prt_capture needs an"):
                    mi.load_dict({"type": "slepian_prt_capture"})
            finally:
                mi.set_variant(VARIANT)


def test_a_scene_file_may_name_it(mi, tmp_path):
    parts = '<integrator type="slepian_prt_capture"/><sensor type="perspective"/><shape type="sphere"/>'
    (tmp_path / "scene.xml").write_text(f'<scene version="3.0.0">{parts}</scene>')
    assert sp.capture(tmp_path / "scene.xml", samples=2, bandlimit=0).film.width == 768
