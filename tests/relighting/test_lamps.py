"""Relighting with the lamps of a scene: added to distant light, scaled, and turned."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.polynomial import legendre

import slepian_prt as sp
from slepian_prt.cli import main
from slepian_prt.compression.files.prt_file import load
from slepian_prt.errors import UserError
from slepian_prt.relighting.damping import damp
from slepian_prt.relighting.series import Lights, relight_series
from tests.numerics import assert_rounded
from tests.transport.test_lamp_light import point

BANDLIMIT = 6
EPSILON = float(np.finfo(np.float32).eps)
FLOOR = """<shape type="rectangle" id="floor"><bsdf type="diffuse"><rgb name="reflectance" value=".6, .5, .4"/></bsdf>
</shape>"""
SUN = """<emitter type="directional" id="sun"><vector name="direction" x="-1" y="0" z="-1"/>
<rgb name="irradiance" value="1, 2, 3"/></emitter>"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A floor under two lamps, as a scene and a file, and a map."""
    path = tmp_path_factory.mktemp("lamps")
    content = FLOOR + SUN + point("bulb", (0.0, 0.0, 1.0), 2.0)
    (path / "lit.xml").write_text(f'<scene version="3.0.0">{content}</scene>')
    (path / "dark.xml").write_text(f'<scene version="3.0.0">{FLOOR}</scene>')
    for name in ("lit", "dark"):
        transfer = sp.precompute(path / f"{name}.xml", BANDLIMIT, 16)
        transfer.save(path / f"{name}.npz")
        sp.compress(transfer, clusters=2).save(path / f"{name}.prt", keep_order=True)
    return path


@pytest.fixture(scope="module")
def transfer(folder) -> sp.Transfer:
    return sp.load_transfer(folder / "lit.npz")


def smooth_light(rng: np.random.Generator) -> np.ndarray:
    return rng.normal(size=(3, (BANDLIMIT + 1) ** 2))


def test_lamps_are_added_to_each_light(transfer, folder, rng):
    lights = np.stack([smooth_light(rng) for _ in range(3)])
    fixed = transfer.fixed
    lamps = transfer.mesh.albedo * (fixed.direct + fixed.bounced).sum(axis=0)
    distant = sp.relight(transfer, lights, fixed_lights=0.0)
    for one, light in zip(sp.relight(transfer, lights), distant, strict=True):
        assert_rounded(one, light + lamps, terms=4, size=float(np.abs(light).max() + lamps.max()))
    np.testing.assert_allclose(sp.relight(transfer, None), lamps, rtol=10.0 * EPSILON)
    packed = load(folder / "lit.prt")
    np.testing.assert_allclose(sp.relight(packed, None), lamps, rtol=2.0**-11 + 2e-5)


def test_lamps_are_scaled_by_name(transfer):
    fixed, albedo = transfer.fixed, transfer.mesh.albedo
    sun, bulb = albedo * (fixed.direct + fixed.bounced)
    half = sp.relight(transfer, None, fixed_lights=0.5)
    np.testing.assert_allclose(half, 0.5 * (sun + bulb), rtol=10.0 * EPSILON)
    one = sp.relight(transfer, None, fixed_lights={"*": 0.0, "bulb": 3.0})
    np.testing.assert_allclose(one, 3.0 * bulb, rtol=10.0 * EPSILON)
    with pytest.raises(UserError, match="names 'lamp', which is no lamp"):
        sp.relight(transfer, None, fixed_lights={"lamp": 3.0})


def test_without_any_light(folder):
    with pytest.raises(UserError, match="the transfer has no lamps; give lighting"):
        sp.relight(load(folder / "dark.prt"), None)


def bandlimited_cosine(cosine: float) -> float:
    """(1/π) Σ_l c_l P_l(cos θ) up to the bandlimit, of the clamped cosine, by Gauss's rule on [0, 1]."""
    x, w = legendre.leggauss(40)
    x, w = 0.5 * (x + 1.0), 0.5 * w
    parts = [(2 * l + 1) / 2 * np.sum(w * x * legendre.legval(x, np.eye(l + 1)[l])) for l in range(BANDLIMIT + 1)]
    return float(legendre.legval(cosine, parts)) / math.pi


@pytest.mark.parametrize("degrees", [0.0, 30.0, 180.0])
def test_a_directional_lamp_turns_through_the_transfer(transfer, degrees):
    """Of a floor that nothing shadows: E times the clamped cosine as the bandlimit has it."""
    radiance = sp.relight(transfer, None, fixed_lights={"bulb": 0.0}, turn_directional=degrees)
    # About y, from (1, 0, 1)/√2 toward +x: the height over the floor, which looks along z, is cos(45° + turn).
    expected = bandlimited_cosine(math.cos(math.radians(45.0 + degrees))) * np.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(radiance, transfer.mesh.albedo * expected, atol=1e-5)
    still = sp.relight(transfer, None, turn_directional=degrees) - radiance
    np.testing.assert_allclose(still, transfer.mesh.albedo * transfer.fixed.direct[1], atol=1e-5)


