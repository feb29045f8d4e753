"""``transport.txt`` of GAMES202."""

import json
import math

import numpy as np
import pytest

import slepian_prt as sp
from slepian_prt.errors import UserError
from slepian_prt.scene.mesh import make_mesh
from slepian_prt.transport.transport_text import read_transport, transport_text
from tests.conftest import bumpy, random_directions
from tests.numerics import assert_exact

# Two triangles of a square, each vertex with numbers of its own, as ``fout << x << " "`` writes them: blanks at ends.
SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3\nf 1 3 4\n"


def their_file(rows, faces):
    """As prt.cpp writes it: the number of vertices, then a line for each corner of each triangle, six digits."""
    lines = [f"{len(rows)}"]
    for face in faces:
        lines += ["".join(f"{number:g} " for number in rows[corner]) for corner in face]
    return "\n".join(lines) + "\n"


@pytest.fixture
def square(tmp_path):
    (tmp_path / "square.obj").write_text(SQUARE)
    return tmp_path / "square.obj"


def test_numbers_of_corners_are_those_of_vertices(tmp_path, square, rng):
    """π times ours, and a picture that is π times as bright: their shader has no 1/π."""
    rows = np.round(rng.normal(size=(4, 9)), 4)
    (tmp_path / "transport.txt").write_text(their_file(rows, [(0, 1, 2), (0, 2, 3)]))
    transfer = sp.load_transfer(tmp_path / "transport.txt", mesh=square)
    assert transfer.bandlimit == 2
    np.testing.assert_allclose(transfer.vectors[:, 0], rows / math.pi, rtol=1e-6)
    light = rng.normal(size=(9, 3))
    radiance = sp.relight(transfer, sp.convert_sh(light, source="games202", quantity="lighting"))
    np.testing.assert_allclose(math.pi * radiance, rows @ light, atol=1e-5)


def test_a_byte_order_mark_is_no_part_of_it(tmp_path, square, rng):
    text = their_file(rng.normal(size=(4, 9)), [(0, 1, 2), (0, 2, 3)])
    (tmp_path / "a.txt").write_text(text)
    (tmp_path / "b.txt").write_bytes(b"\xef\xbb\xbf" + text.encode())
    read = [sp.load_transfer(tmp_path / name, mesh=square).vectors for name in ("a.txt", "b.txt")]
    assert_exact(*read, "the same digits")


def test_what_is_read_can_be_compressed(tmp_path, square, rng):
    rows = rng.normal(size=(4, 9))
    (tmp_path / "transport.txt").write_text(their_file(rows, [(0, 1, 2), (0, 2, 3)]))
    transfer = sp.load_transfer(tmp_path / "transport.txt", mesh=square)
    packed = sp.compress(transfer, "none")
    packed.save(tmp_path / "a.prt", keep_order=True)
    np.testing.assert_allclose(sp.load(tmp_path / "a.prt").reconstruct(), transfer.vectors, atol=1e-6)


