"""Broken glTF files end in one true line, whatever is broken."""

import json
import struct

import numpy as np
import pytest

from slepian_prt.errors import UserError
from slepian_prt.scene.formats.gltf import read_gltf
from tests.scene.formats.gltf_writer import FACES, TETRAHEDRON, Writer, pack


def full():
    """A file with a bit of everything: skin, morph target, sparse values, instances, a texture."""
    writer = Writer()
    flat = np.float32([[0, 0], [1, 0], [0, 1], [1, 1]])
    weights = np.tile([1.0, 0, 0, 0], (4, 1))
    writer.mesh(TETRAHEDRON, FACES, NORMAL=TETRAHEDRON + 1, TEXCOORD_0=flat, WEIGHTS_0=weights,
                JOINTS_0=writer.accessor(np.zeros((4, 4), dtype="u1")))  # fmt: skip
    sparse = {
        "count": 1,
        "indices": {"bufferView": writer.view(bytes([2, 0])), "componentType": 5121},
        "values": {"bufferView": writer.view(np.float32([8, 0, 0]).tobytes())},
    }
    target = writer.add("accessors", componentType=5126, count=4, type="VEC3", sparse=sparse)
    writer.primitive().update(targets=[{"POSITION": target}], material=0)
    writer.json["meshes"][0]["weights"] = [0.5]
    writer.add("materials", pbrMetallicRoughness={"baseColorTexture": {"index": 0}, "baseColorFactor": [1, 1, 1, 1]})
    writer.add("textures", source=0, sampler=0)
    writer.add("samplers", wrapS=33071)
    writer.add("images", bufferView=writer.view(b"\x89PNG"))
    bind = writer.accessor(np.eye(4).reshape(1, 16).astype("f4"))
    writer.add("skins", joints=[0], inverseBindMatrices=bind)
    at = writer.accessor(np.float32([[0, 0, 0], [1, 0, 0]]))
    writer.node(translation=[1, 0, 0], rotation=[0, 0, 0, 1], scale=[1, 1, 1], children=[1])
    writer.node(root=False, mesh=0, skin=0)
    writer.node(mesh=0, extensions={"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": at}}})
    return writer


def fault(path):
    """The line of the refusal."""
    with pytest.raises(UserError) as caught:
        read_gltf(path)
    line = str(caught.value)
    assert line.startswith(f"{path}: ")
    assert "\n" not in line
    assert "; " in line  # what to do
    assert caught.value.__cause__ is None  # foreseen
    return line


def survive(path) -> bool:
    """Read a file that may be broken, and say whether it was: refused in one line that was foreseen, or not at all."""
    try:
        read_gltf(path)
    except UserError as error:
        refusal = error
    else:
        return False
    assert "\n" not in str(refusal)
    assert refusal.__cause__ is None, refusal
    return True


def test_the_whole_file_is_read(tmp_path):
    assert len(read_gltf(full().write(tmp_path)).parts) == 3


def put(keys, value):
    """A change of the JSON: the value at a path of keys."""

    def change(content):
        for key in keys[:-1]:
            content = content[key]
        content[keys[-1]] = value

    return change


PRIMITIVE = ("meshes", 0, "primitives", 0)
INSTANCES = ("nodes", 2, "extensions", "EXT_mesh_gpu_instancing", "attributes")

