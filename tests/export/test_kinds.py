"""What cannot be exported is said in one line, before any work."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from slepian_prt.errors import UserError
from slepian_prt.export.byte_texture import byte_texture
from slepian_prt.export.kinds import check_exportable
from slepian_prt.export.model import export_model
from slepian_prt.transport.transfer import Transfer


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("a.gltf", {}, r"transfer is written as \.glb, not '\.gltf'$"),
        ("a.ply", {}, r"transfer is written as \.glb, not '\.ply'; `what=occlusion` and the like are"),
        ("a.obj", {"what": "l1"}, r"l1 is written as \.glb or \.ply, not '\.obj'$"),
        (
            "a.glb",
            {"what": "light"},
            r"^what must be one of transfer, occlusion, bent-normals, sky-visibility, l1, games202, not",
        ),
        ("a.glb", {"attributes": "half"}, r"^attributes must be one of bytes, float, texture, not 'half'$"),
        ("a.glb", {"functions": 12}, "^functions must be a multiple of 8"),
        ("a.glb", {"what": "occlusion", "functions": 16}, "`functions` is about `what=transfer`"),
        ("a.glb", {"what": "occlusion", "attributes": "bytes"}, "`attributes` is about `what=transfer`"),
        ("a.glb", {"up": "x"}, "^up must be one of y, z, not 'x'$"),
        ("none/a.glb", {}, "the folder .* does not exist"),
    ],
)
def test_bad_wishes(tmp_path, packed, name, options, message):
    with pytest.raises(UserError, match=message) as raised:
        export_model(packed, tmp_path / name, **options)
    assert "\n" not in str(raised.value)
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_compressed_transfer(tmp_path, packed):
    vectors = packed.reconstruct()
    transfer = Transfer(vectors, packed.mesh.normals, packed.mesh, packed.parts, packed.bandlimit, 16, 0, (), 0, 0)
    for what, name in (("games202", "a.txt"), ("transfer", "a.glb"), ("l1", "a.ply")):
        with pytest.raises(UserError, match=r"must be a CompressedTransfer, not Transfer; compress it first$"):
            export_model(transfer, tmp_path / name, what)
    with pytest.raises(UserError, match="must be a CompressedTransfer, not str"):
        export_model("a.prt", tmp_path / "a.glb")


@pytest.mark.parametrize(
    "lights", [{3: np.ones((3, 9))}, {"a": np.ones((3, 9)), 3: np.ones((3, 9))}, [np.ones((3, 9))]]
)
def test_lights_have_names(tmp_path, packed, lights):
    with pytest.raises(UserError, match=r"^lights must be a dict of names, which are str, to coefficients"):
        export_model(packed, tmp_path / "a.txt", "games202", lights=lights)
    assert list(tmp_path.iterdir()) == []


def test_transfer_toward_a_camera_has_no_place_in_an_engine(tmp_path, packed):
    with pytest.raises(UserError, match="toward a camera, which is right from there alone"):
        export_model(replace(packed, toward_view=True), tmp_path / "a.glb", file="x.prt")


def test_pixels_of_a_camera_are_no_model():
    picture = SimpleNamespace(film_outline=object(), name="pixels")
    with pytest.raises(UserError, match=r"^x\.prt: holds the pixels of a camera, which are no model; `slep"):
        check_exportable(picture, "transfer", "x.prt")


def test_a_bandlimit_that_is_too_low(tmp_path, packed):
    for what, least in (("bent-normals", 1), ("sky-visibility", 2), ("l1", 1)):
        with pytest.raises(UserError, match=f"has bandlimit {least - 1}, and `what={what}` needs {least}"):
            export_model(replace(packed, bandlimit=least - 1), tmp_path / "a.glb", what)


def test_more_than_a_texture_holds(monkeypatch, rng):
    monkeypatch.setattr("slepian_prt.export.byte_texture._LARGEST", 2)
    byte_texture(rng.integers(0, 256, (2 * 682, 16)).astype("u1"))
    with pytest.raises(UserError, match="need a texture of 3 rows, and 2 are what hardware takes; give fewer"):
        byte_texture(rng.integers(0, 256, (2 * 682 + 1, 16)).astype("u1"))
