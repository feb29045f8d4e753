"""Coded coefficients as arrays of a file."""

from __future__ import annotations

import zlib

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.codec.cap_stream import CapBytes
from slepian_prt.compression.codec.caps import Coded, Tuning
from slepian_prt.compression.codec.contexts import BASES, CONTEXTS, RAREST_SHARE, WIDTH_CONTEXTS, WIDTHS, Contexts
from slepian_prt.compression.codec.lanes import LaneWords
from slepian_prt.compression.codec.models import MODELS
from slepian_prt.compression.codec.prediction import LARGEST_GAIN, PARTS, Predictor
from slepian_prt.compression.codec.surface import DEPTHS

# Rows of "coded/caps".
_LANES, _WORDS, _BITS, _WIDTH, _AXES, _CHECKSUM = range(6)


def pack_coded(coded: Coded) -> dict[str, NDArray]:
    """Arrays that hold coded coefficients: few, as each takes some 200 bytes of its own."""
    caps, predictor, contexts = coded.caps, coded.tuning.predictor, coded.tuning.contexts
    table = np.zeros((6, len(caps)), dtype=np.uint32)
    for column, cap in zip(table.T, caps, strict=True):
        column[:] = (
            cap.lanes.lengths.size,
            cap.lanes.words.size,
            cap.bits.size,
            cap.width,
            cap.principal_axes,
            _checksum(cap),
        )
    long = {
        "coded/words": np.concatenate([np.zeros(0, dtype=np.uint16), *(cap.lanes.words for cap in caps)]),
        "coded/bits": np.concatenate([np.zeros(0, dtype=np.uint8), *(cap.bits for cap in caps)]),
        "coded/lanes": np.concatenate([np.zeros(0, dtype=np.uint16), *(cap.lanes.lengths for cap in caps)]),
    }
    return {
        **{name: array for name, array in long.items() if array.size},
        "coded/caps": table,
        "coded/prediction": np.concatenate([predictor.gains, predictor.shrinkage]),
        "coded/contexts": np.concatenate(
            [predictor.steps, contexts.models, contexts.changes, contexts.width_table, contexts.width_tables.ravel()]
        ),
    }


def unpack_coded(arrays: dict[str, NDArray], step: float, caps: int) -> Coded:
    """What `pack_coded` packed.

    Raises
    ------
    ValueError, KeyError
        Arrays that do not fit together, or whose checksum is another.
    """
    table = arrays["coded/caps"].astype(np.int64)
    if table.shape != (6, caps):
        raise ValueError("number of coded caps")
    parts = []
    for name, row, kind in (("words", _WORDS, "u2"), ("bits", _BITS, "u1"), ("lanes", _LANES, "u2")):
        array = arrays.get(f"coded/{name}", np.zeros(0, dtype=kind))
        if table[row].sum() != array.size or array.dtype != kind:
            raise ValueError(f"number of {name}")
        parts.append(np.split(array, np.cumsum(table[row])[:-1]))
    contents = []
    for words, bits, lanes, column in zip(*parts, table.T, strict=True):
        content = CapBytes(LaneWords(lanes, words), bits, int(column[_WIDTH]), bool(column[_AXES]))
        if _checksum(content) != column[_CHECKSUM]:
            raise ValueError("checksum of a cap")
        contents.append(content)
    steps, contexts = np.split(arrays["coded/contexts"], [DEPTHS])
    predictor = _predictor(arrays["coded/prediction"], steps)
    return Coded(Tuning(step, predictor, _contexts(contexts)), tuple(contents))


def _predictor(stored: NDArray[np.uint8], steps: NDArray[np.uint8]) -> Predictor:
    if len(stored) != 4 or stored[:2].max(initial=0) > LARGEST_GAIN or steps.min() < 1 or steps.max() > PARTS:
        raise ValueError("prediction")
    return Predictor(stored[:2], stored[2:], steps)


def _contexts(stored: NDArray[np.uint8]) -> Contexts:
    ends = np.cumsum([CONTEXTS, BASES, WIDTH_CONTEXTS])
    models, changes, width_table, tables = np.split(stored, ends)
    if (
        tables.size == 0
        or tables.size % WIDTHS
        or models.max() >= MODELS
        or max(changes.max(), tables.max()) > RAREST_SHARE
    ):
        raise ValueError("contexts")
    if width_table.max() >= tables.size // WIDTHS:
        raise ValueError("tables of widths")
    return Contexts(models, changes, tables.reshape(-1, WIDTHS), width_table)


def _checksum(cap: CapBytes) -> int:
    found = 0
    for part, kind in ((cap.lanes.lengths, "<u2"), (cap.lanes.words, "<u2"), (cap.bits, "u1")):
        found = zlib.crc32(part.astype(kind).tobytes(), found)
    return found
