"""Numbers in the buffers of a glTF file: views, accessors, and what is compressed in them.

Source: glTF 2.0, section 3.6; KHR_mesh_quantization for integers that stand for reals.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slepian_prt.scene.formats.gltf_file import Document, read_buffer
from slepian_prt.scene.formats.gltf_json import Entry
from slepian_prt.scene.formats.gltf_meshopt import FILTERS, decode_attributes
from slepian_prt.scene.formats.gltf_meshopt_indices import decode_sequence, decode_triangles

_COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_UNSIGNED = (5121, 5123, 5125)

# Columns and rows; each column of a matrix begins at a multiple of four bytes.
_SHAPES = {
    "SCALAR": (1, 1), "VEC2": (1, 2), "VEC3": (1, 3), "VEC4": (1, 4), "MAT2": (2, 2), "MAT3": (3, 3), "MAT4": (4, 4),
}  # fmt: skip

# Elements that an accessor without data of its own may have beside those of the largest that has data: they are all
# zeros, and nothing else limits their number.
_MOST_ZEROS = 1 << 20

_MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")


@dataclass(frozen=True, eq=False)
class Elements:
    """What an accessor holds.

    Attributes
    ----------
    values : (count, components)
        In the type of the file; matrices column by column.
    normalized : bool
        Integers stand for numbers from 0 or -1 to 1.
    """

    values: NDArray
    normalized: bool

    def scaled(self, normalized: bool | None = None) -> NDArray[np.float64]:
        """(count, components) the numbers meant; ``normalized`` overrules what the file says of integers."""
        values = self.values.astype(np.float64)
        if self.values.dtype.kind == "f" or not (self.normalized if normalized is None else normalized):
            return values
        return np.maximum(values / np.iinfo(self.values.dtype).max, -1.0)


def read_accessor(document: Document, index: int, user: Entry, kinds: tuple[str, ...]) -> Elements:
    """An accessor of one of some types (``"VEC3"``, …), sparse values put in.

    Raises
    ------
    UserError
        Of another type, or not within its buffer view.
    """
    entry = document.at("accessors", index, user)
    kind, component = entry.text("type"), entry.integer("componentType")
    if kind not in kinds:
        raise entry.fault(f"is {kind!r:.20} where {user.place} needs {' or '.join(kinds)}")
    if component not in _COMPONENTS:
        raise entry.fault(f"has an unknown componentType ({component})")
    count = entry.integer("count")
    dtype = np.dtype(_COMPONENTS[component])
    columns, rows = _SHAPES[kind]
    if "bufferView" in entry.values:
        values = _read_elements(document, entry, count, dtype, (columns, rows))
        document.take(8 * values.size)
    elif count > _MOST_ZEROS and count > _largest_stored(document):
        raise entry.fault(f"has {count} elements and no data")
    else:
        document.take(8 * count * columns * rows)
        values = np.zeros((count, columns * rows), dtype=dtype)
    sparse = entry.entry("sparse")
    if sparse is not None:
        values = _put_sparse(document, sparse, values, (columns, rows))
    return Elements(values, entry.flag("normalized"))


def _largest_stored(document: Document) -> int:
    """Elements of the largest accessor that has data."""
    stored = (entry for entry in document.table("accessors") if "bufferView" in entry.values)
    return max((entry.integer("count") for entry in stored), default=0)


def _put_sparse(document: Document, sparse: Entry, base: NDArray, shape: tuple[int, int]) -> NDArray:
    """``base`` with some elements replaced."""
    indices, values = sparse.entry("indices"), sparse.entry("values")
    if indices is None or values is None:
        raise sparse.fault("has no indices or no values")
    component = indices.integer("componentType")
    if component not in _UNSIGNED:
        raise indices.fault(f"has componentType {component}, which no index has")
    count = sparse.integer("count")
    places = _read_elements(document, indices, count, np.dtype(_COMPONENTS[component]), (1, 1))[:, 0]
    replaced = base.copy()
    if count and places.max() >= len(base):
        raise sparse.fault(f"replaces element {places.max()} of {len(base)}")
    replaced[places] = _read_elements(document, values, count, base.dtype, shape)
    return replaced


def read_indices(document: Document, index: int, user: Entry) -> NDArray[np.int64]:
    """(count,) indices of vertices.

    Raises
    ------
    UserError
        Not unsigned integers, or among them the largest, which glTF forbids.
    """
    elements = read_accessor(document, index, user, ("SCALAR",))
    entry, values = document.at("accessors", index, user), elements.values[:, 0]
    if values.dtype.kind != "u":
        raise entry.fault(f"has componentType {entry.integer('componentType')}, which no index has")
    if values.size and values.max() == np.iinfo(values.dtype).max:
        raise entry.fault(f"has the index {values.max()}, which glTF keeps for restarts that it does not allow")
    return values.astype(np.int64)


def _read_elements(document: Document, user: Entry, count: int, dtype: np.dtype, shape: tuple[int, int]) -> NDArray:
    """(count, columns x rows) elements of the view that ``user`` names, from its ``byteOffset`` on."""
    columns, rows = shape
    index = user.integer("bufferView")
    view = read_view(document, index, user)
    column = rows * dtype.itemsize
    apart = column if columns == 1 else -(-column // 4) * 4
    size = apart * (columns - 1) + column
    stride = document.at("bufferViews", index, user).integer("byteStride", apart * columns)
    if stride < size and count > 1:
        raise user.fault(f"has elements of {size} bytes in buffer view {index}, whose byteStride is {stride}")
    begin = user.integer("byteOffset", 0)
    if count == 0:
        return np.empty((0, columns * rows), dtype=dtype)
    if begin + stride * (count - 1) + size > len(view):
        raise user.fault(f"reads beyond buffer view {index}")
    # Rows of bytes first: elements need not be aligned to their type.
    at = np.lib.stride_tricks.as_strided(view[begin:], (count, columns, column), (stride, apart, 1), writeable=False)
    return np.ascontiguousarray(at).view(dtype).reshape(count, columns * rows)


def read_view(document: Document, index: int, user: Entry) -> NDArray[np.uint8]:
    """The bytes of a buffer view, decompressed.

    Raises
    ------
    UserError
        Not within its buffer, or compressed and broken.
    """
    if index not in document.views:
        entry = document.at("bufferViews", index, user)
        packed = next((found for name in _MESHOPT if (found := entry.extension(name))), None)
        document.views[index] = _slice_buffer(document, entry) if packed is None else _unpack(document, entry, packed)
    return document.views[index]


def _slice_buffer(document: Document, entry: Entry) -> NDArray[np.uint8]:
    """The bytes that a buffer view, or the extension of one, names."""
    index = entry.integer("buffer")
    begin, length = entry.integer("byteOffset", 0), entry.integer("byteLength")
    buffer = read_buffer(document, index, entry)
    if begin + length > len(buffer):
        raise entry.fault(f"reads beyond buffer {index}")
    return buffer[begin : begin + length]


def _unpack(document: Document, entry: Entry, packed: Entry) -> NDArray[np.uint8]:
    """The bytes of a view that meshoptimizer compressed."""
    mode, name = packed.text("mode"), packed.text("filter", "NONE")
    count, stride = packed.integer("count"), packed.integer("byteStride")
    data = _slice_buffer(document, packed).tobytes()
    if name not in FILTERS or (mode != "ATTRIBUTES" and name != "NONE"):
        raise packed.fault(f"has an unknown filter for {mode[:12]} ({name[:16]!r})")
    try:
        if mode == "ATTRIBUTES":
            strides, restore = FILTERS[name]
            if stride not in strides:
                raise ValueError(f"a byteStride of {stride} for {name}")
            unpacked = restore(decode_attributes(data, count, stride)).reshape(-1)
        elif mode not in ("TRIANGLES", "INDICES") or stride not in (2, 4):
            raise ValueError(f"an unknown mode or byteStride ({mode[:12]!r}, {stride})")
        else:
            indices = (decode_triangles if mode == "TRIANGLES" else decode_sequence)(data, count)
            unpacked = indices.astype(f"<u{stride}").view(np.uint8)
    except ValueError as error:
        raise packed.fault(f"has {error}") from None
    if len(unpacked) < entry.integer("byteLength"):
        raise entry.fault(f"has {len(unpacked)} of its {entry.integer('byteLength')} bytes")
    return unpacked
