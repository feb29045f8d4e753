"""Compressed transfer decoded: coefficients of caps, and transfer vectors."""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from slepian_prt.compression.blocks import pieces_of
from slepian_prt.compression.codec.caps import Coded, DecodedCap, decode_caps
from slepian_prt.compression.codec.surface import surface_of
from slepian_prt.compression.pilot import channel_mixing
from slepian_prt.errors import UserError
from slepian_prt.machine.memory import check_memory
from slepian_prt.sphere.harmonics import num_coefficients

if TYPE_CHECKING:
    from slepian_prt.compression.compressed import CompressedTransfer


# Coefficients that are decoded together: they take some 40 bytes each meanwhile.
_PIECE = 1 << 22
_THREADS = 4


class CapCoefficients(NamedTuple):
    """One cap's coefficients as numbers.

    Attributes
    ----------
    values : (n, A) float32
        In the order of the cap's members.
    axes : (A, K channels) or None
        Principal axes, which the values belong to; None if they belong to the cap's basis itself.
    """

    values: NDArray[np.float32]
    axes: NDArray[np.float64] | None

    def in_basis(self) -> NDArray[np.float32]:
        """(n, K channels) coefficients of the cap's basis."""
        return self.values if self.axes is None else self.values @ self.axes.astype(np.float32)


def decode(packed: CompressedTransfer, cap: int) -> CapCoefficients:
    """One cap's coefficients, the others left alone."""
    if packed.coded is None:
        return CapCoefficients(packed.coefficients[cap].astype(np.float32), None)
    return _decode_coded(packed, range(cap, cap + 1))[0]


def decode_all(packed: CompressedTransfer) -> tuple[CapCoefficients, ...]:
    """All caps' coefficients; kept until `forget`.

    Raises
    ------
    UserError
        What was loaded does not fit together.
    """
    if packed not in _decoded:
        each = np.array([basis.count for basis in packed.bases]) * packed.channels
        check_memory(
            4 * int(packed.clusters.sizes @ each), "what is decoded", "precompute it again with fewer vertices"
        )
        if packed.coded is None:
            _decoded[packed] = tuple(decode(packed, c) for c in range(len(packed.bases)))
        else:
            _decoded[packed] = tuple(_decode_pieces(packed, packed.coded))
    return _decoded[packed]


def _decode_pieces(packed: CompressedTransfer, coded: Coded) -> Iterator[CapCoefficients]:
    """All caps, piece by piece; several pieces at once, as most of the work lets go of Python's lock."""
    pieces = pieces_of(packed.clusters.sizes * np.array([content.width for content in coded.caps]), _PIECE)
    surface_of(packed.mesh.receivers)
    # One thread of BLAS for each of these: more would wait for each other over small principal axes.
    count = min(len(pieces), os.cpu_count() or 1, _THREADS)
    with threadpool_limits(1, "blas"), ThreadPoolExecutor(count) as threads:
        for decoded in threads.map(lambda piece: _decode_coded(packed, piece), pieces):
            yield from decoded


def _decode_coded(packed: CompressedTransfer, caps: range) -> list[CapCoefficients]:
    assert packed.coded is not None
    rows = surface_of(packed.mesh.receivers).rows([packed.clusters.members[c] for c in caps])
    components = [packed.bases[c].count * packed.channels for c in caps]
    tuning = packed.coded.tuning
    try:
        decoded = decode_caps(packed.coded.caps[caps.start : caps.stop], components, rows, tuning)
    except ValueError as error:
        raise UserError(f"coefficients cannot be decoded ({error}); precompute the file again") from None
    return [CapCoefficients(cap.values(tuning.step), cap.axes) for cap in decoded]


def remember(packed: CompressedTransfer, decoded: tuple[DecodedCap, ...]) -> None:
    """What the encoder knows need not be decoded."""
    assert packed.coded is not None
    step = packed.coded.tuning.step
    _decoded[packed] = tuple(CapCoefficients(cap.values(step), cap.axes) for cap in decoded)


def forget(packed: CompressedTransfer) -> None:
    """Free the memory of `decode_all`."""
    _decoded.pop(packed, None)


def reconstruct(packed: CompressedTransfer, vertices: NDArray[np.integer] | None = None) -> NDArray[np.float32]:
    """Transfer vectors as the file has them; see `CompressedTransfer.reconstruct`."""
    receivers, clusters = packed.mesh.receivers, packed.clusters
    wanted = np.arange(len(receivers)) if vertices is None else np.asarray(vertices)
    vectors = np.zeros((wanted.size, packed.channels, num_coefficients(packed.bandlimit)), dtype=np.float32)
    mixing = channel_mixing(packed.channels)
    known = _decoded.get(packed)
    if known is None and vertices is None:
        known = decode_all(packed)  # together: far faster than cap by cap
        forget(packed)
    caps, active = clusters.index[wanted], receivers.active[wanted]
    for c in np.unique(caps[active]):
        rows = np.flatnonzero((caps == c) & active)
        coefficients = decode(packed, int(c)) if known is None else known[c]
        places = np.searchsorted(clusters.members[c], wanted[rows])
        chosen = coefficients._replace(values=coefficients.values[places]).in_basis()
        mixed = packed.bases[c].reconstruct(chosen, packed.channels)
        if packed.mean is not None:
            mixed[:, 0] += packed.mean.vectors(packed.normals[wanted[rows]], int(clusters.occlusion_classes[c]))
        vectors[rows] = mixed if packed.channels == 1 else np.einsum("dc,ndm->ncm", mixing, mixed)
    return vectors


def coded_along_principal_axes(packed: CompressedTransfer) -> tuple[bool, ...]:
    """Which caps are coded along their principal axes."""
    return () if packed.coded is None else tuple(content.principal_axes for content in packed.coded.caps)


_decoded: WeakKeyDictionary[CompressedTransfer, tuple[CapCoefficients, ...]] = WeakKeyDictionary()
