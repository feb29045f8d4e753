"""A model with its transfer: read by the specification, decoded by the 30 lines of the format, relit."""

import io
import os
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from slepian_prt.errors import UserError
from slepian_prt.export.model import export_model
from slepian_prt.export.transfer_glb import write_transfer_glb
from slepian_prt.lighting.fixed_lights import FixedLights
from slepian_prt.relighting.files.surfaces import split_surfaces
from slepian_prt.relighting.relight import relight
from slepian_prt.runtime.gpu_transfer import gpu_transfer
from slepian_prt.scene.formats.parts import Texture
from slepian_prt.scene.left_out import GATHERED
from slepian_prt.scene.reflectance.surface_detail import SurfaceDetail
from slepian_prt.scene.scene import Part
from slepian_prt.transport.effects import Effect
from tests.export.glb_reader import Glb, read_glb
from tests.numerics import assert_exact
from tests.runtime_reference import lit_table, relit


def bytes_of(glb: Glb, primitive: dict) -> np.ndarray:
    """(n, K) the numbers of the vertices of a primitive, however they are carried."""
    told = glb.root["extras"]["slepian_prt"]["coefficients"]
    attributes, count = primitive["attributes"], glb.root["extras"]["slepian_prt"]["bytesPerVertex"]
    if told["in"] != "texture":
        return np.hstack([glb.accessor(attributes[name]) for name in told["attributes"]])
    image = glb.image(told["texture"])
    size = np.array(image.shape[1::-1])
    column, row = np.floor(glb.accessor(attributes[told["coordinates"]]).astype(float) * size).astype(int).T
    texels = [image[row, column + number] for number in range(told["texels"])]
    return np.hstack(texels)[:, :count]


def radiance_of(glb: Glb, primitive: dict, lighting: np.ndarray) -> np.ndarray:
    """(n, 3) what a shader makes of it."""
    told = glb.root["extras"]["slepian_prt"]
    table = lit_table(glb.array(told["functions"]), glb.array(told["zeros"]), lighting)
    radiance = relit(bytes_of(glb, primitive).astype(np.uint8), table)
    attributes = primitive["attributes"]
    if "_LAMPS" in attributes:
        radiance = radiance + glb.accessor(attributes["_LAMPS"])
    material = glb.root["materials"][primitive["material"]]["pbrMetallicRoughness"]
    radiance = radiance * np.array(material.get("baseColorFactor", [1, 1, 1, 1]))[:3]
    return radiance * glb.accessor(attributes["COLOR_0"])[:, :3] if "COLOR_0" in attributes else radiance


def relative(found: np.ndarray, expected: np.ndarray) -> float:
    return float(np.sqrt(np.mean((found - expected) ** 2) / np.mean(expected**2)))


@pytest.mark.parametrize("attributes", ["bytes", "float", "texture"])
@pytest.mark.parametrize("functions", [8, 24])
def test_what_is_read_relights_as_the_file_does(tmp_path, packed, light, attributes, functions):
    exported = export_model(packed, tmp_path / "a.glb", attributes=attributes, functions=functions)
    gpu = gpu_transfer(packed, functions)
    glb = read_glb(tmp_path / "a.glb")
    (primitive,) = glb.primitives()
    # Vertices of a plain model stand in their order; they are found by it, and not by their place.
    found = bytes_of(glb, primitive)
    assert_exact(found, gpu.vertices, "bytes, copied")
    told = glb.root["extras"]["slepian_prt"]
    assert (told["functions"]["dtype"], told["zeros"]["dtype"]) == ("float16", "float32")
    assert_exact(glb.array(told["functions"]), gpu.functions, "numbers of float16")
    assert_exact(glb.array(told["zeros"]), gpu.zeros, "copied")
    assert told["error"]["ofThis"] == exported.error == gpu.error()
    # 16 bits of albedo are 1.3e-5 of 0.1; what is lost is measured, and told to be so under any rotation of such light.
    own = gpu.relight(light) * packed.mesh.albedo
    np.testing.assert_allclose(radiance_of(glb, primitive, light), own, atol=2e-5 * np.abs(own).max())
    assert relative(radiance_of(glb, primitive, light), relight(packed, light)) < 2.0 * gpu.error(light) + 1e-4


def test_three_channels(tmp_path, coloured, light):
    """The albedo of the ball is one colour: of the material, and no attribute."""
    export_model(coloured, tmp_path / "a.glb")
    glb = read_glb(tmp_path / "a.glb")
    (primitive,) = glb.primitives()
    assert sorted(primitive["attributes"]) == ["NORMAL", "POSITION", "_CUSTOM0", "_CUSTOM1", "_CUSTOM2", "_CUSTOM3"]
    assert glb.root["extras"]["slepian_prt"]["channels"] == 3
    error = relative(radiance_of(glb, primitive, light), relight(coloured, light))
    assert error < 2.0 * gpu_transfer(coloured).error(light) + 1e-4


