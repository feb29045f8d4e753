"""One capture under several maps, against Mitsuba's own pictures under each of them."""

import logging

import numpy as np
import pytest

from slepian_prt.errors import UserError
from slepian_prt.lighting.environment import make_environment
from slepian_prt.lighting.projection import project_environment
from slepian_prt.relighting.drawing.film_pictures import FilmDrawing
from slepian_prt.relighting.relight import relight
from slepian_prt.transport.capturing.capture import capture
from slepian_prt.transport.capturing.pixel_paths import PixelPaths
from slepian_prt.transport.capturing.settings import CaptureSettings
from tests.numerics import assert_rounded
from tests.statistics import assert_agree
from tests.transport.capturing.scenes import (
    BANDLIMIT,
    RED,
    camera,
    film,
    llvm_mitsuba,
    open_box,
    smooth_map,
    under,
)
from tests.variants import VARIANT, sibling

RUNS, SAMPLES = 6, 64

# A map of 96 rows differs from the band-limited one by its interpolation: (π/95)² l(l+1)/8 of it.
INTERPOLATION = 1e-3


@pytest.fixture(scope="module")
def mi():
    return llvm_mitsuba()


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("SLEPIAN_PRT_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def shown(transfer, texels):
    """(h, w, 3) the picture under a map, which is seen behind it."""
    radiance = relight(transfer, project_environment(make_environment(texels), BANDLIMIT))
    drawing = FilmDrawing(transfer.film, radiance[None])
    return drawing.picture(0).over(drawing.backdrop(make_environment(texels))).radiance


def at_silhouettes(transfer, texels):
    """(h, w, 3) what the map at the middle of a pixel may differ from the map beside what the pixel shows.

    Of a part b that shows the map the middle is at most (1 - b)/2 of a pixel away from that of the pixel.
    """
    backdrop = FilmDrawing(transfer.film, np.zeros((1, len(transfer.vectors), 3))).backdrop(make_environment(texels))
    part = transfer.film.picture(transfer.film.background.mean(axis=1))[..., None]
    return 0.5 * part * (1.0 - part) * sum(np.abs(np.gradient(backdrop, axis=axis)) for axis in (0, 1))


def assert_shows(mi, description, seeds=(1, 2), integrator="path", spp=2 * SAMPLES):
    captured = [
        capture(description, bandlimit=BANDLIMIT, samples=SAMPLES, seed=seed, smooth=False) for seed in range(RUNS)
    ]
    tracer = mi.load_dict({"type": integrator})
    for seed in seeds:
        texels = smooth_map(seed)
        scene = under(mi, description, texels)
        reference = [np.array(mi.render(scene, integrator=tracer, spp=spp, seed=10 + run)) for run in range(RUNS)]
        ours = np.stack([shown(transfer, texels) for transfer in captured])
        bias = INTERPOLATION * texels.max() + at_silhouettes(captured[0], texels)
        assert_agree(ours, np.stack(reference)[..., :3], bias=bias)


@pytest.mark.slow
def test_glass_and_mirrors_under_three_maps(mi):
    assert_shows(mi, open_box(mi), seeds=(1, 2, 3))


@pytest.mark.slow
@pytest.mark.parametrize("rfilter", ["gaussian", "mitchell"])
def test_filters_of_films(rfilter, mi):
    """Of a crop window, at whose borders the filter is cut; it shows nothing of the map, which is drawn unfiltered."""
    window = film(24, rfilter={"type": rfilter}, crop_offset_x=6, crop_offset_y=8, crop_width=10, crop_height=8)
    description = open_box(mi, eye=camera(mi, film_of=window))
    assert_shows(mi, description, seeds=(1,), spp=8 * SAMPLES)
    made = capture(description, bandlimit=0, samples=2)
    assert (made.film.width, made.film.height, made.film.crop, made.film.size) == (10, 8, (6, 8), (24, 24))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "more"),
    [("thinlens", {"aperture_radius": 0.2, "focus_distance": 3.0}), ("orthographic", {})],
)
def test_kinds_of_cameras(kind, more, mi):
    assert_shows(mi, open_box(mi, eye=camera(mi, kind, **more)), seeds=(1,))


