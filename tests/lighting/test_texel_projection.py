import tracemalloc

import numpy as np
import OpenEXR
import pytest

from slepian_prt.errors import UserError
from slepian_prt.lighting.environment import about_up, make_environment, read_environment
from slepian_prt.lighting.map_files import Checked, Rows, array_rows, file_rows
from slepian_prt.lighting.projection import project_environment
from slepian_prt.lighting.texel_projection import TexelProjection, clenshaw_curtis
from slepian_prt.renderer.variants import imported_mitsuba, mitsuba
from slepian_prt.sphere.harmonics import num_coefficients, real_sh
from slepian_prt.sphere.rotation import rotate_sh
from tests.lighting.test_environment import grid_directions, write_exr
from tests.numerics import assert_exact, assert_rounded


@pytest.mark.parametrize(("height", "bandlimit"), [(3, 4), (5, 0), (64, 5), (129, 20)])
def test_adjoint_is_the_transpose(height, bandlimit, rng):
    projection = TexelProjection(height, 2 * height, bandlimit, about_up(33.0))
    texels = rng.normal(size=(height, 2 * height, 3))
    coefficients = rng.normal(size=(3, num_coefficients(bandlimit)))
    there = np.sum(projection(texels) * coefficients)
    assert np.sum(texels * projection.adjoint(coefficients)) == pytest.approx(there, rel=1e-10)


@pytest.mark.slow
def test_projection_is_the_sum_over_texels(rng):
    """Every harmonic evaluated at every texel, the way one would first write it."""
    height, bandlimit = 256, 20
    texels = rng.random((height, 2 * height, 3)) ** 8
    weights = np.repeat(clenshaw_curtis(height - 1) * np.pi / height, 2 * height)
    harmonics = real_sh(bandlimit, grid_directions(height).reshape(-1, 3))
    expected = (texels.reshape(-1, 3) * weights[:, None]).T @ harmonics
    found = TexelProjection(height, 2 * height, bandlimit)(texels.astype(np.float32))
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())


# By Cauchy-Schwarz, what a coefficient of light of at most one is the sum of: ∫ |y_lm| dω.
WHITE = np.sqrt(4.0 * np.pi)


def test_blocks_of_rows_add_up_to_the_whole(rng):
    texels = rng.random((200, 400, 3)).astype(np.float32)
    projection = TexelProjection(200, 400, 9)
    expected = projection(texels)
    found = projection.of_rows(texels[a:b] for a, b in [(0, 1), (1, 77), (77, 78), (78, 200)])
    assert_rounded(found, expected, terms=200, size=WHITE)


def test_any_rotation_is_that_of_the_light(rng):
    texels = rng.random((64, 128, 3))
    plain = project_environment(texels, 6)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    np.testing.assert_allclose(project_environment(texels, 6, rotate=turn), rotate_sh(plain, turn), atol=1e-12)
    np.testing.assert_allclose(project_environment(texels, 6, rotate=about_up(20.0)),
                               project_environment(texels, 6, rotate=20.0), atol=1e-12)  # fmt: skip
    for angle in (0.0, 360.0, 1e-9):
        np.testing.assert_allclose(project_environment(texels, 6, rotate=angle), plain, atol=1e-9)
    with mitsuba() as mi:
        transform = mi.ScalarTransform4f().rotate([0, 1, 0], 20.0)
    np.testing.assert_allclose(project_environment(texels, 6, rotate=transform),
                               project_environment(texels, 6, rotate=20.0), atol=1e-6)  # fmt: skip
    for wrong in (np.eye(4), -np.eye(3), 2 * np.eye(3), np.full((3, 3), np.nan), "north"):
        with pytest.raises(UserError, match="rotation must be"):
            project_environment(texels, 6, rotate=wrong)