def test_turned_by_nothing_is_nearly_the_lamp(transfer):
    direct = sp.relight(transfer, None, fixed_lights={"bulb": 0.0})
    through = sp.relight(transfer, None, fixed_lights={"bulb": 0.0}, turn_directional=0.0)
    np.testing.assert_allclose(through, direct, rtol=0.03)  # the cosine's energy above degree 6
    with pytest.raises(UserError, match="degrees, or a rotation matrix"):
        sp.relight(transfer, None, turn_directional=True)


def test_series_of_lamps_alone(folder):
    packed, remarks = load(folder / "lit.prt"), []
    series = relight_series(packed, Lights(), "lit.prt", remarks.append)
    np.testing.assert_allclose(series.radiance[0], sp.relight(packed, None), rtol=10.0 * EPSILON)
    assert series.fixed_lights == {"sun": 1.0, "bulb": 1.0}
    assert not series.lighting.any()
    assert not remarks
    with pytest.raises(UserError, match="its lamps are off, and the scene has no light of its own"):
        relight_series(packed, Lights(fixed_lights=0.0), "lit.prt")
    with pytest.raises(UserError, match=r"dark\.prt: the scene has no light of its own; name a map"):
        relight_series(load(folder / "dark.prt"), Lights(), "dark.prt")


def test_a_turntable_turns_what_it_is_asked_to(folder):
    packed, remarks = load(folder / "lit.prt"), []
    still = relight_series(packed, Lights(turntable=4), "lit.prt", remarks.append)
    assert np.ptp(still.radiance, axis=0).max() == 0.0
    assert remarks == [
        "the lamps of the scene stand still while distant light turns; `turn_directional` turns directional ones"
    ]
    lights = Lights(turntable=4, rotate=15.0, turn_directional=True, fixed_lights={"bulb": 0.0})
    turned = relight_series(packed, lights, "lit.prt", remarks.append)
    assert turned.fixed_lights == {"sun": 0.0, "bulb": 0.0}
    for number, radiance in enumerate(turned.radiance):
        expected = bandlimited_cosine(math.cos(math.radians(60.0 + 90.0 * number))) * np.array([1.0, 2.0, 3.0])
        np.testing.assert_allclose(radiance, packed.mesh.albedo * expected, atol=0.05)  # compressed to 2 %
    assert any("vertices are negative" in line for line in remarks)


def test_what_changes_nothing_is_said(folder, tmp_path):
    packed, remarks = load(folder / "dark.prt"), []
    lights = Lights((write_map(tmp_path),), fixed_lights=2.0, turn_directional=True)
    relight_series(packed, lights, "dark.prt", remarks.append)
    assert remarks == [
        "dark.prt holds the light of no lamps; `fixed_lights` changes nothing",
        "dark.prt has no directional lamp; `turn_directional` changes nothing",
    ]


def write_map(folder: Path) -> str:
    """A white map."""
    import OpenEXR

    with OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGB": np.ones((16, 32, 3), np.float32)}) as file:
        file.write(str(folder / "white.exr"))
    return str(folder / "white.exr")


def test_windows_are_chosen_for_distant_light(transfer, rng):
    """Lamps would hide what rings."""
    light = smooth_light(rng)
    with_lamps, without = damp(transfer, light, "hann"), damp(replace(transfer, fixed=None), light, "hann")
    assert with_lamps.width == without.width
    assert with_lamps.negative_before == without.negative_before


def test_command_line(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    options = ["--fixed-lights", "0", "--fixed-lights", "bulb=2"]
    assert main(["relight", "lit.prt", "-o", "lit_by_bulb.npz", *options]) == 0
    expected = sp.relight(load("lit.prt"), None, fixed_lights={"sun": 0.0, "bulb": 2.0})
    with np.load("lit_by_bulb.npz") as file:
        np.testing.assert_allclose(file["radiance"], expected, rtol=10.0 * EPSILON)
    for option, message in (
        ("bright", "--fixed-lights must be a number, or NAME=NUMBER for one lamp, not 'bright'"),
        ("lamp=2", "--fixed-lights names 'lamp', which is no lamp of the transfer; it has: 'sun', 'bulb'"),
        ("bulb=-2", "--fixed-lights of 'bulb' must be a finite number from 0 on, not -2.0"),
    ):
        assert main(["relight", "lit.prt", "-o", "no.npz", "--fixed-lights", option]) == 2
        assert message in capsys.readouterr().err
    for one, named in (("bulb", "bulb"), ("*", "all lamps")):
        given = [f"--fixed-lights={one}=1", f"--fixed-lights={one}=3"]
        assert main(["relight", "lit.prt", "-o", "no.npz", *given]) == 2
        assert f"--fixed-lights is given twice for {named}; give it once" in capsys.readouterr().err
    assert not (folder / "no.npz").exists()
