"""Mesh files that claim, name or repeat what they should not: one line, in time and memory that their size allows."""

import base64
import io
import json
import os
import struct
import sys

import numpy as np
import pytest
from PIL import Image

from slepian_prt.errors import UserError, printable
from slepian_prt.machine.file_content import is_file, read_content
from slepian_prt.machine.memory import memory_limited
from slepian_prt.scene.formats import polygons
from slepian_prt.scene.formats.gltf import read_gltf
from slepian_prt.scene.formats.joining import join_near
from slepian_prt.scene.formats.obj import read_obj
from slepian_prt.scene.mesh_files import read_mesh
from slepian_prt.scene.reflectance import textures
from tests.scene.formats.gltf_writer import FACES, TETRAHEDRON, Writer

CORNERS = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
PLY = (
    "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    "element face {}\nproperty list uchar int vertex_indices\n{}end_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
)
WEDGES = PLY.format(1, "").replace("property list uchar int vertex_indices", "property list uchar float texcoord")

BAD = {
    "zero.obj": (CORNERS + "f 0 1 2\n", "names vertex 0, and OBJ files count from 1"),
    "flat.obj": ("v 1 2\nv 0 0\nv 1 1\nf 1 2 3\n", "line 1: 'v 1 2' has fewer than 3"),
    "infinite.off": ("OFF\ninf 1 0\n0 0 0\n", "'inf 1 0' are no counts"),
    "endless.off": ("OFF\n3 1e300 0\n0 0 0\n", "'3 1e300 0' are no counts"),
    "digits.off": ("OFF\n" + "9" * 5000 + " 1 0\n0 0 0\n", "are no counts"),
    "claims.ply": (PLY.format(10**18, ""), "declares 1000000000000000000 rows of 'face'"),
    "digits.ply": (PLY.format("9" * 5000, ""), "'element face 999.* is not understood"),
    "wedges.ply": (WEDGES, "no faces"),
    "header.ply": ("ply\nformat ascii 1.0\n" + ("comment " + "a" * 1000 + "\n") * 1100, "no end_header"),
    "huge.stl": ("solid a\nfacet normal 0 0 1\nouter loop\n" + "vertex 1e200 0 0\nvertex 0 1e200 0\nvertex 0 0 1e200\n"
                 + "endloop\nendfacet\nendsolid a\n", "coordinates above 1e\\+60"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_what_files_claim_is_refused(name, tmp_path):
    text, message = BAD[name]
    (tmp_path / name).write_text(text)
    with pytest.raises(UserError, match=message) as told:
        read_mesh(tmp_path / name)
    assert len(str(told.value)) < 400
    assert str(told.value).isprintable()


@pytest.mark.parametrize("word", ["mtllib {}", "mtllib a.mtl\nusemtl a"])
def test_names_that_no_file_can_have_are_missing_files(word, tmp_path, caplog):
    caplog.set_level("INFO")
    (tmp_path / "a.mtl").write_text(f"newmtl a\nmap_Kd {'b' * 5000}.png\n")
    corners = "vt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n"
    (tmp_path / "a.obj").write_text(word.format("b" * 5000 + ".mtl") + "\n" + CORNERS + corners)
    assert len(read_mesh(tmp_path / "a.obj").faces) == 1
    assert "is missing" in caplog.text or "there is no file" in caplog.text


def test_materials_beyond_floats_warn_of_nothing(tmp_path, recwarn):
    (tmp_path / "a.mtl").write_text("newmtl a\nKd 1e308 1e308 1\nPm 1e308\n")
    (tmp_path / "a.obj").write_text("mtllib a.mtl\nusemtl a\n" + CORNERS + "f 1 2 3\n")
    mesh = read_mesh(tmp_path / "a.obj")
    assert np.all((mesh.albedo >= 0) & (mesh.albedo <= 1))
    assert not recwarn.list


def gltf(folder, uri, **more):
    content = {
        "asset": {"version": "2.0"}, "nodes": [{"mesh": 0}], "buffers": [{"byteLength": 36, "uri": uri}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}], "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}], **more,
    }  # fmt: skip
    path = folder / "a.gltf"
    path.write_text(json.dumps(content))
    return path


TRIANGLE = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0)


@pytest.mark.parametrize("uri", ["../secret.bin", "{}/secret.bin", "below/../../secret.bin", "%2e%2e/secret.bin"])
def test_bytes_from_outside_of_its_folder_do_not_become_a_model(uri, tmp_path):
    (tmp_path / "model" / "below").mkdir(parents=True)
    (tmp_path / "secret.bin").write_bytes(TRIANGLE)
    (tmp_path / "model" / "below" / "own.bin").write_bytes(TRIANGLE)
    assert len(read_mesh(gltf(tmp_path / "model", "below/own.bin")).faces) == 1
    with pytest.raises(UserError, match="outside of the model's folder"):
        read_mesh(gltf(tmp_path / "model", uri.format(tmp_path)))


