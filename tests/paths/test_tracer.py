"""Paths that are followed to their ends, against Mitsuba's path tracer under the same light."""

import numpy as np
import pytest

from slepian_prt.lighting.projection import project_environment
from slepian_prt.paths.harmonics import sum_paths
from slepian_prt.paths.tracer import PathTracer
from slepian_prt.renderer.variants import imported_mitsuba
from slepian_prt.sphere.harmonics import real_sh
from tests.lighting.test_environment import grid_directions
from tests.statistics import assert_agree
from tests.variants import VARIANT

BANDLIMIT, SIZE, SAMPLES, RUNS = 2, 8, 64, 12
RED = {"type": "rgb", "value": [0.7, 0.3, 0.1]}
DIFFUSE = {"type": "diffuse", "reflectance": RED}
MATERIALS = {
    "diffuse": {"type": "twosided", "bsdf": DIFFUSE},
    "mirror": {"type": "conductor", "material": "Au"},
    "metal": {"type": "roughconductor", "alpha": 0.2},
    "glass": {"type": "dielectric"},
    "rough glass": {"type": "roughdielectric", "alpha": 0.2},
    "thin glass": {"type": "thindielectric"},
    "plastic": {"type": "roughplastic", "diffuse_reflectance": RED},
    "principled": {"type": "principled", "base_color": RED, "metallic": 0.3, "spec_trans": 0.3},
    "leaf": {"type": "principledthin", "base_color": RED, "diff_trans": 1.2},
    "mask": {"type": "mask", "opacity": 0.4, "bsdf": {"type": "twosided", "bsdf": DIFFUSE}},
}


@pytest.fixture(scope="module")
def mi():
    module = imported_mitsuba()
    module.set_variant(VARIANT)
    return module


def smooth_map():
    """A positive map of degrees 0 to 2, as fine as its bilinear interpolation must be."""
    values = real_sh(BANDLIMIT, grid_directions(96).reshape(-1, 3)) @ np.random.default_rng(4).normal(size=(9, 3))
    return (values - values.min(axis=0) + 0.2).reshape(96, 192, 3).astype(np.float32)


def scene_of(mi, material):
    place = mi.ScalarTransform4f
    return mi.load_dict({
        "type": "scene",
        "sky": {"type": "envmap", "bitmap": mi.Bitmap(smooth_map())},
        "camera": {
            "type": "perspective",
            "fov": 35,
            "to_world": place().look_at([0, 2.2, 4.5], [0, 0.3, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}},
        },
        "floor": {"type": "rectangle", "to_world": place().rotate([1, 0, 0], -90).scale(2), "bsdf": DIFFUSE},
        "ball": {"type": "sphere", "center": [0, 0.6, 0], "radius": 0.5, "bsdf": material},
    })  # fmt: skip


def relit(mi, scene, tracer, lighting, seed, **options):
    """(h, w, 3) a picture as a sum over paths."""
    import drjit as dr

    count = SIZE * SIZE * SAMPLES
    sampler = mi.load_dict({"type": "independent", "sample_count": SAMPLES})
    sampler.seed(seed, count)
    pixel = dr.arange(mi.UInt32, count) // SAMPLES
    place = (mi.Point2f(mi.Float(pixel % SIZE), mi.Float(pixel // SIZE)) + sampler.next_2d()) / SIZE
    ray, _ = scene.sensors()[0].sample_ray(0.0, 0.5, place, mi.Point2f(0.5))
    sums = sum_paths(mi, BANDLIMIT, tracer.follow(sampler, ray, **options), SAMPLES)
    return np.einsum("ncm,cm->nc", sums.vectors, lighting).reshape(SIZE, SIZE, 3) / SAMPLES


@pytest.mark.slow
@pytest.mark.parametrize("name", MATERIALS)
def test_paths_bring_the_light_that_path_brings(name, mi):
    scene = scene_of(mi, MATERIALS[name])
    tracer = PathTracer(mi, scene, [shape.bsdf() for shape in scene.shapes()])
    texels = smooth_map()
    lighting = project_environment(texels, BANDLIMIT)
    ours = np.stack([relit(mi, scene, tracer, lighting, seed) for seed in range(RUNS)])
    path = mi.load_dict({"type": "path"})
    reference = [mi.render(scene, integrator=path, spp=4 * SAMPLES, seed=100 + seed) for seed in range(RUNS)]
    # A map of 96 rows differs from the band-limited one by its interpolation: (π/95)² (l(l+1)) / 8 of it.
    assert_agree(ours, np.stack([np.array(picture) for picture in reference]), bias=1e-3 * texels.max())


@pytest.mark.parametrize("first_known", [False, True])
def test_paths_end_where_light_is_known(first_known, mi):
    """A floor that shines as if the sky were 1 all around it, and a mask above it: under such a sky all is known."""
    scene = scene_of(mi, MATERIALS["mask"])

    class Everything:
        """Every surface has a diffuse reflection of 1 times its albedo; so what is not reflected passes the mask."""

        def at(self, ray, hit, si, active):
            return active, mi.Color3f(0.0)

    import drjit as dr

    tracer = PathTracer(mi, scene, [shape.bsdf() for shape in scene.shapes()], known=Everything())
    count = 1 << 14
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, count)
    ray = mi.Ray3f(mi.Point3f(0, 3, 0), dr.normalize(mi.Vector3f(0.05, -1, 0)))
    ray = mi.Ray3f(mi.Point3f(ray.o + dr.zeros(mi.Point3f, count)), mi.Vector3f(ray.d + dr.zeros(mi.Vector3f, count)))
    ends = tracer.follow(sampler, ray, first_known=first_known)
    throughput, held = np.array(ends.throughput), np.array(ends.held)
    assert not np.array(ends.escaped).any()
    on_ball = np.array(ends.hit.compute_surface_interaction(ends.ray).p)[1] > 0.05
    # Weights without the albedo: 1 from the ball where it counts, then .6 of what passes each of its two sides.
    near, floor = throughput[0][held & on_ball].sum() / count, throughput[0][held & ~on_ball].sum() / count
    deviation = 4.0 * throughput[0].std() / np.sqrt(count)
    assert abs(near - (0.6 if first_known else 1.0 + 0.6)) <= deviation
    assert abs(floor - 0.36) <= deviation
