"""Small mesh files of every format that is read, and damage to them."""

from __future__ import annotations

import io
import json
import random
import struct
from pathlib import Path
from typing import Any

import DracoPy
import numpy as np
from PIL import Image

from tests.fuzzing import mutations
from tests.scene.formats import meshopt_streams as streams
from tests.scene.formats.gltf_writer import FACES, TETRAHEDRON, Writer, pack

# Files that are read by way of another: which, as others are read themselves.
READ_BY = {"material.mtl": "textured.obj", "picture.png": "textured.obj", "buffer.bin": "scene.gltf"}

_MESHOPT = "EXT_meshopt_compression"
_DRACO = "KHR_draco_mesh_compression"

# Values that no key of a glTF file may have, or hardly any.
_VALUES: tuple[Any, ...] = (
    None, True, False, -1, 0, 1, 2, 3.5, 2**31, 2**53, 2**63, 10**18, 1e308, -1e308, "", "x", "\ud800", "a" * 5000, [],
    [0], [-1], [1e308] * 3, [None], [[]], {}, {"x": 0}, "VEC2", "MAT4", 5120, 5121, 5126, "../../../etc/passwd",
    "/dev/zero", "data:,", "data:;base64,!", "http://example.org/a.bin", "a\0b",
)  # fmt: skip


def seeds() -> dict[str, bytes]:
    """Files by name, all valid; they may lie in one folder."""
    return {**_text_files(), **_binary_ply(), "binary.stl": _stl(), **_gltf_files(), "picture.png": _picture()}


def write_seeds(folder: Path) -> None:
    """All of them in a folder, so that files which are read by way of others find them."""
    for name, content in seeds().items():
        (folder / name).write_bytes(content)


def mutate(name: str, content: bytes, random: random.Random) -> bytes:
    """A file of this name, damaged; which kind is drawn.

    Parameters
    ----------
    name : str
        Its suffix tells what damage there is beside any file's.
    """
    suffix = Path(name).suffix
    if suffix in (".gltf", ".glb") and random.random() < 0.7:
        return _change_gltf(content, random)
    if suffix in (".obj", ".mtl", ".off", ".gltf") or name.startswith("text"):
        return mutations.mutate(content, random, mutations.TEXT)
    if suffix == ".ply" and random.random() < 0.5:
        end = content.index(b"end_header")
        return mutations.mutate(content[:end], random, mutations.TEXT) + content[end:]
    return mutations.mutate(content, random)


def _text_files() -> dict[str, bytes]:
    corners = [" ".join(f"{x:g}" for x in row) for row in TETRAHEDRON]
    colored = [f"{row} {k * 60} 100 200" for k, row in enumerate(corners)]
    faces = [" ".join(str(v) for v in row) for row in FACES]
    uv = "vt 0 0\nvt 1 0\nvt 0 1\nvt 1 1\n"
    obj = "".join(f"v {row}\n" for row in corners)
    split = "".join("f " + " ".join(f"{v + 1}/{v + 1}/{k + 1}" for v in row) + "\n" for k, row in enumerate(FACES))
    normals = "vn 0 0 -1\nvn 0 -1 0\nvn -1 0 0\nvn 1 1 1\n"
    header = (
        "ply\nformat ascii 1.0\ncomment made by hand\ncomment TextureFile picture.png\nelement vertex 4\n"
        "property float x\nproperty float y\nproperty float z\nproperty uchar red\nproperty uchar green\n"
        "property uchar blue\nelement face 4\nproperty list uchar int vertex_indices\n"
        "property list uchar float texcoord\nend_header\n"
    )
    wedges = "".join(f"3 {row} 6 0 0 1 0 0 1\n" for row in faces)
    stl = "".join(
        "facet normal 0 0 1\nouter loop\n" + "".join(f"vertex {corners[v]}\n" for v in row) + "endloop\nendfacet\n"
        for row in FACES
    )
    texts = {
        "plain.obj": obj + "".join("f " + " ".join(str(v + 1) for v in row) + "\n" for row in FACES),
        "textured.obj": "mtllib material.mtl\n" + obj + uv + normals + "usemtl paint\n" + split,
        "relative.obj": "".join(f"v {row} 0.5 0.5 1\n" for row in corners) + "f -4 -2 -3\nf -4 -3 -1 -2\n",
        "material.mtl": "newmtl paint\nKd 0.5 0.25 1\nPm 0.5\nd 0.9\nmap_Kd -s 2 2 -o 0.5 0.5 picture.png\n",
        "text.ply": header + "".join(f"{row}\n" for row in colored) + wedges,
        "text.stl": f"solid a\n{stl}endsolid a\n",
        "plain.off": "OFF\n# made by hand\n4 4 6\n" + "\n".join([*corners, *(f"3 {row}" for row in faces)]) + "\n",
        "colored.off": "COFF\n4 4 6\n" + "\n".join([*(f"{row} 255" for row in colored), *(f"3 {r}" for r in faces)]),
    }
    return {name: text.encode() for name, text in texts.items()}


