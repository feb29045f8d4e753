"""Where a glTF file puts its triangles: nodes, instances, skins, morph targets, and the topologies of primitives."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slepian_prt.errors import UserError
from slepian_prt.scene.formats.gltf import read_gltf
from tests.numerics import assert_exact, assert_rounded
from tests.scene.formats.gltf_writer import FACES, TETRAHEDRON, Writer, pack

COPIED = "numbers are copied, and multiplied by ones and zeros at most"


def volume(part):
    """Signed: positive if the faces of a closed surface look outwards."""
    a, b, c = (part.positions[part.faces[:, k]] - part.positions.mean(axis=0) for k in range(3))
    return np.einsum("ij,ij->", a, np.cross(b, c)) / 6


def sphere(rings=6):
    """(V, 3) unit vectors and the faces of their convex hull, seen from outside."""
    from scipy.spatial import ConvexHull

    i = np.arange(20 * rings)
    z = 1 - (2 * i + 1) / len(i)
    angle = i * 2.399963229728653
    unit = np.column_stack([np.sqrt(1 - z * z) * np.cos(angle), np.sqrt(1 - z * z) * np.sin(angle), z])
    faces = ConvexHull(unit).simplices.astype(np.int64)
    a, b, c = (unit[faces[:, k]] for k in range(3))
    inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), a) < 0
    faces[inwards] = faces[inwards][:, ::-1]
    return unit, faces


@pytest.fixture
def writer():
    return Writer()


@pytest.fixture
def read(tmp_path):
    """The parts of a writer's file."""
    return lambda writer: read_gltf(writer.write(tmp_path)).parts


def test_a_mesh_as_it_is(writer, tmp_path):
    writer.mesh()
    writer.node(mesh=0, name="corner")
    file = read_gltf(writer.write(tmp_path))
    (part,) = file.parts
    assert part.name == "corner"
    assert part.material is None
    assert file.notes == ()
    assert part.positions.dtype == np.float64
    assert_exact(part.positions, TETRAHEDRON, COPIED)
    assert_exact(part.faces, FACES, COPIED)


def test_nodes_in_nodes(writer, read):
    writer.mesh()
    turn = Rotation.from_euler("xyz", [0.3, -1.1, 2.0])
    shear = np.array([[1.0, 0.5, 0, 7], [0, 2, 0, 8], [0, 0.25, 1, 9], [0, 0, 0, 1]])
    inner = writer.node(root=False, mesh=0, matrix=shear.T.ravel().tolist())
    outer = {"translation": [1.0, 2, 3], "rotation": turn.as_quat().tolist(), "scale": [2.0, 3, 4]}
    writer.node(children=[inner], camera=0, **outer)
    (part,) = read(writer)
    wanted = turn.apply((TETRAHEDRON @ shear[:3, :3].T + shear[:3, 3]) * [2, 3, 4]) + [1, 2, 3]
    assert_rounded(part.positions, wanted, 20, size=100.0)


def test_far_from_the_origin(writer, read):
    """A translation as large as coordinates of the earth keeps what float32 would lose."""
    writer.mesh(TETRAHEDRON / 8)
    writer.node(mesh=0, translation=[5.4e6 + 0.001, -4.2e5, 0.25])
    (part,) = read(writer)
    assert_rounded(part.positions, TETRAHEDRON / 8 + [5.4e6 + 0.001, -4.2e5, 0.25], 4)