@pytest.mark.parametrize("uri", ["//server/share/a.bin", "\\\\server\\share\\a.bin", "%5c%5cserver/a.bin"])
def test_other_computers_are_not_asked(uri, tmp_path):
    with pytest.raises(UserError, match="not fetched"):
        read_mesh(gltf(tmp_path, uri))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_pipes_and_devices_are_not_read(tmp_path):
    """A hang would be the end of the test."""
    os.mkfifo(tmp_path / "a.bin")
    for uri in ("a.bin", "/dev/zero"):
        with pytest.raises(UserError, match="is not there"):
            read_mesh(gltf(tmp_path, uri))
    (tmp_path / "b.obj").write_text("mtllib /dev/zero\n" + CORNERS + "f 1 2 3\n")
    assert any("/dev/zero is a pipe or a device" in note for note in read_obj(tmp_path / "b.obj").notes)
    os.mkfifo(tmp_path / "a.obj")
    with pytest.raises(UserError, match="is a pipe or a device"):
        read_mesh(tmp_path / "a.obj")
    with pytest.raises(UserError, match="is a pipe or a device"):
        read_content(tmp_path / "a.bin")


def test_zeros_that_no_data_back(tmp_path):
    with pytest.raises(UserError, match="50000001 elements and no data"):
        read_mesh(gltf(tmp_path, "a", accessors=[{"componentType": 5126, "count": 50_000_001, "type": "VEC3"}]))


def test_instances_are_counted_before_they_are_made(tmp_path):
    """A thousand copies of a mesh of 30,000 vertices: some 8 GB from a file of a megabyte."""
    writer = Writer()
    many = np.tile(TETRAHEDRON[:3], (10_000, 1))
    mesh = writer.mesh(many, None)
    places = writer.accessor(np.zeros((1000, 3), dtype=np.float32))
    writer.node(mesh=mesh, extensions={"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": places}}})
    path = writer.write(tmp_path)
    with memory_limited(1 << 30), pytest.raises(UserError, match=r"its geometry needs about 7\.9 GiB"):
        read_mesh(path)


def test_names_with_half_characters_can_be_written(tmp_path):
    uri = "data:;base64," + base64.b64encode(TRIANGLE).decode()
    path = gltf(tmp_path, uri, nodes=[{"mesh": 0, "name": "\ud800"}], extensionsRequired=[])
    read_mesh(path).name.encode()
    with pytest.raises(UserError, match="extension") as told:
        read_mesh(gltf(tmp_path, uri, extensionsRequired=["\ud800\x1b[31m\n"]))
    str(told.value).encode()
    assert str(told.value).isprintable()


def test_long_numbers_in_json_are_told_without_advice_on_python(tmp_path):
    path = gltf(tmp_path, "a")
    path.write_text(path.read_text().replace("36", "9" * 5000))
    with pytest.raises(UserError, match="JSON cannot be read") as told:
        read_mesh(path)
    assert "sys." not in str(told.value)


@pytest.mark.skipif(os.name == "nt", reason="names are text there")
def test_messages_can_be_printed_whatever_the_file_is_called(tmp_path):
    path = tmp_path / os.fsdecode(b"caf\xe9\n\x1b.obj")
    path.write_text(CORNERS + "f 0 1 2\n")
    with pytest.raises(UserError) as told:
        read_mesh(path)
    assert str(told.value).isprintable()
    assert "caf\\udce9\\n\\x1b.obj" in str(told.value)


def test_printable_leaves_text_alone():
    assert printable("µ … é 'x'") == "µ … é 'x'"


