"""Transfer in its run-time format as a page carries it, and captured films."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.lighting.fixed_lights import lamp_scales
from slepian_prt.scene.film import Film
from slepian_prt.sphere.harmonics import num_coefficients
from slepian_prt.viewer.buffers import Buffers

if TYPE_CHECKING:
    from slepian_prt.runtime.gpu_transfer import GpuTransfer

_UNORM = 65535.0

# What a half float holds, and minus the exponent of its smallest number.
_LARGEST_HALF = 65504.0
_FINEST = 24


@dataclass(frozen=True, eq=False)
class Model:
    """What is lit.

    Attributes
    ----------
    label : str
    packed : CompressedTransfer
    transfer : GpuTransfer
    lamps : (V, 3) float32 or None
        Radiance of unit albedo under the lamps of the scene.
    """

    label: str
    packed: CompressedTransfer
    transfer: GpuTransfer
    lamps: NDArray[np.float32] | None

    def entry(
        self, buffers: Buffers, bandlimit: int, geometry: int | None, receivers: NDArray[np.int64] | None
    ) -> dict[str, Any]:
        """What the payload says of it.

        Parameters
        ----------
        buffers : Buffers
        bandlimit : int
            Of the lights of the page: functions of a lower one have zeros behind.
        geometry : int or None
        receivers : (N,)
            Those of the drawn vertices; None for all of them.
        """
        transfer, table = self.transfer, self.transfer.functions
        more = num_coefficients(bandlimit) - table.shape[3]
        table = np.pad(table, ((0, 0), (0, 0), (0, 0), (0, more)))
        chosen = slice(None) if receivers is None else receivers
        lamps = self.lamps
        if lamps is not None:
            half = np.minimum(lamps[chosen], _LARGEST_HALF).astype(np.float16)
        return {
            "label": self.label,
            "geometry": geometry,
            "functions": table.shape[1],
            "caps": table.shape[0],
            "channels": transfer.channels,
            "bandlimit": transfer.bandlimit,
            "table": _table_entry(buffers, table),
            "zeros": buffers.add(transfer.zeros.astype(np.float32)),
            "bytes": buffers.add(transfer.vertices[chosen], "clusters"),
            "fixed": None if lamps is None else buffers.add(half, "planes"),
            "lampNames": list(self.packed.lamp_names),
            "fileError": self.packed.predicted_relit_error(),
            "stepError": transfer.error(),
            "relitError": transfer.relit_error(),
        }


def _table_entry(buffers: Buffers, table: NDArray[np.float32]) -> dict[str, Any]:
    """Functions, which are numbers of float16 and so multiples of a power of two, as whole numbers of the largest."""
    whole = np.rint(table.ravel() * 2.0**_FINEST).astype(np.int64)
    bits = int(np.bitwise_or.reduce(np.abs(whole), initial=0))
    shift = (bits & -bits).bit_length() - 1 if bits else 0
    whole >>= shift
    kind = np.int16 if np.abs(whole).max(initial=0) < 2**15 else np.int32
    if np.abs(whole).max(initial=0) >= 2**31:  # of all magnitudes that float16 has
        return buffers.add(table.astype(np.float16).ravel(), "planes")
    return buffers.add(whole.astype(kind), "folded", scale=2.0 ** (shift - _FINEST))


def lamp_radiance(packed: CompressedTransfer, fixed_lights: float | Mapping[str, float]) -> NDArray[np.float32] | None:
    """(V, 3) what the lamps of the scene send to receivers of unit albedo; None where they are dark."""
    scales = lamp_scales(packed.fixed, fixed_lights)
    return packed.fixed.radiance(scales) if packed.fixed is not None and scales.any() else None


def film_entry(buffers: Buffers, film: Film) -> dict[str, Any]:
    """What the payload says of the film whose pixels are lit."""
    background = np.rint(np.clip(film.background, 0.0, 1.0) * _UNORM).astype(np.uint16)
    coverage = np.rint(film.coverage * _UNORM).astype(np.uint16)
    looks, rows, columns, _ = film.directions.shape
    return {
        "name": film.name,
        "width": film.width,
        "height": film.height,
        "coverage": buffers.add(coverage, "steps", scale=1.0 / _UNORM),
        "background": buffers.add(background, "steps", scale=1.0 / _UNORM),
        "directions": {
            "looks": looks,
            "rows": rows,
            "columns": columns,
            "values": buffers.add(film.directions.reshape(-1, 3), "planes"),
        },
    }
