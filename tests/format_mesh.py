"""The mesh of a .prt file, as docs/file-format.md describes it; a part of tests/format_reader.py, without our code."""

from __future__ import annotations

import math

import DracoPy
import numpy as np


def mesh_of_file(entry: dict, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Positions, normals (float32), faces and albedo under the names that other parts of the reader know."""
    draco = arrays["mesh/draco"].tobytes()
    loose = np.cumsum(numbers(arrays.get("mesh/loose"), 3), axis=0)
    listed = numbers(arrays.get("mesh/loose_faces"), 3)
    listed[:, 0] = np.cumsum(listed[:, 0])
    listed[:, 1:] += listed[:, :1]
    positions, places, faces, blocks = [], [], [], []
    first = 0
    for piece in entry["pieces"]:
        data, draco = draco[: piece["draco"]], draco[piece["draco"] :]
        own, loose = loose[: piece["loose"]], loose[piece["loose"] :]
        sides, listed = listed[: piece["loose_faces"]], listed[piece["loose_faces"] :]
        if data:
            place, corners = vertices_of_draco(data, piece["vertices"] - len(own))
            own, sides = np.concatenate([place, own]), np.concatenate([corners, sides])
        assert (len(own), len(sides)) == (piece["vertices"], piece["faces"])
        step = entry["step"] / 2 ** piece["shift"]
        for side in range(piece["sides"]):
            places.append(own.astype(float))
            positions.append(np.array(entry["low"]) + (np.array(piece["first"]) + own) * step)
            faces.append((sides if side == 0 else sides[:, ::-1]) + first)
            blocks.append((first, first + len(own), step, np.array(piece["first"])))
            first += len(own)
    position, face, place = np.concatenate(positions), np.concatenate(faces), np.concatenate(places)
    if entry["exact"]:
        kind = {"float32": np.float32, "float64": np.float64}[entry["positions"]]
        position = shifted(position.astype(kind), numbers(arrays["mesh/positions"], 3)).astype(float)
        for begin, end, step, lowest in blocks:
            place[begin:end] = (position[begin:end] - np.array(entry["low"])) / step - lowest
    labels = np.concatenate([np.full(end - begin, i) for i, (begin, end, *_) in enumerate(blocks)])
    normal = normals_of(place, face, labels, entry["exact"], arrays)
    albedo = albedo_of(entry["albedo"], arrays, [(begin, end) for begin, end, *_ in blocks], len(position))
    return {"mesh/positions": position, "mesh/normals": normal, "mesh/faces": face, "mesh/albedo": albedo}


def numbers(planes: np.ndarray | None, columns: int) -> np.ndarray:
    """(n, columns) signed integers from planes of bytes."""
    if planes is None:
        return np.zeros((0, columns), dtype=np.int64)
    folded = np.zeros((planes.shape[2], columns), dtype=object)
    for byte in range(planes.shape[1]):
        folded += planes[:, byte].T.astype(object) << (8 * byte)
    return np.array([[z // 2 if z % 2 == 0 else -(z + 1) // 2 for z in row] for row in folded], dtype=np.int64).reshape(
        -1, columns
    )


def shifted(near: np.ndarray, away: np.ndarray) -> np.ndarray:
    """Floats so many places further among all floats of their type."""
    size = 8 * near.itemsize
    bits = near.view(f"u{near.itemsize}")
    result = []
    for own, steps in zip(bits.ravel().tolist(), away.ravel().tolist(), strict=True):
        top = 1 << (size - 1)
        place = (own if own < top else -(own - top) - 1) + steps
        place = (place + top) % (1 << size) - top
        result.append(place if place >= 0 else top - place - 1)
    return np.array(result, dtype=f"u{near.itemsize}").view(near.dtype).reshape(near.shape)


def vertices_of_draco(data: bytes, count: int) -> tuple[np.ndarray, np.ndarray]:
    mesh = DracoPy.decode(data)
    columns = {int(attribute["attribute_type"]): attribute["data"] for attribute in mesh.attributes}
    place, faces = columns[0].astype(np.int64), np.asarray(mesh.faces, dtype=np.int64)
    if len(place) == count:
        return place, faces
    copies = columns[4][:, 0] if 4 in columns else np.zeros(len(place), dtype=np.int64)
    known: dict[tuple, int] = {}
    which = [known.setdefault((*where, copy), len(known)) for where, copy in zip(place.tolist(), copies, strict=True)]
    assert len(known) == count
    return np.array([where[:3] for where in known]), np.array(which)[faces]


def normals_of(place, faces, blocks, exact, arrays) -> np.ndarray:
    own = computed_normals(place, faces, np.arange(len(place)))
    single = own.astype(np.float32)
    if exact:
        return shifted(single, numbers(arrays["mesh/normals"], 3)) if "mesh/normals" in arrays else single
    ways = arrays.get("mesh/normal_ways", np.zeros(len(place), dtype=np.uint8))
    if np.any(ways == 1):
        known: dict[tuple, int] = {}
        group = [known.setdefault((*p, b), len(known)) for p, b in zip(place.tolist(), blocks.tolist(), strict=True)]
        single[ways == 1] = computed_normals(place, faces, np.array(group))[ways == 1]
    if np.any(ways == 2):
        away = numbers(arrays["mesh/normals"], 2)
        for vertex, steps in zip(np.flatnonzero(ways == 2), away, strict=True):
            single[vertex] = from_octahedron(to_octahedron(own[vertex].tolist()) + steps)
    single[ways == 3] = 0.0
    return single


def computed_normals(place, faces, group) -> np.ndarray:
    """Plain Python: one operation after the other, as the page has them."""
    sums = np.zeros((len(place), 3))
    terms = [face_terms(*(place[vertex].tolist() for vertex in face)) for face in faces.tolist()]
    for corner in range(3):
        part = np.zeros((len(place), 3))
        for face, term in zip(faces.tolist(), terms, strict=True):
            part[group[face[corner]]] += term[corner]
        sums += part
    normals = np.zeros((len(place), 3))
    for i, (x, y, z) in enumerate(sums.tolist()):
        length = math.sqrt(x * x + y * y + z * z)
        if length > 1e-9:
            normals[i] = x / length, y / length, z / length
    return normals[group]


def face_terms(a: list, b: list, c: list) -> list[np.ndarray]:
    """The normal times the angle, for each corner."""

    def dot(u: list, v: list) -> float:
        return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]

    u, v, w = ([q - p for p, q in zip(*pair, strict=True)] for pair in ((a, b), (b, c), (c, a)))
    n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
    area = math.sqrt(dot(n, n)) or 1.0
    terms = []
    for coming, going in ((w, u), (u, v), (v, w)):
        product = math.sqrt(dot(coming, coming)) * math.sqrt(dot(going, going)) or 1.0
        angle = arccosine(-dot(coming, going) / product)
        terms.append(np.array([x / area * angle for x in n]))
    return terms


def arccosine(x: float) -> float:
    size, series = min(abs(x), 1.0), -0.0012624911
    for a in (0.0066700901, -0.0170881256, 0.0308918810, -0.0501743046, 0.0889789874, -0.2145988016, 1.5707963050):
        series = series * size + a
    series *= math.sqrt(1.0 - size)
    return math.pi - series if x < 0.0 else series


def to_octahedron(n: list) -> np.ndarray:
    size = (abs(n[0]) + abs(n[1]) + abs(n[2])) or 1.0
    u, v = n[0] / size, n[1] / size
    if n[2] < 0.0:
        u, v = (1 - abs(v)) * (-1 if u < 0 else 1), (1 - abs(u)) * (-1 if v < 0 else 1)
    return np.array([round(u * 2047), round(v * 2047)])


def from_octahedron(point: np.ndarray) -> np.ndarray:
    u, v = (int(x) for x in point)
    z = 2047 - abs(u) - abs(v)
    if z < 0:
        u, v = (2047 - abs(v)) * (-1 if u < 0 else 1), (2047 - abs(u)) * (-1 if v < 0 else 1)
    return np.array([u, v, z]) / math.sqrt(u * u + v * v + z * z)


def albedo_of(entry: dict, arrays: dict, blocks: list[tuple[int, int]], count: int) -> np.ndarray:
    albedo = np.zeros((count, 3), dtype=np.float32)
    if entry["kind"] == "constant":
        for i, (begin, end) in enumerate(blocks):
            albedo[begin:end] = entry["colors"][i if len(entry["colors"]) > 1 else 0]
        return albedo
    packed = arrays["mesh/albedo"]
    if entry["kind"] == "table":
        index = np.cumsum(packed.astype(int), axis=1) % 256
        albedo[:] = np.array(entry["values"], dtype=np.float32)[index].T
        return albedo
    kind = {"float16": np.float16, "float32": np.float32}[entry["kind"]]
    along = numbers(packed, len(packed))
    albedo[:] = shifted(np.zeros(along.shape, dtype=kind), np.cumsum(along, axis=0))
    return albedo