BROKEN = [
    (("asset",), {"version": "1.0"}, "is glTF 1.0, and only glTF 2.0"),
    (("asset",), {"version": 1}, "is glTF 1.0, and only glTF 2.0"),
    (("asset",), {"version": True}, "asset has version True, not a string"),
    (("asset",), {"version": 10**400}, "not a string"),
    (("asset",), {"version": "2.0", "minVersion": "2.7"}, "is glTF 2.7"),
    (("asset",), {}, "asset has no version"),
    (("asset",), None, "no glTF version"),
    (("asset",), [], "asset [], not an object"),
    (("extensionsUsed",), "KHR_x", "extensionsUsed 'KHR_x', not a list of names"),
    (("extensionsRequired",), ["KHR_texture_transform", "ACME_shape"], "needs the glTF extension ACME_shape"),
    (("meshes",), {}, "meshes {}, not a list"),
    (("meshes", 0), 7, "mesh 0 is 7, not an object"),
    (("meshes", 0, "weights"), [1, 2], "mesh 0, primitive 0 has 1 morph targets and 2 weights"),
    (("meshes", 0, "weights"), "x", "mesh 0 has weights 'x', not a list of numbers"),
    (("scene",), 3, "the file names entry 3 of scenes, of which there are 1"),
    (("scenes", 0, "nodes"), [9], "scene 0 names entry 9 of nodes"),
    (("scenes", 0, "nodes"), [-1], "scene 0 has nodes [-1], not a list of indices"),
    (("scenes", 0, "nodes"), [], "scene 0 shows no triangles"),
    (("nodes", 1, "children"), [0], "is its own ancestor"),
    (("nodes", 1, "children"), [1], "node 1 has node 1 as a child, which node 0 has already"),
    (("nodes", 0, "matrix"), [1] * 15, "node 0 has matrix"),
    (("nodes", 0, "matrix"), [2] * 16, "not affine"),
    (("nodes", 0, "rotation"), [0, 0, 0, 0], "node 0 has a rotation of zero length"),
    (("nodes", 0, "rotation"), [0, 0, 0, None], "not a list of 4 numbers"),
    (("nodes", 0, "scale"), [1, 1, True], "node 0 has scale"),
    (("nodes", 0, "translation"), [1, 1], "not a list of 3 numbers"),
    (("nodes", 1, "mesh"), 5, "node 1 names entry 5 of meshes, of which there are 1"),
    (("nodes", 1, "mesh"), 0.5, "node 1 has mesh 0.5, not a whole number"),
    (("nodes", 1, "skin"), 1, "node 1 names entry 1 of skins"),
    (("skins", 0, "joints"), [], "skin 0 has no joints"),
    (("skins", 0, "joints"), [7], "skin 0 names entry 7 of nodes"),
    (("skins", 0, "joints"), [0, 0], "skin 0 has 1 inverse bind matrices for 2 joints"),
    ((*PRIMITIVE, "mode"), 7, "mesh 0, primitive 0 has an unknown mode (7)"),
    ((*PRIMITIVE, "mode"), "4", "mode '4', not a whole number"),
    ((*PRIMITIVE, "attributes"), {}, "shows no triangles"),
    ((*PRIMITIVE, "attributes", "POSITION"), 99, "primitive 0, attributes names entry 99 of accessors"),
    ((*PRIMITIVE, "attributes", "POSITION"), 3, "accessor 3 is 'VEC2' where"),
    ((*PRIMITIVE, "attributes", "JOINTS_0"), 1, "'VEC3' where mesh 0, primitive 0, attributes needs VEC4"),
    ((*PRIMITIVE, "indices"), 1, "needs SCALAR"),
    ((*PRIMITIVE, "material"), 4, "names entry 4 of materials"),
    (("accessors", 2, "count"), 3, "mesh 0, primitive 0 has 4 of POSITION and 3 of NORMAL"),
    (("accessors", 1, "count"), 10**9, "accessor 1 reads beyond buffer view"),
    (("accessors", 1, "count"), -4, "accessor 1 has count -4, not a whole number"),
    (("accessors", 1, "count"), 10**400, "not a whole number"),
    (("accessors", 1, "byteOffset"), 4, "accessor 1 reads beyond buffer view 1"),
    (("accessors", 1, "componentType"), 5124, "accessor 1 has an unknown componentType (5124)"),
    (("accessors", 1, "bufferView"), 99, "accessor 1 names entry 99 of bufferViews"),
    (("accessors", 1, "type"), "VEC9", "accessor 1 is 'VEC9' where"),
    (("accessors", 1, "normalized"), 1, "normalized 1, not true or false"),
    (("accessors", 6, "sparse", "count"), 3, "reads beyond buffer view"),
    (("accessors", 6, "sparse", "indices"), None, "accessor 6, sparse has no indices or no values"),
    (("accessors", 6, "sparse", "indices", "componentType"), 5126, "which no index has"),
    (("accessors", 6, "count"), 10**12, "accessor 6 has 1000000000000 elements and no data"),
    (("accessors", 6, "count"), 3, "has 3 of POSITION for 4"),
    (("accessors", 6, "count"), 2, "sparse replaces element 2 of 2"),
    (("bufferViews", 1, "byteLength"), 10**6, "buffer view 1 reads beyond buffer 0"),
    (("bufferViews", 1, "byteStride"), 4, "elements of 12 bytes in buffer view 1, whose byteStride is 4"),
    (("bufferViews", 1, "byteStride"), 0, "whose byteStride is 0"),
    (("bufferViews", 1, "buffer"), 1, "buffer view 1 names entry 1 of buffers"),
    (("buffers", 0, "byteLength"), 10**6, "buffer 0 has"),
    (("buffers", 0, "byteLength"), None, "buffer 0 has no byteLength"),
    (("buffers", 0, "uri"), "gone.bin", "gone.bin' with its buffer 0 is not there"),
    (("buffers", 0, "uri"), "a\x00b", "is not there"),
    (("buffers", 0, "uri"), "x" * 5000, "is not there"),
    (("buffers", 0, "uri"), ".", "is not there"),
    (("buffers", 0, "uri"), "https://example.com/a.bin", "which is not fetched"),
    (("buffers", 0, "uri"), "data:application/octet-stream;base64,@@@", "not base64"),
    (("buffers", 0, "uri"), "data:nothing", "without data"),
    ((*INSTANCES, "TRANSLATION"), 0, "accessor 0 is 'VEC4' where"),
    ((*INSTANCES, "SCALE"), 1, "has 2 and 4 instances"),
    ((*INSTANCES, "ROTATION"), 4, "has 2 and 4 instances"),
    (("materials", 0, "pbrMetallicRoughness", "baseColorFactor"), [1], "not a list of 4 numbers"),
    (("materials", 0, "pbrMetallicRoughness", "baseColorTexture"), {}, "baseColorTexture has no index"),
    (("materials", 0, "alphaMode"), "BLUR", "unknown alphaMode"),
    (("materials", 0, "name"), 5, "material 0 has name 5, not a string"),
    (("samplers", 0, "wrapS"), 5, "sampler 0 has an unknown wrap mode (5)"),
    (("images", 0, "bufferView"), None, "image 0 has no bufferView"),
]


