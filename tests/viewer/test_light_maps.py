"""Lights of a page: maps are carried as they are where they mean the same without their headers, else made small."""

from __future__ import annotations

import numpy as np
import OpenEXR
import pytest
from PIL import Image

import slepian_prt as sp
from slepian_prt.errors import UserError
from slepian_prt.lighting.environment import make_environment, read_environment
from slepian_prt.viewer import light_maps
from slepian_prt.viewer.light_maps import map_lights
from tests.numerics import assert_exact


def light_of(path, **options):
    """The light of one map."""
    (light,) = map_lights([path], 2, "y", **{"clamp_negative": False, **options})
    return light


def texels(height: int = 32, least: float = 0.5) -> np.ndarray:
    v, u = np.meshgrid(np.linspace(0, 3, height), np.linspace(0, 6, 2 * height), indexing="ij")
    return np.stack([1.5 + np.sin(u), 1.5 + np.cos(v), least + 1.0 + np.sin(u + v)], axis=-1).astype(np.float32)


def write_exr(path, image, **header) -> None:
    OpenEXR.File(
        {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **header}, {"RGB": image}
    ).write(str(path))


def write_hdr(path, image, *lines: str) -> None:
    """A Radiance picture without run lengths (G. Ward, "Real Pixels", 1991)."""
    exponent = np.ceil(np.log2(image.max(axis=2)))
    mantissas = np.clip(image / 2.0 ** exponent[..., None] * 256.0, 0, 255).astype(np.uint8)
    shared = (exponent + 128).astype(np.uint8)[..., None]
    head = "\n".join(["#?RADIANCE", "FORMAT=32-bit_rle_rgbe", *lines, "", f"-Y {len(image)} +X {image.shape[1]}", ""])
    path.write_bytes(head.encode() + np.concatenate([mantissas, shared], axis=2).tobytes())


def read_back(light, tmp_path) -> np.ndarray:
    path = tmp_path / f"carried{light.suffix}"
    path.write_bytes(light.map)
    return read_environment(path).texels


def test_small_plain_files_are_carried_as_they_are(tmp_path):
    write_exr(tmp_path / "plain.exr", texels())
    write_hdr(tmp_path / "plain.hdr", texels())
    for name in ("plain.exr", "plain.hdr"):
        light = light_of(tmp_path / name)
        assert light.map == (tmp_path / name).read_bytes()
        assert (light.suffix, light.name) == (name[-4:], "plain")
        assert_exact(light.coefficients, sp.project_environment(tmp_path / name, 2), "the same call")


@pytest.mark.parametrize("made", ["gamut", "exposure", "large", "picture", "alpha"])
def test_other_files_are_written_again(tmp_path, monkeypatch, made):
    path = tmp_path / "map.exr"
    if made == "gamut":
        write_exr(path, texels() + 5.0, chromaticities=(0.708, 0.292, 0.17, 0.797, 0.131, 0.046, 0.3127, 0.329))
    elif made == "exposure":
        write_hdr(path := tmp_path / "map.hdr", texels(), "EXPOSURE=4.0")
    elif made == "large":
        write_exr(path, texels())
        monkeypatch.setattr(light_maps, "_LARGEST_FILE", 1000)
    elif made == "alpha":
        image = np.concatenate([texels(), np.ones((32, 64, 1), np.float32)], axis=2)
        OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGBA": image}).write(str(path))
    else:
        Image.fromarray(np.full((16, 32, 3), 188, np.uint8)).save(path := tmp_path / "map.png")
    light = light_of(path)
    assert light.suffix == ".exr"
    assert light.map != path.read_bytes()
    wanted = read_environment(path).texels
    # DWAA rounds; half floats have 11 bits.
    np.testing.assert_allclose(read_back(light, tmp_path), wanted, rtol=0.03, atol=0.02 * wanted.max())
    assert_exact(light.coefficients, sp.project_environment(path, 2), "the same call")


def test_large_maps_are_made_small_by_means(tmp_path):
    image = np.ones((768, 1536, 3), np.float32)
    image[:, ::2] = 3.0
    image[300, 600] = 1e6
    light = light_of(make_environment(image, name="large"))
    small = read_back(light, tmp_path)
    assert small.shape == (512, 1024, 3)
    # Each new texel is of one and a half columns: of means between 5/3 and 7/3.
    plain = np.delete(small.reshape(-1, 3), np.flatnonzero(small[..., 0].ravel() > 100), axis=0)
    assert 1.6 < plain.min() < plain.max() < 2.4
    assert small.max() < 65504.0 * 1.01  # what half floats hold


def test_large_maps_keep_their_directions(tmp_path):
    row, column = np.mgrid[:1024, :2048]
    image = np.stack([row / 1024.0, column / 2048.0, np.full(row.shape, 0.25)], axis=2).astype(np.float32)
    small = read_back(light_of(make_environment(image, name="large")), tmp_path)
    rows, columns = np.mgrid[:512, :1024]
    # Means of two by two texels; DWAA rounds.
    np.testing.assert_allclose(small[..., 0], (rows + 0.25) / 512.0, atol=0.01)
    np.testing.assert_allclose(small[..., 1], (columns + 0.25) / 1024.0, atol=0.01)
    np.testing.assert_allclose(small[..., 2], 0.25, atol=0.01)


def test_negative_texels_are_told_and_not_carried(tmp_path):
    image = texels()
    image[3, 5] = -1e-4
    write_exr(tmp_path / "small.exr", image)
    light = light_of(tmp_path / "small.exr")
    assert light.clamped == 1
    assert read_back(light, tmp_path).min() >= 0.0
    image[:9] = -1.0
    write_exr(tmp_path / "much.exr", image)
    with pytest.raises(UserError, match="`clamp_negative`"):
        light_of(tmp_path / "much.exr")
    assert light_of(tmp_path / "much.exr", clamp_negative=True).clamped == 9 * 64


def test_maps_have_different_names(tmp_path):
    write_exr(tmp_path / "a.exr", texels())
    with pytest.raises(UserError, match="environments must have different names"):
        map_lights([tmp_path / "a.exr"] * 2, 2, "y", clamp_negative=False)


def test_carried_maps_can_be_read_in_a_browser(modules, tmp_path):
    """Those that are written again, by the reader that the page has."""
    light = light_of(make_environment(texels(), name="again"))
    body = """
        const { readMap } = await import("#maps");
        const map = await readMap("again.exr", content.buffer);
        return [map.width, map.height, map.data];
    """
    width, height, data = modules.run(body, content=light.map)
    assert (width, height) == (64, 32)
    # Cosine transforms in other orders may round to other steps of DWAA.
    np.testing.assert_allclose(data.reshape(32, 64, -1)[..., :3], read_back(light, tmp_path), rtol=2.0**-7)
