"""Ambient occlusion and the like as files, read by other means."""

import numpy as np
import pytest

from slepian_prt.export.ambient import ambient_part
from slepian_prt.export.model import export_model
from tests.export.glb_reader import read_glb
from tests.numerics import assert_exact

NAMES = {
    "occlusion": ["occlusion"],
    "bent-normals": ["bent_x", "bent_y", "bent_z"],
    "sky-visibility": ["sky_dc", "sky_x", "sky_y", "sky_z"],
    "l1": ["l1_dc", "l1_x", "l1_y", "l1_z"],
}


def ply_vertices(path) -> np.ndarray:
    """The first element of a binary .ply, by its header."""
    header, content = path.read_bytes().split(b"end_header\n", 1)
    lines = [line.split() for line in header.decode().splitlines()]
    assert ["format", "binary_little_endian", "1.0"] in lines
    count = next(int(line[2]) for line in lines if line[:2] == ["element", "vertex"])
    kinds = {"float": "<f4", "double": "<f8", "uchar": "u1"}
    fields = [(line[2], kinds[line[1]]) for line in lines if line[0] == "property" and line[1] != "list"]
    return np.frombuffer(content, np.dtype(fields), count)


@pytest.mark.parametrize("what", list(NAMES))
def test_properties_of_a_ply(tmp_path, packed, what):
    export_model(packed, tmp_path / "a.ply", what)
    vertices = ply_vertices(tmp_path / "a.ply")
    found = np.stack([vertices[name] for name in NAMES[what]], axis=1)
    ambient = ambient_part(packed, what)
    np.testing.assert_allclose(found, ambient.values[:, 0], rtol=0, atol=2e-7 * np.abs(found).max())
    gray = np.clip(ambient.occlusion[:, 0], 0.0, 1.0)
    srgb = np.where(gray <= 0.0031308, 12.92 * gray, 1.055 * np.maximum(gray, 1e-9) ** (1 / 2.4) - 0.055)
    for colour in ("red", "green", "blue"):
        np.testing.assert_allclose(vertices[colour] / 255, srgb, atol=0.5001 / 255)


def test_three_channels_are_named_by_their_colours(tmp_path, coloured):
    export_model(coloured, tmp_path / "a.ply", "l1")
    vertices = ply_vertices(tmp_path / "a.ply")
    values = ambient_part(coloured, "l1").values
    assert_exact(vertices["l1_x_green"], values[:, 1, 1], "copied")
    assert_exact(vertices["l1_dc_blue"], values[:, 2, 0], "copied")


@pytest.mark.parametrize("what", list(NAMES))
def test_attributes_of_a_glb(tmp_path, packed, what):
    """Colours are occlusion, of a mesh whose albedo varies."""
    export_model(packed, tmp_path / "a.glb", what)
    glb = read_glb(tmp_path / "a.glb")
    (primitive,) = glb.primitives()
    ambient, attributes = ambient_part(packed, what), primitive["attributes"]
    gray = np.clip(ambient.occlusion[:, 0], 0.0, 1.0)
    assert_exact(glb.accessor(attributes["COLOR_0"]), np.stack([gray] * 3, axis=1), "copied")
    if what == "occlusion":
        assert "_CUSTOM0" not in attributes
        return
    vector = glb.accessor(attributes["_CUSTOM0"])
    assert_exact(vector[:, : len(NAMES[what])], ambient.values[:, 0], "copied")
    if what == "bent-normals":
        np.testing.assert_allclose(np.linalg.norm(vector[:, :3], axis=1), 1.0, atol=1e-6)
        assert_exact(vector[:, 3], ambient.occlusion[:, 0], "copied")
