"""Compressed transfer decoded: coefficients of caps, and transfer vectors."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.arrays import whole_numbers
from slepian_prt.compression.blocks import pieces_of
from slepian_prt.compression.codec.caps import DecodedCap, decode_caps
from slepian_prt.compression.codec.surface import surface_of
from slepian_prt.compression.pilot import channel_mixing
from slepian_prt.errors import UserError
from slepian_prt.machine.kept import Kept
from slepian_prt.machine.memory import check_memory
from slepian_prt.machine.threads import map_in_threads
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

    def make() -> tuple[CapCoefficients, ...]:
        each = np.array([basis.count for basis in packed.bases]) * packed.channels
        size = 4 * int(packed.clusters.sizes @ each)
        check_memory(size, "what is decoded", "precompute it again with fewer vertices")
        return tuple(_decode_pieces(packed))

    return _decoded.of(packed, make)


def _decode_pieces(packed: CompressedTransfer) -> Iterator[CapCoefficients]:
    """All caps, piece by piece; several pieces at once, as most of the work lets go of Python's lock."""
    coded = packed.coded
    if coded is None:
        yield from (decode(packed, c) for c in range(len(packed.bases)))
        return
    pieces = pieces_of(packed.clusters.sizes * np.array([content.width for content in coded.caps]), _PIECE)
    surface_of(packed.mesh.receivers)
    for decoded in map_in_threads(lambda piece: _decode_coded(packed, piece), pieces, _THREADS):
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
    _decoded.put(packed, tuple(CapCoefficients(cap.values(step), cap.axes) for cap in decoded))


def forget(packed: CompressedTransfer) -> None:
    """Free the memory of `decode_all`."""
    _decoded.forget(packed)


def reconstruct(packed: CompressedTransfer, vertices: NDArray[np.integer] | None = None) -> NDArray[np.float32]:
    """Transfer vectors as the file has them; see `CompressedTransfer.reconstruct`."""
    receivers, clusters = packed.mesh.receivers, packed.clusters
    wanted = np.arange(len(receivers)) if vertices is None else _some_of(vertices, len(receivers))
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


def _some_of(vertices: ArrayLike, count: int) -> NDArray[np.int64]:
    wanted = whole_numbers(vertices, "vertices")
    if np.asarray(vertices).dtype.kind == "b":
        raise UserError("vertices must be their numbers, not which of them; give numpy.flatnonzero of it")
    if wanted.ndim != 1 or wanted.min(initial=0) < 0 or wanted.max(initial=0) >= count:
        raise UserError(f"vertices must be a list of numbers from 0 to {count - 1}, those of the transfer's vertices")
    return wanted


def coded_along_principal_axes(packed: CompressedTransfer) -> tuple[bool, ...]:
    """Which caps are coded along their principal axes."""
    return () if packed.coded is None else tuple(content.principal_axes for content in packed.coded.caps)


_decoded: Kept[CompressedTransfer, tuple[CapCoefficients, ...]] = Kept()
