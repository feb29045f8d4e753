"""Gradients of pictures as finite differences."""

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from tests.relighting.mitsuba.scenes import loaded, picture

# --- Gradients -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("key", ["emitter.data", "emitter.scale", "integrator.albedo"])
def test_gradients_are_those_of_finite_differences(key, mi, folder, rng):
    import drjit as dr

    scene = loaded(mi, folder, integrator={"hide_emitters": True})
    parameters = mi.traverse(scene)
    start = type(parameters[key])(parameters[key])
    weights = mi.TensorXf(rng.normal(size=(32, 32, 3)).astype(np.float32))
    along = rng.normal(size=np.shape(start)).astype(np.float32) * np.array(start)
    if key == "emitter.data":
        along[:, [0, -1]] = along[:, [-2, 1]]

    def set_to(value):
        parameters[key] = value
        parameters.update()

    def loss():
        # Gradients are taken with random numbers of their own.
        return dr.sum(mi.render(scene, parameters, spp=16, seed=1, seed_grad=2) * weights, axis=None)

    values = []
    for step in (0.1, -0.1):  # the picture is linear in each: large steps lose nothing
        set_to(type(start)(np.array(start) + step * along))
        pixels = np.array(mi.render(scene, spp=16, seed=2), dtype=np.float64)
        values.append(float(np.sum(pixels * np.array(weights))))
    expected = (values[0] - values[1]) / 0.2

    leaf = type(start)(start)
    dr.enable_grad(leaf)
    set_to(leaf)
    dr.backward(loss())
    gradient = np.array(dr.grad(leaf), dtype=np.float64)
    assert float(np.sum(gradient * along)) == pytest.approx(expected, rel=2e-3)

    leaf = type(start)(start)
    dr.enable_grad(leaf)
    dr.set_grad(leaf, type(start)(along))
    set_to(leaf)
    forward = dr.forward_to(loss())
    assert float(np.array(forward).ravel()[0]) == pytest.approx(expected, rel=2e-3)


def test_gradient_of_a_material_of_the_scene(mi, folder):
    import drjit as dr

    scene = loaded(mi, folder, integrator={"hide_emitters": True, "albedo": "scene"})
    parameters = mi.traverse(scene)
    key = "bumpy.bsdf.reflectance.value"
    leaf = mi.Color3f(0.8, 0.5, 0.2)
    dr.enable_grad(leaf)
    parameters[key] = leaf
    parameters.update()
    image = mi.render(scene, parameters, spp=16, seed=1, seed_grad=2)
    dr.backward(dr.sum(image, axis=None))
    total = picture(mi, scene, seed=2).sum(axis=(0, 1))
    np.testing.assert_allclose(np.array(dr.grad(leaf)).ravel(), total / [0.8, 0.5, 0.2], rtol=1e-3)


@pytest.mark.slow
def test_gradients_of_what_is_seen_stand_beside_what_is_gathered(mi, folder, rng):
    """A mirror beside the model: pixels of the model keep their gradients, and those of the mirror have none."""
    import drjit as dr

    mirror = {"type": "sphere", "center": [1.2, 0.0, 0.8], "radius": 0.4, "bsdf": {"type": "conductor"}}
    scene = loaded(mi, folder, integrator={"hide_emitters": True}, mirror=mirror)
    parameters = mi.traverse(scene)
    key = "integrator.albedo"
    start = mi.TensorXf(parameters[key])
    along = rng.normal(size=start.shape).astype(np.float32)
    si = scene.ray_intersect(middle_rays(mi, scene))
    on_mirror = np.array(si.shape == mi.ShapePtr(next(s for s in scene.shapes() if s.id() == "mirror"))).reshape(32, 32)
    assert 20 < on_mirror.sum() < 300
    away = ~binary_dilation(on_mirror, np.ones((3, 3)))[..., None] * np.ones(3)

    def pixels(value, seed=1, seed_grad=2):
        parameters[key] = value
        parameters.update()
        return mi.render(scene, parameters, spp=16, seed=seed, seed_grad=seed_grad)

    # Gradients have random numbers of their own: those of the finite differences.
    ends = [
        np.array(pixels(mi.TensorXf(np.array(start) + step * along), seed=2, seed_grad=1), dtype=np.float64)
        for step in (0.1, -0.1)
    ]
    leaf = mi.TensorXf(start)
    dr.enable_grad(leaf)
    dr.backward(dr.sum(pixels(leaf) * mi.TensorXf(away.astype(np.float32)), axis=None))
    found = float(np.sum(np.array(dr.grad(leaf), dtype=np.float64) * along))
    assert found == pytest.approx(float(np.sum((ends[0] - ends[1]) * away)) / 0.2, rel=2e-3)
    dr.backward(dr.sum(pixels(leaf) * mi.TensorXf((1.0 - away).astype(np.float32)), axis=None))
    assert np.isfinite(np.array(dr.grad(leaf))).all()


def middle_rays(mi, scene):
    """Through the middles of the pixels."""
    middle = (np.arange(32, dtype=np.float32) + 0.5) / 32
    x, y = (axis.ravel() for axis in np.meshgrid(middle, middle))
    return scene.sensors()[0].sample_ray(0.0, 0.5, mi.Point2f(x, y), mi.Point2f(0.5, 0.5))[0]