@pytest.mark.parametrize("scale", [[-1.0, 1, 1], [2.0, -3, 0.5], [-1.0, -1, -1], [-1e-90, 1e-90, 1e-90], [-1.0, -1, 1]])
def test_mirrored_surfaces_still_look_outwards(writer, read, scale):
    unit, faces = sphere()
    corners = writer.accessor(unit[:, :2].astype("f4"))
    writer.mesh(unit, faces, NORMAL=unit, TEXCOORD_0=corners)
    writer.add("materials", pbrMetallicRoughness={"baseColorTexture": {"index": 0}})
    writer.add("textures", source=0)
    writer.add("images", uri="a.png")
    writer.primitive()["material"] = 0
    writer.node(mesh=0, scale=scale)
    (part,) = read(writer)
    assert volume(part) > 0
    # The normal of x² / a² + y² / b² + z² / c² = 1 is along (x / a², y / b², z / c²).
    wanted = unit / np.array(scale)
    wanted /= np.linalg.norm(wanted, axis=1, keepdims=True)
    assert_rounded(part.normals, wanted, 50, size=2**29)  # the file has float32
    assert_exact(part.uv, unit.astype("f4")[part.faces][..., :2], "corners keep their coordinates")


def test_a_flattened_surface_keeps_its_normal(writer, read):
    writer.mesh([[0.0, 0, 1], [1, 0, 2], [0, 1, 3]], [[0, 1, 2]], NORMAL=np.tile([0.0, 0, 1], (3, 1)))
    writer.node(mesh=0, scale=[1, 1, 0])
    assert_exact(read(writer)[0].normals, np.tile([0.0, 0, 1], (3, 1)), COPIED)


def test_a_missing_normal_stays_missing(writer, read):
    writer.mesh(NORMAL=np.array([[0.0, 0, 0], [3, 0, 0], [np.nan, 0, 0], [0, -2, 0]]))
    writer.node(mesh=0)
    normals = read(writer)[0].normals
    assert not normals[0].any()
    assert np.isnan(normals[2]).any()
    assert_exact(normals[[1, 3]], [[1, 0, 0], [0, -1, 0]], COPIED)


# --- Topology ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mode", "indices", "faces"),
    [
        (4, [3, 1, 0, 0, 1, 2], [[3, 1, 0], [0, 1, 2]]),
        (5, [0, 1, 2, 3, 4, 5], [[0, 1, 2], [1, 3, 2], [2, 3, 4], [3, 5, 4]]),
        (5, [0, 1, 2, 3, 4], [[0, 1, 2], [1, 3, 2], [2, 3, 4]]),
        (5, [0, 1, 2, 2, 3, 3, 4, 5], [[0, 1, 2], [3, 5, 4]]),
        (6, [5, 1, 2, 3], [[1, 2, 5], [2, 3, 5]]),
    ],
)
@pytest.mark.parametrize("dtype", ["u1", "u2", "u4", None])
def test_topologies(writer, read, mode, indices, faces, dtype):
    points = np.arange(18.0).reshape(6, 3)
    if dtype is None:  # without indices
        points = points[indices]
    writer.mesh(points, None)
    if dtype is not None:
        writer.primitive()["indices"] = writer.accessor(np.array(indices, dtype=dtype))
    writer.primitive()["mode"] = mode
    writer.node(mesh=0)
    (part,) = read(writer)
    wanted = np.arange(18.0).reshape(6, 3)[np.array(faces)]
    came = part.positions[part.faces]
    # Without indices equal positions are different vertices: strips keep the flat triangles between them.
    flat = (came[:, 0] == came[:, 1]).all(1) | (came[:, 1] == came[:, 2]).all(1) | (came[:, 2] == came[:, 0]).all(1)
    assert_exact(came[~flat], wanted, COPIED)


def test_points_and_lines_are_left_out(writer, tmp_path):
    writer.mesh()
    at = writer.primitive()["attributes"]
    writer.json["meshes"][0]["primitives"] += [{"attributes": at, "mode": mode} for mode in range(4)]
    writer.node(mesh=0)
    file = read_gltf(writer.write(tmp_path))
    assert len(file.parts) == 1
    assert file.notes == ("points or lines left out (4 times)",)
    del writer.json["meshes"][0]["primitives"][0]
    with pytest.raises(UserError, match="scene 0 shows no triangles"):
        read_gltf(writer.write(tmp_path))


