"""Numbers in the buffers of glTF files: types, strides, sparse values, padding, compression."""

import sys

import numpy as np
import pytest

from slepian_prt.errors import UserError
from slepian_prt.scene.formats.gltf import read_gltf
from slepian_prt.scene.formats.gltf_accessors import read_accessor
from slepian_prt.scene.formats.gltf_file import open_gltf
from tests.numerics import assert_exact, assert_rounded
from tests.scene.formats import meshopt_streams as streams
from tests.scene.formats.gltf_writer import COMPONENTS, FACES, TETRAHEDRON, Writer

COPIED = "numbers are copied"


@pytest.fixture
def writer():
    return Writer()


def load(writer, tmp_path, index, *kinds):
    """An accessor as the reader sees it."""
    document = open_gltf(writer.write(tmp_path))
    return read_accessor(document, index, document.root, kinds)


@pytest.mark.parametrize("dtype", COMPONENTS)
@pytest.mark.parametrize("normalized", [False, True])
def test_component_types(writer, tmp_path, dtype, normalized):
    largest = 1 if dtype == "f4" else np.iinfo(dtype).max
    smallest = -1 if dtype == "f4" else np.iinfo(dtype).min
    values = np.array([[smallest, 0, largest], [1, 0, largest]]).astype(dtype)
    came = load(writer, tmp_path, writer.accessor(values, normalized=normalized), "VEC3").scaled()
    wanted = values.astype(float)
    if normalized and dtype != "f4":
        wanted = np.maximum(wanted / largest, -1)
    assert_exact(came, wanted, "one division, as the specification has it")


def test_attributes_among_each_other(writer, tmp_path):
    """Interleaved, with an offset, the last element cut off where its numbers end; not aligned to their type."""
    record = np.zeros(4, dtype=[("pad", "u1", 3), ("p", "<f4", 3), ("n", "<i2", 3), ("c", "u1", 4)])
    rng = np.random.default_rng(1)
    for name in ("p", "n", "c"):
        record[name] = rng.integers(0, 100, record[name].shape)
    data = record.tobytes()
    view = writer.view(data, byteStride=record.itemsize)
    for name, offset in (("p", 3), ("n", 15), ("c", 21)):
        index = writer.accessor(record[name].copy(), bufferView=view, byteOffset=offset)
        kind = writer.json["accessors"][index]["type"]
        assert_exact(load(writer, tmp_path, index, kind).values, record[name], COPIED)


@pytest.mark.parametrize("based", [True, False])
@pytest.mark.parametrize("dtype", ["u1", "u2", "u4"])
def test_sparse_values(writer, tmp_path, based, dtype):
    places, values = np.array([1, 3], dtype=dtype), np.float32([[5, 6, 7], [8, 9, 10]])
    base = writer.accessor(TETRAHEDRON.astype("f4"))
    entry = writer.json["accessors"][base]
    if not based:
        del entry["bufferView"]
    entry["sparse"] = {
        "count": 2,
        "indices": {"bufferView": writer.view(b"??" + bytes(2) + places.tobytes()), "byteOffset": 4,
                    "componentType": COMPONENTS[dtype]},
        "values": {"bufferView": writer.view(values.tobytes())},
    }  # fmt: skip
    wanted = TETRAHEDRON.copy() if based else np.zeros((4, 3))
    wanted[[1, 3]] = values
    assert_exact(load(writer, tmp_path, base, "VEC3").values, wanted, COPIED)