def test_an_emitter_of_mitsuba_is_its_map(rng):
    texels = rng.random((40, 80, 3)).astype(np.float32)
    with mitsuba() as mi:
        emitter = mi.load_dict({"type": "envmap", "bitmap": mi.Bitmap(texels), "scale": 0.5})
        found = project_environment(emitter, 4)
        lamp = mi.load_dict({"type": "point", "intensity": {"type": "rgb", "value": 1.0}})
        with pytest.raises(UserError, match="PointLight is no distant light"):
            project_environment(lamp, 4)
    np.testing.assert_allclose(found, 0.5 * project_environment(texels, 4), atol=1e-6)


# --- Files -----------------------------------------------------------------------------------------------------------


COMPRESSIONS = sorted(name for name in dir(OpenEXR) if name.endswith("_COMPRESSION"))


@pytest.mark.parametrize("half", [True, False])
@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_every_compression_of_openexr(compression, half, tmp_path, rng):
    coarse = 0.5 + rng.random((4, 8, 3))
    texels = np.repeat(np.repeat(coarse, 8, axis=0), 8, axis=1).astype(np.float32)  # what lossy ones keep well
    write_exr(tmp_path / "map.exr", texels, getattr(OpenEXR, compression), half)
    lossy = compression.startswith(("B44", "DWA", "LJ2K")) or (compression.startswith("PXR24") and not half)
    read = read_environment(tmp_path / "map.exr").texels
    np.testing.assert_allclose(read, texels, atol=0.1 if lossy else 1e-3 if half else 0.0)


def test_rows_of_a_file_are_those_of_the_whole(tmp_path, rng):
    texels = rng.random((96, 192, 3)).astype(np.float32)
    write_exr(tmp_path / "map.exr", texels, OpenEXR.PIZ_COMPRESSION, half=False)
    rows = file_rows(tmp_path / "map.exr")
    assert_exact(rows.read(33, 70), texels[33:70], because="a copy")
    from_file = project_environment(tmp_path / "map.exr", 5)
    assert_rounded(from_file, project_environment(texels, 5), terms=96, size=WHITE)


@pytest.mark.parametrize("kind", ["tiled", "luminance", "layer", "window"])
def test_other_kinds_of_openexr(kind, tmp_path, rng):
    texels = rng.random((32, 64, 3)).astype(np.float32)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    channels = {c: np.ascontiguousarray(texels[..., i]) for i, c in enumerate("RGB")}
    expected = texels
    if kind == "tiled":
        header |= {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()}
    if kind == "luminance":
        channels, expected = {"Y": channels["G"]}, np.repeat(texels[..., 1:2], 3, axis=2)
    if kind == "layer":
        channels = {f"sky.{name}": part for name, part in channels.items()} | {"Z": channels["R"]}
    if kind == "window":
        origin = np.array([5, 7], np.int32)
        header["dataWindow"] = header["displayWindow"] = (origin, origin + np.array([63, 31], np.int32))
    with OpenEXR.File(header, channels) as file:
        file.write(str(tmp_path / "map.exr"))
    assert_exact(read_environment(tmp_path / "map.exr").texels, expected, because="a copy")


def test_primaries_of_a_file_are_followed(tmp_path):
    """A red of Rec. 2020 is outside sRGB: less than nothing in green. White stays white."""
    texels = np.full((8, 16, 3), 0.5, dtype=np.float32)
    texels[2, 3] = [1.0, 0.0, 0.0]
    primaries = (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290)
    header = {"compression": OpenEXR.NO_COMPRESSION, "type": OpenEXR.scanlineimage, "chromaticities": primaries}
    with OpenEXR.File(header, {"RGB": texels}) as file:
        file.write(str(tmp_path / "map.exr"))
    read = file_rows(tmp_path / "map.exr").read(0, 8)
    np.testing.assert_allclose(read[5, 5], 0.5, atol=1e-5)
    # ITU-R BT.2087, table of the conversion to BT.709.
    np.testing.assert_allclose(read[2, 3], [1.6605, -0.1246, -0.0182], atol=1e-3)