def test_no_permission_is_one_line(tmp_path, monkeypatch):
    """As root one may read everything."""
    (tmp_path / "a.obj").write_text(CORNERS + "f 1 2 3\n")

    def refused(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("slepian_prt.machine.file_content.os.open", refused)
    with pytest.raises(UserError, match=r"cannot be read \(Permission denied\)"):
        read_mesh(tmp_path / "a.obj")


def test_a_file_larger_than_memory_is_not_read(tmp_path):
    path = tmp_path / "a.obj"
    with path.open("wb") as file:
        file.truncate(1 << 20)  # a sparse file
    with memory_limited(1 << 20), pytest.raises(UserError, match=r"needs about .* of memory"):
        read_mesh(path)


def test_is_file(tmp_path):
    assert not is_file(tmp_path / ("a" * 5000))
    assert not is_file(tmp_path / "a\0b")


def test_vertices_much_finer_than_the_box_are_not_taken_for_copies():
    """12,000 vertices within the tolerance have 72 million pairs; a few copies that rounding made are still joined."""
    rng = np.random.default_rng(5)
    cluster = rng.random((12_000, 3))
    copies = cluster[:100] + 1e-9 * rng.standard_normal((100, 3))
    positions = np.concatenate([cluster, copies, [[1e6, 0, 0]]])
    first, joined = join_near(positions, np.empty((0, 3), dtype=np.int64), 2.0)
    assert len(first) > 6_000
    assert np.mean(joined[12_000:12_100] == joined[:100]) > 0.9


def test_polygons_that_cross_themselves_take_bounded_work(monkeypatch):
    """Spanning one of a hundred corners takes a fifth of a second; ten are spanned, and the others are fans."""
    spanned = []
    monkeypatch.setattr(polygons, "_span", lambda points: spanned.append(1) or np.zeros((len(points) - 2, 3), np.int64))
    k = np.arange(100)
    positions = np.stack([np.cos(k * k), np.sin(3 * k), k % 3], axis=1)
    owners = polygons.triangulate(positions, np.full(150, 100), np.tile(k, 150))[1]
    assert len(np.unique(owners)) == 150
    assert len(spanned) == 10


def test_each_of_very_many_materials_has_its_own_triangle(tmp_path):
    """In the order of the file, which names some of them twice."""
    count = 2000
    colours = np.random.default_rng(5).integers(0, 256, (count, 3)) / 255.0
    (tmp_path / "a.mtl").write_text(
        "".join("newmtl a{}\nKd {:.6f} {:.6f} {:.6f}\n".format(k, *colour) for k, colour in enumerate(colours))
    )
    used = [*range(count), 7, count - 1]
    triangles = "".join(f"v {k} 0 0\nv {k} 1 0\nv {k} 0 1\nusemtl a{own}\nf -3 -2 -1\n" for k, own in enumerate(used))
    (tmp_path / "a.obj").write_text(f"mtllib a.mtl\n{triangles}")
    mesh = read_mesh(tmp_path / "a.obj")
    assert len(mesh.faces) == len(used)
    corners = mesh.positions[mesh.faces[:, 0], 0].astype(int)
    assert sorted(corners) == list(range(len(used)))
    np.testing.assert_allclose(mesh.albedo[mesh.faces[:, 0]], colours[used][corners], atol=1e-6)


@pytest.mark.slow
def test_an_image_that_many_materials_name_is_decoded_once(tmp_path, monkeypatch):
    """In .obj and glTF alike; one that continues otherwise beyond its borders is another."""
    file = io.BytesIO()
    Image.new("RGB", (4, 4), (255, 0, 0)).save(file, "PNG")
    (tmp_path / "a.png").write_bytes(file.getvalue())
    names = [f"a{k}" for k in range(5)]
    (tmp_path / "a.mtl").write_text("".join(f"newmtl {n}\nmap_Kd {'-clamp on ' * (n == 'a3')}a.png\n" for n in names))
    used = "".join(f"usemtl {n}\nf 1/1 2/2 3/3\n" for n in names)
    (tmp_path / "a.obj").write_text("mtllib a.mtl\n" + CORNERS + "vt 0 0\nvt 1 0\nvt 0 1\n" + used)
    writer = Writer()
    image = writer.add("images", bufferView=writer.view(file.getvalue()), mimeType="image/png")
    for _ in range(5):
        texture = writer.add("textures", source=image)
        colour = {"baseColorTexture": {"index": texture}}
        material = writer.add("materials", pbrMetallicRoughness={**colour, "metallicFactor": 0})
        mesh = writer.mesh(TETRAHEDRON, FACES, TEXCOORD_0=np.zeros((4, 2)))
        writer.primitive(mesh)["material"] = material
        writer.node(mesh=mesh)
    decoded = []
    original = textures.decode_texture
    monkeypatch.setattr(textures, "decode_texture", lambda *a, **b: decoded.append(a) or original(*a, **b))
    for path, times in ((tmp_path / "a.obj", 2), (writer.write(tmp_path), 1)):
        decoded.clear()
        mesh = read_mesh(path)
        assert np.ptp(mesh.albedo - [1.0, 0.0, 0.0]) < 1e-6
        assert len(decoded) == times


def test_nodes_that_hold_nothing_take_little_work(tmp_path):
    """Calls of functions, for each of many nodes: six; there were seventy."""
    writer = Writer()
    writer.node(mesh=writer.mesh(TETRAHEDRON, FACES))
    for _ in range(5_000):
        writer.node()
    path, calls = writer.write(tmp_path), 0

    def count(_, event, __):
        nonlocal calls
        calls += event in ("call", "c_call")

    sys.setprofile(count)
    try:
        read_gltf(path)
    finally:
        sys.setprofile(None)
    assert calls < 20 * 5_000
