"""Damaged and hostile ``.prt`` files, from good ones: each with checksums as they should be, so that readers go on.

Independent of the package: what it knows of the format is in docs/file-format.md.
"""

from __future__ import annotations

import io
import json
import math
import random
import zipfile
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Manifest = dict[str, Any]
Arrays = dict[str, NDArray]


def mutate(content: bytes, random: random.Random) -> bytes:
    """A file that differs from a good one as a writer in error, a bad disk or an attacker may make it."""
    kind = random.choice((_spoil_bytes, _spoil_manifest, _spoil_text, _spoil_arrays, _spoil_arrays, _spoil_archive))
    return kind(content, random)


def unpack(content: bytes) -> tuple[Manifest, Arrays]:
    """Manifest and arrays of a file."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        manifest = json.loads(archive.read("manifest.json"))
        names = [name.removesuffix(".npy") for name in archive.namelist() if name.endswith(".npy")]
        return manifest, {name: np.load(io.BytesIO(archive.read(f"{name}.npy"))) for name in names}


def pack(manifest: Manifest | bytes, arrays: dict[str, NDArray | bytes]) -> bytes:
    """A file of these, with the checksums that belong to them."""
    buffer = io.BytesIO()
    text = manifest if isinstance(manifest, bytes) else json.dumps(manifest).encode()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr("manifest.json", text)
        for name, array in with_checksums(arrays).items():
            archive.writestr(f"{name}.npy", array if isinstance(array, bytes) else npy(array))
    return buffer.getvalue()


def npy(array: NDArray) -> bytes:
    """An array as a member."""
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, np.ascontiguousarray(array), (1, 0), allow_pickle=False)
    return buffer.getvalue()


def with_checksums(arrays: dict[str, NDArray | bytes]) -> dict[str, NDArray | bytes]:
    """The same with checksums of the coded caps that are those of their parts, where there are such parts."""
    table = arrays.get("coded/caps")
    if not isinstance(table, np.ndarray) or table.dtype != np.uint32 or table.ndim != 2 or len(table) != 6:
        return arrays
    table, found = table.copy(), np.zeros(table.shape[1], dtype=np.uint32)
    for name, row in (("lanes", 0), ("words", 1), ("bits", 2)):
        array = arrays.get(f"coded/{name}", np.zeros(0, dtype=np.uint8))
        if not isinstance(array, np.ndarray):
            return arrays
        for cap, part in enumerate(np.split(array, np.cumsum(table[row].astype(np.int64))[:-1])):
            found[cap] = zlib.crc32(part.tobytes(), int(found[cap]))
    table[5] = found
    return {**arrays, "coded/caps": table}


# --- Of the bytes ----------------------------------------------------------------------------------------------------


def _spoil_bytes(content: bytes, random: random.Random) -> bytes:
    """As disks and networks do."""
    spoilt = bytearray(content)
    kind = random.randrange(4)
    if kind == 0:
        return bytes(spoilt[: random.randrange(len(spoilt))])
    if kind == 1:
        begin = random.randrange(len(spoilt))
        spoilt[begin : begin + random.randrange(1, 64)] = random.randbytes(random.randrange(64))
        return bytes(spoilt)
    for _ in range(random.choice((1, 1, 2, 8))):
        spoilt[random.randrange(len(spoilt))] ^= 1 << random.randrange(8)
    return bytes(spoilt)


# --- Of the manifest -------------------------------------------------------------------------------------------------

_VALUES: tuple[Any, ...] = (
    None, True, False, 0, 1, -1, 2, 3, 4, 255, 256, 65535, 65536, 10**6, 2**31 - 1, 2**31, 2**32, 2**62, 2**63, 2**64,
    10**30, -(2**63), 0.5, -0.5, 1e-320, 1e30, 1e300, -1e300, math.nan, math.inf, -math.inf,
    "", "float32", "coded", "x" * 100_000, "\ud800", "\x1b[2J\n[/red]", "</script>",
    [], [[]], [0], [1, 2, 3], {}, {"a": 1},
)  # fmt: skip


def _spoil_manifest(content: bytes, random: random.Random) -> bytes:
    manifest, arrays = unpack(content)
    for _ in range(random.choice((1, 1, 1, 2, 3))):
        spoil_value(manifest, random)
    return pack(manifest, arrays)


def spoil_value(manifest: Manifest, random: random.Random) -> None:
    """Change a value of a manifest, wherever it is."""
    holder: Any = manifest
    key: Any = random.choice(list(manifest))
    while isinstance(holder[key], dict | list) and holder[key] and random.random() < 0.8:
        holder = holder[key]
        key = random.choice(list(holder)) if isinstance(holder, dict) else random.randrange(len(holder))
    value = holder[key]
    kind = random.randrange(5)
    if kind == 0:
        del holder[key]
    elif kind == 1 and isinstance(value, int | float):
        changed = (value + 1, value - 1, 2 * value, -value, value + 0.5, str(value), value * 10**6, value // 2)
        holder[key] = random.choice(changed)
    elif kind == 2 and isinstance(value, list):
        holder[key] = random.choice((value * 2, value[:-1], value[::-1], [*value, *value[:1]], value * 1000))
    elif kind == 3 and isinstance(holder, dict):
        holder["more"] = random.choice(_VALUES)
        holder[key] = manifest[random.choice(list(manifest))]
    else:
        holder[key] = random.choice(_VALUES)


def _spoil_text(content: bytes, random: random.Random) -> bytes:
    """What JSON itself may do."""
    manifest, arrays = unpack(content)
    text = json.dumps(manifest)
    depth = random.choice((100, 2000, 200_000))
    nested = random.choice(("[" * depth + "]" * depth, '{"a":' * depth + "1" + "}" * depth, "[" * depth))
    at = random.randrange(len(text))
    changed = (
        nested,
        text[:-1] + f', "more": {nested}}}',
        text[:-1] + ', "bandlimit": 1}',
        text.replace('"parts": ', f'"parts": {nested}, "others": ', 1),
        text[:at] + chr(random.randrange(1, 0x250)) + text[at + 1 :],
        text[:at],
        text[:at] + "\x00" + text[at:],
        text + " " * (1 << 21),
        "[]",
        "null",
        "9" * 5000,
        "\ufeff" + text,
        text.replace(": 0", ": 1e999", 1),
    )
    return pack(random.choice(changed).encode("utf-8", "surrogatepass"), arrays)


# --- Of the arrays ---------------------------------------------------------------------------------------------------


def _spoil_arrays(content: bytes, random: random.Random) -> bytes:
    manifest, arrays = unpack(content)
    members: dict[str, NDArray | bytes] = dict(arrays)
    for _ in range(random.choice((1, 1, 1, 2))):
        name = random.choice(list(arrays))
        members[name] = spoil_array(arrays[name], random)
        if isinstance(members[name], np.ndarray):
            arrays[name] = members[name]  # type: ignore[assignment]
    return pack(manifest, members)


def spoil_array(array: NDArray, random: random.Random) -> NDArray | bytes:
    """Of other values, or another type, shape or header."""
    kind = random.choice((_other_values, _other_values, _other_values, _other_type, _other_shape, _other_header))
    return kind(array, random)


def _other_values(array: NDArray, random: random.Random) -> NDArray:
    """Of the same type and shape."""
    spoilt = array.copy()
    if not spoilt.size or array.dtype.kind not in "iuf":
        return spoilt
    flat = spoilt.reshape(-1)
    at = [random.randrange(flat.size) for _ in range(random.choice((1, 1, 3, 20)))]
    kind = random.randrange(6)
    if kind == 0:
        octets = flat.view(np.uint8)
        for _ in at:
            octets[random.randrange(octets.size)] ^= 1 << random.randrange(8)
    elif kind == 1:
        flat[:] = random.choice((0, 1))
    elif kind == 2:
        flat[:] = flat[at[0]]
    elif kind == 3:
        flat[:] = flat[::-1].copy()
    elif array.dtype.kind == "f":
        with np.errstate(over="ignore"):
            flat[at] = random.choice((math.nan, math.inf, -math.inf, 1e30, -1e30, 1e300, 1e-300, 0.0, -1.0))
    else:
        limits = np.iinfo(array.dtype)
        flat[at] = random.choice((0, 1, int(limits.max), int(limits.min), random.randint(limits.min, limits.max)))
    return spoilt


def _other_type(array: NDArray, random: random.Random) -> NDArray:
    names = (
        "u1",
        "u2",
        "u4",
        "u8",
        "i1",
        "i2",
        "i4",
        "i8",
        "f2",
        "f4",
        "f8",
        "c8",
        ">f4",
        ">u2",
        "U3",
        "S1",
        "?",
        "m8[s]",
    )
    name = random.choice(names)
    if random.randrange(2) or name in ("U3", "S1", "m8[s]"):
        return np.zeros(array.shape, name)
    with np.errstate(all="ignore"):
        return array.astype(name)


def _other_shape(array: NDArray, random: random.Random) -> NDArray:
    if array.ndim == 0:
        return array[None]
    kind = random.randrange(7)
    if kind == 0:
        return array[:-1]
    if kind == 1:
        return array[..., :-1]
    if kind == 2:
        return array.reshape(-1)
    if kind == 3:
        return array[None]
    if kind == 4:
        return np.concatenate([array, array])
    if kind == 5:
        return array[:0]
    # Zeros deflate a thousandfold.
    return np.zeros((random.choice((1 << 20, 1 << 24)), *(min(n, 16) for n in array.shape[1:2])), dtype=np.uint8)


def _other_header(array: NDArray, random: random.Random) -> bytes:
    """A header that does not belong to the numbers."""
    content = npy(array)
    length = int.from_bytes(content[8:10], "little")
    header = content[10 : 10 + length].decode("latin1")
    shape = header[header.index("(") : header.index(")") + 1]
    huge = random.choice((2**20, 2**31, 2**40, 2**62, 2**63, 2**64, -1, 10**100))
    descr = header.split("'")[3]
    changed = (
        header.replace(shape, f"({huge},)"),
        header.replace(shape, f"({huge}, {huge}, 3)"),
        header.replace(shape, "()"),
        header.replace(shape, "(" * 300 + ")" * 300),
        header.replace("False", "True"),
        header.replace("False", "None"),
        header.replace(descr, "|O"),
        header.replace(descr, "<f99"),
        header.replace(f"'{descr}'", "[('a', '<f4')]"),
        header.replace(f"'{descr}'", "__import__('os').getpid()"),
        "[" * 500,
        "",
        header * 100,
    )
    text = random.choice(changed).encode("latin1")
    return content[:8] + (len(text) % (1 << 16)).to_bytes(2, "little") + text + content[10 + length :]


# --- Of the archive --------------------------------------------------------------------------------------------------


def _spoil_archive(content: bytes, random: random.Random) -> bytes:
    """Members that are missing, doubled, packed otherwise, or other than the directory says."""
    manifest, arrays = unpack(content)
    name = random.choice(list(arrays))
    kinds: tuple[Callable[[], bytes], ...] = (
        lambda: pack(manifest, {key: array for key, array in arrays.items() if key != name}),
        lambda: pack({**manifest, "arrays": [key for key in arrays if key != name]}, arrays),
        lambda: pack({**manifest, "arrays": [*arrays, name, "basis/dense", "more"]}, arrays),
        lambda: pack({**manifest, "arrays": []}, {}),
        lambda: _rewritten(content, zipfile.ZIP_BZIP2),
        lambda: _rewritten(content, zipfile.ZIP_LZMA),
        lambda: _doubled(content, f"{name}.npy"),
        lambda: _doubled(content, "manifest.json"),
        lambda: _many_members(content),
        lambda: _lying(content, f"{name}.npy"),
        lambda: _lying(content, "manifest.json"),
        lambda: _encrypted(content),
    )
    return random.choice(kinds)()


def _rewritten(content: bytes, compression: int) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(buffer, "w", compression) as new:
        for name in old.namelist():
            new.writestr(name, old.read(name))
    return buffer.getvalue()


def _doubled(content: bytes, name: str) -> bytes:
    buffer = io.BytesIO(content)
    with zipfile.ZipFile(buffer, "a") as archive:
        member = zipfile.ZipInfo(name)
        archive.infolist().append(member)  # writestr warns of a name that is there already
        archive.filelist.pop()
        archive.NameToInfo.pop(name)
        archive.writestr(member, b"{}")
    return buffer.getvalue()


def _many_members(content: bytes) -> bytes:
    buffer = io.BytesIO(content)
    with zipfile.ZipFile(buffer, "a") as archive:
        for number in range(20_000):
            archive.writestr(f"more/{number:06}" + "x" * 40, b"")
    return buffer.getvalue()


def _lying(content: bytes, name: str) -> bytes:
    """A member of far more than the directory says of it."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as new:
        for member in old.infolist():
            own = old.read(member.filename)
            if member.filename != name:
                new.writestr(member.filename, own)
                continue
            new.writestr(name, own + bytes(1 << 26))
            told = new.getinfo(name)
            told.file_size, told.CRC = len(own), zlib.crc32(own)
    return buffer.getvalue()


def _encrypted(content: bytes) -> bytes:
    """The flag of a member that is encrypted."""
    spoilt, at = bytearray(content), 0
    while (at := spoilt.find(b"PK\1\2", at)) >= 0:
        spoilt[at + 8] |= 1
        at += 4
    return bytes(spoilt)