# --- Scenes -----------------------------------------------------------------------------------------------------------


def test_the_scene_that_the_file_shows(writer, tmp_path):
    writer.mesh()
    for name in ("first", "second", "third"):
        writer.node(root=False, mesh=0, name=name)
    writer.json["scenes"] = [{"nodes": [0]}, {"nodes": [2, 1, 2]}]

    def shown():
        file = read_gltf(writer.write(tmp_path))
        return [part.name for part in file.parts], file.notes

    assert shown() == (["first"], ("scene 0 of 2 is read",))
    writer.json["scene"] = 1
    assert shown() == (["third", "second"], ("scene 1 of 2 is read",))
    del writer.json["scene"]
    assert shown()[0] == ["first"]
    del writer.json["scenes"]
    assert shown() == (["first", "second", "third"], ())
    del writer.json["nodes"]
    assert shown() == (["mesh 0"], ("the file has no scene; its meshes are read as they are",))


def test_children_that_the_scene_names_again_are_there_once(writer, read):
    writer.mesh()
    writer.node(mesh=0, name="child")
    writer.node(children=[0], name="parent", translation=[0, 0, 5])
    (part,) = read(writer)
    assert_exact(part.positions, TETRAHEDRON + [0, 0, 5], COPIED)


def test_hidden_nodes_and_animations_are_told(writer, tmp_path):
    writer.mesh()
    child = writer.node(root=False, mesh=0)
    writer.node(children=[child], mesh=0, extensions={"KHR_node_visibility": {"visible": False}})
    writer.node(mesh=0, name="shown")
    writer.json["animations"] = [{"channels": [], "samplers": []}]
    file = read_gltf(writer.write(tmp_path))
    assert [part.name for part in file.parts] == ["shown"]
    assert file.notes == (
        "animations left out (the pose at rest is read)",
        "a hidden node left out, with all below it",
    )


def test_names_are_unique_and_those_of_nodes_or_meshes(writer, read):
    writer.mesh(name="box\nwith a break")
    writer.json["meshes"][0]["primitives"] *= 2
    writer.mesh()
    writer.node(mesh=0)
    below = writer.node(root=False, mesh=1)
    writer.node(children=[below], name="above")
    writer.node(mesh=1, name="above")
    writer.node(mesh=1)
    assert [part.name for part in read(writer)] == [
        "box with a break, primitive 0", "box with a break, primitive 1", "above", "above (2)", "node 4",
    ]  # fmt: skip


def test_a_chain_of_many_nodes(writer, read):
    """Deeper than Python's recursion goes."""
    writer.mesh()
    writer.json["nodes"] = [{"children": [i + 1], "translation": [1, 0, 0]} for i in range(3000)] + [{"mesh": 0}]
    writer.json["scenes"][0]["nodes"] = [0]
    (part,) = read(writer)
    assert_exact(part.positions, TETRAHEDRON + [3000, 0, 0], "sums of small integers")


# --- Instances, morph targets, skins ----------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", ["f4", "i2", "i1"])
def test_instances(writer, read, dtype):
    writer.mesh(NORMAL=TETRAHEDRON + 0.1)
    turns = Rotation.from_euler("z", [[0.0], [90.0], [180.0]], degrees=True).as_quat()
    largest = 1 if dtype == "f4" else np.iinfo(dtype).max
    quaternions = (turns * largest).round(0 if largest > 1 else 8).astype(dtype)
    at = np.array([[0.0, 0, 0], [0, 0, 4], [8, 0, 0]])
    sizes = np.array([[1.0, 1, 1], [2, 2, 2], [1, -1, 1]])
    attributes = {
        "TRANSLATION": writer.accessor(at.astype("f4")),
        "ROTATION": writer.accessor(quaternions, normalized=dtype != "f4"),
        "SCALE": writer.accessor(sizes.astype("f4")),
    }
    writer.node(mesh=0, name="i", scale=[1, 1, 3], extensions={"EXT_mesh_gpu_instancing": {"attributes": attributes}})
    writer.json["extensionsRequired"] = ["EXT_mesh_gpu_instancing"]
    parts = read(writer)
    assert [part.name for part in parts] == ["i [0]", "i [1]", "i [2]"]
    for part, turn, offset, size in zip(parts, Rotation.from_quat(turns), at, sizes, strict=True):
        wanted = (turn.apply(TETRAHEDRON * size) + offset) * [1, 1, 3]
        # Equal components of a quaternion stay equal however few bits they have.
        np.testing.assert_allclose(part.positions, wanted, rtol=0, atol=1e-6)
        assert volume(part) > 0


