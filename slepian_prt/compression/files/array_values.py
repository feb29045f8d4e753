"""What the numbers of a file's arrays may be, and the sizes that they tell of arrays behind them.

Each check raises ValueError for numbers that no writer writes and some decoder would not survive.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.codec.contexts import (
    BASES,
    CONTEXTS,
    RAREST_SHARE,
    WIDTH_CONTEXTS,
    WIDTHS,
)
from slepian_prt.compression.codec.models import MODELS
from slepian_prt.compression.codec.prediction import LARGEST_GAIN, PARTS
from slepian_prt.compression.codec.surface import DEPTHS
from slepian_prt.compression.files.known import Known
from slepian_prt.compression.files.manifest import LARGEST_NUMBER
from slepian_prt.compression.stored_mesh.connectivity import check_draco_header
from slepian_prt.compression.stored_mesh.surface_normals import STORED, WAYS

# Sites are unit vectors times this, rounded.
_SITE = 1 << 14

# Functions are unit vectors, rounded to float16 at worst; centres are ones in float64.
_NORM_OF_FUNCTION = 0.02
_NORM_OF_CENTER = 1e-6

# Rows of "coded/caps", but for the checksum, which is that of arrays behind it.
LANES, WORDS, BITS, WIDTH, AXES, CHECKSUM = range(6)

# A symbol takes so many bits at most, and a number so many more that are not coded.
_SYMBOL_BITS, _EXTRA_BITS = 12, 33
_LANE_BITS = 3200

Check = Callable[[Known, NDArray], None]


def pass_over(known: Known, array: NDArray) -> None:
    """Any numbers may be."""


def within(low: float, high: float) -> Check:
    """Finite numbers in an interval."""

    def check(known: Known, array: NDArray) -> None:
        if array.size and not (float(array.min()) >= low and float(array.max()) <= high):  # nor NaN
            raise ValueError(f"numbers outside of [{low:g}, {high:g}]")

    return check


def below(size: str) -> Check:
    """Whole numbers below a size."""

    def check(known: Known, array: NDArray) -> None:
        if array.max(initial=0) >= known.sizes[size]:
            raise ValueError(f"a number of {known.sizes[size]} or more")

    return check


def check_rows(known: Known, array: NDArray) -> None:
    """One row for red, green and blue, or three."""
    if len(array) not in (1, 3):
        raise ValueError(f"{len(array)} rows")


def check_units(known: Known, array: NDArray) -> None:
    """Unit vectors (n, 3)."""
    within(-2.0, 2.0)(known, array)
    if np.abs(np.linalg.norm(array, axis=1) - 1.0).max() > _NORM_OF_CENTER:
        raise ValueError("vectors that are not of unit length")


def check_sites(known: Known, array: NDArray) -> None:
    """Unit vectors (n, 3) times 2^14."""
    if np.abs(np.linalg.norm(array.astype(np.float64), axis=1) - _SITE).max() > 2.0:
        raise ValueError("directions that are not of unit length")


# --- Mesh and light --------------------------------------------------------------------------------------------------


def check_draco(known: Known, array: NDArray) -> None:
    """Streams of Draco, whose beginnings have to tell what the manifest does before anything else is made of them."""
    assert known.mesh is not None
    begin = 0
    for piece in known.mesh["pieces"]:
        end = begin + piece["draco"]
        if piece["draco"]:
            check_draco_header(array[begin:end].tobytes(), piece["faces"] - piece["loose_faces"])
        begin = end


def check_ways(known: Known, array: NDArray) -> None:
    """How vertices have their normals."""
    if array.max() >= WAYS:
        raise ValueError(f"a way of {WAYS} or more")
    known.sizes["stored normals"] = int(np.count_nonzero(array == STORED))


def check_halves(known: Known, array: NDArray) -> None:
    """Low and high bytes of float16, which have to be finite."""
    if array.size and np.any((array[1] & 0x7C) == 0x7C):
        raise ValueError("numbers that are not finite")


# --- Caps and functions ----------------------------------------------------------------------------------------------


def check_kinds(known: Known, array: NDArray) -> None:
    """Occlusion classes of caps."""
    known.ranges["classes"] = (int(array.max()) + 1, 256)


def check_terms(known: Known, array: NDArray) -> None:
    """Functions of caps."""
    caps, size, channels = known.sizes["C"], known.sizes["M"], known.manifest["channels"]
    if len(array) not in (1, caps):
        raise ValueError(f"shape {array.shape}")
    if array.max() > size:  # of means alone there may be none
        raise ValueError(f"{array.max()} functions of {size}")
    terms = np.broadcast_to(array.astype(np.int64), caps)
    low, high = int(terms.min()), int(terms.max())
    known.sizes["functions M"] = int(terms.sum()) * size
    # Of components that no cap has nothing is read: predictions may have been fitted to wider ones.
    known.ranges["widths"] = (max(1, high * channels), size * channels)
    known.ranges["numbers"] = (known.sizes["V"] * low * channels, known.sizes["V"] * high * channels)


def check_counts(known: Known, array: NDArray) -> None:
    """Functions of families."""
    known.sizes["families"] = len(array)
    known.sizes["orders"] = int(array.sum(dtype=np.int64))
    known.sizes["octets of orders"] = (known.sizes["orders"] + 7) // 8
    if array.max() > known.sizes["M"]:
        raise ValueError(f"{array.max()} functions of {known.sizes['M']}")


def check_families(known: Known, array: NDArray) -> None:
    """Families of caps."""
    below("families")(known, array)
    if np.any(known.terms > known.arrays["radial/count"][array]):
        raise ValueError("families have fewer functions than their caps")


def check_orders(known: Known, array: NDArray) -> None:
    """Orders of functions."""
    if np.abs(array.astype(np.int64)).max(initial=0) >= known.sizes["L+1"]:
        raise ValueError("orders above the bandlimit")
    owner = np.repeat(np.arange(known.sizes["families"]), known.arrays["radial/count"].astype(np.int64))
    span, bands = 2 * known.sizes["L+1"], known.sizes["L+1"]
    each = owner * span + array + bands
    used, counts = np.unique(each, return_counts=True)
    if np.any(counts > bands - np.abs(used % span - bands)):
        raise ValueError("more functions of an order than there are")


def check_repeats(known: Known, array: NDArray) -> None:
    """Which functions have the numbers of those before them."""
    orders, count = np.abs(known.arrays["radial/order"].astype(np.int64)), known.sizes["orders"]
    repeats = np.unpackbits(array, count=count).astype(bool)
    firsts = np.cumsum(known.arrays["radial/count"].astype(np.int64)) - known.arrays["radial/count"]
    alone = np.zeros(count, dtype=bool)
    alone[firsts[firsts < count]] = True
    if np.any(repeats & alone):
        raise ValueError("a first function that repeats another")
    lengths = np.where(repeats, 0, known.sizes["L+1"] - orders)
    known.sizes["radial numbers"] = int(lengths.sum())
    known.arrays["lengths of functions"] = lengths[lengths > 0]
    known.arrays["repeats"] = repeats


def check_radial(known: Known, array: NDArray) -> None:
    """Functions of one order each, one after the other; those of other orders may have the same numbers.

    About the whole sphere functions are single harmonics, so that a number 1 of degree 3 serves the orders 0 to 3.
    """
    lengths = known.arrays["lengths of functions"]
    if not lengths.size:
        return
    starts = np.cumsum(lengths) - lengths
    _check_norms(np.add.reduceat(_squares(known, array), starts))
    orders, repeats = np.abs(known.arrays["radial/order"].astype(np.int64)), known.arrays["repeats"]
    places = np.flatnonzero(array)  # each function has some, as it is of unit length
    first = places[np.searchsorted(places, starts)]
    lowest = first - starts + orders[~repeats]  # degree
    if np.any(orders > lowest[np.cumsum(~repeats) - 1]):
        raise ValueError("functions that repeat degrees below their order")


def check_dense(known: Known, array: NDArray) -> None:
    """Functions."""
    _check_norms(_squares(known, array).reshape(-1, known.sizes["M"]).sum(axis=1))


def _squares(known: Known, array: NDArray) -> NDArray[np.float32]:
    within(-2.0, 2.0)(known, array)
    return np.square(array, dtype=np.float32)


def _check_norms(squares: NDArray) -> None:
    if squares.size and not np.abs(squares - 1.0).max() < _NORM_OF_FUNCTION:
        raise ValueError("functions that are not of unit length")


# --- Coefficients ----------------------------------------------------------------------------------------------------


def check_coefficients(known: Known, array: NDArray) -> None:
    """Plain ones."""
    if array.dtype.name != known.manifest["coding"]:
        raise ValueError(f"{array.dtype.name} where the coding is {known.manifest['coding']}")
    within(-LARGEST_NUMBER, LARGEST_NUMBER)(known, array)


def check_coded_caps(known: Known, array: NDArray) -> None:
    """Sizes of what is coded of each cap, which cannot be more than what so many symbols take."""
    table, components = array.astype(np.int64), known.terms * known.manifest["channels"]
    widths, axes = table[WIDTH], table[AXES]
    if np.any(widths > components) or np.any(axes > 1):
        raise ValueError("more components than the functions have")
    # Classes, then exponents, models and entries of axes, then of each vertex a width and its components.
    header = widths * (1 + axes * (2 + components))
    symbols = header + known.sizes["V"] * np.where(widths > 0, 1 + widths, 0)
    most = int(header.sum()) + known.sizes["V"] * (1 + int(widths.max(initial=0)))
    if np.any(table[LANES] > np.where(symbols, 1 + symbols * _SYMBOL_BITS // _LANE_BITS, 0)):
        raise ValueError("more lanes than symbols need")
    for name, row in (("lanes", LANES), ("words", WORDS), ("bits", BITS)):
        known.sizes[name] = int(table[row].sum())
    if known.sizes["words"] > most * _SYMBOL_BITS // 16 + 2 * known.sizes["lanes"]:
        raise ValueError("more words than symbols need")
    if known.sizes["bits"] > most * _EXTRA_BITS // 8 + len(widths):
        raise ValueError("more bits than numbers need")
    known.ranges["contexts"] = _contexts_range()


def check_prediction(known: Known, array: NDArray) -> None:
    """Gains, and shrinkages."""
    if array[:2].max(initial=0) > LARGEST_GAIN:
        raise ValueError(f"gains above {LARGEST_GAIN}")


def _contexts_range() -> tuple[int, int]:
    fixed = DEPTHS + CONTEXTS + BASES + WIDTH_CONTEXTS
    return fixed + WIDTHS, fixed + WIDTHS * WIDTH_CONTEXTS


def check_contexts(known: Known, array: NDArray) -> None:
    """Steps of levels and models of contexts."""
    ends = np.cumsum([DEPTHS, CONTEXTS, BASES, WIDTH_CONTEXTS])
    steps, models, changes, width_table, tables = np.split(array, ends)
    if steps.min() < 1 or steps.max() > PARTS:
        raise ValueError("steps of levels")
    if tables.size % WIDTHS or models.max() >= MODELS or max(changes.max(), tables.max()) > RAREST_SHARE:
        raise ValueError("models of contexts")
    if width_table.max() >= tables.size // WIDTHS:
        raise ValueError("tables of widths")
