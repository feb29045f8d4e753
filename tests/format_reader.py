"""A reader of .prt files written from docs/file-format.md alone: it shares no code with the package.

It needs numpy, Draco (through DracoPy) and the standard library; a second implementation in another language can be
checked against it.
"""

from __future__ import annotations

import decimal
import io
import itertools
import json
import math
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.format_mesh import mesh_of_file
from tests.format_pixels import mesh_of_pixels

# --- The container ---------------------------------------------------------------------------------------------------


@dataclass
class Cap:
    """One cap as the file holds it: members, what multiplies its functions, and how the numbers scale.

    ``numbers`` are integer multiples of ``scale`` if coded (of principal axes if there are ``axes``), floats otherwise.
    """

    members: np.ndarray
    numbers: np.ndarray
    scale: float
    axes: np.ndarray | None


@dataclass
class File:
    manifest: dict
    arrays: dict[str, np.ndarray]
    index: np.ndarray
    caps: list[Cap]


def read(path: str | Path) -> File:
    with zipfile.ZipFile(path) as container:
        manifest = json.loads(container.read("manifest.json"))
        assert (manifest["format"], manifest["version"]) == ("slepian_prt transfer", 3)
        arrays = {name: np.load(io.BytesIO(container.read(f"{name}.npy"))) for name in manifest["arrays"]}
    if "film" in manifest:
        arrays |= mesh_of_pixels(manifest["film"], arrays)
    else:
        arrays |= mesh_of_file(manifest["mesh"], arrays)
    index, caps = cap_of_each_vertex(arrays)
    members = [np.flatnonzero(index == c) for c in range(caps)]
    widths = np.broadcast_to(arrays["caps/terms"], caps).astype(int) * manifest["channels"]
    if manifest["coding"] != "coded":
        starts = np.cumsum([0, *(m.size * k for m, k in zip(members, widths, strict=True))])
        flat = [arrays["coefficients"][a:b] for a, b in itertools.pairwise(starts)]
        found = [Cap(m, x.reshape(m.size, k), 1.0, None) for m, x, k in zip(members, flat, widths, strict=True)]
        return File(manifest, arrays, index, found)
    surface = Surface(arrays)
    tables = cumulative_tables()
    words = arrays["coded/words"]
    found, begin = [], 0
    for c, (length, checksum) in enumerate(arrays["coded/caps"].tolist()):
        part = words[begin : begin + length]
        begin += length
        assert zlib.crc32(part.astype("<u4").tobytes()) == checksum
        order, multiples, axes = decode_cap(part.tolist(), int(widths[c]), members[c], surface, arrays, tables)
        by_member = np.empty_like(multiples)
        by_member[np.searchsorted(members[c], order)] = multiples
        found.append(Cap(members[c], by_member, manifest["step"] / 16, axes))
    assert begin == words.size
    return File(manifest, arrays, index, found)


# --- Lamps -----------------------------------------------------------------------------------------------------------


def light_of_lamps(file: File, table: str) -> np.ndarray:
    """(lamps, V, 3) radiance of unit albedo, ``table`` being direct or bounced."""
    low, high = file.arrays[f"fixed/{table}"].astype(np.uint16)
    rows = iter((low + 256 * high).astype("<u2").view("<f2").astype(np.float64))
    result = np.zeros((len(file.manifest["fixed"]), len(file.index), 3))
    for lamp, entry, scales in zip(result, file.manifest["fixed"], file.arrays[f"fixed/{table}_scale"], strict=True):
        if entry[f"{table}_rows"] == 1:
            lamp[:] = np.outer(next(rows), scales)
        for channel in range(3 if entry[f"{table}_rows"] == 3 else 0):
            lamp[:, channel] = next(rows) * scales[channel]
    assert next(rows, None) is None
    return result


# --- Which vertex belongs to which cap -------------------------------------------------------------------------------


def cap_of_each_vertex(arrays: dict[str, np.ndarray]) -> tuple[np.ndarray, int]:
    if "clusters/sites" in arrays:
        sites = arrays["clusters/sites"].astype(np.int64)
        whole = np.rint(arrays["mesh/normals"].astype(np.float64) * 2**20).astype(np.int64)
        return (whole @ sites.T).argmax(axis=1), len(sites)
    index = np.empty(len(arrays["mesh/positions"]), dtype=np.int64)
    index[curve(arrays["mesh/positions"])] = arrays["clusters/index"]
    return index, len(arrays["caps/center"])


