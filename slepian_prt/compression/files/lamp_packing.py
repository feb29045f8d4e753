"""Light of lamps as arrays of a file: float16 by lamp and channel, one row where the channels are alike."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.lighting.fixed_lights import FixedLights

# The largest number of each channel becomes this, so that what is 2⁻²⁹ of it is still a normal float16.
_PEAK = 2.0**15

# Channels that differ by no more than this, relatively, are one: rounding of float32 in sums of samples.
_ALIKE = 1e-5

_TABLES = ("direct", "bounced")


def pack_lamps(fixed: FixedLights) -> tuple[list[dict[str, Any]], dict[str, NDArray]]:
    """Entries of the manifest, one for each lamp, and arrays.

    What is read back differs by at most 2⁻¹¹ + 10⁻⁵, relatively, where it is more than 2⁻²⁹ of the largest.
    """
    entries: list[dict[str, Any]] = [
        {"name": name, "kind": kind, "emitted": fixed.emitted[i].tolist(), "direction": fixed.directions[i].tolist()}
        for i, (name, kind) in enumerate(zip(fixed.names, fixed.kinds, strict=True))
    ]
    arrays: dict[str, NDArray] = {}
    for table in _TABLES:
        packed = [_pack(light) for light in getattr(fixed, table)]
        for entry, (rows, _) in zip(entries, packed, strict=True):
            entry[f"{table}_rows"] = len(rows)
        halves = np.concatenate([rows for rows, _ in packed])
        octets = halves.astype("<f2").view(np.uint8).reshape(*halves.shape, 2)
        # Low bytes apart from high ones, which deflate well.
        arrays[f"fixed/{table}"] = np.ascontiguousarray(np.moveaxis(octets, 2, 0))
        arrays[f"fixed/{table}_scale"] = np.array([scale for _, scale in packed])
    return entries, arrays


def _pack(light: NDArray[np.float32]) -> tuple[NDArray[np.float16], NDArray[np.float64]]:
    """Rows of float16, 0, 1 or 3 of V, and scales (3,), of one lamp's light (V, 3)."""
    peak = light.max(axis=0, initial=0.0).astype(np.float64)
    scale = peak / _PEAK
    shining = np.flatnonzero(peak > 0.0)
    if shining.size == 0:
        return np.zeros((0, len(light)), dtype=np.float16), scale
    rows = light[:, shining].T / scale[shining, None]
    if np.all(np.abs(rows - rows[0]) <= _ALIKE * np.abs(rows[0])):
        return rows[:1].astype(np.float16), scale
    full = np.zeros((3, len(light)))
    full[shining] = rows
    return full.astype(np.float16), scale


def unpack_lamps(entries: list[dict[str, Any]] | None, arrays: dict[str, NDArray], vertices: int) -> FixedLights | None:
    """What `pack_lamps` packed; None of a file without lamps."""
    if not entries:
        return None
    light = {}
    for table in _TABLES:
        octets, scales = arrays[f"fixed/{table}"], arrays[f"fixed/{table}_scale"]
        counts = [entry[f"{table}_rows"] for entry in entries]
        rows = np.ascontiguousarray(np.moveaxis(octets, 0, 2)).view("<f2")[..., 0].astype(np.float64)
        light[table] = np.zeros((len(entries), vertices, 3), dtype=np.float32)
        for target, scale, own in zip(light[table], scales, np.split(rows, np.cumsum(counts)[:-1]), strict=True):
            if len(own):
                target[:] = own.T * scale
    return FixedLights(
        tuple(entry["name"] for entry in entries),
        tuple(entry["kind"] for entry in entries),
        np.array([entry["emitted"] for entry in entries], dtype=np.float64).reshape(-1, 3),
        light["direct"],
        light["bounced"],
        np.array([entry["direction"] for entry in entries], dtype=np.float64).reshape(-1, 3),
    )
