"""Radiance and gradients on Mitsuba's arrays, against the operator that NumPy applies."""

import drjit as dr
import numpy as np
import pytest

from slepian_prt.relighting.mitsuba import device_operator
from slepian_prt.relighting.mitsuba.device_operator import DeviceOperator
from slepian_prt.relighting.operator import TransferOperator
from tests.numerics import assert_rounded
from tests.relighting.test_operator import made_up

SIZE = 25


def both(mi, rng, channels, caps=5):
    parts, members, whole = made_up(rng, channels, caps)
    operator = TransferOperator(parts, members)
    return operator, DeviceOperator(mi, operator), np.broadcast_to(whole, (len(whole), 3, SIZE))


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("count", [1, 4])
def test_radiance(channels, count, mi, rng):
    operator, device, whole = both(mi, rng, channels)
    lights = rng.normal(size=(count, 3, SIZE)).astype(np.float32)
    found = np.array(device.radiance(mi.Float(lights.ravel()))).reshape(device.count, count, 3)
    # Sums of (L+1)² products, then of up to twelve.
    bound = np.einsum("vcm,bcm->vbc", np.abs(whole), np.abs(lights)).max()
    assert_rounded(found, np.einsum("vcm,bcm->vbc", whole, lights).astype(np.float32), SIZE + 12, bound)
    assert_rounded(np.moveaxis(found, 1, 0), operator.apply(lights), SIZE + 12, bound)


@pytest.mark.parametrize("channels", [1, 3])
def test_gradients_both_ways(channels, mi, rng):
    """Backward by the transpose, forward by the map itself."""
    operator, device, whole = both(mi, rng, channels)
    light, weight = rng.normal(size=(3, SIZE)).astype(np.float32), rng.normal(size=(device.count, 3)).astype(np.float32)
    given = mi.Float(light.ravel())
    dr.enable_grad(given)
    radiance = device.radiance(given)
    dr.backward(dr.sum(radiance * mi.Float(weight.ravel())))
    wanted = operator.adjoint(weight[None])[0]
    bound = np.einsum("vc,vcm->cm", np.abs(weight), np.abs(whole)).max()
    assert_rounded(np.array(dr.grad(given)).reshape(3, SIZE), wanted.astype(np.float32), len(weight) + 12, bound)
    given = mi.Float(light.ravel())
    dr.enable_grad(given)
    radiance = device.radiance(given)
    dr.set_grad(given, mi.Float(light.ravel()))
    dr.forward_to(radiance)
    np.testing.assert_allclose(np.array(dr.grad(radiance)), np.array(radiance), atol=1e-5 * bound)


def test_more_tiles_than_one_call_takes(mi, rng, monkeypatch):
    monkeypatch.setattr(device_operator, "_MOST_TILES", 2)
    operator, device, _ = both(mi, rng, 1, caps=9)
    assert len(device._tiles) > len(operator.groups)
    light = rng.normal(size=(1, 3, SIZE)).astype(np.float32)
    wanted = operator.apply(light)[0]
    found = np.array(device.radiance(mi.Float(light.ravel()))).reshape(-1, 3)
    np.testing.assert_allclose(found, wanted, atol=1e-5 * np.abs(wanted).max())
