"""Relit models with textures as files: a strict reading of the containers, and what other readers make of them."""

import io
import json
import struct

import numpy as np
import pytest
import trimesh
from PIL import Image

from slepian_prt.relighting.files.coloured_mesh import write_textured_ply
from slepian_prt.relighting.files.glb_file import write_glb
from slepian_prt.relighting.files.painted_mesh import paint_mesh
from slepian_prt.scene.formats.parts import Texture
from slepian_prt.scene.mesh import make_mesh
from slepian_prt.scene.mesh_files import read_mesh, read_parts
from slepian_prt.scene.reflectance.surface_detail import SurfaceDetail
from slepian_prt.scene.scene import Part
from tests.conftest import sphere
from tests.numerics import assert_exact

DTYPES = {5126: "<f4", 5125: "<u4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}
TARGETS = {"indices": 34963, "attributes": 34962}


def png(texels: np.ndarray) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(texels).save(stream, "PNG")
    return stream.getvalue()


TEXTURE = Texture("t", png(np.random.default_rng(1).integers(0, 256, (4, 8, 3)).astype(np.uint8)), ("clamp", "mirror"))


def strict_glb(path) -> tuple[dict, list[np.ndarray]]:
    """The JSON and the accessors of a .glb, after every check of the container that the specification asks for."""
    content = path.read_bytes()
    magic, version, length = struct.unpack_from("<4sII", content)
    assert (magic, version, length) == (b"glTF", 2, len(content))
    size, kind = struct.unpack_from("<I4s", content, 12)
    assert kind == b"JSON"
    assert size % 4 == 0
    root = json.loads(content[20 : 20 + size])
    binary_size, kind = struct.unpack_from("<I4s", content, 20 + size)
    assert kind == b"BIN\0"
    assert binary_size % 4 == 0
    assert 28 + size + binary_size == length
    binary = content[28 + size :]
    assert root["asset"]["version"] == "2.0"
    assert len(root["buffers"]) == 1
    assert 0 <= binary_size - root["buffers"][0]["byteLength"] <= 3
    for view in root["bufferViews"]:
        assert view["byteOffset"] % 4 == 0
        assert view["byteLength"] > 0
        assert view["byteOffset"] + view["byteLength"] <= root["buffers"][0]["byteLength"]
    arrays = []
    for accessor in root["accessors"]:
        view = root["bufferViews"][accessor["bufferView"]]
        dtype, width = np.dtype(DTYPES[accessor["componentType"]]), WIDTHS[accessor["type"]]
        assert accessor["count"] * width * dtype.itemsize == view["byteLength"]
        begin = view["byteOffset"]
        values = np.frombuffer(binary[begin : begin + view["byteLength"]], dtype).reshape(-1, width)
        assert np.isfinite(values).all()
        assert_exact(accessor["min"], values.min(axis=0), "bounds are of the very numbers")
        assert_exact(accessor["max"], values.max(axis=0), "bounds are of the very numbers")
        arrays.append(values)
    for mesh in root["meshes"]:
        for primitive in mesh["primitives"]:
            counts = {len(arrays[number]) for number in primitive["attributes"].values()}
            assert len(counts) == 1
            assert arrays[primitive["indices"]].max() < counts.pop()
            for number in primitive["attributes"].values():
                view = root["bufferViews"][root["accessors"][number]["bufferView"]]
                assert view["target"] == TARGETS["attributes"]
            normals = arrays[primitive["attributes"]["NORMAL"]]
            np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-6)
            assert arrays[primitive["attributes"]["COLOR_0"]].min() >= 0.0
            assert arrays[primitive["attributes"]["COLOR_0"]].max() <= 1.0
    reached = {child for node in root["nodes"] for child in node.get("children", ())} | set(root["scenes"][0]["nodes"])
    assert reached == set(range(len(root["nodes"])))
    return root, arrays


def detail_of(mesh, choice, rng, textures=(TEXTURE,)) -> SurfaceDetail:
    count = len(mesh.faces)
    return SurfaceDetail(
        textures,
        np.broadcast_to(np.asarray(choice, dtype=np.int32), (count,)).copy(),
        rng.uniform(-1.0, 2.0, (count, 3, 2)).astype(np.float32),
        np.full((count, 3, 3), [0.5, 1.0, 0.25], dtype=np.float32),
        np.full(count, 0.5, dtype=np.float32),
        np.full(count, -1, dtype=np.int32),
        np.zeros((count, 3, 2), dtype=np.float32),
    )


def corners(root: dict, arrays: list, attribute: str) -> np.ndarray:
    """Values at the corners of all faces, one primitive after the other."""
    found = []
    for mesh in root["meshes"]:
        for primitive in mesh["primitives"]:
            indices = arrays[primitive["indices"]].reshape(-1, 3)
            found.append(arrays[primitive["attributes"][attribute]][indices])
    return np.concatenate(found)