@pytest.mark.parametrize(
    ("kind", "dtype", "columns", "rows", "apart"),
    [("MAT2", "u1", 2, 2, 4), ("MAT3", "u1", 3, 3, 4), ("MAT3", "i2", 3, 3, 8)],
)
def test_columns_of_matrices_are_padded(writer, tmp_path, kind, dtype, columns, rows, apart):
    values = np.arange(2 * columns * rows).reshape(2, columns, rows).astype(dtype)
    padded = np.full((2, columns, apart // values.itemsize), 99, dtype=dtype)
    padded[:, :, :rows] = values
    data = padded.tobytes()[: -(apart - rows * values.itemsize)]  # after the last column it may be missing
    index = writer.add("accessors", bufferView=writer.view(data), componentType=COMPONENTS[dtype], count=2, type=kind)
    assert_exact(load(writer, tmp_path, index, kind).values, values.reshape(2, -1), COPIED)


def test_quantised_meshes(writer, tmp_path):
    """Positions in shorts, normals in bytes, each padded to four bytes, as KHR_mesh_quantization has them."""
    positions = np.zeros((4, 4), dtype="i2")
    positions[:, :3] = TETRAHEDRON * 1000
    normals = np.zeros((4, 4), dtype="i1")
    normals[:, 2] = 127
    for normalized in (True, False):
        mesh = writer.mesh(
            writer.accessor(
                positions, type="VEC3", bufferView=writer.view(positions.tobytes(), byteStride=8), normalized=normalized
            ),
            NORMAL=writer.accessor(
                normals, type="VEC3", bufferView=writer.view(normals.tobytes(), byteStride=4), normalized=True
            ),
        )
        writer.node(mesh=mesh, scale=[32.767 if normalized else 0.001] * 3)
    writer.json["extensionsRequired"] = ["KHR_mesh_quantization"]
    for part in read_gltf(writer.write(tmp_path)).parts:
        assert_rounded(part.positions, TETRAHEDRON, 4)
        assert_exact(part.normals, np.tile([0, 0, 1], (4, 1)), COPIED)


def test_colours_of_vertices(writer, tmp_path):
    """Linear, from 0 to 1, integers always divided by their largest; alpha left out."""
    shades = np.array([[0, 51, 255, 9], [255, 0, 0, 9], [1, 2, 3, 9], [4, 5, 6, 9]])
    for colors in (
        writer.accessor(shades.astype("u1"), normalized=True),
        writer.accessor(shades[:, :3].astype("u1")),
        writer.accessor((shades * 257).astype("u2"), normalized=True),
        writer.accessor((shades / 255).astype("f4")),
        writer.accessor((shades / 255 + np.where(shades == 255, 3, 0)).astype("f4")),
    ):
        writer.node(mesh=writer.mesh(COLOR_0=colors))
    parts = read_gltf(writer.write(tmp_path)).parts
    assert len(parts) == 5
    for part in parts:
        assert part.colors.dtype == np.float32
        assert_rounded(part.colors, shades[:, :3] / 255, 2)


# --- Compression ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("extension", ["EXT_meshopt_compression", "KHR_meshopt_compression"])
def test_meshopt_views(writer, tmp_path, extension):
    """Compressed positions and indices; the buffer that they would unpack to has no data."""
    wanted = streams.mixed_attributes()
    triangles = streams.grid_triangles()

    def packed(stream, mode, count, stride, **more):
        view = writer.view(stream)
        source = dict(writer.json["bufferViews"][view])
        target = {"buffer": 1, "byteLength": count * stride, **more}
        writer.json["bufferViews"][view] = {
            **target, "extensions": {extension: {**source, "mode": mode, "count": count, "byteStride": stride}}
        }  # fmt: skip
        return view

    view = packed(streams.ATTRIBUTES_1, "ATTRIBUTES", 300, 16, byteStride=16)
    positions = writer.add("accessors", bufferView=view, componentType=5122, count=300, type="VEC3")
    view = packed(streams.TRIANGLES, "TRIANGLES", len(triangles), 4)
    indices = writer.add("accessors", bufferView=view, componentType=5125, count=len(triangles), type="SCALAR")
    view = packed(streams.SEQUENCE, "INDICES", 52, 2)
    sequence = writer.add("accessors", bufferView=view, componentType=5123, count=52, type="SCALAR")
    writer.json["buffers"] = [{"byteLength": 9999, "extensions": {extension: {"fallback": True}}}]
    writer.mesh(positions, None)
    writer.primitive()["indices"] = indices
    writer.node(mesh=0)
    writer.json["extensionsRequired"] = [extension]
    (part,) = read_gltf(writer.write(tmp_path)).parts
    assert_exact(part.positions, wanted[:, :6].copy().view("<i2"), COPIED)
    assert_exact(np.sort(part.faces, axis=1), np.sort(triangles.reshape(-1, 3), axis=1), COPIED)
    assert_exact(load(writer, tmp_path, sequence, "SCALAR").values[:, 0], streams.strip_indices() % 65536, COPIED)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mode": "LINES"}, "unknown mode"),
        ({"filter": "COLOR"}, "byteStride of 16 for COLOR"),
        ({"filter": "BLUR"}, "unknown filter"),
        ({"byteLength": 40}, "end early"),
        ({"byteStride": 6}, "byteStride of 6"),
        ({"count": 20}, "bytes too many"),
        ({"byteOffset": 10**6}, "reads beyond buffer 0"),
        ({"buffer": 1}, "names entry 1 of buffers"),
    ],
)
def test_broken_meshopt_views(writer, tmp_path, change, message):
    view = writer.view(streams.ATTRIBUTES_1)
    source = writer.json["bufferViews"][view]
    packed = {**source, "mode": "ATTRIBUTES", "count": 300, "byteStride": 16, **change}
    writer.json["bufferViews"][view] = {
        "buffer": 0, "byteLength": 4800, "byteStride": 16, "extensions": {"EXT_meshopt_compression": packed}
    }  # fmt: skip
    writer.mesh(writer.add("accessors", bufferView=view, componentType=5122, count=300, type="VEC3"))
    writer.node(mesh=0)
    with pytest.raises(UserError, match=message) as caught:
        read_gltf(writer.write(tmp_path))
    assert "buffer view 0" in str(caught.value)