@pytest.mark.slow
def test_hair(mi, tmp_path):
    strands = [
        [(0.1 * k + 0.02 * np.sin(3 * s + k), 0.2 + 0.4 * s, 0.3 * np.cos(s)) for s in np.linspace(0, 3, 8)]
        for k in range(-5, 6)
    ]
    text = "\n\n".join("\n".join(f"{x} {y} {z} 0.03" for x, y, z in strand) for strand in strands)
    (tmp_path / "hair.txt").write_text(text + "\n")
    hair = {"type": "bsplinecurve", "filename": str(tmp_path / "hair.txt"), "bsdf": {"type": "hair"}}
    assert_shows(mi, {"type": "scene", "eye": camera(mi), "hair": hair}, seeds=(1,))


@pytest.mark.slow
def test_fog_that_is_seen_through(mi):
    """A ball of fog: what it lets pass of the map behind is coloured, and no part of the transfer."""
    fog = {"type": "homogeneous", "albedo": 0.8, "scale": 2.0, "sigma_t": {"type": "rgb", "value": [0.25, 0.5, 1.0]}}
    ball = {"type": "sphere", "center": [0, 0.9, 0], "radius": 0.7, "bsdf": {"type": "null"}, "interior": fog}
    assert_shows(
        mi, {"type": "scene", "eye": camera(mi), "ball": ball}, seeds=(1,), integrator="volpath", spp=8 * SAMPLES
    )


@pytest.mark.slow
def test_a_camera_in_fog(mi):
    """The medium of the sensor: all around it, as far as a ball reaches."""
    fog = {"type": "homogeneous", "albedo": 0.7, "sigma_t": 0.15}
    shared = {"type": "ref", "id": "fog"}
    description = {
        "type": "scene",
        "fog": fog,
        "eye": camera(mi, medium=shared),
        "cloud": {"type": "sphere", "radius": 6.0, "bsdf": {"type": "null"}, "interior": shared},
        "ball": {"type": "sphere", "center": [0, 0.9, 0], "radius": 0.6, "bsdf": RED, "exterior": shared},
    }
    assert_shows(mi, description, seeds=(1,), integrator="volpath", spp=8 * SAMPLES)


def test_the_background_is_apart_from_the_transfer(mi):
    made = capture(
        {
            "type": "scene",
            "eye": camera(mi, film_of=film(8)),
            "ball": {"type": "sphere", "center": [0, 1, 0], "radius": 1.0},
        },
        samples=4,
        bandlimit=1,
    )
    coverage = made.film.picture(made.film.coverage)
    assert coverage[0, 0] == 0.0
    assert coverage[4, 4] == 1.0
    dark = made.film.coverage == 0.0
    assert not made.vectors[dark].any()
    assert not made.axes[dark].any()
    np.testing.assert_allclose(made.film.background[dark], 1.0, rtol=1e-6)
    np.testing.assert_allclose(made.film.background.mean(axis=1) + made.film.coverage, 1.0, atol=1e-6)


def test_the_same_seed_gives_the_same_pixels(mi):
    scene = mi.load_dict(open_box(mi, eye=camera(mi, film_of=film(12))))
    first, again, other = (capture(scene, samples=16, bandlimit=2, seed=seed) for seed in (5, 5, 6))
    assert_rounded(again.vectors, first.vectors, 16)
    assert np.abs(other.vectors - first.vectors).max() > 0.01


@pytest.mark.slow
def test_noise_is_told(mi):
    """What one capture tells of its own noise, against how much captures differ."""
    scene = mi.load_dict(open_box(mi, eye=camera(mi, film_of=film(16))))
    runs = [capture(scene, samples=256, bandlimit=3, seed=seed, smooth=False) for seed in range(12)]
    spread = np.stack([run.vectors for run in runs]).var(axis=0, ddof=1)
    measured = np.array([spread[:, :, l * l : (l + 1) ** 2].sum() for l in range(4)]) / len(spread)
    told = np.mean([run.film.noise_power for run in runs], axis=0)
    np.testing.assert_allclose(told, measured, rtol=0.15)
    # Per pixel: under light of mean radiance 1 that falls, RMS over the channels.
    power = 4.0 * np.pi / (1.0 + np.arange(4)) ** 2
    wanted = np.sqrt(np.einsum("vcm,m->v", spread, np.repeat(power, 2 * np.arange(4) + 1)) / 3.0)
    rms = np.sqrt(np.mean([run.film.noise**2 for run in runs], axis=0))
    assert np.median(np.abs(rms / np.maximum(wanted, 1e-9) - 1.0)[wanted > 1e-4]) < 0.25


