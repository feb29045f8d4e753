"""A reader of .prt files written from docs/file-format.md alone: it shares no code with the package.

It needs numpy, Draco (through DracoPy) and the standard library; a second implementation in another language can be
checked against it.
"""

from __future__ import annotations

import io
import itertools
import json
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.format_coefficients import curve, decoded_caps, orthonormal
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
    found = []
    for own, cap in zip(members, decoded_caps(arrays, widths.tolist(), members), strict=True):
        by_member = np.empty_like(cap.multiples)
        by_member[np.searchsorted(own, cap.order)] = cap.multiples
        found.append(Cap(own, by_member, manifest["step"] / 16, cap.axes))
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