@pytest.mark.parametrize(("keys", "value", "message"), BROKEN, ids=lambda value: None)
def test_broken_json(tmp_path, keys, value, message):
    writer = full()
    writer.json["buffers"] = []
    content = {**writer.json, "buffers": [{"byteLength": len(writer.blob)}]}
    put(keys, value)(content)
    path = tmp_path / "a.glb"
    path.write_bytes(pack(json.dumps(content).encode(), bytes(writer.blob)))
    assert message in fault(path)


@pytest.mark.parametrize(
    ("dtype", "bad", "message"),
    [
        ("u1", 255, "has the index 255, which glTF keeps for restarts"),
        ("u2", 65535, "has the index 65535, which glTF keeps for restarts"),
        ("u4", 2**32 - 1, "which glTF keeps for restarts"),
        ("u2", 4, "mesh 0, primitive 0 names vertex 4 of 4"),
        ("f4", np.nan, "has componentType 5126, which no index has"),
        ("i2", -1, "has componentType 5122, which no index has"),
    ],
)
def test_broken_indices(tmp_path, dtype, bad, message):
    writer = full()
    writer.primitive()["indices"] = writer.accessor(np.array([0, 1, bad]).astype(dtype))
    assert message in fault(writer.write(tmp_path))
    writer.primitive()["indices"] = writer.accessor(np.array([0, 1, 2, 0], dtype="u1"))
    assert "has 4 indices, which are no triangles" in fault(writer.write(tmp_path))


@pytest.mark.parametrize(
    ("joint", "weight", "message"),
    [
        (1, 0.5, "names joint 1 of 1"),
        (0, -1, "negative or not finite"),
        (0, np.inf, "negative or not finite"),
    ],
)
def test_broken_skins(tmp_path, joint, weight, message):
    writer = full()
    at = writer.primitive()["attributes"]
    at["JOINTS_0"] = writer.accessor(np.full((4, 4), joint, dtype="u2"))
    at["WEIGHTS_0"] = writer.accessor(np.full((4, 4), weight, dtype="f4"))
    assert message in fault(writer.write(tmp_path))
    del at["WEIGHTS_0"]
    assert "JOINTS_0 without WEIGHTS_0" in fault(writer.write(tmp_path))
    del at["JOINTS_0"]
    assert "has a skin and no JOINTS_0" in fault(writer.write(tmp_path))


def test_instances_without_a_rotation(tmp_path):
    writer = full()
    turns = writer.accessor(np.zeros((2, 4), dtype="i2"), normalized=True)
    writer.json["nodes"][2]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"]["ROTATION"] = turns
    assert "has an instance whose transform is not finite" in fault(writer.write(tmp_path))


GOOD = full().glb()