def test_goals(mi):
    scene = mi.load_dict(open_box(mi, eye=camera(mi, film_of=film(12))))
    rough = capture(scene, bandlimit=2, max_error=0.2)
    fine = capture(scene, bandlimit=2, max_error=0.05)
    assert rough.samples < fine.samples
    power = 1.0 / (1.0 + np.arange(3)) ** 2
    energy = np.array([(fine.vectors[:, :, l * l : (l + 1) ** 2] ** 2).sum() for l in range(3)]) / len(fine.vectors)
    assert fine.film.relative_noise(energy, power) <= 0.05
    assert capture(scene, bandlimit=2, max_seconds=1e-3).samples == 32  # two passes, without which no noise is known


class Killed(BaseException):
    pass


def test_stopped_in_a_pass_and_continued_toward_another_goal(mi, monkeypatch):
    """Of three blocks two have one pass more when it is stopped: the third gets it, too, before anything is decided."""
    monkeypatch.setattr("slepian_prt.transport.capturing.passes.LANES", 50 * 16)
    scene, calls = mi.load_dict(open_box(mi, eye=camera(mi, film_of=film(12)))), []
    trace = PixelPaths.trace

    def stopping(self, pixels, number):
        calls.append(number)
        if len(calls) > 8:
            raise Killed
        return trace(self, pixels, number)

    with monkeypatch.context() as patch:
        patch.setattr(PixelPaths, "trace", stopping)
        with pytest.raises(Killed):
            capture(scene, bandlimit=2, max_error=1e-4)
    assert calls == [0, 0, 0, 1, 1, 1, 2, 2, 2]
    resumed = capture(scene, bandlimit=2, max_error=0.9)
    assert resumed.samples == 3 * 16
    monkeypatch.setattr(CaptureSettings, "passes", 3)
    assert_rounded(resumed.vectors, capture(scene, bandlimit=2, max_error=0.9).vectors, 64)


@pytest.mark.slow
def test_lamps_apart_from_the_sky(mi):
    """Each lamp has a picture of its own, with its bounces off glass and mirrors; together they are Mitsuba's."""
    lamp = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().translate([0, 1.9, 0]).rotate([1, 0, 0], 90).scale(0.3),
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [4.0, 2.0, 1.0]}},
    }
    spot = {"type": "point", "position": [0.5, 1.5, 1.0], "intensity": 1.5}
    texels = smooth_map(1)
    description = open_box(mi, lamp=lamp, spot=spot)
    scene = under(mi, description, texels)
    before = str(scene), np.array(mi.traverse(scene)["sky.data"]).sum()
    made = [capture(scene, samples=SAMPLES, bandlimit=BANDLIMIT, seed=seed, smooth=False) for seed in range(RUNS)]
    assert (str(scene), np.array(mi.traverse(scene)["sky.data"]).sum()) == before
    assert set(made[0].fixed.names) == {"spot", "lamp"}
    path = mi.load_dict({"type": "path"})
    reference = np.stack(
        [np.array(mi.render(scene, integrator=path, spp=4 * SAMPLES, seed=90 + run)) for run in range(RUNS)]
    )
    ours = np.stack([shown(transfer, texels) for transfer in made])
    assert_agree(ours, reference[..., :3], bias=INTERPOLATION * texels.max())


