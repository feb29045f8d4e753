"""What is left of materials without their diffuse reflection; against the whole of them in tests of the integrator."""

import numpy as np
import pytest

from slepian_prt.paths.lobes import MaterialTable, Remainder
from slepian_prt.renderer.variants import imported_mitsuba
from tests.variants import VARIANT


@pytest.fixture(scope="module")
def mi():
    module = imported_mitsuba()
    module.set_variant(VARIANT)
    return module


MIRROR = {"type": "conductor"}
DIFFUSE = {"type": "diffuse"}


@pytest.mark.parametrize(
    "material",
    [
        {"type": "blendbsdf", "weight": 0.5, "a": DIFFUSE, "b": MIRROR},
        {"type": "blendbsdf", "weight": 0.5, "a": MIRROR, "b": DIFFUSE},
        {"type": "mask", "opacity": 0.5, "bsdf": DIFFUSE},
    ],
    ids=["blend", "turned blend", "mask"],
)
def test_no_direction_is_lost_to_the_diffuse_half(material, mi):
    """All mirror, or go on, with one half each, as exactly as that can be."""
    import drjit as dr

    scene = mi.load_dict({"type": "scene", "square": {"type": "rectangle", "bsdf": material}})
    count = 1000
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, count)
    ray = mi.Ray3f(mi.Point3f(0.1, -1.4, 2.0) + dr.zeros(mi.Point3f, count), mi.Vector3f(0.0, 0.6, -0.8))
    si = scene.ray_intersect(ray)
    table = MaterialTable(mi, [shape.bsdf() for shape in scene.shapes()])
    rest = Remainder(table, si, mi.Bool(True), mi.Color3f(0.0), mi.Bool(True))
    drawn, weight = rest.sample(sampler)
    np.testing.assert_allclose(np.array(weight), 0.5, rtol=2 * np.finfo(np.float32).eps)
    direction = np.array(si.to_world(drawn.wo))
    wanted = [0.0, 0.6, -0.8 if material["type"] == "mask" else 0.8]
    np.testing.assert_allclose(direction, np.tile(np.array(wanted)[:, None], count), atol=1e-6)