def test_morph_targets(writer, read):
    """Weights of a node go before those of its mesh, and none is 0; targets of zeros and few values are sparse."""
    up = np.tile([0.0, 0, 1], (4, 1))
    writer.mesh(NORMAL=up)
    moved = writer.accessor(np.float32([[0, 0, 2]] * 4))
    sparse = {
        "count": 1,
        "indices": {"bufferView": writer.view(np.array([2], dtype="u2").tobytes()), "componentType": 5123},
        "values": {"bufferView": writer.view(np.float32([[8, 0, 0]]).tobytes())},
    }
    few = writer.add("accessors", componentType=5126, count=4, type="VEC3", sparse=sparse)
    leaning = writer.accessor(np.float32([[4, 0, 0]] * 4))
    writer.primitive()["targets"] = [{"POSITION": moved}, {"POSITION": few, "NORMAL": leaning}]
    writer.json["meshes"][0]["weights"] = [0.5, 0]
    writer.node(mesh=0)
    writer.node(mesh=0, weights=[0, 0.25])
    first, second = read(writer)
    assert_exact(first.positions, TETRAHEDRON + [0, 0, 1], "halves of small integers")
    assert_exact(first.normals, up, COPIED)
    assert_exact(second.positions, TETRAHEDRON + np.float64([[0] * 3, [0] * 3, [2, 0, 0], [0] * 3]), "quarters")
    assert_rounded(second.normals, np.tile([0.5**0.5, 0, 0.5**0.5], (4, 1)), 4)
    del writer.json["meshes"][0]["weights"]
    assert_exact(read(writer)[0].positions, TETRAHEDRON, COPIED)


@pytest.mark.parametrize("dtype", ["u1", "u2"])
def test_skins(writer, read, dtype):
    """Two sets of joints; the node of the mesh has no say, its weights need not add up to one."""
    rng = np.random.default_rng(3)
    weights = rng.random((4, 8))
    joints = rng.integers(0, 3, (4, 8)).astype(dtype)
    writer.mesh(
        NORMAL=TETRAHEDRON + 1,
        JOINTS_0=writer.accessor(joints[:, :4]),
        JOINTS_1=writer.accessor(joints[:, 4:]),
        WEIGHTS_0=weights[:, :4],
        WEIGHTS_1=weights[:, 4:],
    )
    turns = Rotation.from_euler("xyz", rng.normal(size=(3, 3)) * 0.3)
    at = rng.normal(size=(3, 3))
    for k in range(3):
        writer.node(
            root=k == 0, translation=at[k].tolist(), rotation=turns[k].as_quat().tolist(), children=[k + 1] * (k < 2)
        )
    inverse = np.tile(np.eye(4), (3, 1, 1))
    inverse[:, :3, 3] = rng.normal(size=(3, 3)).astype("f4")
    bind = writer.accessor(inverse.transpose(0, 2, 1).reshape(3, 16).astype("f4"))
    writer.add("skins", joints=[2, 0, 1], inverseBindMatrices=bind)
    writer.node(mesh=0, skin=0, scale=[100, 100, 100], translation=[1, 2, 3])
    (part,) = read(writer)

    placed, total = [], np.eye(4)
    for k in range(3):
        own = np.eye(4)
        own[:3, :3], own[:3, 3] = turns[k].as_matrix(), at[k]
        total = total @ own
        placed.append(total)
    matrices = np.array([placed[joint] @ inverse[i] for i, joint in enumerate([2, 0, 1])])
    share = weights.astype("f4").astype(float)
    share /= share.sum(axis=1, keepdims=True)
    blended = np.einsum("vk,vkij->vij", share, matrices[joints.astype(int)])
    points = np.column_stack([TETRAHEDRON, np.ones(4)])
    assert_rounded(part.positions, np.einsum("vij,vj->vi", blended, points)[:, :3], 100, size=10.0)
    normals = np.einsum("vji,vj->vi", np.linalg.inv(blended[:, :3, :3]), TETRAHEDRON + 1)
    assert_rounded(part.normals, normals / np.linalg.norm(normals, axis=1, keepdims=True), 200, size=10.0)
    assert volume(part) > 0


