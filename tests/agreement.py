"""The package and the reader written from docs/file-format.md get the same of a file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import slepian_prt as sp
from slepian_prt.compression.codec.caps import DecodedCap, decode_caps
from slepian_prt.compression.codec.surface import surface_of
from slepian_prt.compression.compressed import CompressedTransfer
from tests.format_reader import File, read
from tests.numerics import assert_exact, assert_rounded


def assert_readers_agree(path: Path) -> tuple[CompressedTransfer, File]:
    """Caps, integers and stored floats bit for bit; principal axes to rounding. What both read."""
    packed, file = sp.load(path), read(path)
    assert_exact(file.index, packed.clusters.index, "integers decide which cap a vertex belongs to")
    decoded: Sequence[DecodedCap | None] = [None] * len(file.caps)
    if packed.coded is not None:
        rows = surface_of(packed.mesh.receivers).rows(packed.clusters.members)
        widths = [basis.count * packed.channels for basis in packed.bases]
        decoded = decode_caps(packed.coded.caps, widths, rows, packed.coded.tuning)
        assert file.caps[0].scale == packed.coded.tuning.step / 16
    for number, (theirs, ours) in enumerate(zip(file.caps, decoded, strict=True)):
        assert_exact(theirs.members, packed.clusters.members[number], "the same index")
        if ours is None:
            assert_exact(theirs.numbers, packed.coefficients[number], "stored as they are")
            continue
        told = ours.multiples.shape[1]
        assert theirs.numbers.shape == (len(ours.multiples), ours.count)
        assert_exact(theirs.numbers[:, :told], ours.multiples, "integers")
        assert not theirs.numbers[:, told:].any()
        assert (theirs.axes is None) == (ours.axes is None)
        if ours.axes is not None and theirs.axes is not None:
            # Each axis less its parts along at most all others, of length 1.
            assert_rounded(theirs.axes, ours.axes, terms=10 * len(ours.axes), size=1.0)
    return packed, file