def test_lamps_stand_beside_the_bytes(tmp_path, packed, light, rng):
    shape = (1, packed.vertex_count, 3)
    direct, bounced = rng.uniform(0.0, 2.0, (2, *shape)).astype(np.float32)
    lamp = FixedLights(("bulb",), ("point",), np.ones((1, 3)), direct, bounced)
    lit = replace(packed, fixed=lamp)
    export_model(lit, tmp_path / "a.glb")
    glb = read_glb(tmp_path / "a.glb")
    (primitive,) = glb.primitives()
    assert glb.root["extras"]["slepian_prt"]["lamps"] == ["bulb"]
    assert_exact(glb.accessor(primitive["attributes"]["_LAMPS"]), direct[0] + bounced[0], "one sum of float32")
    assert relative(radiance_of(glb, primitive, light), relight(lit, light)) < 2.0 * gpu_transfer(lit).error(light)


@pytest.mark.parametrize("attributes", ["bytes", "texture"])
def test_parts_and_textures_of_the_source_survive(tmp_path, packed, rng, attributes):
    """Vertices at a seam are there several times, all with the bytes of their receiver."""
    stream = io.BytesIO()
    texels = rng.integers(0, 256, (4, 8, 3)).astype(np.uint8)
    Image.fromarray(texels).save(stream, "PNG")
    count = len(packed.mesh.faces)
    detail = SurfaceDetail(
        (Texture("t", stream.getvalue(), ("clamp", "mirror")),),
        np.where(np.arange(count) < 100, 0, -1).astype(np.int32),
        rng.uniform(-1.0, 2.0, (count, 3, 2)).astype(np.float32),
        np.full((count, 3, 3), 0.5, dtype=np.float32),
        np.zeros(count, dtype=np.float32),
        np.full(count, -1, dtype=np.int32),
        np.zeros((count, 3, 2), dtype=np.float32),
    )
    gpu = gpu_transfer(packed)
    surfaces = split_surfaces(packed.mesh, (Part("ball", 0, packed.vertex_count),), detail)
    write_transfer_glb(tmp_path / "a.glb", packed, gpu, surfaces, attributes)
    glb = read_glb(tmp_path / "a.glb")
    plain, textured = glb.primitives()
    faces = glb.accessor(textured["indices"]).reshape(-1, 3)
    assert_exact(bytes_of(glb, textured)[faces], gpu.vertices[packed.mesh.faces[:100]], "bytes, copied")
    assert_exact(glb.accessor(textured["attributes"]["TEXCOORD_0"])[faces], detail.uv[:100], "copied")
    assert len(bytes_of(glb, textured)) > len(np.unique(packed.mesh.faces[:100]))
    material = glb.root["materials"][textured["material"]]["pbrMetallicRoughness"]
    assert material["baseColorFactor"] == [0.5, 0.5, 0.5, 1.0]
    assert_exact(glb.image(material["baseColorTexture"]["index"]), texels, "the image, as it was")
    assert "baseColorTexture" not in glb.root["materials"][plain["material"]]["pbrMetallicRoughness"]
    assert all("KHR_materials_unlit" in entry["extensions"] for entry in glb.root["materials"])
    if attributes == "texture":
        assert all(entry["occlusionTexture"]["strength"] == 0.0 for entry in glb.root["materials"])


def test_what_engines_draw_plainly_is_said(tmp_path, packed):
    """Rows of the plan whose light depends on the camera; of a file whose source is not there, textures too."""
    names = [f"{what} of shape 'ball'" for what in ("mirror reflection", "texture between vertices")]
    rows = tuple(Effect(name, GATHERED, 0.5, None, 0, "") for name in names)
    plain, remarks = replace(packed, effects=rows, source=""), []
    export_model(plain, tmp_path / "a.glb", report=remarks.append)
    (remark,) = remarks
    assert f"({'; '.join(names)}); textures that are found beside the file, or in `scene`, are written" in remark


def test_a_texture_does_not_use_alpha_and_is_not_filtered(tmp_path, packed):
    export_model(packed, tmp_path / "a.glb", attributes="texture")
    glb = read_glb(tmp_path / "a.glb")
    told = glb.root["extras"]["slepian_prt"]["coefficients"]
    sampler = glb.root["samplers"][glb.root["textures"][told["texture"]]["sampler"]]
    assert sampler == {"wrapS": 33071, "wrapT": 33071, "magFilter": 9728, "minFilter": 9728}
    assert told["texels"] == 6


def test_a_file_that_is_too_large_is_not_written(tmp_path, packed, monkeypatch):
    monkeypatch.setattr("slepian_prt.relighting.files.gltf_document._LARGEST", 10_000)
    with pytest.raises(UserError, match=r"GiB, and \.glb holds 4; give fewer `functions`"):
        export_model(packed, tmp_path / "a.glb")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize("attributes", ["bytes", "float", "texture"])
def test_khronos_finds_it_valid(tmp_path, packed, attributes):
    """GLTF_VALIDATOR names a folder in which `npm install gltf-validator` was run."""
    folder = os.environ.get("GLTF_VALIDATOR")
    if not folder or shutil.which("node") is None:
        pytest.skip("GLTF_VALIDATOR is not set, or there is no node: the .glb is not seen by Khronos' validator")
    export_model(packed, tmp_path / "a.glb", attributes=attributes)
    script = (
        "require('gltf-validator').validateBytes(new Uint8Array(require('fs').readFileSync(process.argv[1])))"
        ".then(r => console.log(r.issues.numErrors, r.issues.numWarnings))"
    )
    command = ["node", "-e", script, str(tmp_path / "a.glb")]
    done = subprocess.run(command, cwd=Path(folder), capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["0", "0"]