@pytest.mark.slow
def test_a_lamp_by_itself(mi):
    """Of two lamps the one that is asked for, against a scene that has no other."""
    lamps = {f"lamp{k}": {"type": "point", "position": [0.5 - k, 1.5, 1.0], "intensity": 1.5 + k} for k in (0, 1)}
    made = [
        capture(open_box(mi, **lamps), samples=SAMPLES, bandlimit=0, seed=seed, smooth=False) for seed in range(RUNS)
    ]
    alone = mi.load_dict(open_box(mi, lamp1=lamps["lamp1"]))
    path = mi.load_dict({"type": "path"})
    reference = [np.array(mi.render(alone, integrator=path, spp=2 * SAMPLES, seed=run)) for run in range(RUNS)]
    pictures = [one.film.picture(relight(one, None, fixed_lights={"lamp1": 1.0, "*": 0.0})) for one in made]
    assert_agree(np.stack(pictures), np.stack(reference)[..., :3])


def test_a_lamp_that_cannot_be_used_is_told_before_the_work(mi, monkeypatch):
    monkeypatch.setattr(PixelPaths, "trace", lambda *_: pytest.fail("traced before the lamp was looked at"))
    lamp = {"type": "point", "intensity": {"type": "rgb", "value": [-1.0, 0.0, 0.0]}}
    with pytest.raises(UserError, match="lamp 'lamp': its light is negative"):
        capture(open_box(mi, lamp=lamp), samples=2, bandlimit=0)


# --- What cannot be captured -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "sensor",
    [
        {"type": "radiancemeter", "film": {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}},
        {"type": "distant", "film": {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}},
        {"type": "batch", "film": film(8), "one": {"type": "perspective"}, "two": {"type": "perspective"}},
    ],
)
def test_sensors_without_a_picture_of_their_own(sensor, mi):
    scene = {"type": "scene", "eye": sensor, "ball": {"type": "sphere"}}
    with pytest.raises(UserError, match="takes no picture; add a perspective"):
        capture(scene, samples=2)
    with pytest.raises(UserError, match="takes no picture; name another with `sensor=other`"):
        capture({**scene, "other": camera(mi)}, sensor=0, samples=2)


def test_scenes_without_cameras(mi):
    with pytest.raises(UserError, match="has no camera to capture"):
        capture({"type": "scene", "ball": {"type": "sphere"}})
    with pytest.raises(UserError, match=r"no camera 'here'; name one by number or id: 0 \('eye'\)"):
        capture(open_box(mi), sensor="here")


def test_a_camera_that_sees_nothing(mi, caplog):
    ball = {"type": "sphere", "center": [0, 0, 30], "bsdf": RED}
    with caplog.at_level(logging.INFO):
        made = capture({"type": "scene", "eye": camera(mi, film_of=film(8)), "ball": ball}, samples=2, bandlimit=1)
    assert "camera 'eye' sees nothing of the scene" in caplog.text
    assert not made.vectors.any()
    assert not made.film.coverage.any()
    assert made.mesh.receivers.active.all()


@pytest.mark.parametrize("variant", ["scalar_rgb", sibling("ad_spectral")])
def test_scenes_of_other_variants(variant, mi):
    if variant not in mi.variants():
        pytest.skip("the wheel has no such variant")
    mi.set_variant(variant)
    try:
        scene = mi.load_dict({"type": "scene", "eye": {"type": "perspective"}, "ball": {"type": "sphere"}})
        with pytest.raises(UserError, match=f"was loaded in the variant {variant}"):
            capture(scene)
    finally:
        mi.set_variant(VARIANT)


@pytest.mark.parametrize("power", [np.ones(4), [1.0, np.nan], [1.0, -1.0], [0.0, 0.0], []])
def test_power_that_is_no_light_is_refused(mi, power):
    with pytest.raises(UserError, match="power must be 2 numbers for bandlimit 1"):
        capture(open_box(mi), bandlimit=1, max_error=0.5, power=power)


@pytest.mark.parametrize(("width", "height"), [(48, 1), (1, 48)])
def test_lines_of_pixels_are_smoothed(width, height, mi):
    line = {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}}
    floor = {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(20.0), "bsdf": RED}
    scene = {"type": "scene", "eye": camera(mi, film_of=line), "floor": floor}
    noise = [capture(scene, bandlimit=1, samples=16, smooth=smooth).noise for smooth in (False, True)]
    assert noise[1] < 0.75 * noise[0]


def test_a_single_pixel(mi):
    assert capture(open_box(mi, eye=camera(mi, film_of=film(1))), bandlimit=1, samples=16).vectors.any()
