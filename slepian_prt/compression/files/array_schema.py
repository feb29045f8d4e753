"""The arrays of a ``.prt`` file: types, shapes in named sizes, and what their numbers may be (docs/file-format.md).

`ARRAYS` is in the order of reading. A row's shape is in sizes that the manifest or arrays before it tell, so that it
is known how much is read before it is. What a decoder has to look at more closely has functions in `array_values`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.files import array_values as values
from slepian_prt.compression.files.known import Known
from slepian_prt.compression.files.manifest import LARGEST_NUMBER
from slepian_prt.transport.archive_members import Misfit

# The most that sizes may be which nothing tells.
_FREE = {"nodes": 1 << 10, "classes": 256}

Size = int | str
Shape = Sequence[Size] | Callable[[Known], Sequence[Size]]


@dataclass(frozen=True)
class ArrayRow:
    """What is said of an array.

    Attributes
    ----------
    name : str
    dtypes : str
        Names of the types that it may have.
    shape : sequence of int or str, or a callable that gives it
        Names are sizes.
    there : callable
        True where the array has to be there, False where it is not looked at, None where it may be there.
    check : callable
        Raises ValueError for numbers that cannot be, and tells sizes of arrays that follow.
    """

    name: str
    dtypes: str
    shape: Shape
    there: Callable[[Known], bool | None]
    check: Callable[[Known, NDArray], None] = field(default=values.pass_over)

    def expect(self, known: Known, dtype: np.dtype[Any], shape: tuple[int, ...]) -> None:
        """Raise Misfit for an array of another type or shape."""
        wanted = self.shape(known) if callable(self.shape) else self.shape
        limits = [(size, size) if isinstance(size, int) else _limits(known, size) for size in wanted]
        if dtype.name not in self.dtypes.split():
            raise Misfit(f"{self.name} is of type {dtype.name}")
        if len(shape) != len(limits) or not all(low <= n <= high for n, (low, high) in zip(shape, limits, strict=True)):
            wanted_shape = ", ".join(str(low) if low == high else f"{low} to {high}" for low, high in limits)
            raise Misfit(f"{self.name} has shape ({', '.join(map(str, shape))}), not ({wanted_shape})")

    def accept(self, known: Known, array: NDArray) -> None:
        """Raise Misfit for numbers that cannot be."""
        known.arrays[self.name] = array
        try:
            self.check(known, array)
        except ValueError as error:
            raise Misfit(f"{self.name}: {error}") from None


def _limits(known: Known, size: str) -> tuple[int, int]:
    if size in known.sizes:
        return known.sizes[size], known.sizes[size]
    return known.ranges.get(size) or (1, _FREE[size])


def always(known: Known) -> bool:
    """For arrays of every file."""
    return True


def _may(known: Known) -> None:
    return None


def _mesh(known: Known) -> bool:
    return known.mesh is not None


def _film(known: Known) -> bool:
    return known.film is not None


def _exact(known: Known) -> bool:
    return known.mesh is not None and known.mesh["exact"]


def _may_if_mesh(known: Known) -> bool | None:
    return None if known.mesh is not None else False


def _normals(known: Known) -> bool | None:
    if known.mesh is None:
        return False
    return None if known.mesh["exact"] else known.sizes["stored normals"] > 0


def _normals_shape(known: Known) -> Sequence[Size]:
    return (3, "bytes", "V") if _exact(known) else (2, "bytes", "stored normals")


def _albedo_shape(known: Known) -> Sequence[Size]:
    assert known.mesh is not None
    return ("rows", "V") if known.mesh["albedo"]["kind"] == "table" else ("rows", "bytes", "V")


def _coded(known: Known) -> bool:
    return known.manifest["coding"] == "coded"


def _plain(known: Known) -> bool:
    return not _coded(known)


def _no_sites(known: Known) -> bool:
    return "clusters/sites" not in known.names


def _caps_told(known: Known) -> bool:
    return not (_coded(known) and "clusters/sites" in known.names)


def _radial(known: Known) -> bool:
    return "radial/order" in known.names


def _some(size: str) -> Callable[[Known], bool]:
    return lambda known: known.sizes.get(size, 0) > 0


# A coefficient of transfer is at most 1e12; three channels, and the factors of means and of degrees, make less of this.
_mean = values.within(-1e14, 1e14)
_number = values.within(-LARGEST_NUMBER, LARGEST_NUMBER)
_positive = values.within(2.0**-64, LARGEST_NUMBER)
_scale = values.within(0.0, LARGEST_NUMBER)

ARRAYS = (
    ArrayRow("mesh/draco", "uint8", ("draco",), _mesh, values.check_draco),
    ArrayRow("mesh/loose", "uint8", (3, "bytes", "loose"), _some("loose")),
    ArrayRow("mesh/loose_faces", "uint8", (3, "bytes", "loose faces"), _some("loose faces")),
    ArrayRow("mesh/positions", "uint8", (3, "bytes", "V"), _exact),
    ArrayRow(
        "mesh/normal_ways",
        "uint8",
        ("V",),
        lambda known: None if known.mesh is not None and not known.mesh["exact"] else False,
        values.check_ways,
    ),
    ArrayRow("mesh/normals", "uint8", _normals_shape, _normals),
    ArrayRow(
        "mesh/albedo",
        "uint8",
        _albedo_shape,
        lambda known: known.mesh is not None and known.mesh["albedo"]["kind"] != "constant",
        values.check_rows,
    ),
    ArrayRow("mesh/order", "uint8", (1, "bytes", "V"), _may_if_mesh),
    ArrayRow("mesh/source", "uint8", (2, "bytes", "pairs"), _may_if_mesh),
    ArrayRow("film/axes", "uint8", (2, "V"), _film),
    ArrayRow("film/background", "uint16", ("rows", "V"), _film, values.check_rows),
    ArrayRow("film/noise", "uint8", (1, "V"), _film),
    ArrayRow("film/directions", "float32", ("nodes", "nodes", "nodes", 3), _film, values.within(-1e6, 1e6)),
    ArrayRow("environment/lighting", "float64", (3, "M"), _may, _number),
    ArrayRow("fixed/direct", "uint8", (2, "direct rows", "V"), _some("lamps"), values.check_halves),
    ArrayRow("fixed/direct_scale", "float64", ("lamps", 3), _some("lamps"), _scale),
    ArrayRow("fixed/bounced", "uint8", (2, "bounced rows", "V"), _some("lamps"), values.check_halves),
    ArrayRow("fixed/bounced_scale", "float64", ("lamps", 3), _some("lamps"), _scale),
    ArrayRow("clusters/sites", "int16", ("C", 3), _may, values.check_sites),
    ArrayRow("clusters/index", "uint8 uint16", ("V",), _no_sites, values.below("C")),
    ArrayRow("clusters/kinds", "uint8", ("C",), lambda known: None if _no_sites(known) else False, values.check_kinds),
    ArrayRow("caps/center", "float64", ("C", 3), _caps_told, values.check_units),
    ArrayRow("caps/half_angle", "float64", ("C",), _caps_told, values.within(0.0, 3.1416)),
    ArrayRow("caps/terms", "uint16", ("C or 1",), always, values.check_terms),
    ArrayRow("radial/count", "uint16", ("families",), _radial, values.check_counts),
    ArrayRow("radial/family", "uint16", ("C",), _radial, values.check_families),
    ArrayRow("radial/order", "int16", ("orders",), _radial, values.check_orders),
    ArrayRow("radial/repeats", "uint8", ("octets of orders",), _radial, values.check_repeats),
    ArrayRow("radial/values", "float16 float32", ("radial numbers",), _radial, values.check_radial),
    ArrayRow(
        "basis/dense",
        "float16 float32",
        ("functions M",),
        lambda known: False if _radial(known) else None,
        values.check_dense,
    ),
    ArrayRow("basis/mean", "float16 float32", ("C D M",), _may, _mean),
    ArrayRow("basis/weights", "float64", ("L+1",), _may, _positive),
    ArrayRow("mean/zonal", "float32", ("classes", "L+1"), _may, _mean),
    ArrayRow("coefficients", "float16 float32", ("numbers",), _plain, values.check_coefficients),
    ArrayRow("coded/caps", "uint32", (6, "C"), _coded, values.check_coded_caps),
    ArrayRow("coded/prediction", "uint8", (4, "widths"), _coded, values.check_prediction),
    ArrayRow("coded/contexts", "uint8", ("contexts",), _coded, values.check_contexts),
    ArrayRow("coded/lanes", "uint16", ("lanes",), _some("lanes")),
    ArrayRow("coded/words", "uint16", ("words",), _some("words")),
    ArrayRow("coded/bits", "uint8", ("bits",), _some("bits")),
)
