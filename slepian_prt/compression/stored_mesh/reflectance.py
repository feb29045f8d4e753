"""Albedo in few bytes: constants once, few different values as a table, else float16 along the vertices."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.stored_mesh.planes import from_ordered, from_planes, to_ordered, to_planes

# Numbers of a table, which is exact.
_TABLE = 256

# float16 is within 2⁻¹¹ of what it rounds, relatively, or 2⁻²⁵; above this it has no numbers.
_LARGEST_HALF = 65504.0


def pack_albedo(
    albedo: NDArray[np.float32], blocks: Sequence[slice], exact: bool
) -> tuple[dict[str, Any], dict[str, NDArray]]:
    """The entry of the manifest, and arrays, of albedo (V, 3); blocks of vertices may have one colour each."""
    if all(np.all(albedo[rows] == albedo[rows][:1]) for rows in blocks):
        colors = np.array([albedo[rows][0] for rows in blocks])
        if np.all(colors == colors[0]):
            colors = colors[:1]
        return {"kind": "constant", "colors": colors.tolist()}, {}
    gray = bool(np.all(albedo == albedo[:, :1]))
    values = np.ascontiguousarray(albedo[:, :1] if gray else albedo)
    table, index = np.unique(values, return_inverse=True)
    if table.size <= _TABLE:
        along = np.diff(index.reshape(values.shape), axis=0, prepend=0)
        return {"kind": "table", "values": table.tolist()}, {"mesh/albedo": along.T.astype(np.uint8)}
    half = not exact and values.min() >= 0.0 and values.max() <= _LARGEST_HALF
    numbers = to_ordered(values.astype(np.float16 if half else np.float32))
    along = np.diff(numbers, axis=0, prepend=0)
    return {"kind": "float16" if half else "float32"}, {"mesh/albedo": to_planes(along)}


def unpack_albedo(
    entry: dict[str, Any], arrays: dict[str, NDArray], blocks: Sequence[slice], count: int
) -> NDArray[np.float32]:
    """(V, 3) what `pack_albedo` packed, as the schema of files has it.

    Raises
    ------
    ValueError, KeyError
    """
    albedo = np.empty((count, 3), dtype=np.float32)
    if entry["kind"] == "constant":
        colors = np.array(entry["colors"], dtype=np.float32)
        for rows, color in zip(blocks, np.broadcast_to(colors, (len(blocks), 3)), strict=True):
            albedo[rows] = color
        return albedo
    packed = arrays["mesh/albedo"]
    if entry["kind"] == "table":
        table = np.array(entry["values"], dtype=np.float32)
        albedo[:] = table[np.cumsum(packed, axis=1, dtype=np.uint8)].T
        return albedo
    dtype: np.dtype[Any] = np.dtype({"float16": "f2", "float32": "f4"}[entry["kind"]])
    albedo[:] = from_ordered(np.cumsum(from_planes(packed, len(packed)), axis=0), dtype)
    return albedo
