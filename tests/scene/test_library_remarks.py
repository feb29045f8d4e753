"""What libraries would remark on a file is said in one line of ours, or not at all."""

import numpy as np
import pytest
from PIL import Image

from slepian_prt.errors import UserError
from slepian_prt.scene.mesh_files import read_mesh


@pytest.mark.parametrize("number", ["inf", "-inf", "nan"])
@pytest.mark.parametrize("library", ["Kd .5 .5 .5", "Kd .5 .5 .5\nPm 0.5"])
def test_materials_of_what_is_not_finite(tmp_path, number, library):
    (tmp_path / "a.mtl").write_text(f"newmtl a\n{library}\n")
    path = tmp_path / "a.obj"
    path.write_text(f"mtllib a.mtl\nusemtl a\nv 0 0 {number}\nv 1 0 {number}\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(UserError, match="2 vertices have NaN or infinite coordinates"):
        read_mesh(path)


def test_vertices_that_no_face_uses_beside_several_parts(tmp_path):
    path = tmp_path / "a.obj"
    triangle = "v 0 0 {0}\nv 1 0 {0}\nv 0 1 {0}\n"
    path.write_text(f"{triangle.format(0)}{triangle.format(1)}v -7 7 7\nf 1 2 3\nf 4 5 6\n")
    assert len(read_mesh(path).faces) == 2


def test_a_palette_with_transparency_is_read(tmp_path):
    image = Image.new("P", (4, 4), 1)
    image.putpalette([0, 0, 0, 255, 0, 128])
    image.save(tmp_path / "a.png", transparency=bytes([0, 200]))
    (tmp_path / "a.mtl").write_text("newmtl a\nmap_Kd a.png\n")
    path = tmp_path / "a.obj"
    path.write_text("mtllib a.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\n")
    linear = ((128 / 255 + 0.055) / 1.055) ** 2.4
    np.testing.assert_allclose(read_mesh(path).albedo, [[1.0, 0.0, linear]] * 3, rtol=1e-6)
