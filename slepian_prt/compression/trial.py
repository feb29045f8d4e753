"""Some caps coded on trial: what compression would lose and cost, before all vectors are there."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.attempts import lost_by_degree
from slepian_prt.compression.blocks import CapBlocks
from slepian_prt.compression.codec.caps import decode_caps
from slepian_prt.compression.codec.encoding import encode_caps
from slepian_prt.compression.codec.prediction import LARGEST_MULTIPLE
from slepian_prt.compression.codec.tuning import tune
from slepian_prt.compression.encoder import (
    WarmStart,
    allowed_distortion,
    measure_expectation,
    principal_axes_asked,
)
from slepian_prt.compression.pilot import channel_mixing
from slepian_prt.compression.prediction import Expectation
from slepian_prt.compression.projection import Projection
from slepian_prt.lighting.spectrum import light_power
from slepian_prt.machine.threads import one_blas_thread


@dataclass(frozen=True)
class CodingTrial:
    """What coding some of the caps gave.

    Attributes
    ----------
    projection : Projection
    warm_start : WarmStart
        For coding all of them.
    expected : Expectation
        Of a vector, by degree, as measured on these caps.
    missed : (L+1,)
        The part of it that the bases miss.
    errors : (K channels, K channels)
        Mean products of the coefficients' errors.
    decoded : list of (n, K channels)
        The coefficients as they will be decoded, for each cap in the order of its members.
    bytes_per_vertex : float
        In these caps.
    reading, coding, decoding : float
        Seconds to lay out the surface of these caps, to code them, with a choice of axes, and to decode them.
    """

    projection: Projection
    warm_start: WarmStart
    expected: Expectation
    missed: NDArray[np.float64]
    errors: NDArray[np.float64]
    decoded: list[NDArray[np.float32]]
    bytes_per_vertex: float
    reading: float
    coding: float
    decoding: float

    def error_under(self, lighting: NDArray) -> NDArray[np.float64]:
        """(3,) mean squared errors of radiance under one light (3, (L+1)²), were coefficients off alike in all caps.

        What caps have in common is their functions, not how they stand. What the bases miss counts averaged over the
        rotations of the light.
        """
        learned, bases = self.projection.learned, self.projection.bases
        count, channels = bases[0].count, learned.channels
        mixing = channel_mixing(channels).astype(np.float64)
        products = self.errors.reshape(count, channels, count, channels)
        squares = self.missed @ np.array([light_power(light) for light in lighting]).T
        sizes = learned.clusters.sizes
        for basis, size in zip(bases, sizes, strict=True):
            along = basis.synthesis @ lighting.T  # (K, 3)
            for c in range(3):
                mixed = mixing[:, c if channels == 3 else 0]
                of_channel = np.einsum("kdle,d,e->kl", products, mixed, mixed)
                squares[c] += size / sizes.sum() * float(along[:, c] @ of_channel @ along[:, c])
        return squares


def try_caps(projection: Projection, blocks: CapBlocks, caps: Sequence[int]) -> CodingTrial:
    """Code the given caps, whose receivers alone are in the blocks."""
    total, missed = blocks.energies()
    begin = time.perf_counter()
    samples, rows = [blocks.coefficients(c) for c in caps], blocks.rows(caps)
    read = time.perf_counter()
    with one_blas_thread():
        distortion = allowed_distortion(projection, total, missed)
        axes = principal_axes_asked(projection)
        tuning = tune(samples, rows, distortion, blocks.largest() / LARGEST_MULTIPLE, axes)
        tuned = time.perf_counter()
        encoded = encode_caps(samples, rows, tuning, principal_axes=[axes] * len(caps))
        coded = time.perf_counter()
    channels = projection.learned.channels
    counts = [projection.bases[c].count * channels for c in caps]
    decoded = decode_caps([cap.content for cap in encoded], counts, rows, tuning)
    read_back = time.perf_counter()
    size = blocks.size(caps)
    lost = [lost_by_degree(projection, c, cap) for c, cap in zip(caps, encoded, strict=True)]
    expected, missing = measure_expectation(projection, lost, size, total, missed)
    return CodingTrial(
        projection,
        WarmStart(tuning),
        expected,
        missing,
        np.sum([cap.errors for cap in encoded], axis=0) / size,
        [cap.coefficients(tuning.step).astype(np.float32) for cap in decoded],
        sum(cap.content.size for cap in encoded) / size,
        read - begin,
        coded - tuned,
        read_back - coded,
    )
