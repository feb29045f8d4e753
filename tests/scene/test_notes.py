"""What a reader left out is told of a mesh, and of a file that is refused only why."""

import logging

import pytest

from slepian_prt.errors import UserError
from slepian_prt.scene.mesh_files import read_mesh


def test_notes_are_told_of_meshes_only(tmp_path, caplog):
    caplog.set_level(logging.INFO, logger="slepian_prt")
    path = tmp_path / "a.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nl 1 2\nf 1 2 3\n")
    read_mesh(path)
    assert caplog.messages == [f"{path}: 1 points and lines left out"]
    caplog.clear()
    path.write_text("v 0 0 0\nv 1 0 0\nv 2 0 0\nl 1 2\nf 1 2 3\n")
    with pytest.raises(UserError, match="zero area"):
        read_mesh(path)
    assert caplog.messages == []