def test_a_model_without_textures_holds_its_radiance(tmp_path, rng):
    mesh = sphere(1)
    radiance = rng.uniform(0.0, 0.7, (len(mesh.positions), 3)).astype(np.float32)
    painted = paint_mesh(mesh, (Part("ball", 0, len(radiance)),), radiance, scale=1.0)
    write_glb(tmp_path / "a.glb", painted)
    root, arrays = strict_glb(tmp_path / "a.glb")
    assert root["extensionsUsed"] == ["KHR_materials_unlit"]
    assert root["materials"][0]["doubleSided"] is False
    assert "KHR_materials_unlit" in root["materials"][0]["extensions"]
    assert root["nodes"][0]["name"] == "ball"
    # Below the knee of the tone curve colours are radiance, in float32.
    assert_exact(corners(root, arrays, "COLOR_0"), radiance[mesh.faces], "copies")
    assert_exact(corners(root, arrays, "POSITION"), mesh.positions[mesh.faces].astype(np.float32), "copies")
    assert len(trimesh.load(tmp_path / "a.glb", force="mesh").faces) == len(mesh.faces)


def test_textures_are_multiplied_by_what_white_would_send(tmp_path, rng):
    mesh = sphere(1)
    count = len(mesh.positions)
    radiance, white = rng.uniform(0.0, 0.3, (2, count, 3)).astype(np.float32)
    choice = np.where(np.arange(len(mesh.faces)) < 50, 0, -1)
    detail = detail_of(mesh, choice, rng)
    painted = paint_mesh(mesh, (Part("ball", 0, count),), radiance, white, detail, scale=2.0)
    write_glb(tmp_path / "a.glb", painted)
    root, arrays = strict_glb(tmp_path / "a.glb")
    assert len(root["meshes"]) == 1
    assert len(root["meshes"][0]["primitives"]) == 2
    plain, textured = root["meshes"][0]["primitives"]  # in the order of the numbers of their textures
    assert "TEXCOORD_0" not in plain["attributes"]
    found = arrays[textured["attributes"]["COLOR_0"]][arrays[textured["indices"]].reshape(-1, 3)]
    expected = 2.0 * white[mesh.faces[:50]] * detail.colors[:50] * 0.5  # half of it is metal
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    uv = arrays[textured["attributes"]["TEXCOORD_0"]][arrays[textured["indices"]].reshape(-1, 3)]
    assert_exact(uv, detail.uv[:50], "copies")
    assert root["samplers"] == [{"wrapS": 33071, "wrapT": 33648, "magFilter": 9729, "minFilter": 9987}]
    view = root["bufferViews"][root["images"][0]["bufferView"]]
    content = (tmp_path / "a.glb").read_bytes()
    begin = content.index(b"BIN\0") + 4 + view["byteOffset"]
    assert content[begin : begin + view["byteLength"]] == TEXTURE.source


def test_our_reader_and_trimesh_see_texture_and_light(tmp_path, rng):
    """What the files say that vertices reflect is the mean of their texture times the colour."""
    mesh = sphere(1)
    white = np.full((len(mesh.positions), 3), 0.4, dtype=np.float32)
    flat = Texture("flat", png(np.full((4, 4, 3), 188, np.uint8)))
    detail = detail_of(mesh, 0, rng, (flat,))
    painted = paint_mesh(mesh, (Part("ball", 0, len(white)),), white, white, detail, scale=1.0)
    write_glb(tmp_path / "a.glb", painted)
    again = read_mesh(tmp_path / "a.glb")
    expected = 0.4 * 0.5 * np.array([0.5, 1.0, 0.25]) * ((188 / 255 + 0.055) / 1.055) ** 2.4
    np.testing.assert_allclose(again.albedo, np.broadcast_to(expected, again.albedo.shape), rtol=1e-5)
    loaded = trimesh.load(tmp_path / "a.glb", force="mesh")
    assert loaded.visual.material.baseColorTexture.size == (4, 4)
    assert len(loaded.faces) == len(mesh.faces)


def test_what_is_up_stands_upright(tmp_path, rng):
    mesh = sphere(1)
    moved = make_mesh(mesh.positions * [1.0, 1.0, 3.0], mesh.faces)
    radiance = np.ones_like(mesh.positions, dtype=np.float32)
    write_glb(tmp_path / "a.glb", paint_mesh(moved, (Part("b", 0, len(radiance)),), radiance), up="z")
    strict_glb(tmp_path / "a.glb")
    np.testing.assert_allclose(np.ptp(read_mesh(tmp_path / "a.glb").positions, axis=0), [2.0, 6.0, 2.0], rtol=1e-3)


def test_georeferenced_models_keep_their_shape(tmp_path, rng):
    mesh = sphere(1)
    moved = make_mesh(mesh.positions + [4.5e6, 5.2e6, 300.0], mesh.faces)
    radiance = np.ones_like(mesh.positions, dtype=np.float32)
    write_glb(tmp_path / "a.glb", paint_mesh(moved, (Part("b", 0, len(radiance)),), radiance))
    strict_glb(tmp_path / "a.glb")
    np.testing.assert_allclose(read_mesh(tmp_path / "a.glb").positions, moved.positions, rtol=0, atol=1e-6)


