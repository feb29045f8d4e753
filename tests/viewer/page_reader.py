"""A reader of pages from what `slepian_prt/viewer/buffers.py` and `payload.py` say of them: slow, and plain."""

from __future__ import annotations

import base64
import gzip
import json
import re
import struct
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

SCRIPT = re.compile(r'<script id="(\w+)" type="application/octet-stream;base64">(.*?)</script>', re.DOTALL)


def blocks(page: Path) -> dict[str, bytes]:
    """What a page carries in base64 of gzip, by the ids of its scripts."""
    return {name: gzip.decompress(base64.b64decode(text)) for name, text in SCRIPT.findall(page.read_text())}


def read_payload(content: bytes) -> dict[str, Any]:
    """The JSON of a payload with arrays (rows, columns) in the place of buffers."""
    (length,) = struct.unpack_from("<I", content)
    begin = 4 + length
    begin += -begin % 8
    return with_arrays(json.loads(content[4 : 4 + length]), content[begin:])


def with_arrays(value: Any, content: bytes) -> Any:
    if isinstance(value, list):
        return [with_arrays(one, content) for one in value]
    if not isinstance(value, dict):
        return value
    if "buffer" in value:
        return decode(value["buffer"], content)
    return {name: with_arrays(one, content) for name, one in value.items()}


def decode(entry: dict[str, Any], content: bytes) -> np.ndarray:
    """One buffer."""
    own = content[entry["begin"] : entry["begin"] + entry["size"]]
    kind, shape = np.dtype(entry["type"]).newbyteorder("<"), (entry["rows"], entry["columns"])
    if entry["coding"] == "plain":
        numbers = np.frombuffer(own, kind).reshape(shape)
    else:
        numbers = uncoded(entry["coding"], gathered(own, kind, shape))
    if "scale" not in entry:
        return numbers
    return numbers.astype(np.float64) * entry["scale"] + entry.get("offset", 0.0)


def gathered(own: bytes, kind: np.dtype, shape: tuple[int, int]) -> np.ndarray:
    """Numbers whose bytes lie in planes."""
    rows, columns = shape
    planes = [own[at : at + rows] for at in range(0, len(own), rows)] if rows else []
    numbers = np.zeros(shape, kind)
    for row in range(rows):
        for column in range(columns):
            octets = bytes(planes[column * kind.itemsize + octet][row] for octet in range(kind.itemsize))
            numbers[row, column] = np.frombuffer(octets, kind)[0]
    return numbers


def uncoded(coding: str, numbers: np.ndarray) -> np.ndarray:
    kind = numbers.dtype
    if coding == "planes":
        return numbers
    whole = [[int(x) for x in row] for row in numbers]
    modulus = 1 << (8 * kind.itemsize)
    if coding in ("folded", "steps"):
        unsigned = [[x % modulus for x in row] for row in whole]
        whole = [[x // 2 if x % 2 == 0 else -(x + 1) // 2 for x in row] for row in unsigned]
    if coding == "steps":
        for before, row in pairwise(whole):
            row[:] = [a + b for a, b in zip(before, row, strict=True)]
        whole = [[x % modulus for x in row] for row in whole]
    if coding == "clusters":
        last: dict[int, list[int]] = {}
        for row in whole:
            before = last.get(row[-1], [128] * (len(row) - 1))
            row[:-1] = [(a + b) % 256 for a, b in zip(before, row[:-1], strict=True)]
            last[row[-1]] = row[:-1]
    if coding == "corners":
        largest = -1
        for row in whole:
            row[0] = largest + 1 - row[0]
            largest = max(largest, row[0])
    return np.array(whole, dtype=kind).reshape(numbers.shape)
