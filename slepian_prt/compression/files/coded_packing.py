"""Coded coefficients as arrays of a file."""

from __future__ import annotations

import zlib

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.codec.cap_stream import CapBytes
from slepian_prt.compression.codec.caps import Coded, Tuning
from slepian_prt.compression.codec.contexts import BASES, CONTEXTS, WIDTH_CONTEXTS, WIDTHS, Contexts
from slepian_prt.compression.codec.lanes import LaneWords
from slepian_prt.compression.codec.prediction import Predictor
from slepian_prt.compression.codec.surface import DEPTHS
from slepian_prt.compression.files.array_values import AXES, BITS, CHECKSUM, LANES, WIDTH, WORDS


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
    ValueError
        The checksum of a cap is another.
    """
    table = arrays["coded/caps"].astype(np.int64)
    parts = [
        np.split(arrays.get(f"coded/{name}", np.zeros(0, dtype=kind)), np.cumsum(table[row])[:-1])
        for name, row, kind in (("words", WORDS, "u2"), ("bits", BITS, "u1"), ("lanes", LANES, "u2"))
    ]
    contents = []
    for words, bits, lanes, column in zip(*parts, table.T, strict=True):
        content = CapBytes(LaneWords(lanes, words), bits, int(column[WIDTH]), bool(column[AXES]))
        if _checksum(content) != column[CHECKSUM]:
            raise ValueError("checksum of a cap")
        contents.append(content)
    steps, models, changes, width_table, tables = np.split(
        arrays["coded/contexts"], np.cumsum([DEPTHS, CONTEXTS, BASES, WIDTH_CONTEXTS])
    )
    gains, shrinkage = np.split(arrays["coded/prediction"], 2)
    contexts = Contexts(models, changes, tables.reshape(-1, WIDTHS), width_table)
    return Coded(Tuning(step, Predictor(gains, shrinkage, steps), contexts), tuple(contents))


def _checksum(cap: CapBytes) -> int:
    found = 0
    for part, kind in ((cap.lanes.lengths, "<u2"), (cap.lanes.words, "<u2"), (cap.bits, "u1")):
        found = zlib.crc32(part.astype(kind).tobytes(), found)
    return found
