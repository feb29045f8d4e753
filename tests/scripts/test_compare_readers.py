"""The comparison of readers sees what differs, and passes over what is only cut or rounded otherwise."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

SCRIPTS = Path(__file__).parents[2] / "scripts"

CUBE = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
TRIANGLES = CUBE[[[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6]]]


@pytest.fixture
def scripts(monkeypatch):
    monkeypatch.syspath_prepend(str(SCRIPTS))


@pytest.mark.parametrize(
    ("other", "said"),
    [
        (TRIANGLES, ""),
        (TRIANGLES.astype(np.float32) * np.float32(1 + 1e-7), ""),
        (np.concatenate([TRIANGLES, np.zeros((3, 3, 3))]), ""),
        (TRIANGLES[:-1], "8 triangles, not 7; area 4, not 3.5"),
        (TRIANGLES * [1.0, 1.0, 1.01], "area 4, not 4.04; box 1 x 1 x 1, not 1 x 1 x 1.01"),
        (TRIANGLES + [1.0, 0.0, 0.0], "box from [0.0, 0.0, 0.0], not from [1.0, 0.0, 0.0]"),
    ],
)
def test_differences(scripts, other, said):
    from readers.measures import differences, measure

    assert differences(measure(TRIANGLES), measure(other)) == said


@pytest.mark.slow
def test_a_folder_is_told_by_file_and_format(tmp_path):
    square = "v 0 0 0\nv 2 0 0\nv 2 2 0\nv 0 2 0\nv 1 .5 0\n"
    (tmp_path / "good.obj").write_text(square + "f 1 2 3 4\n")
    (tmp_path / "concave.obj").write_text(square + "f 1 5 2 3 4\n")
    (tmp_path / "bad.off").write_text("OFF\n")
    command = [sys.executable, str(SCRIPTS / "compare_readers.py"), str(tmp_path), "--verbose"]
    done = subprocess.run(command, capture_output=True, text=True)
    said = done.stdout
    assert done.returncode == 0, done.stderr
    assert "refused  " in said
    assert "has no counts of vertices and faces after 'OFF'" in said
    assert "good.obj: as trimesh" in said
    assert "with polygons as fans" in said or "concave.obj: as " in said
    assert said.splitlines()[-2].split()[:5] == ["2", "0", "0", "0", "0"]
    assert said.splitlines()[-1].split()[:5] == ["0", "1", "0", "0", "0"]
