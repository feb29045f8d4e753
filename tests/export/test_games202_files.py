"""What the viewer of GAMES202 reads, read here as its engine.js and three.js read it."""

import math
from pathlib import Path

import numpy as np
import pytest

import slepian_prt as sp
from slepian_prt.errors import UserError
from slepian_prt.export.kinds import check_export
from tests.conftest import random_directions
from tests.numerics import assert_exact


def their_reader(text):
    """``val.split(/[\\r\\n' ']+/)`` of engine.js: all numbers but the first, and the last empty one."""
    words = text.replace("\n", " ").split(" ")
    words = [word for word in words if word] + [""]
    return np.array([float(word) for word in words[1:-1]]).reshape(-1, 9)


def their_materials(path):
    """Diffuse colours of a .mtl file by their names, as three.js's MTLLoader has them."""
    colours, name = {}, None
    for line in path.read_text().splitlines():
        head, _, rest = line.strip().partition(" ")
        if head == "newmtl":
            name = rest.strip()
        elif head.lower() == "kd":
            colours[name] = [float(word) for word in rest.split()]
    return colours


def their_mesh(folder, name):
    """(corners, 3) positions, normals and colours, triangle by triangle, as loadOBJ.js has them.

    It loads NAME.mtl, and in the callback of that NAME.obj: without the one the other is never asked for.
    """
    materials = their_materials(folder / f"{name}.mtl")
    positions, normals, corners, colours, colour = [], [], [], [], None
    for line in (folder / f"{name}.obj").read_text().splitlines():
        head, *words = line.split()
        if head == "mtllib":
            assert words == [f"{name}.mtl"]
        elif head == "usemtl":
            colour = materials[words[0]]
        elif head == "v":
            positions.append([float(word) for word in words])
        elif head == "vn":
            normals.append([float(word) for word in words])
        elif head == "f":
            corners += [[int(index) - 1 for index in word.split("//")] for word in words]
            colours += [colour] * 3
    of_position, of_normal = np.array(corners).T
    return np.array(positions)[of_position], np.array(normals)[of_normal], np.array(colours)