def test_skins_without_weights_or_bind_matrices(writer, read):
    """A vertex without weights goes with its first joint; joints that mirror turn the winding around."""
    weights = np.array([[1.0, 0, 0, 0], [0, 0, 0, 0], [0.5, 0.5, 0, 0], [3, 0, 0, 0]])
    joints = np.zeros((4, 4), dtype="u1")
    joints[0, 1] = 200  # without a weight it does not matter
    writer.mesh(JOINTS_0=writer.accessor(joints), WEIGHTS_0=weights)
    writer.node(scale=[-1, 1, 1], translation=[5, 0, 0])
    writer.add("skins", joints=[0])
    writer.node(mesh=0, skin=0)
    (part,) = read(writer)
    assert_exact(part.positions, TETRAHEDRON * [-1, 1, 1] + [5, 0, 0], COPIED)
    assert volume(part) > 0


# --- Where the bytes are ----------------------------------------------------------------------------------------------


def test_buffers_of_their_own(writer, tmp_path):
    """A relative URI with an encoded space, the same written as it is, data in the URI, and a .gltf that is binary."""
    import base64
    from urllib.parse import quote

    writer.mesh()
    writer.node(mesh=0)
    (tmp_path / "sub folder").mkdir()
    (tmp_path / "sub folder" / "sphère 50%.bin").write_bytes(writer.blob)
    (tmp_path / "a%41.bin").write_bytes(writer.blob)
    packed = base64.b64encode(bytes(writer.blob)).decode()
    for uri in (
        quote("sub folder/sphère 50%.bin"), "sub folder/sphère 50%.bin", "sub folder\\sphère 50%.bin", "a%41.bin",
        f"data:application/octet-stream;base64,{packed}", f"data:;base64,{packed.rstrip('=')}",
        "data:application/octet-stream," + quote(bytes(writer.blob)),
    ):  # fmt: skip
        content = {**writer.json, "buffers": [{"byteLength": len(writer.blob), "uri": uri}]}
        path = tmp_path / "a.gltf"
        path.write_text("\ufeff" + json.dumps(content), encoding="utf-8")
        assert_exact(read_gltf(path).parts[0].positions, TETRAHEDRON, COPIED)
        (tmp_path / "b.glb").write_bytes(pack(json.dumps(content).encode()))
        assert_exact(read_gltf(tmp_path / "b.glb").parts[0].positions, TETRAHEDRON, COPIED)
    text = json.dumps({**writer.json, "buffers": [{"byteLength": len(writer.blob)}]}).encode()
    (tmp_path / "d.glb").write_bytes(pack(text + bytes(-len(text) % 4 + 4), bytes(writer.blob)))  # padded with zeros
    assert_exact(read_gltf(tmp_path / "d.glb").parts[0].positions, TETRAHEDRON, COPIED)
    (tmp_path / "c.gltf").write_bytes(writer.glb() + b"trailing")
    assert_exact(read_gltf(tmp_path / "c.gltf").parts[0].positions, TETRAHEDRON, COPIED)