def test_how_it_was_made_is_not_known(tmp_path, square, rng, capsys):
    """What is read is not unshadowed because nothing says that it is shadowed: neither here nor in files of it."""
    from slepian_prt.cli import main

    (tmp_path / "transport.txt").write_text(their_file(rng.normal(size=(4, 9)), [(0, 1, 2), (0, 2, 3)]))
    transfer = sp.load_transfer(tmp_path / "transport.txt", mesh=square)
    for words in ("samples", "bounces", "rays_traced", "none"):
        assert words not in repr(transfer)
    assert "effects='unknown'" in repr(transfer)
    transfer.save(tmp_path / "a.npz")
    assert "effects='unknown'" in repr(sp.load_transfer(tmp_path / "a.npz"))
    sp.compress(transfer, "none").save(tmp_path / "a.prt")
    assert main(["info", str(tmp_path / "a.prt")]) == 0
    said = capsys.readouterr().out
    assert "GAMES202's transport.txt does not say what was simulated" in said
    for word in ("samples", "seed", "bounces", "rays_traced"):
        assert not any(line.startswith(word) for line in said.splitlines())
    assert main(["info", str(tmp_path / "a.prt"), "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert [content[name] for name in ("samples", "seed", "bounces", "rays_traced")] == [None] * 4
    assert content["effects"][0]["verdict"] == "unknown"


def test_where_a_transfer_file_is_wanted_it_is_recognised(tmp_path, square, rng, capsys):
    """And what the line says to do does it."""
    from slepian_prt.cli import main

    path = tmp_path / "t.txt"
    path.write_text(their_file(rng.normal(size=(4, 9)), [(0, 1, 2), (0, 2, 3)]))
    for command in (
        ["info", str(path)],
        ["relight", str(path), "--environment", "x.exr", "-o", str(tmp_path / "a.npz")],
    ):
        assert main(command) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert (
            "t.txt: is a transport.txt of GAMES202, without its mesh; make a transfer file of both in Python: " in line
        )
    with pytest.raises(UserError, match=r"t\.txt: is a transport\.txt") as caught:
        sp.load(path)
    remedy = str(caught.value).split("Python: ")[1].replace("NAME.obj", str(square))
    exec(remedy.replace("NAME", str(tmp_path / "made")), {"sp": sp})
    assert sp.load(tmp_path / "made.prt").bandlimit == 2


def test_other_text_is_not_taken_for_it(tmp_path):
    for text in ("1 2 3\n" * 9, "notes", ""):
        (tmp_path / "a.txt").write_text(text)
        with pytest.raises(UserError, match="is not a transfer file"):
            sp.load(tmp_path / "a.txt")


def test_written_files_read_back_equal(tmp_path):
    transfer = sp.precompute(bumpy(2), bandlimit=2, samples=64)
    (tmp_path / "a.txt").write_bytes(transport_text(transfer.vectors[:, 0], transfer.mesh.faces))
    read = read_transport(tmp_path / "a.txt", transfer.mesh)
    assert_exact(
        read.vectors, transfer.vectors, "nine digits of numbers that are float32 divided by what they were times"
    )


def test_unshadowed_receivers_have_the_values_of_the_course(rng):
    """∫ (n·ω)₊ y_00 dω = π y_00 = 0.886227, as the first of Google's ``cosine_lobe``."""
    normals = random_directions(rng, 3)
    lobe = np.repeat([1.0, 2.0 / 3.0, 0.25], [1, 3, 5])
    text = transport_text(sp.real_sh(2, normals) * lobe, np.array([[0, 1, 2]])).decode()
    assert text.startswith("3\n")
    assert [float(line.split()[0]) for line in text.splitlines()[1:]] == pytest.approx([0.886227] * 3, abs=1e-6)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "cannot be read as transport"),
        ("4 one two", "cannot be read as transport"),
        ("4\n" + "0 " * 26, "holds 26 numbers after that of the vertices, and each triangle has 27"),
        ("4\n" + "0 " * 27, r"is of 1 triangles, and square has 2"),
        ("4\n" + "nan " * 54, "not finite"),
        ("1_0\n" + "0 " * 54, "cannot be read as transport"),
        ("4\n" + "1_0 " * 54, "cannot be read as transport"),
        ("4\n" + "-1e300 " * 54, r"holds numbers beyond 1e\+06, and those of transfer are about 1; compute it again"),
    ],
)
def test_what_is_refused(tmp_path, square, content, message):
    path = tmp_path / "transport.txt"
    path.write_text(content)
    with pytest.raises(UserError, match=message) as caught:
        sp.load_transfer(path, mesh=square)
    assert "\n" not in str(caught.value)


def test_another_mesh_is_told_by_its_corners(tmp_path, square, rng):
    rows = rng.normal(size=(4, 9))
    (tmp_path / "transport.txt").write_text(their_file(rows, [(0, 1, 2), (3, 2, 0)]))
    with pytest.raises(UserError, match="differ between the corners of one vertex of square: it is another mesh"):
        sp.load_transfer(tmp_path / "transport.txt", mesh=square)


def test_a_mesh_is_needed_here_and_nowhere_else(tmp_path, square):
    (tmp_path / "transport.txt").write_text("4\n" + "0 " * 54)
    with pytest.raises(UserError, match="holds no mesh; give mesh, the one that it was made of"):
        sp.load_transfer(tmp_path / "transport.txt")
    with pytest.raises(UserError, match=r"holds its mesh; leave out mesh, which is for transport\.txt"):
        sp.load_transfer(tmp_path / "a.npz", mesh=square)


def test_a_mesh_in_memory(tmp_path):
    mesh = make_mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    (tmp_path / "transport.txt").write_text(their_file(np.arange(27.0).reshape(3, 9), [(0, 1, 2)]))
    transfer = sp.load_transfer(tmp_path / "transport.txt", mesh=mesh)
    np.testing.assert_allclose(transfer.vectors.ravel() * math.pi, np.arange(27.0), rtol=1e-6)
