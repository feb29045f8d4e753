"""Coded coefficients of a .prt file, as docs/file-format.md has them; a part of tests/format_reader.py.

Plain Python integers, one vertex after the other.
"""

from __future__ import annotations

import itertools
import math
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tests.format_lanes import TOKEN_MODELS, Lanes, power_of_two, share, token_frequencies, width_frequencies, zigzag


@dataclass
class Decoded:
    """Multiples (N, A) of a sixteenth of the step, of the vertices ``order``, and principal axes or None."""

    order: list[int]
    multiples: np.ndarray
    axes: np.ndarray | None


def decoded_caps(arrays: dict[str, np.ndarray], functions: list[int], members: list[np.ndarray]) -> Iterator[Decoded]:
    """Each cap in turn; ``functions`` are K D of each."""
    surface, contexts = Surface(arrays), Contexts(arrays["coded/contexts"], arrays["coded/prediction"])
    models = token_frequencies() + width_frequencies(contexts.widths)
    nothing = np.zeros(0, dtype=np.uint16)
    counts, words, raw = (arrays.get(f"coded/{name}", nothing) for name in ("lanes", "words", "bits"))
    for column, components, own in zip(arrays["coded/caps"].T.tolist(), functions, members, strict=True):
        lanes, length, size, width, principal, checksum = column
        parts = [counts[:lanes].astype("<u2"), words[:length].astype("<u2"), raw[:size]]
        counts, words, raw = counts[lanes:], words[length:], raw[size:]
        assert zlib.crc32(b"".join(part.tobytes() for part in parts)) == checksum
        numbers = Lanes(parts[0].tolist(), parts[1].tolist(), parts[2].tobytes(), models)
        order = sorted(own.tolist(), key=lambda vertex: surface.rank[vertex])
        axes = None
        classes = read_steps(numbers, width, 18, 18)
        assert all(0 <= c <= 33 for c in classes)
        if principal:
            axes = read_axes(numbers, width, components)
        multiples = np.zeros((len(order), width if principal else components), dtype=np.int64)
        if width:
            multiples[:, :width] = read_multiples(numbers, surface, order, classes, contexts)
        numbers.check_end()
        yield Decoded(order, multiples, axes)
    assert counts.size + words.size + raw.size == 0


# --- The header of a cap ---------------------------------------------------------------------------------------------


def read_steps(numbers: Lanes, count: int, model: int, first: int) -> list[int]:
    """Each less the one before it."""
    result = []
    for step in numbers.numbers([model] * count):
        first += zigzag(step)
        result.append(first)
    return result


def read_axes(numbers: Lanes, axes: int, components: int) -> np.ndarray:
    """Orthonormal rows, (A, K D)."""
    exponents = read_steps(numbers, axes, 16, 8)
    models = read_steps(numbers, axes, 16, 20)
    assert all(0 <= e <= 15 for e in exponents)
    entries = numbers.values([model for model in models for _ in range(components)])
    rows = np.array(entries, dtype=np.float64).reshape(axes, components)
    return orthonormal(rows / 2.0 ** np.array(exponents, dtype=np.float64)[:, None])


def orthonormal(rows: np.ndarray) -> np.ndarray:
    """Gram-Schmidt, each row against those before it."""
    done: list[np.ndarray] = []
    for row in rows:
        for _ in range(2):
            row = row - sum(((row @ earlier) * earlier for earlier in done), np.zeros(row.size))
        done.append(row / np.linalg.norm(row))
    return np.array(done).reshape(rows.shape)


# --- The surface as the codec sees it --------------------------------------------------------------------------------


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


@dataclass
class Row:
    """One row of a level: where it is told from, as pairs of (row, weight), and whether these are on the curve."""

    row: int
    sources: list[tuple[int, int]]
    on_curve: bool


