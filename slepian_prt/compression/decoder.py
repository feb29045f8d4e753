"""Compressed transfer decoded: coefficients of caps, and transfer vectors."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.codec.caps import DecodedCap, decode_cap
from slepian_prt.compression.codec.surface import surface_of
from slepian_prt.compression.pilot import channel_mixing
from slepian_prt.sphere.harmonics import num_coefficients

if TYPE_CHECKING:
    from slepian_prt.compression.compressed import CompressedTransfer


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
    surface = surface_of(packed.mesh.receivers).cap(packed.clusters.members[cap])
    components = packed.bases[cap].count * packed.channels
    return _sorted(packed, cap, decode_cap(packed.coded.words[cap], components, surface, packed.coded.tuning))


def decode_all(packed: CompressedTransfer) -> tuple[CapCoefficients, ...]:
    """All caps' coefficients; kept until `forget`, because relighting wants them after a file was checked."""
    if packed not in _decoded:
        _decoded[packed] = tuple(decode(packed, c) for c in range(len(packed.bases)))
    return _decoded[packed]


def remember(packed: CompressedTransfer, decoded: tuple[DecodedCap, ...]) -> None:
    """What the encoder knows need not be decoded."""
    _decoded[packed] = tuple(_sorted(packed, c, cap) for c, cap in enumerate(decoded))


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
    return vectors[:, 0] if packed.channels == 1 else vectors


def coded_along_principal_axes(packed: CompressedTransfer) -> tuple[bool, ...]:
    """Which caps are coded along their principal axes."""
    return tuple(cap.axes is not None for cap in decode_all(packed))


def _sorted(packed: CompressedTransfer, cap: int, decoded: DecodedCap) -> CapCoefficients:
    """From the order of coding to that of the cap's members."""
    assert packed.coded is not None
    members = packed.clusters.members[cap]
    values = np.empty(decoded.multiples.shape, dtype=np.float32)
    places = np.searchsorted(members, surface_of(packed.mesh.receivers).cap(members).order)
    values[places] = decoded.values(packed.coded.tuning.step)
    return CapCoefficients(values, decoded.axes)


_decoded: WeakKeyDictionary[CompressedTransfer, tuple[CapCoefficients, ...]] = WeakKeyDictionary()