def test_corners_of_the_mesh_beside_have_its_transfer(packed, tmp_path, light):
    """The picture of their shader, Σ light × transport at each corner, is π times ours at the vertex there."""
    told = []
    sp.export_model(packed, tmp_path / "transport.txt", "games202", lights={"sky": light}, report=told.append)
    rows = their_reader((tmp_path / "transport.txt").read_text())
    assert (tmp_path / "transport.txt").read_text().split("\n", 1)[0] == str(packed.vertex_count)
    corners = packed.mesh.faces.ravel()
    positions, normals, colours = their_mesh(tmp_path, "transport")
    np.testing.assert_allclose(positions, packed.mesh.positions[corners], rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(normals, packed.mesh.normals[corners], rtol=1e-8, atol=1e-8)
    assert_exact(colours, np.ones((len(corners), 3)), "digits 1")
    lines = [[float(word) for word in line.split()] for line in (tmp_path / "light.txt").read_text().splitlines()]
    assert np.shape(lines) == (9, 3)
    ours = packed.reconstruct()[packed.mesh.faces.ravel(), 0, :9] @ light[:, :9].T
    np.testing.assert_allclose(rows @ np.array(lines), math.pi * ours, rtol=0.0, atol=1e-5 * np.abs(ours).max())
    assert told == [f"{tmp_path / 'transport.txt'}: GAMES202 has degrees 0 to 2; 3 to 4 are left out"]


def test_what_is_written_is_read_back(packed, tmp_path):
    sp.export_model(packed, tmp_path / "transport.txt", "games202")
    read = sp.load_transfer(tmp_path / "transport.txt", mesh=tmp_path / "transport.obj")
    np.testing.assert_allclose(read.vectors, packed.reconstruct()[:, :, :9], rtol=1e-6, atol=1e-9)
    assert not (tmp_path / "light.txt").exists()


def test_its_error_is_that_of_leaving_out_degrees(packed, tmp_path, light):
    exported = sp.export_model(packed, tmp_path / "transport.txt", "games202", lights={"sky": light})
    vectors = packed.reconstruct()[:, 0].astype(float)
    missed, whole = vectors[:, 9:] @ light[:, 9:].T, vectors @ light.T
    assert exported.measured["sky"] == pytest.approx(np.linalg.norm(missed) / np.linalg.norm(whole), rel=1e-5)
    assert 0.0 < exported.error < exported.relit_error


def test_colours_become_their_mean_and_it_is_said(coloured, tmp_path):
    told = []
    sp.export_model(coloured, tmp_path / "t.txt", "games202", report=told.append)
    rows = their_reader((tmp_path / "t.txt").read_text())
    mean = coloured.reconstruct().mean(axis=1)[coloured.mesh.faces.ravel(), :9]
    np.testing.assert_allclose(rows, math.pi * mean, rtol=1e-5, atol=1e-7)
    assert "one number for all colours" in told[1]


def test_several_lights_have_a_file_each(packed, tmp_path, light):
    sp.export_model(packed, tmp_path / "t.txt", "games202", lights={"sky.exr": light, "b": 2.0 * light})
    assert {path.name for path in tmp_path.iterdir()} == {"t.txt", "t.obj", "t.mtl", "light-sky.txt", "light-b.txt"}


def test_degrees_that_are_not_there_are_zero(tmp_path, packed):
    low = sp.compress(
        sp.Transfer(packed.reconstruct()[:, :, :4], packed.mesh.normals, packed.mesh, packed.parts, 1, 16, 0, (), 0, 0),
        "none",
    )
    sp.export_model(low, tmp_path / "t.txt", "games202")
    assert not their_reader((tmp_path / "t.txt").read_text())[:, 4:].any()


def test_a_mesh_of_ones_own_is_not_replaced(packed, tmp_path):
    (tmp_path / "bunny.obj").write_text("v 0 0 0\n")
    with pytest.raises(UserError, match=r"bunny\.obj: would be replaced"):
        sp.export_model(packed, tmp_path / "bunny.txt", "games202")
    assert (tmp_path / "bunny.obj").read_text() == "v 0 0 0\n"
    (tmp_path / "mary.mtl").write_text("newmtl skin\n")
    with pytest.raises(
        UserError, match=r"mary\.mtl: would be replaced by the material that goes with .*; name the output"
    ):
        sp.export_model(packed, tmp_path / "mary.txt", "games202")
    assert {path.name for path in tmp_path.iterdir()} == {"bunny.obj", "mary.mtl"}
    sp.export_model(packed, tmp_path / "t.txt", "games202")
    sp.export_model(packed, tmp_path / "t.txt", "games202")  # one's own export may be


def test_other_kinds_of_files_are_refused(tmp_path):
    for what, name, message in (
        ("games202", "a.glb", r"games202 is written as \.txt, not '\.glb'"),
        ("transfer", "a.txt", r"transfer is written as \.glb, not '\.txt'; `what=games202` is written as \.txt"),
    ):
        with pytest.raises(UserError, match=message):
            check_export(tmp_path / name, what, None, None)


def test_the_command_writes_them(packed, tmp_path, capsys):
    from slepian_prt.cli import main

    packed.save(tmp_path / "a.prt")
    sky = sp.example("sky")
    arguments = [
        "export",
        tmp_path / "a.prt",
        "--as",
        "games202",
        "--environment",
        sky,
        "-o",
        tmp_path / "transport.txt",
    ]
    assert main([str(word) for word in arguments]) == 0
    assert (tmp_path / "light.txt").exists()
    captured = capsys.readouterr()
    assert "note: " in captured.err
    assert "3 to 4 are left out" in captured.err
    assert "as games202, which costs" in captured.out
    np.testing.assert_allclose(
        sp.project_environment(tmp_path / "light.txt", 2), sp.project_environment(sky, 2), rtol=1e-12, atol=1e-12
    )


def content_of(folder):
    return {path.name: path.read_bytes() if path.is_file() else None for path in folder.iterdir()}


@pytest.mark.parametrize(
    ("name", "names", "message"),
    [
        (
            "light.txt",
            ["sky.exr"],
            r"light\.txt: would be written twice, as the transfer and as the light sky\.exr; name",
        ),
        (
            "light-a.txt",
            ["a", "b"],
            r"light-a\.txt: would be written twice, as the transfer and as the light a; name the",
        ),
        (
            "t.txt",
            ["a.hdr", "a.exr"],
            r"light-a\.txt: .* as the light a\.hdr and as the light a\.exr; name one of the li",
        ),
        ("t.txt", ["x/light", "y/light"], r"light-light\.txt: would be written twice"),
    ],
)
def test_no_file_is_written_twice(packed, tmp_path, light, name, names, message):
    with pytest.raises(UserError, match=message):
        sp.export_model(packed, tmp_path / name, "games202", lights=dict.fromkeys(names, light))
    assert content_of(tmp_path) == {}


def test_a_light_of_ones_own_is_not_replaced(packed, tmp_path, light):
    """Of the course's program, six digits; or written by hand. What was exported here may be exported again."""
    for own in ("1 1 1\n" + "0 0 0\n" * 8, "0.886227 0.5 0.25\n" * 9, "notes\n"):
        (tmp_path / "light.txt").write_text(own)
        before = content_of(tmp_path)
        with pytest.raises(
            UserError, match=r"light\.txt: would be replaced by the light sky that goes with .*t\.txt; w"
        ):
            sp.export_model(packed, tmp_path / "t.txt", "games202", lights={"sky": light})
        assert content_of(tmp_path) == before
    (tmp_path / "light.txt").unlink()
    for factor in (1.0, 2.0):
        sp.export_model(packed, tmp_path / "t.txt", "games202", lights={"sky": factor * light})
    np.testing.assert_allclose(sp.project_environment(tmp_path / "light.txt", 2), 2.0 * light[:, :9])


def test_a_folder_in_the_place_of_a_light_is_found_before_anything_is_written(packed, tmp_path, light):
    (tmp_path / "light.txt").mkdir()
    with pytest.raises(UserError, match=r"light\.txt: is a folder; name a file"):
        sp.export_model(packed, tmp_path / "t.txt", "games202", lights={"sky": light})
    assert content_of(tmp_path) == {"light.txt": None}


def test_nothing_is_left_half_written(packed, tmp_path, light, monkeypatch):
    """The disk is full when the last file is written."""
    from slepian_prt.export import games202_files

    def full(path):
        if Path(path).name == "light.txt":
            raise UserError("light.txt: cannot be written (No space left on device)")
        return atomic_output(path)

    atomic_output = games202_files.atomic_output
    monkeypatch.setattr(games202_files, "atomic_output", full)
    with pytest.raises(UserError, match="No space left"):
        sp.export_model(packed, tmp_path / "t.txt", "games202", lights={"sky": light})
    assert content_of(tmp_path) == {}


def test_the_command_replaces_no_input(packed, tmp_path, capsys):
    from slepian_prt.cli import main

    packed.save(tmp_path / "a.prt")
    sky = str(sp.example("sky"))
    command = ["export", str(tmp_path / "a.prt"), "--as", "games202", "--environment"]
    assert main([*command, sky, "-o", str(tmp_path / "light.txt")]) == 2
    assert "light.txt: would be written twice, as the transfer and as the light sky" in capsys.readouterr().err
    sp.export_model(packed, tmp_path / "t.txt", "games202", lights={"sky": np.ones((3, 9))})
    before = content_of(tmp_path)
    assert main([*command, str(tmp_path / "light.txt"), "-o", str(tmp_path / "t.txt")]) == 2
    assert "light.txt: would be replaced by the light light that goes with" in capsys.readouterr().err
    assert content_of(tmp_path) == before


def test_what_is_up_is_y_in_their_files(packed, tmp_path, light):
    """Heights of z become heights of y, and the picture stays: the same products of all that is turned."""
    sp.export_model(packed, tmp_path / "t.txt", "games202", lights={"sky": light}, up="z")
    corners = packed.mesh.faces.ravel()
    positions, normals, _ = their_mesh(tmp_path, "t")
    x, y, z = packed.mesh.positions[corners].T
    np.testing.assert_allclose(positions, np.stack([x, z, -y], axis=1), rtol=1e-8, atol=1e-8)
    x, y, z = packed.mesh.normals[corners].T
    np.testing.assert_allclose(normals, np.stack([x, z, -y], axis=1), rtol=1e-8, atol=1e-8)
    vectors = their_reader((tmp_path / "t.txt").read_text()) / math.pi
    turned = np.loadtxt(tmp_path / "light.txt").T
    d = random_directions(np.random.default_rng(1), 50)
    there = sp.real_sh(2, np.stack([d[:, 0], d[:, 2], -d[:, 1]], axis=1))
    here = sp.real_sh(2, d)
    size = np.abs(light[:, :9]).sum()
    np.testing.assert_allclose(there @ turned.T, here @ light[:, :9].T, rtol=0.0, atol=1e-14 * size)
    ours = packed.reconstruct()[corners, 0, :9]
    np.testing.assert_allclose(there @ vectors.T, here @ ours.T, rtol=0.0, atol=1e-6)
