"""Textures of mesh files, read again for pictures, and checked against what was precomputed."""

import shutil

import numpy as np
import pytest
from PIL import Image

from slepian_prt.errors import UserError
from slepian_prt.scene.mesh_files import read_mesh
from slepian_prt.scene.reflectance.surface_detail import read_surface_detail
from tests.numerics import assert_exact

OBJ = """mtllib m.mtl
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 2 0 1
v 2 1 1
vt 0 0
vt 1 0
vt 1 1
vt 0 1
usemtl painted
f 1/1 2/2 3/3
f 1/1 3/3 4/4
f 1/1 1/1 4/4
usemtl plain
f 2 5 6
f 2 6 3
"""


@pytest.fixture
def model(tmp_path):
    rng = np.random.default_rng(0)
    Image.fromarray(rng.integers(0, 255, (8, 8, 3)).astype(np.uint8)).save(tmp_path / "t.png")
    (tmp_path / "m.mtl").write_text("newmtl painted\nKd 0.5 1 1\nmap_Kd t.png\nnewmtl plain\nKd 0.1 0.2 0.3\n")
    (tmp_path / "m.obj").write_text(OBJ)
    return tmp_path / "m.obj"


@pytest.mark.parametrize("crease", [180.0, 20.0])
def test_coordinates_are_those_of_the_faces_that_are_kept(model, crease):
    mesh = read_mesh(model, crease_angle=crease)
    detail = read_surface_detail(model, mesh)
    assert len(mesh.faces) == 4  # one of five has no area
    assert_exact(detail.choice, [0, 0, -1, -1], "copies")
    # v runs down, and x and y of the plane are u and v of the file.
    corners = mesh.positions[mesh.faces[:2]]
    np.testing.assert_allclose(detail.uv[:2], np.stack([corners[..., 0], 1.0 - corners[..., 1]], axis=-1), atol=1e-7)
    np.testing.assert_allclose(detail.colors[:, 0], [[0.5, 1, 1], [0.5, 1, 1], [0.1, 0.2, 0.3], [0.1, 0.2, 0.3]])
    assert detail.is_textured


def test_a_model_that_changed_since_is_refused(model):
    mesh = read_mesh(model)
    model.write_text(OBJ.replace("v 1 1 0", "v 1 1.01 0"))
    with pytest.raises(UserError, match="another mesh than the one that was precomputed"):
        read_surface_detail(model, mesh)
    model.write_text(OBJ + "f 1 5 6\n")
    with pytest.raises(UserError, match="another mesh than the one that was precomputed"):
        read_surface_detail(model, mesh)


def test_an_albedo_that_was_given_wins(model):
    from dataclasses import replace

    mesh = read_mesh(model)
    assert read_surface_detail(model, replace(mesh, albedo=np.full_like(mesh.albedo, 0.5))) is None


def test_models_without_textures_have_no_detail(model, tmp_path):
    (tmp_path / "m.mtl").write_text("newmtl painted\nKd 1 0 0\nnewmtl plain\nKd 0 1 0\n")
    assert read_surface_detail(model, read_mesh(model)) is None


def test_a_texture_that_is_gone_counts_as_white(model, caplog):
    (model.parent / "t.png").unlink()
    caplog.set_level("INFO")
    detail = read_surface_detail(model, read_mesh(model))
    assert not detail.is_textured
    assert "it is not drawn" in caplog.text


def test_a_model_may_lie_elsewhere(model, tmp_path):
    mesh = read_mesh(model)
    other = tmp_path / "other"
    other.mkdir()
    for name in ("m.obj", "m.mtl", "t.png"):
        shutil.copy(model.parent / name, other / name)
    assert read_surface_detail(other / "m.obj", mesh).is_textured


def test_coordinates_that_say_nothing_are_finite(model):
    """Sums of those that float32 just holds are not; those beyond 2^24 have no fractions."""
    for wrong in ("3e38", "-1e39", "nan"):
        model.write_text(OBJ.replace("vt 1 1", f"vt {wrong} {wrong}"))
        detail = read_surface_detail(model, read_mesh(model))
        assert np.isfinite(detail.uv).all()
        assert np.abs(detail.uv).max() <= 2.0**24