class Surface:
    def __init__(self, arrays: dict[str, np.ndarray]) -> None:
        positions = arrays["mesh/positions"]
        low = positions.min(axis=0)
        extent = float((positions.max(axis=0) - low).max())
        self.places = np.rint((positions - low) * (2**18 / extent if extent > 0 else 0.0)).astype(np.int64).tolist()
        self.turns = np.rint(arrays["mesh/normals"].astype(np.float64) * 2**8).astype(np.int64).tolist()
        self.rank = np.argsort(curve(positions)).tolist()
        self.neighbours: list[set[int]] = [set() for _ in positions]
        for a, b, c in arrays["mesh/faces"].tolist():
            for i, j in ((a, b), (b, c), (c, a)):
                if i != j:
                    self.neighbours[i].add(j)
                    self.neighbours[j].add(i)
        lengths = [
            squared_distance(self.places[i], self.places[j]) for i, near in enumerate(self.neighbours) for j in near
        ]
        self.edge = max(1, sum(lengths) // max(1, len(lengths)))

    def weight(self, a: int, b: int) -> int:
        p = squared_distance(self.places[a], self.places[b])
        q = squared_distance(self.turns[a], self.turns[b])
        measure = p + 40 * q * self.edge // 2**16 + self.edge // 20
        return max(2**8 * self.edge // max(measure, 1), 1)

    def levels(self, order: list[int]) -> Iterator[tuple[int, list[Row]]]:
        """(depth, rows) of row 0 and then of each level, for the members of a cap in the order of the curve."""
        count = len(order)
        row_of = {vertex: row for row, vertex in enumerate(order)}
        near = [{row_of[v] for v in self.neighbours[vertex] if v in row_of} for vertex in order]
        around = [surroundings(row, near) for row in range(count)]
        yield 4, [Row(0, [], False)]
        for j in reversed(range((count - 1).bit_length())):
            stride = 2**j
            level = []
            for row in range(stride, count, 2 * stride):
                known = sources_of(row, near, around, 2 * stride)
                chosen = known or [b for b in (row - stride, row + stride) if b < count]
                level.append(Row(row, [(b, self.weight(order[row], order[b])) for b in chosen], not known))
            yield min(j, 4), level


def squared_distance(a: list[int], b: list[int]) -> int:
    return sum((x - y) ** 2 for x, y in zip(a, b, strict=True))


def surroundings(row: int, near: list[set[int]]) -> set[int]:
    """A row, its neighbours, and maybe the neighbours of these."""
    found = {row} | near[row]
    if sum(len(near[b]) for b in near[row]) <= 256:
        found |= {c for b in near[row] for c in near[b]}
    return found


def sources_of(row: int, near: list[set[int]], around: list[set[int]], spacing: int) -> list[int]:
    """What is around a row among the multiples of a spacing, coarse levels first."""
    known = {b for b in near[row] if b % spacing == 0}
    if spacing >= 8:  # of depth 2 and more
        wide = sum(len(around[b]) for b in around[row]) <= 2048
        known = {c for b in around[row] for c in around[b]} if wide else around[row]
    elif len(known) < 5:
        known = around[row]
    known = {b for b in known if b % spacing == 0}
    return sorted(known, key=lambda b: (-stride_of(b), b))[:64]


def stride_of(row: int) -> float:
    """The stride of the level that a row is in: the largest power of two that divides it."""
    return row & -row if row else math.inf


# --- Differences -----------------------------------------------------------------------------------------------------


class Contexts:
    """The tables of a file."""

    def __init__(self, contexts: np.ndarray, prediction: np.ndarray) -> None:
        sizes = np.cumsum([0, 5, 440, 88, 160])
        self.steps, self.models, self.changes, self.tables_of_widths = (
            contexts[a:b].tolist() for a, b in itertools.pairwise(sizes)
        )
        self.widths = contexts[sizes[-1] :].reshape(-1, 16)
        gains = prediction.tolist()
        self.gain, self.shrinkage = gains[:2], gains[2:]


def read_multiples(numbers: Lanes, surface: Surface, order: list[int], classes: list[int], contexts: Contexts) -> list:
    """(N, w) integers."""
    width = len(classes)
    usual = math.fsum(0.0 if c == 0 else power_of_two(c - 20, 2) for c in classes)
    edges = [power_of_two(i - 8, 4) for i in range(19)]
    foretold = [foretold_width(activity, classes, contexts) for activity in range(20)]
    multiples = [[0] * width for _ in order]
    sizes = [0] * len(order)
    for depth, level in surface.levels(order):
        activities = [activity_of(place.sources, sizes, usual, edges) for place in level]
        tables = [contexts.tables_of_widths[10 * foretold[a] + a // 2] for a in activities]
        bits_of_rows = numbers.symbols([TOKEN_MODELS + table for table in tables])
        read, models = [], []
        for place, activity, bits in zip(level, activities, bits_of_rows, strict=True):
            for k in range(min(width, 2**bits - 1)):
                octave = min(4, bits - (k + 1).bit_length())
                read.append((place.row, k))
                models.append(contexts.models[5 * (activity + 2 * classes[k]) + octave])
        differences = dict(zip(read, numbers.values(models), strict=True))
        for place in level:
            own = [differences.get((place.row, k), 0) for k in range(width)]
            sizes[place.row] = sum(abs(v) for v in own)
            for k, v in enumerate(own):
                multiples[place.row][k] = predicted(place, k, multiples, contexts) + contexts.steps[depth] * v
    return multiples


def foretold_width(activity: int, classes: list[int], contexts: Contexts) -> int:
    shares = [share(contexts.changes[activity + 2 * c]) if c else 0 for c in classes]
    return sum(sum(shares[k:]) > 734003 for k in range(len(shares))).bit_length()


def activity_of(sources: list[tuple[int, int]], sizes: list[int], usual: float, edges: list[float]) -> int:
    if usual == 0.0:
        return 0
    around = sum(w * sizes[b] for b, w in sources) / sum(w for _, w in sources) if sources else 0.0
    ratio = (around + 0.3 * usual) / ((1.0 + 0.3) * usual)
    return sum(edge < ratio for edge in edges)


def predicted(place: Row, k: int, multiples: list[list[int]], contexts: Contexts) -> int:
    if not place.sources:
        return 0
    gain, shrinkage = contexts.gain[place.on_curve][k], contexts.shrinkage[place.on_curve][k]
    whole = sum(w for _, w in place.sources) + 8 * shrinkage
    return (2 * gain * sum(w * multiples[b][k] for b, w in place.sources) + 32 * whole) // (64 * whole)
