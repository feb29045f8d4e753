"""Scenes for the integrator, and pictures of them."""

import numpy as np

import slepian_prt as sp
from slepian_prt.sphere.harmonics import real_sh
from tests.lighting.test_environment import grid_directions
from tests.variants import VARIANT, sibling

VARIANTS = [
    VARIANT,
    *map(sibling, ("ad_mono", "ad_mono_polarized", "ad_spectral", "ad_spectral_polarized")),
]


def sky(seed: int = 3, height: int = 32) -> np.ndarray:
    """A smooth positive map with a bright spot."""
    d = grid_directions(height)
    rng = np.random.default_rng(seed)
    texels = 0.2 + 0.1 * np.abs(
        np.einsum("hwm,cm->hwc", real_sh(3, d.reshape(-1, 3)).reshape(*d.shape[:2], 16), rng.normal(size=(3, 16)))
    )
    spot = d @ (np.array([0.6, 0.5, 0.3]) / np.linalg.norm([0.6, 0.5, 0.3]))
    return (texels + np.exp(20.0 * (spot - 1.0))[..., None] * [3.0, 2.0, 1.0]).astype(np.float32)


def camera(mi, width: int = 32, **film):
    return {
        "type": "perspective",
        "fov": 40,
        "to_world": mi.ScalarTransform4f().look_at([1.0, 2.0, 4.0], [0, 0, 0], [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": width, "height": width, "rfilter": {"type": "box"}, **film},
        "sampler": {"type": "independent", "sample_count": 16},
    }


def shape(mi, folder, turn=None):
    made = {
        "type": "ply",
        "filename": str(folder / "bumpy.ply"),
        "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.5, 0.2]}},
    }
    return made if turn is None else {**made, "to_world": mi.ScalarTransform4f(turn.tolist())}


def envmap(mi, texels=None, rotation=None, **others):
    matrix = np.eye(4)
    if rotation is not None:
        matrix[:3, :3] = rotation
    texels = sky() if texels is None else texels
    return {"type": "envmap", "bitmap": mi.Bitmap(texels), "to_world": mi.ScalarTransform4f(matrix.tolist()), **others}


def loaded(mi, folder, emitter=None, integrator=None, **others):
    return mi.load_dict({
        "type": "scene",
        "integrator": {"type": "slepian_prt", "transfer": str(folder / "bumpy.prt"), **(integrator or {})},
        "bumpy": shape(mi, folder),
        "emitter": envmap(mi) if emitter is None else emitter,
        "sensor": camera(mi),
        **others,
    })  # fmt: skip


SPP = 16  # samples, and so terms in the sum of a pixel


def picture(mi, scene, **options):
    return np.array(mi.render(scene, **{"spp": SPP, "seed": 1, **options}))


def runs(mi, scene, count: int = 24, **options):
    """Pictures with random numbers of their own each."""
    return np.stack([picture(mi, scene, **{**options, "seed": seed}) for seed in range(1, count + 1)])


def painted(mi, scene, radiance, name: str = "bumpy"):
    """The scene with Mitsuba's own interpolation of colours at the vertices of a shape; black elsewhere.

    Also where the front is seen but its vertex normals say back, as Mitsuba's materials are.
    """
    import drjit as dr

    mesh = next(s for s in scene.shapes() if s.id() == name)
    mesh.add_attribute("vertex_radiance", 3, np.ascontiguousarray(radiance, dtype=np.float32).ravel())

    class Painted(mi.SamplingIntegrator):
        def sample(self, scene, sampler, ray, medium=None, active=True):
            si = scene.ray_intersect(ray, active)
            front = si.is_valid() & (dr.dot(si.n, ray.d) < 0.0) & (si.wi.z > 0.0)
            return dr.select(front, si.shape.eval_attribute_3("vertex_radiance", si, front), 0.0), front, []

    return picture(mi, scene, integrator=Painted(mi.Properties()))


def packed_of(folder):
    return sp.load(folder / "bumpy.prt")


def messages(error: BaseException) -> str:
    """Mitsuba wraps what a plugin raises in errors of its own."""
    text = ""
    while error is not None:
        text += f"{error}\n"
        error = error.__cause__ or error.__context__
    return text
