"""Light of maps and radiance under it, made by Dr.Jit where the arrays are, against NumPy's."""

import drjit as dr
import numpy as np
import pytest

import slepian_prt as sp
from slepian_prt.lighting.texel_projection import TexelProjection
from slepian_prt.relighting.mitsuba.device_envmap import DeviceEnvmap
from slepian_prt.relighting.mitsuba.emission import EnvmapTables, distant_light
from slepian_prt.relighting.mitsuba.vertex_radiance import VertexRadiance
from slepian_prt.sphere.rotation import rotation_to
from tests.numerics import assert_exact, assert_rounded
from tests.relighting.mitsuba.scenes import sky

TURN = rotation_to(np.array([0.3, -0.5, 0.8]) / np.linalg.norm([0.3, -0.5, 0.8]))


# One that is fine enough, and two that are interpolated: in rows and columns, and in rows alone.
@pytest.mark.parametrize(("height", "width"), [(64, 130), (7, 9), (10, 200)])
@pytest.mark.parametrize("bandlimit", [0, 1, 5])
def test_matrices_are_the_projection(height, width, bandlimit, rng):
    texels = rng.normal(size=(height, width, 3))
    projection = TexelProjection(height, width, bandlimit, TURN)
    along, across = projection.matrices()
    sums = np.einsum("mw,hwc->mhc", along, texels)
    found = projection.rotation_of_sums() @ np.einsum("mlh,mhc->mlc", across, sums).reshape(-1, 3)
    np.testing.assert_allclose(found.T, projection(texels), atol=1e-12)


@pytest.mark.parametrize("mirrored", [False, True])
def test_light_of_an_envmap(mirrored, mi):
    place = mi.ScalarTransform4f(np.pad(TURN, (0, 1)) + np.diag([0.0, 0.0, 0.0, 1.0]))
    if mirrored:
        place = place @ mi.ScalarTransform4f().scale([-1.0, 1.0, 1.0])
    emitter = mi.load_dict({"type": "envmap", "bitmap": mi.Bitmap(sky()), "to_world": place, "scale": 2.5})
    tables = EnvmapTables()
    wanted = np.array(distant_light(mi, emitter, 6, TURN))
    found = np.array(distant_light(mi, emitter, 6, TURN, tables))
    # Both in float64; float32 at the end, and of the rotation that Mitsuba keeps.
    assert_rounded(found, wanted, 4)
    again = np.array(distant_light(mi, emitter, 6, TURN, tables))
    assert_exact(again, found, "the same kernels on the same machine")
    other = np.array(distant_light(mi, emitter, 4, np.eye(3), tables))
    assert_rounded(other, np.array(distant_light(mi, emitter, 4, np.eye(3))), 4)


def test_light_that_cannot_be_computed_with(mi):
    device = DeviceEnvmap(mi, TexelProjection(8, 14, 2), mirrored=False)
    for bad, told in [(np.nan, "NaN or infinite"), (1e20, "more than can be computed with")]:
        texels = np.ones((8, 16, 3), dtype=np.float32)
        texels[2, 3, 1] = bad
        with pytest.raises(sp.UserError, match=told):
            device.light(mi.TensorXf(texels))


@pytest.fixture
def packed():
    from tests.conftest import bumpy

    return sp.compress(sp.precompute(bumpy(2), bandlimit=4, samples=64), tolerance=0.05, clusters=5)


def test_radiance_and_its_gradient(mi, packed, rng):
    emitter = mi.load_dict({"type": "envmap", "bitmap": mi.Bitmap(sky()), "scale": 0.7})
    damping = np.array([1.0, 0.9, 0.7, 0.5, 0.2])
    results = []
    weights = rng.normal(size=3 * packed.vertex_count).astype(np.float32)
    for on_device in (False, True):
        vertices = VertexRadiance(mi, packed, TURN, damping, on_device=on_device)
        radiance = np.array(vertices.under(emitter))
        parameters = mi.traverse(emitter)
        leaf = mi.TensorXf(parameters["data"])
        dr.enable_grad(leaf)
        parameters["data"] = leaf
        parameters.update()
        dr.backward(dr.sum(vertices.under(emitter) * mi.Float(weights)))
        results.append((radiance, np.array(dr.grad(leaf)), vertices.negative))
        parameters["data"] = dr.detach(leaf)
        parameters.update()
    (wanted, gradient, negative), (found, on_device, as_negative) = results
    size = np.abs(wanted).max()
    assert_rounded(found, wanted, 100, size)
    np.testing.assert_allclose(on_device, gradient, atol=1e-5 * np.abs(gradient).max())
    assert negative == as_negative


def test_what_is_negative_is_counted_alike(mi, packed):
    light = np.zeros((3, 25))
    light[:, 0], light[:, 6] = 0.02, 3.0
    counted = [
        VertexRadiance(mi, packed, np.eye(3), np.ones(5), light, on_device=on_device).negative
        for on_device in (False, True)
    ]
    assert 0.1 < counted[0] < 1.0
    assert counted[0] == pytest.approx(counted[1], abs=1.5 / packed.vertex_count)


@pytest.mark.parametrize("on_device", [False, True])
def test_a_light_is_computed_again_only_when_it_changed(on_device, mi, packed):
    emitter = mi.load_dict({"type": "envmap", "bitmap": mi.Bitmap(sky())})
    vertices = VertexRadiance(mi, packed, np.eye(3), np.ones(5), on_device=on_device)
    first = vertices.under(emitter)
    assert vertices.under(emitter) is first
    parameters = mi.traverse(emitter)
    parameters["data"] = mi.TensorXf(np.array(parameters["data"]))  # other memory, the same texels
    parameters.update()
    assert vertices.under(emitter) is first
    parameters["data"] = 2.0 * parameters["data"]
    parameters.update()
    assert_rounded(np.array(vertices.under(emitter)), 2.0 * np.array(first), 100)