# The beginning of a mesh of four faces and four vertices.
DRACO = b"DRACO\2\2\1\0\0\0\4\4"


def draco_mesh(writer, identifiers, faces=FACES):
    """A mesh whose attributes stand in a view that is said to be Draco's."""
    positions = writer.add("accessors", componentType=5126, count=4, type="VEC3")
    normals = writer.add("accessors", componentType=5120, count=4, type="VEC3", normalized=True)
    indices = writer.add("accessors", componentType=5125, count=12, type="SCALAR")
    extension = {"bufferView": writer.view(DRACO), "attributes": identifiers}
    attributes = {"POSITION": positions, "NORMAL": normals}
    writer.add("meshes", primitives=[
        {"attributes": attributes, "indices": indices, "extensions": {"KHR_draco_mesh_compression": extension}}
    ])  # fmt: skip
    writer.node(mesh=0)
    writer.json["extensionsUsed"] = ["KHR_draco_mesh_compression"]


class Decoded:
    """What DracoPy returns, in an order of its own."""

    faces = np.array(FACES, dtype="u4")
    attributes = (
        {"unique_id": 7, "data": np.int8([[0, 0, 127]] * 4)},
        {"unique_id": 0, "data": np.zeros((4, 2), dtype="f4")},
        {"unique_id": 3, "data": TETRAHEDRON.astype("f4")},
    )


class StandIn:
    """In place of the package DracoPy."""

    __spec__ = object()

    @staticmethod
    def decode(data):
        if data != DRACO:
            raise RuntimeError("not Draco")
        return Decoded()


def test_draco_attributes_go_by_their_identifiers(writer, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "DracoPy", StandIn)
    draco_mesh(writer, {"POSITION": 3, "NORMAL": 7})
    (part,) = read_gltf(writer.write(tmp_path)).parts
    assert_exact(part.positions, TETRAHEDRON, COPIED)
    assert_exact(part.faces, FACES, COPIED)
    assert_exact(part.normals, np.tile([0, 0, 1], (4, 1)), COPIED)


@pytest.mark.parametrize(
    ("identifiers", "message"), [({"POSITION": 4}, "names attribute 4"), ({"POSITION": 0}, "2 components of POSITION")]
)
def test_draco_attributes_that_are_not_there(writer, tmp_path, monkeypatch, identifiers, message):
    monkeypatch.setitem(sys.modules, "DracoPy", StandIn)
    draco_mesh(writer, identifiers)
    with pytest.raises(UserError, match=message):
        read_gltf(writer.write(tmp_path))


def test_draco_data_that_are_broken(writer, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "DracoPy", StandIn)
    draco_mesh(writer, {"POSITION": 3})
    at = writer.json["bufferViews"][0].get("byteOffset", 0)
    for begin, message in (
        (DRACO[:-1] + b"\5", "cannot be decoded by DracoPy: not Draco"),
        (DRACO[:5], "cannot be decoded: not a triangle mesh of Draco"),
        (DRACO[:7] + b"\0" + DRACO[8:], "cannot be decoded: not a triangle mesh of Draco"),  # a cloud of points
        (DRACO[:11] + b"\xff" * 4, "cannot be decoded: Draco's header is cut short"),
    ):
        writer.json["bufferViews"][0]["byteLength"] = len(begin)
        writer.blob[at : at + len(begin)] = begin
        with pytest.raises(UserError, match=message):
            read_gltf(writer.write(tmp_path))


def test_draco_data_of_more_than_memory_holds(writer, tmp_path, monkeypatch):
    """Nothing is decoded: it would take memory for as many as are claimed."""
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    draco_mesh(writer, {"POSITION": 3})
    at = writer.json["bufferViews"][0].get("byteOffset", 0)
    writer.json["bufferViews"][0]["byteLength"] = 17
    writer.blob[at : at + 17] = DRACO[:11] + b"\xff\xff\xff\xff\5\3"
    with pytest.raises(UserError, match=r"needs about .* of memory"):
        read_gltf(writer.write(tmp_path))


def test_with_dracopy(writer, tmp_path):
    package = pytest.importorskip("DracoPy")
    data = package.encode(TETRAHEDRON, FACES.astype("u4"), quantization_bits=12, preserve_order=True)
    (attribute,) = package.decode(data).attributes
    draco_mesh(writer, {"POSITION": attribute["unique_id"]})
    del writer.primitive()["attributes"]["NORMAL"]
    writer.json["bufferViews"][0] = {"buffer": 0, "byteOffset": len(writer.blob), "byteLength": len(data)}
    writer.blob += data
    (part,) = read_gltf(writer.write(tmp_path)).parts
    np.testing.assert_allclose(part.positions, TETRAHEDRON, rtol=0, atol=1 / 2**12)
    assert_exact(part.faces, FACES, COPIED)
