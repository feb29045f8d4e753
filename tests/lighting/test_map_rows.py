"""What texels of maps may be, from arrays and portable float maps."""

import numpy as np
import OpenEXR
import pytest

from slepian_prt.errors import UserError
from slepian_prt.lighting.environment import make_environment, read_environment
from slepian_prt.lighting.map_files import file_rows
from slepian_prt.lighting.map_rows import BRIGHTEST, NEGATIVE_TOLERANCE
from slepian_prt.lighting.projection import project_environment
from slepian_prt.renderer.variants import bitmap_module
from tests.numerics import assert_exact

# --- Arrays ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["<f4", ">f4", "<f8", ">f8", "<f2", ">f2", "g"])
def test_floats_of_any_kind_are_radiance(kind, rng):
    texels = rng.random((8, 16, 3)).astype(np.float16)  # what all of them hold
    assert_exact(make_environment(texels.astype(kind)).texels, texels, because="a copy")


def test_booleans_are_one_or_nothing(rng):
    lit = rng.random((8, 16)) > 0.5
    assert_exact(make_environment(lit).texels[..., 1], lit, because="a copy")


@pytest.mark.parametrize("kind", ["u1", "i2", ">u2", "i4", "i8"])
def test_integers_are_not_radiance(kind):
    texels = np.full((8, 16, 3), 100, dtype=kind)
    for use in (make_environment, lambda light: project_environment(light, 2)):
        with pytest.raises(UserError, match=r"texels are integers .*/ 255.*astype\(float\)") as caught:
            use(texels)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("texels", [np.ones((8, 16), complex), np.full((8, 16), "x"), np.ones((8, 16), object)])
def test_what_is_no_number_is_not_radiance(texels):
    with pytest.raises(UserError, match="must be real numbers"):
        make_environment(texels)


def test_masks_are_not_forgotten(rng):
    texels = rng.random((8, 16, 3))
    with pytest.raises(UserError, match="masked"):
        make_environment(np.ma.masked_less(texels, 0.5))
    assert_exact(make_environment(np.ma.array(texels)).texels, texels.astype(np.float32), because="a copy")


# --- Bright ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [1e39, 1e38, 1.01 * BRIGHTEST, -1e39, 1e300])
def test_beyond_what_can_be_calculated_with(value):
    texels = np.ones((8, 16, 3))
    texels[4, 5, 1] = value
    with pytest.raises(UserError, match=r"beyond 1e\+30.*row 4, column 5"):
        make_environment(texels)


def test_up_to_there_all_is_right(rng):
    texels = rng.random((16, 32, 3)).astype(np.float32)
    scale = np.float32(2.0**99)  # 6e29: a power of two rounds nothing
    assert scale <= BRIGHTEST < 2 * scale
    assert_exact(
        project_environment(texels * scale, 6), project_environment(texels, 6) * float(scale), because="scaled"
    )


# --- Negative --------------------------------------------------------------------------------------------------------


def ways(texels, folder):
    """The same map as it may come in."""
    channels = {c: np.ascontiguousarray(texels[..., i].astype(np.float32)) for i, c in enumerate("RGB")}
    with OpenEXR.File({"type": OpenEXR.scanlineimage}, channels) as file:
        file.write(str(folder / "map.exr"))
    write_pfm(folder / "map.pfm", texels)
    return [
        lambda **more: make_environment(texels, **more),
        lambda **more: read_environment(folder / "map.exr", **more),
        lambda **more: read_environment(folder / "map.pfm", **more),
        lambda **more: project_environment(folder / "map.exr", 0, **more),
        lambda **more: project_environment(texels, 0, **more),
    ]


def negative(part: float) -> np.ndarray:
    """A map of light 1 whose rows at the equator take this part of all light away in one column."""
    height = 16
    texels = np.ones((height, 2 * height, 3))
    sine = np.sin((np.arange(height) + 0.5) * np.pi / height)
    rows = slice(height // 2 - 1, height // 2 + 1)
    light = 2 * height * sine.sum() - sine[rows].sum()
    texels[rows, 4] = -part * light / sine[rows].sum()
    return texels


@pytest.mark.parametrize("number", range(5))
def test_negative_light_that_matters_is_refused_whichever_way_it_comes(number, tmp_path):
    small, large = negative(0.99 * NEGATIVE_TOLERANCE), negative(1.01 * NEGATIVE_TOLERANCE)
    use = ways(small, tmp_path)[number]
    assert getattr(use(), "clamped", 2) == 2
    use = ways(large, tmp_path)[number]
    with pytest.raises(UserError, match=r"2 texels are negative .*0\.1% of the light.*`clamp_negative`"):
        use()
    assert getattr(use(clamp_negative=True), "clamped", 2) == 2


def test_all_negative():
    with pytest.raises(UserError, match="outweigh all light in the map"):
        make_environment(np.full((8, 16, 3), -1.0))


# --- Portable float maps ---------------------------------------------------------------------------------------------


def write_pfm(path, texels, scale=-1.0):
    """From the bottom up, as the format has it."""
    kind = b"PF" if texels.ndim == 3 else b"Pf"
    header = kind + b"\n%d %d\n%g\n" % (texels.shape[1], texels.shape[0], scale)
    path.write_bytes(header + texels[::-1].astype("<f4" if scale < 0 else ">f4").tobytes())


@pytest.mark.parametrize("scale", [-1.0, 1.0, -0.5, 4.0])
@pytest.mark.parametrize("colours", [True, False])
def test_portable_float_maps(scale, colours, tmp_path, rng):
    texels = rng.random((8, 16, 3) if colours else (8, 16)).astype(np.float32)
    write_pfm(tmp_path / "map.pfm", texels, scale)
    found = file_rows(tmp_path / "map.pfm")
    whole = found.read(0, 8)
    expected = texels * abs(scale) if colours else np.repeat(texels[..., None], 3, axis=2) * abs(scale)
    assert_exact(whole, expected, because="a power of two")
    assert_exact(found.read(2, 5), whole[2:5], because="a copy")
    theirs = np.array(bitmap_module().Bitmap(str(tmp_path / "map.pfm"))).reshape(8, 16, -1)
    assert_exact(whole, np.broadcast_to(theirs, (8, 16, 3)), because="a power of two")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"PF\n16 8\n-1\n" + bytes(1000), "cut short"),
        (b"PF\n16 8\n0\n" + bytes(1536), "scale is 0"),
        (b"PF\n16 8\ne\n" + bytes(1536), "could not convert"),
        (b"PF\n0 0\n1\n", "0 x 0"),
        (b"PF\n2000000000 1000000000\n1\n", "at most"),
        (b"PF\n16 16\n1\n" + bytes(3072), "twice as wide"),
        (b"PFsomething", "its header"),
    ],
)
def test_damaged_portable_float_maps(content, message, tmp_path):
    (tmp_path / "map.pfm").write_bytes(content)
    with pytest.raises(UserError, match=message):
        read_environment(tmp_path / "map.pfm")