def _binary_ply() -> dict[str, bytes]:
    body = {}
    for order in "<>":
        rows = b"".join(struct.pack(f"{order}6d", *row, *(row or [0])) for row in TETRAHEDRON.tolist())
        lists = b"".join(struct.pack(f"{order}B3i", 3, *row) for row in FACES.tolist())
        strip = struct.pack(f"{order}I4i", 4, 0, 1, 2, 3)
        body[order] = rows, lists + struct.pack(f"{order}B4i", 4, 0, 1, 2, 3), strip
    names = "".join(f"property double {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz"))
    head = f"ply\nformat binary_{{}}_endian 1.0\nelement vertex 4\n{names}"
    faces = "element face 5\nproperty list uchar int vertex_index\nend_header\n"
    strips = "element tristrips 1\nproperty list uint int vertex_indices\nend_header\n"
    return {
        "little.ply": (head.format("little") + faces).encode() + body["<"][0] + body["<"][1],
        "big.ply": (head.format("big") + faces).encode() + body[">"][0] + body[">"][1],
        "strips.ply": (head.format("little") + strips).encode() + body["<"][0] + body["<"][2],
    }


def _stl() -> bytes:
    facets = np.zeros(len(FACES), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
    facets["corners"] = TETRAHEDRON[FACES]
    return bytes(80) + struct.pack("<I", len(FACES)) + facets.tobytes()


def _picture() -> bytes:
    stream = io.BytesIO()
    Image.fromarray(np.arange(8 * 8 * 3, dtype=np.uint8).reshape(8, 8, 3)).save(stream, "PNG")
    return stream.getvalue()


def _gltf_files() -> dict[str, bytes]:
    plain = _scene()
    text = {**plain.json, "buffers": [{"byteLength": len(plain.blob), "uri": "buffer.bin"}]}
    return {
        "scene.glb": plain.glb(),
        "scene.gltf": json.dumps(text, indent=1).encode(),
        "buffer.bin": bytes(plain.blob),
        "draco.glb": _draco().glb(),
        "meshopt.glb": _meshopt(),
        "skinned.glb": _skinned().glb(),
    }


def _scene() -> Writer:
    """A mesh with a texture, copies of it, and positions of which some stand apart."""
    writer = Writer()
    uv, color = np.float32([[0, 0], [1, 0], [0, 1], [1, 1]]), np.full((4, 4), 200, dtype=np.uint8)
    tint = writer.accessor(color, normalized=True)
    mesh = writer.mesh(TEXCOORD_0=uv, NORMAL=TETRAHEDRON - 0.25, COLOR_0=tint)
    image = writer.add("images", bufferView=writer.view(_picture()), mimeType="image/png")
    texture = writer.add("textures", source=image, sampler=writer.add("samplers", wrapS=33071))
    paint = {"baseColorTexture": {"index": texture}, "metallicFactor": 0.5, "baseColorFactor": [0.5, 1, 1, 1]}
    writer.primitive(mesh)["material"] = writer.add("materials", name="paint", pbrMetallicRoughness=paint)
    sparse = {
        "count": 1,
        "indices": {"bufferView": writer.view(np.uint16([1]).tobytes()), "componentType": 5123},
        "values": {"bufferView": writer.view(np.float32([[2, 0, 0]]).tobytes())},
    }
    zeros = writer.add("accessors", componentType=5126, count=4, type="VEC3", sparse=sparse)
    writer.primitive(mesh)["targets"] = [{"POSITION": zeros}]
    writer.json["meshes"][mesh]["weights"] = [0.5]
    places = writer.accessor(np.float32([[0, 0, 0], [3, 0, 0]]))
    copies = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": places}}}
    child = writer.node(root=False, mesh=mesh, extensions=copies)
    writer.node(children=[child], rotation=[0, 0, 0, 1], scale=[1, 2, 1])
    writer.json["extensionsUsed"] = ["EXT_mesh_gpu_instancing"]
    return writer


def _skinned() -> Writer:
    writer = Writer()
    joints = writer.accessor(np.uint8([[0, 1, 0, 0]] * 4))
    mesh = writer.mesh(JOINTS_0=joints, WEIGHTS_0=np.float32([[0.5, 0.5, 0, 0]] * 4))
    bind = writer.accessor(np.float32([np.eye(4).ravel()] * 2))
    bones = [writer.node(translation=[0, 0, z]) for z in (0, 1)]
    writer.node(mesh=mesh, skin=writer.add("skins", joints=bones, inverseBindMatrices=bind))
    return writer


def _draco() -> Writer:
    writer = Writer()
    points, faces = TETRAHEDRON, FACES.astype(np.uint32)
    data = DracoPy.encode(points, faces, quantization_bits=12, preserve_order=True, normals=points - 0.25)
    names = {("POSITION", "NORMAL")[k]: int(a["unique_id"]) for k, a in enumerate(DracoPy.decode(data).attributes)}
    accessors = {name: writer.add("accessors", componentType=5126, count=4, type="VEC3") for name in names}
    indices = writer.add("accessors", componentType=5125, count=12, type="SCALAR")
    packed = {_DRACO: {"bufferView": writer.view(data), "attributes": names}}
    writer.add("meshes", primitives=[{"attributes": accessors, "indices": indices, "extensions": packed}])
    writer.node(mesh=0)
    writer.json["extensionsRequired"] = writer.json["extensionsUsed"] = [_DRACO]
    return writer


def _meshopt() -> bytes:
    """Positions and triangles as meshoptimizer's own encoder wrote them, in place of an empty buffer."""
    writer = Writer()
    count = int(streams.grid_triangles().size)
    for data, mode, entries, stride, size in (
        (streams.ATTRIBUTES_1, "ATTRIBUTES", 300, 16, 4800),
        (streams.TRIANGLES, "TRIANGLES", count, 4, 4 * count),
    ):
        view = writer.view(data)
        packed = {**writer.json["bufferViews"][view], "mode": mode, "count": entries, "byteStride": stride}
        more = {"byteStride": stride} if mode == "ATTRIBUTES" else {}
        writer.json["bufferViews"][-1] = {
            "buffer": 1, "byteOffset": 0, "byteLength": size, "extensions": {_MESHOPT: packed}, **more
        }  # fmt: skip
    positions = writer.add("accessors", bufferView=0, componentType=5122, count=300, type="VEC3")
    indices = writer.add("accessors", bufferView=1, componentType=5125, count=count, type="SCALAR")
    writer.json["buffers"] = [{"byteLength": 9999, "extensions": {_MESHOPT: {"fallback": True}}}]
    writer.mesh(positions, None)
    writer.primitive()["indices"] = indices
    writer.node(mesh=0)
    writer.json["extensionsRequired"] = writer.json["extensionsUsed"] = [_MESHOPT]
    return writer.glb()


def _change_gltf(content: bytes, random: random.Random) -> bytes:
    """One or a few values of the JSON are others, missing, doubled or nested deeply."""
    binary = content[:4] == b"glTF"
    blob = None
    if binary:
        size = struct.unpack_from("<I", content, 12)[0]
        text, blob = content[20 : 20 + size], content[28 + size :]
    else:
        text = content
    root = json.loads(text)
    for _ in range(random.choice((1, 1, 1, 2, 4))):
        places = list(_places(root))
        if not places:
            break
        holder, key = random.choice(places)
        kind = random.random()
        if kind < 0.15:
            del holder[key]
        elif kind < 0.25 and isinstance(holder, list):
            holder.extend([holder[key]] * random.choice((1, 3)))
        elif kind < 0.3:
            holder[key] = [holder[key]]
        else:
            holder[key] = random.choice(_VALUES)
    written = json.dumps(root).encode()
    if random.random() < 0.02:
        written = written[:-1] + b', "extras": ' + b"[" * 100_000 + b"]" * 100_000 + b"}"
    return pack(written, blob) if binary else written


def _places(value: Any) -> Any:
    """Every holder and key in JSON."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in list(items):
        yield value, key
        yield from _places(inner)
