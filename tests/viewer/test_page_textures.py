"""Textures of pages: the model's own files, of a size that hardware takes; found where the model is."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

import slepian_prt as sp
from slepian_prt.cli import main
from slepian_prt.relighting.drawing.camera import relit_camera
from slepian_prt.scene.formats.parts import Texture
from slepian_prt.viewer import page_textures, pages
from slepian_prt.viewer.buffers import Buffers
from slepian_prt.viewer.page_textures import texture_entry
from tests.viewer.page_reader import blocks, read_payload, with_arrays

CUBE = """mtllib box.mtl
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
vt 0 0
vt 2 0
vt 2 2
vt 0 2
usemtl tiles
f 1/1 2/2 3/3 4/4
"""


def encoded(image: np.ndarray, kind: str) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(image).save(stream, kind)
    return stream.getvalue()


def checks(height: int, width: int) -> np.ndarray:
    rows, columns = np.mgrid[:height, :width] // 4
    return np.repeat((255 * ((rows + columns) % 2)).astype(np.uint8)[..., None], 3, axis=2)


def read(texture: Texture):
    buffers = Buffers()
    entry = texture_entry(buffers, texture)
    entry = with_arrays(entry, buffers.content())
    return entry, Image.open(io.BytesIO(entry["bytes"].tobytes()))


@pytest.mark.parametrize(("kind", "mime"), [("PNG", "image/png"), ("JPEG", "image/jpeg")])
def test_files_are_carried_as_they_are(kind, mime):
    content = encoded(checks(16, 32), kind)
    entry, _ = read(Texture("tiles", content, ("clamp", "mirror")))
    assert entry["bytes"].tobytes() == content
    assert (entry["mime"], entry["wrap"]) == (mime, ["clamp", "mirror"])


def test_other_kinds_become_png():
    entry, image = read(Texture("tiles", encoded(checks(16, 32), "BMP")))
    assert entry["mime"] == "image/png"
    np.testing.assert_allclose(np.asarray(image), checks(16, 32), atol=0)


def test_large_images_are_made_smaller(monkeypatch):
    monkeypatch.setattr(page_textures, "_LARGEST_SIDE", 16)
    entry, image = read(Texture("tiles", encoded(checks(32, 64), "PNG")))
    assert (entry["mime"], image.size) == ("image/jpeg", (16, 8))
    np.testing.assert_allclose(np.asarray(image), checks(32, 64)[1::4, 1::4], atol=12)  # JPEG


def test_large_files_are_written_again(monkeypatch):
    monkeypatch.setattr(page_textures, "_LARGEST_FILE", 100)
    entry, image = read(Texture("tiles", encoded(checks(32, 64), "PNG")))
    assert (entry["mime"], image.size) == ("image/jpeg", (64, 32))


def test_textures_are_found_with_the_model_and_missed_without(tmp_path, capsys, monkeypatch):
    # The picture that tells the exposure may be small here.
    monkeypatch.setattr(pages, "relit_camera", lambda packed, _, *how: relit_camera(packed, 32, *how))
    (tmp_path / "box.obj").write_text(CUBE)
    (tmp_path / "box.mtl").write_text("newmtl tiles\nmap_Kd tiles.png\n")
    (tmp_path / "tiles.png").write_bytes(encoded(checks(64, 64), "PNG"))
    sp.compress(sp.precompute(tmp_path / "box.obj", bandlimit=1, samples=16), tolerance=0.1).save(tmp_path / "box.prt")
    arguments = ["view", str(tmp_path / "box.prt"), "-o", str(tmp_path / "box.html")]
    assert main(arguments) == 0
    found = read_payload(blocks(tmp_path / "box.html")["payload"])
    assert found["textures"][0]["bytes"].tobytes() == (tmp_path / "tiles.png").read_bytes()
    assert found["geometries"][0]["surfaces"][0]["texture"] == 0
    # v runs down.
    positions = found["geometries"][0]["positions"] + found["geometries"][0]["center"]
    wanted = np.stack([2.0 * positions[:, 0], 1.0 - 2.0 * positions[:, 1]], axis=1)
    np.testing.assert_allclose(found["geometries"][0]["uv"], wanted, atol=1e-4)
    assert any("Textures are those of the model's own file" in note for note in found["notes"])
    capsys.readouterr()
    (tmp_path / "box.obj").rename(tmp_path / "moved.obj")
    assert main(arguments) == 0
    assert "box.obj is not found, so its textures are drawn as vertices have them; name its --scene" in (
        capsys.readouterr().err
    )
    assert read_payload(blocks(tmp_path / "box.html")["payload"])["textures"] == []
    assert main([*arguments, "--scene", str(tmp_path / "moved.obj")]) == 0
    assert len(read_payload(blocks(tmp_path / "box.html")["payload"])["textures"]) == 1
