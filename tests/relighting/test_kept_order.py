"""Files that keep the order of their source give its own vertices back."""

from collections import Counter
from dataclasses import replace

import numpy as np
import trimesh

import slepian_prt as sp
from slepian_prt.cli import cli
from slepian_prt.relighting.files.mesh_outputs import write_coloured_mesh
from tests.compression.stored_mesh.meshes import cycles
from tests.numerics import assert_exact


def cut_box():
    box = trimesh.creation.box().subdivide().subdivide()
    order = np.random.default_rng(4).permutation(len(box.vertices))
    return trimesh.Trimesh(box.vertices[order], np.argsort(order)[box.faces], process=False)


def test_a_ply_goes_back_to_the_vertices_of_its_source(tmp_path):
    """Split at hard edges, coded in another order, relit, and written again."""
    box = cut_box()
    box.export(tmp_path / "box.ply")
    mesh = sp.read_mesh(tmp_path / "box.ply", crease_angle=30.0)
    assert len(mesh.positions) > len(box.vertices)
    packed = sp.compress(sp.precompute(mesh, bandlimit=1, samples=16, effects="none"), clusters=2)
    packed.save(tmp_path / "box.prt", keep_order=True)
    read = sp.load(tmp_path / "box.prt")
    assert_exact(np.sort(read.mesh.source, axis=0), np.sort(mesh.source, axis=0), because="integers")
    radiance = sp.relight(read, np.eye(1, 4).repeat(3, axis=0) + [0.0, 0.2, 0.3, 0.1])
    write_coloured_mesh(tmp_path / "relit.ply", read.mesh, radiance)
    back = trimesh.load(tmp_path / "relit.ply", process=False)
    np.testing.assert_allclose(back.vertices, box.vertices, rtol=0.0, atol=1.0 / 131_070 + 1e-7)
    assert cycles(np.asarray(back.faces)) == cycles(np.asarray(box.faces))
    # Where three sides meet a colour is the mean of theirs.
    corner = int(np.argmax(box.vertices.sum(axis=1)))
    copies = mesh.source[mesh.source[:, 0] == corner, 1]
    assert len(copies) == 3
    alone = tmp_path / "alone.ply"
    write_coloured_mesh(alone, replace(read.mesh, source=None), radiance)
    colours = np.asarray(trimesh.load(alone, process=False).visual.vertex_colors, dtype=np.float64)
    seen = np.asarray(back.visual.vertex_colors, dtype=np.float64)
    np.testing.assert_allclose(seen[corner], colours[copies].mean(axis=0), atol=0.5)


def test_from_the_command_line(tmp_path, monkeypatch):
    from click.testing import CliRunner

    monkeypatch.chdir(tmp_path)
    box = cut_box()
    box.export("box.ply")
    for flags, unasked, kept in ((["--keep-order"], 0, True), ([], 0, False), ([], 1 << 14, True)):
        monkeypatch.setattr("slepian_prt.cli.precompute.KEPT_ORDER", unasked)
        made = CliRunner().invoke(
            cli, ["precompute", "box.ply", "-o", "box.prt", "--bandlimit", "1", "--samples", "16", *flags]
        )
        assert made.exit_code == 0, made.output
        assert "bytes per vertex" in made.output
        assert "with the mesh and all" in made.output
        read = sp.load("box.prt")
        same = bool(np.abs(read.mesh.positions - box.vertices).max() < 1e-4)
        assert same == kept
        assert Counter(map(tuple, np.round(read.mesh.positions, 3).tolist())) == Counter(
            map(tuple, np.round(np.asarray(box.vertices), 3).tolist())
        )