def curve(positions: np.ndarray) -> np.ndarray:
    """Vertices in the order of the Z-order curve."""
    low = positions.min(axis=0)
    extent = (positions.max(axis=0) - low).max()
    cells = ((positions - low) / max(extent, 1e-300) * (2**21 - 1)).astype(np.uint64)
    keys = np.zeros(len(cells), dtype=np.uint64)
    for bit in range(21):
        for axis in range(3):
            keys |= ((cells[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return np.argsort(keys, kind="stable")


# --- The surface as the codec sees it --------------------------------------------------------------------------------


class Surface:
    def __init__(self, arrays: dict[str, np.ndarray]) -> None:
        positions = arrays["mesh/positions"]
        low = positions.min(axis=0)
        extent = float((positions.max(axis=0) - low).max())
        self.places = np.rint((positions - low) * (2**18 / extent if extent > 0 else 0.0)).astype(np.int64)
        self.turns = np.rint(arrays["mesh/normals"].astype(np.float64) * 256).astype(np.int64)
        self.rank = np.empty(len(positions), dtype=np.int64)
        self.rank[curve(positions)] = np.arange(len(positions))
        self.neighbours: list[set[int]] = [set() for _ in positions]
        for a, b, c in arrays["mesh/faces"].tolist():
            for i, j in ((a, b), (b, c), (c, a)):
                if i != j:
                    self.neighbours[i].add(j)
                    self.neighbours[j].add(i)
        pairs = [(i, j) for i, near in enumerate(self.neighbours) for j in near]
        squares = sum(int(((self.places[i] - self.places[j]) ** 2).sum()) for i, j in pairs)
        self.edge = max(1, squares // max(1, len(pairs)))

    def weight(self, a: int, b: int) -> int:
        apart = int(((self.places[a] - self.places[b]) ** 2).sum())
        turned = int(((self.turns[a] - self.turns[b]) ** 2).sum())
        measure = apart + 40 * turned * self.edge // 65536 + self.edge // 20
        return max(65536 * self.edge // max(measure, 1), 1)

    def levels(self, order: list[int]):
        """For each level, a list of (row, [(source row, weight)], on the curve)."""
        count = len(order)
        row_of = {vertex: row for row, vertex in enumerate(order)}
        near = [{row_of[v] for v in self.neighbours[vertex] if v in row_of} for vertex in order]
        if sum(len(near[b]) for a in near for b in a) <= 64 * count:
            near = [a.union(*(near[b] for b in a)) for a in near]
        stride = 1 << max(0, (count - 1).bit_length() - 1)
        while stride >= 1 and count > 1:
            level = []
            for row in range(stride, count, 2 * stride):
                known = [b for b in near[row] if b % (2 * stride) == 0]
                sources = known or [b for b in (row - stride, row + stride) if b < count]
                level.append((row, [(b, self.weight(order[row], order[b])) for b in sources], not known))
            yield level
            stride //= 2


# --- The entropy coder -----------------------------------------------------------------------------------------------


def cumulative_tables() -> list[list[int]]:
    """Of each of the 56 models, where the 194 symbols begin in 0..2^24, and the end."""
    tables = []
    with decimal.localcontext() as context:
        context.prec = 40
        D = decimal.Decimal
        for i in range(56):
            row = [D(0)] * 98
            for size, part in (("0.6", "0.4"), ("1", "0.4"), ("2", "0.2")):
                decay = 16 / D(2).sqrt().sqrt() ** i / D(size)
                row[0] += D(part) * (1 - (-decay * D("0.64")).exp())
                row[1] += D(part) / 2 * ((-decay * D("0.64")).exp() - (-decay * D("1.5")).exp())
                tail, ratio = (-decay * D("1.5")).exp(), (-decay).exp()
                for k in range(2, 97):
                    row[k] += D(part) / 2 * tail * (1 - ratio)
                    tail *= ratio
                row[97] += D(part) * tail
            both = [float(p + D(2) ** -22) for p in [*row[96:0:-1], *row[:97], row[97]]]
            whole = math.fsum(both)
            tables.append(quantised([p / whole for p in both]))
    return tables


def quantised(probabilities: list[float]) -> list[int]:
    total = 0.0
    for p in probabilities:
        total += p
    scale = (2**24 - len(probabilities)) / total
    starts, running = [], 0.0
    for i, p in enumerate(probabilities):
        starts.append(int(running * scale) + i)
        running += p
    return [*starts, 2**24]


class Decoder:
    def __init__(self, words: list[int], tables: list[list[int]]) -> None:
        self.words, self.tables, self.state = list(words), tables, 0
        while self.words and self.state < 2**32:
            self.state = self.state << 32 | self.words.pop()

    def _advance(self, begin: int, size: int) -> None:
        self.state = (self.state >> 24) * size + (self.state & 0xFFFFFF) - begin
        if self.state < 2**32 and self.words:
            self.state = self.state << 32 | self.words.pop()

    def number(self, size: int) -> int:
        """One of 0..size-1, all alike."""
        if size == 1:
            return 0
        width = 2**24 // size
        value = min((self.state & 0xFFFFFF) // width, size - 1)
        self._advance(value * width, width if value < size - 1 else 2**24 - value * width)
        return value

    def values(self, count: int, model: int) -> list[int]:
        table, symbols = self.tables[model], []
        for _ in range(count):
            symbol = int(np.searchsorted(table, self.state & 0xFFFFFF, side="right")) - 1
            self._advance(table[symbol], table[symbol + 1] - table[symbol])
            symbols.append(symbol)
        return [self._escaped() if symbol == 193 else symbol - 96 for symbol in symbols]

    def _escaped(self) -> int:
        zigzag = self.number(1 << 16) << 16
        zigzag |= self.number(1 << 16)
        return zigzag // 2 if zigzag % 2 == 0 else -(zigzag + 1) // 2


# --- A cap -----------------------------------------------------------------------------------------------------------


def decode_cap(words, components, members, surface: Surface, arrays, tables):
    """Vertices in the order of coding, (N, A) multiples of a sixteenth of the step, and principal axes or None."""
    coder, axes = Decoder(words, tables), None
    if coder.number(2) == 1:
        axes = read_axes(coder, components)
        components = len(axes)
    classes = read_classes(coder, components)
    active = [k for k in range(components) if classes[k] > 0]
    gain = np.full((2, components), 29, dtype=np.int64)
    known = min(components, arrays["coded/shrink"].shape[1])
    gain[:, :known] = arrays["coded/shrink"][:, :known]
    usual = math.fsum(0.0 if c == 0 else power_of_two(c - 20, 2) for c in classes)
    edges = [power_of_two(i - 8, 4) for i in range(19)]

    order = sorted(members.tolist(), key=lambda vertex: surface.rank[vertex])
    multiples = np.zeros((len(order), components), dtype=np.int64)
    sizes = [0] * len(order)
    for level in ([(0, [], False)], *surface.levels(order)):
        symbols_of: dict[int, list[tuple[int, int]]] = {}
        for row, sources, _ in level:
            around = sum(w * sizes[b] for b, w in sources) / max(sum(w for _, w in sources), 1)
            activity = 0
            if usual > 0.0:
                ratio = (around + 0.3 * usual) / ((1.0 + 0.3) * usual)
                activity = sum(edge < ratio for edge in edges)
            for k in active:
                symbols_of.setdefault(int(arrays["coded/models"][activity + 2 * classes[k]]), []).append((row, k))
        differences = {}
        for model in sorted(symbols_of):
            places = symbols_of[model]
            differences.update(zip(places, coder.values(len(places), model), strict=True))
        for row, sources, on_curve in level:
            total = max(sum(w for _, w in sources), 1)
            for k in active:
                mean = sum(w * int(multiples[b, k]) for b, w in sources)
                predicted = (2 * mean * int(gain[int(on_curve), k]) + 32 * total) // (64 * total)
                multiples[row, k] = predicted + 16 * differences[row, k]
            sizes[row] = sum(abs(differences[row, k]) for k in active)
    assert coder.state == 0
    assert not coder.words
    return order, multiples, axes


def read_classes(coder: Decoder, components: int) -> list[int]:
    width = coder.number(components + 1)
    classes = [coder.number(34)] if width else []
    for step in coder.values(width - 1, 20) if width else []:
        classes.append(classes[-1] + step)
    assert all(0 <= c < 34 for c in classes)
    return classes + [0] * (components - width)


def read_axes(coder: Decoder, components: int) -> np.ndarray:
    """Orthonormal rows, (A, K)."""
    rows = np.zeros((coder.number(components + 1), components))
    for row in rows:
        exponent = coder.number(16)
        row[:] = coder.values(components, coder.number(56))
        row /= 2.0**exponent
    return orthonormal(rows)


def orthonormal(rows: np.ndarray) -> np.ndarray:
    """Gram-Schmidt, each row against those before it."""
    done: list[np.ndarray] = []
    for row in rows:
        for _ in range(2):
            row = row - sum(((row @ earlier) * earlier for earlier in done), np.zeros(row.size))
        done.append(row / np.linalg.norm(row))
    return np.array(done).reshape(rows.shape)


def power_of_two(numerator: int, denominator: int) -> float:
    """2^(numerator / denominator) as the format has it: an integer root of 62 or so bits."""
    whole, part = divmod(numerator, denominator)
    root = 1 << (60 * denominator + part)
    for _ in range(denominator.bit_length() - 1):
        root = math.isqrt(root)
    return root / 2**60 * 2.0**whole


# --- Transfer vectors ------------------------------------------------------------------------------------------------


def transfer_vectors(file: File, real_sh, rotate_to) -> np.ndarray:
    """(V, channels, (L+1)²) in float64; ``real_sh(L, directions)`` and ``rotate_to(coefficients, axis)`` are given."""
    manifest, arrays = file.manifest, file.arrays
    bandlimit, channels = manifest["bandlimit"], manifest["channels"]
    normals = arrays["mesh/normals"].astype(np.float64)
    size = (bandlimit + 1) ** 2
    degree = np.repeat(np.arange(bandlimit + 1), 2 * np.arange(bandlimit + 1) + 1)
    weights = arrays.get("basis/weights", np.ones(bandlimit + 1))[degree]
    vectors = np.zeros((len(normals), channels, size))
    kinds = arrays.get("clusters/kinds", np.zeros(len(file.caps), dtype=int))
    for c, (cap, functions) in enumerate(zip(file.caps, functions_of_caps(file, rotate_to), strict=True)):
        numbers = cap.numbers.astype(np.float64) * cap.scale
        if cap.axes is not None:
            numbers = numbers @ cap.axes
        by_function = numbers.reshape(len(numbers), len(functions), channels)
        mixed = np.einsum("nkd,km->ndm", by_function, functions / weights)
        if "basis/mean" in arrays:
            mixed += arrays["basis/mean"].reshape(-1, channels, size)[c].astype(np.float64)
        if "mean/zonal" in arrays:
            zonal = arrays["mean/zonal"].astype(np.float64)[kinds[c]][degree]
            lit = normals[cap.members].any(axis=1)
            mixed[lit, 0] += zonal * real_sh(bandlimit, normals[cap.members[lit]])
        vectors[cap.members] = mixed
    if channels == 3:
        rows = np.array([[1.0, 1.0, 1.0], [1.0, 0.0, -1.0], [1.0, -2.0, 1.0]])
        vectors = np.einsum("dc,ndm->ncm", rows / np.linalg.norm(rows, axis=1, keepdims=True), vectors)
    vectors[~normals.any(axis=1)] = 0.0
    return vectors


def functions_of_caps(file: File, rotate_to) -> list[np.ndarray]:
    """(K, (L+1)²) of each cap, in the frame of the world."""
    arrays, bandlimit = file.arrays, file.manifest["bandlimit"]
    size = (bandlimit + 1) ** 2
    terms = np.broadcast_to(arrays["caps/terms"], len(file.caps)).astype(int).tolist()
    if "basis/dense" in arrays:
        dense = np.split(arrays["basis/dense"].reshape(-1, size), np.cumsum(terms)[:-1])
        return [orthonormal(d.astype(np.float64)) if d.dtype == np.float16 else d.astype(np.float64) for d in dense]
    if "radial/order" not in arrays:
        return [np.eye(k, size) for k in terms]
    if file.manifest["coding"] == "coded" and "clusters/sites" in arrays:
        sites = arrays["clusters/sites"].astype(np.float64)
        centres = sites / np.linalg.norm(sites, axis=1, keepdims=True)
    else:
        centres = arrays["caps/center"]
    families = radial_families(arrays, bandlimit)
    found = []
    for family, k, centre in zip(arrays["radial/family"], terms, centres, strict=True):
        orders, radial = families[family]
        orders, radial = orders[:k], radial[:k].astype(np.float64)
        if arrays["radial/values"].dtype == np.float16:
            for m in set(orders.tolist()):
                radial[orders == m] = orthonormal(radial[orders == m])
        functions = np.zeros((k, size))
        for row, (m, values) in enumerate(zip(orders.tolist(), radial, strict=True)):
            for l in range(abs(m), bandlimit + 1):
                functions[row, l * l + l + m] = values[l]
        found.append(rotate_to(functions, centre))
    return found


def radial_families(arrays: dict[str, np.ndarray], bandlimit: int) -> list[tuple[np.ndarray, np.ndarray]]:
    orders, values = arrays["radial/order"].astype(int), arrays["radial/values"]
    repeats = np.unpackbits(arrays["radial/repeats"], count=orders.size)
    rows, taken = np.zeros((orders.size, bandlimit + 1), dtype=values.dtype), 0
    for k, m in enumerate(np.abs(orders).tolist()):
        if repeats[k]:
            rows[k] = rows[k - 1]
        else:
            rows[k, m:] = values[taken : taken + bandlimit + 1 - m]
            taken += bandlimit + 1 - m
    ends = np.cumsum(arrays["radial/count"].astype(int))
    return [(orders[e - n : e], rows[e - n : e]) for e, n in zip(ends, arrays["radial/count"].astype(int), strict=True)]