CONTAINERS = {
    "empty.glb": (b"", "is not a binary glTF file"),
    "garbage.glb": (b"foo", "is not a binary glTF file"),
    "garbage.gltf": (b"foo", "its glTF JSON cannot be read"),
    "header.glb": (GOOD[:10], "is cut off after 10 bytes"),
    "cut.glb": (GOOD[:-100], f"is cut off: it has {len(GOOD) - 100} of its {len(GOOD)} bytes"),
    "old.glb": (GOOD[:4] + struct.pack("<I", 1) + GOOD[8:], "is binary glTF 1, and only glTF 2.0"),
    "chunk.glb": (GOOD[:12] + struct.pack("<I", 10**9) + GOOD[16:], "its chunk 0 of 1000000000 bytes reaches beyond"),
    "order.glb": (GOOD[:16] + b"BIN\0" + GOOD[20:], "its first chunk is not JSON"),
    "none.glb": (b"glTF" + struct.pack("<II", 2, 20) + bytes(8), "its first chunk is not JSON"),
    "list.glb": (pack(b"[1, 2]"), "it is [1, 2], not an object"),
    "number.gltf": (b"7", "it is 7, not an object"),
    "deep.gltf": (b"[" * 200000, "it is nested too deeply"),
    "deep object.gltf": (b'{"asset":{"version":"2.0"},"a":' + b'{"a":' * 100000, "it is nested too deeply"),
    "latin.gltf": ('{"asset": {"version": "2.0", "copyright": "©"}}'.encode("latin-1"), "it is not UTF-8"),
    "nan.gltf": (b'{"asset": {"version": "2.0"}, "x": NaN}', "NaN is no number in JSON"),
    "cut.gltf": (b'{"asset": {"version": "2.0"', "its glTF JSON cannot be read"),
    "nothing.gltf": (b'{"asset": {"version": "2.0"}}', "the file has no mesh"),
    "camera.gltf": (b'{"asset": {"version": "2.0"}, "nodes": [{"camera": 0}]}', "the file has no mesh"),
    "no chunk.glb": (pack(GOOD[20 : 20 + struct.unpack("<I", GOOD[12:16])[0]]), "buffer 0 has no data"),
}


@pytest.mark.parametrize("name", CONTAINERS)
def test_broken_containers(tmp_path, name):
    content, message = CONTAINERS[name]
    path = tmp_path / name
    path.write_bytes(content)
    assert message in fault(path)


def test_a_missing_file(tmp_path):
    assert "no such file" in fault(tmp_path / "gone.glb")


@pytest.mark.parametrize("seed", range(4))
def test_flipped_bytes(tmp_path, seed):
    """Any damage is refused in one line, or does not matter; nothing is raised that was not foreseen."""
    rng = np.random.default_rng(seed)
    path = tmp_path / "a.glb"
    length = struct.unpack("<I", GOOD[12:16])[0]
    digits = [i for i in range(20, 20 + length) if 48 <= GOOD[i] < 58]
    refused = 0
    for _ in range(150):
        broken = bytearray(GOOD)
        for _ in range(rng.integers(1, 4)):
            if seed % 2:  # another digit, so that it is still JSON
                broken[rng.choice(digits)] = rng.integers(48, 58)
            else:
                broken[rng.integers(len(broken))] = rng.integers(256)
        path.write_bytes(broken)
        refused += survive(path)
    assert 0 < refused < 150


@pytest.mark.slow
def test_values_of_any_type_anywhere(tmp_path):
    """Each value of the JSON in turn replaced by ones of other types."""
    writer = full()
    content = {**writer.json, "buffers": [{"byteLength": len(writer.blob)}]}
    places = []

    def walk(value, keys):
        if keys:
            places.append(keys)
        for key, inner in (
            value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
        ):
            walk(inner, (*keys, key))

    walk(content, ())
    assert len(places) > 150
    text = json.dumps(content)
    path = tmp_path / "a.glb"
    for keys in places:
        for value in (None, -1, 10**30, 1.5, "x", [], {}, [None], True):
            changed = json.loads(text)
            put(keys, value)(changed)
            path.write_bytes(pack(json.dumps(changed).encode(), bytes(writer.blob)))
            survive(path)


@pytest.mark.parametrize(
    ("error", "message"),
    [(IndexError("out of\nrange"), "malformed (IndexError: out of range)"), (MemoryError(), "needs more memory")],
)
def test_what_nobody_foresaw_is_one_line_too(tmp_path, monkeypatch, error, message):
    def fail(*_):
        raise error

    monkeypatch.setattr("slepian_prt.scene.formats.gltf.read_parents", fail)
    with pytest.raises(UserError) as caught:
        read_gltf(full().write(tmp_path))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
