"""The effects plan: its verdicts, and that it keeps what it promises."""

import math

import numpy as np
import pytest

from slepian_prt.errors import UserError
from slepian_prt.transport.transfer import precompute
from tests.conftest import ROOT, bumpy, inside_out, sphere
from tests.numerics import assert_rounded
from tests.transport.test_interreflection import spherical_bowl

AMBIENT = math.sqrt(4 * math.pi)


def verdicts(transfer) -> dict[str, str]:
    return {effect.name: effect.verdict for effect in transfer.effects}


def promised(transfer) -> float:
    """What leaving out interreflection may change at most, of the mean light."""
    row = next(effect for effect in transfer.effects if effect.name == "interreflection")
    return (row.contribution or 0.0) + (row.confidence or 0.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "scene",
    [
        pytest.param(lambda: sphere(3), id="convex"),
        pytest.param(lambda: spherical_bowl(0.6, 16), id="open bowl"),
        pytest.param(lambda: inside_out(sphere(2)), id="closed room"),
        pytest.param(lambda: bumpy(4), id="bumpy"),
    ],
)
@pytest.mark.parametrize("albedo", [0.0, 0.9])
def test_forcing_effects_changes_no_more_than_promised(scene, albedo):
    mesh = scene()
    auto, forced = (precompute(mesh, 3, 256, albedo=albedo, effects=e) for e in ("auto", "all"))
    direct = precompute(mesh, 3, 256, albedo=albedo, effects="direct")
    light = forced.vectors[:, :, 0].mean() * AMBIENT
    # What auto leaves out is below its tolerance; what direct leaves out, below the bound in its plan.
    assert abs(auto.vectors[:, :, 0].mean() * AMBIENT - light) <= 0.005 * max(light, 1e-9) + 1e-6
    assert abs(direct.vectors[:, :, 0].mean() * AMBIENT - light) <= promised(direct) * max(light, 1e-9) + 1e-6


@pytest.mark.slow
def test_forcing_effects_on_the_cornell_box():
    auto = precompute(ROOT / "scenes" / "cornell.xml", 2, 256)
    assert verdicts(auto)["interreflection"] == "simulated"
    assert verdicts(auto)["colour"] == "simulated"
    forced = precompute(ROOT / "scenes" / "cornell.xml", 2, 256, effects="all")
    assert auto.rays_traced == forced.rays_traced
    assert_rounded(auto.vectors, forced.vectors, terms=256 + 64 * auto.bounces, size=1.0)
    direct = precompute(ROOT / "scenes" / "cornell.xml", 2, 256, effects="direct")
    light, without = (t.vectors[:, :, 0].mean() for t in (forced, direct))
    assert 0.2 * light < light - without < promised(direct) * light
    gray = precompute(ROOT / "scenes" / "cornell.xml", 2, 256, effects="shadows,interreflection")
    assert gray.vectors.shape[1] == 1
    tint = next(effect for effect in direct.effects if effect.name == "colour")
    assert tint.verdict == "omitted"


@pytest.mark.slow
def test_forcing_effects_on_the_skull(data):
    skull = data / "meshes" / "skull.ply"
    direct = precompute(skull, 2, 256)
    assert verdicts(direct)["interreflection"] == "omitted"  # a mesh file has no material
    forced = precompute(skull, 2, 256, effects="all")
    light, without = (t.vectors[:, :, 0].mean() for t in (forced, direct))
    assert 0.05 * light < light - without < promised(direct) * light


def test_convex_scenes_trace_nothing_unless_forced():
    assert precompute(sphere(3), 2, 64).rays_traced == 0
    forced = precompute(sphere(3), 2, 64, effects="all", albedo=0.9)
    assert forced.rays_traced > 0
    np.testing.assert_allclose(forced.vectors.mean(axis=1), precompute(sphere(3), 2, 64).vectors[:, 0], atol=1e-6)


def test_without_shadows_everything_is_open():
    transfer = precompute(bumpy(3), 2, 64, effects="none")
    assert transfer.rays_traced == 0
    np.testing.assert_allclose(transfer.vectors[:, 0, 0] * AMBIENT, 1.0, atol=1e-5)
    assert verdicts(transfer)["shadows"] == "omitted"


def test_costs_are_foretold():
    transfer = precompute(bumpy(4), 3, 512, albedo=0.5)
    foretold = sum(effect.rays for effect in transfer.effects if effect.verdict == "simulated")
    assert transfer.rays_traced == pytest.approx(foretold, rel=0.1)
    assert transfer.rays_traced <= 1.3 * 512 * len(transfer.positions)


@pytest.mark.parametrize("effects", ["sparkle", "", "interreflection", "shadows,colour", "shadows,,interreflection"])
def test_bad_effects(effects):
    with pytest.raises(UserError, match="effects"):
        precompute(sphere(1), 1, 16, effects=effects)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"albedo": 1.5}, "albedo must be"),
        ({"albedo": [0.1, 0.2]}, "albedo must be"),
        ({"albedo": float("nan")}, "albedo must be"),
        ({"bounces": -1}, "bounces must be"),
        ({"view": "front"}, "this scene has none"),
    ],
)
def test_bad_options(options, message):
    with pytest.raises(UserError, match=message):
        precompute(sphere(1), 1, 16, **options)


@pytest.mark.slow
def test_what_the_bandlimit_leaves_out_is_foretold():
    mesh = bumpy(3)
    row = precompute(mesh, 4, 64).effects[-1]
    assert row.name == "degrees above 4"
    high = precompute(mesh, 24, 2048).vectors[:, 0].astype(np.float64)
    left = math.sqrt(1.0 - (high[:, :25] ** 2).sum() / (high**2).sum())
    # 256 directions have an error of about 4 % themselves, which hides so much; and degrees above 24 are not counted.
    assert row.contribution == pytest.approx(left, rel=0.25)