def test_both_sides_of_a_part_are_faces_of_one_node(tmp_path, rng):
    """Fronts have their colours and backs have theirs; no face is drawn from behind."""
    quad = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    mesh = make_mesh(np.vstack([quad, quad]), np.vstack([faces, faces[:, ::-1] + 4]))
    radiance = np.repeat([[0.2, 0.2, 0.2], [0.6, 0.1, 0.1]], 4, axis=0).astype(np.float32)
    write_glb(tmp_path / "a.glb", paint_mesh(mesh, (Part("sheet", 0, 4, sides=2),), radiance, scale=1.0))
    root, arrays = strict_glb(tmp_path / "a.glb")
    assert [node["name"] for node in root["nodes"]] == ["sheet"]
    places, colours = corners(root, arrays, "POSITION"), corners(root, arrays, "COLOR_0")
    facing = np.cross(places[:, 1] - places[:, 0], places[:, 2] - places[:, 0])[:, 2] > 0
    assert_exact(colours[facing], np.full((2, 3, 3), np.float32(0.2)), "copies")
    assert_exact(colours[~facing, :, 0], np.full((2, 3), np.float32(0.6)), "copies")


def test_a_texture_lies_beside_the_ply(tmp_path, rng):
    mesh = sphere(1)
    white = np.full((len(mesh.positions), 3), 0.4, dtype=np.float32)
    detail = detail_of(mesh, 0, rng)
    painted = paint_mesh(mesh, (Part("ball", 0, len(white)),), white, white, detail, scale=1.0)
    write_textured_ply(tmp_path / "a.ply", painted)
    assert (tmp_path / "a_texture.png").read_bytes() == TEXTURE.source
    (part,) = read_parts(tmp_path / "a.ply").parts
    assert part.material.texture.source == tmp_path / "a_texture.png"
    # Stored as v up: 1 - (1 - v) in float32.
    np.testing.assert_allclose(part.uv, detail.uv, atol=4e-7)
    linear = np.array([0.5, 1.0, 0.25]) * 0.4 * 0.5
    np.testing.assert_allclose(part.colors, np.broadcast_to(linear, part.colors.shape), atol=0.005)  # 8 bits of sRGB
    theirs = trimesh.load(tmp_path / "a.ply", process=False)
    assert len(theirs.faces) == len(mesh.faces)
    assert theirs.visual.uv.shape == (len(theirs.vertices), 2)


def test_a_texture_that_is_there_under_that_name_stays(tmp_path, rng):
    image = tmp_path / "a_texture.png"
    image.write_bytes(TEXTURE.source)
    mesh = sphere(1)
    white = np.full((len(mesh.positions), 3), 0.4, dtype=np.float32)
    detail = detail_of(mesh, 0, rng, (Texture("t", image),))
    before = image.stat().st_mtime_ns
    painted = paint_mesh(mesh, (Part("ball", 0, len(white)),), white, white, detail, scale=1.0)
    write_textured_ply(tmp_path / "a.ply", painted)
    assert image.stat().st_mtime_ns == before


def test_another_image_of_that_name_stays(tmp_path, rng):
    """The user's own, in the folder that the mesh is written to or is moved to; ours has the next name that is free."""
    mesh = sphere(1)
    white = np.full((len(mesh.positions), 3), 0.4, dtype=np.float32)
    painted = paint_mesh(mesh, (Part("ball", 0, len(white)),), white, white, detail_of(mesh, 0, rng), scale=1.0)
    unfinished = tmp_path / "unfinished"
    unfinished.mkdir()
    own = {name: name.encode() for name in ("a_texture.png", "a_texture_2.png")}
    for name, content in own.items():
        (tmp_path / name).write_bytes(content)
    write_textured_ply(unfinished / "a.ply", painted, folder=tmp_path)
    for _ in range(2):  # the second time it is there
        write_textured_ply(tmp_path / "a.ply", painted)
    assert {name: (tmp_path / name).read_bytes() for name in own} == own
    assert sorted(path.name for path in unfinished.iterdir()) == ["a.ply", "a_texture_3.png"]
    assert sorted(path.name for path in tmp_path.glob("*.png")) == [*sorted(own), "a_texture_3.png"]
    for folder in (tmp_path, unfinished):
        assert (folder / "a_texture_3.png").read_bytes() == TEXTURE.source
        (part,) = read_parts(folder / "a.ply").parts
        assert part.material.texture.source == folder / "a_texture_3.png"


@pytest.mark.parametrize("mode", ["I;16", "CMYK", "P"])
def test_any_image_becomes_one_that_viewers_read(tmp_path, mode):
    from slepian_prt.scene.reflectance.textures import encoded_image

    stream = io.BytesIO()
    if mode == "I;16":
        Image.fromarray(np.full((2, 2), 40000, np.uint16)).save(stream, "PNG")
    else:
        Image.new("RGB", (2, 2), (10, 200, 30)).convert(mode).save(stream, "TIFF" if mode == "CMYK" else "PNG")
    content, suffix = encoded_image(Texture("t", stream.getvalue()))
    with Image.open(io.BytesIO(content)) as image:
        assert (image.format, suffix) == ("PNG", ".png")
        assert image.mode in ("RGB", "P")