@pytest.mark.parametrize("keep", [0.3, 0.9])
def test_a_file_cut_short(keep, tmp_path, rng):
    write_exr(tmp_path / "map.exr", rng.random((64, 128, 3)), OpenEXR.ZIP_COMPRESSION, half=False)
    whole = (tmp_path / "map.exr").read_bytes()
    (tmp_path / "map.exr").write_bytes(whole[: int(keep * len(whole))])
    for use in (read_environment, lambda path: project_environment(path, 3)):
        with pytest.raises(UserError, match="cannot be read as an environment map") as caught:
            use(tmp_path / "map.exr")
        assert "\n" not in str(caught.value)


def test_channels_without_colours(tmp_path):
    with OpenEXR.File({"type": OpenEXR.scanlineimage}, {"Z": np.ones((8, 16), np.float32)}) as file:
        file.write(str(tmp_path / "map.exr"))
    with pytest.raises(UserError, match="has the channels Z, not R, G and B"):
        read_environment(tmp_path / "map.exr")


# --- Hard cases ------------------------------------------------------------------------------------------------------


def suns(height: int) -> Rows:
    """Dim, with a sun of 2e4 in one texel; made row by row."""

    def read(begin: int, end: int) -> np.ndarray:
        block = np.full((end - begin, 2 * height, 3), 0.1, dtype=np.float32)
        if begin <= height // 3 < end:
            block[height // 3 - begin, height // 5] = 2e4
        return block

    return Rows("suns", "suns", height, 2 * height, read)


def test_a_sun_in_one_texel():
    height = 512
    rows = suns(height)
    found = project_environment(rows.read(0, height), 10)
    direction = grid_directions(height)[height // 3, height // 5]
    power = (2e4 - 0.1) * clenshaw_curtis(height - 1)[height // 3] * np.pi / height
    expected = power * real_sh(10, direction[None])[0]
    expected[0] += 0.1 * np.sqrt(4 * np.pi)
    np.testing.assert_allclose(found, np.tile(expected, (3, 1)), rtol=0, atol=1e-6 * np.abs(expected).max())


@pytest.mark.slow
def test_sixteen_thousand_texels_across_are_not_held():
    """16384 x 8192 texels are 1.6 GB; a tenth of that is needed."""
    height = 8192
    tracemalloc.start()
    try:
        found = TexelProjection(height, 2 * height, 10).of_rows(Checked(suns(height), clamp_negative=False))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 0.1 * height * 2 * height * 12
    # A flux of 2e4 times the solid angle of a texel.
    texel = np.sin(np.pi * (height // 3) / (height - 1)) * (np.pi / (height - 1)) * (np.pi / height)
    expected = 0.1 * np.sqrt(4 * np.pi) + (2e4 - 0.1) * texel / np.sqrt(4 * np.pi)
    np.testing.assert_allclose(found[:, 0], expected, rtol=1e-5)


@pytest.mark.parametrize("height", [1, 2])
def test_the_smallest_maps(height, rng):
    texels = rng.random((height, 2 * height, 3))
    found = project_environment(texels, 3)
    assert np.isfinite(found).all()
    assert found[:, 0].min() > 0.0
    np.testing.assert_allclose(project_environment(make_environment(texels), 3), found, atol=1e-12)


def test_texels_that_are_not_numbers():
    with pytest.raises(UserError, match="texels must be real numbers"):
        array_rows(np.full((4, 8, 3), "x"), "sky", "sky")


def test_nothing_is_left_open_that_mitsuba_reads(tmp_path, rng):
    mi = imported_mitsuba()
    if mi.variant() is None:
        mi.set_variant("scalar_rgb")
    texels = (0.2 + 0.6 * rng.random((16, 32, 3))).astype(np.float32)
    mi.Bitmap(texels).write(str(tmp_path / "map.hdr"))
    whole = read_environment(tmp_path / "map.hdr").texels
    assert_exact(file_rows(tmp_path / "map.hdr").read(5, 9), whole[5:9], because="a copy")
