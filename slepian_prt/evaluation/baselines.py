"""What others do, as their authors would tune it: wavelets on a cube, and what Direct3D's PRT library recommends."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.grouping import Grouping
from slepian_prt.compression.stream import compress
from slepian_prt.relighting.relight import relight
from slepian_prt.sphere.harmonics import num_coefficients, real_sh
from slepian_prt.transport.transfer import Transfer

_BLOCK = 4096

# What Direct3D's PRT library (D3DX) recommends: SH of order 6, 24 PCA vectors.
D3DX_BANDLIMIT, D3DX_TERMS = 5, 24


@dataclass(frozen=True)
class HaarTransfer:
    """Transfer as its largest Haar coefficients on the faces of a cube (Ng, Ramamoorthi & Hanrahan, SIGGRAPH 2003).

    The functions Σ t_lm y_lm are sampled at the texels, scaled by the root of their solid angle so that coefficients
    are orthonormal; each vertex keeps its largest, in 8 bits each beside one float16, and their places in as few bits
    as tell them apart.

    Attributes
    ----------
    coefficients : sparse (V channels, 6 n²) float32
        Those that are kept.
    back : (6 n², (L+1)²) float32
        Onto spherical harmonics.
    albedo : (V, 3)
    terms, channels : int
    """

    coefficients: csr_array
    back: NDArray[np.float32]
    albedo: NDArray[np.float32]
    terms: int
    channels: int

    @property
    def bytes_per_vertex(self) -> float:
        """Values and their places; nothing else needs to be stored."""
        bits = self.terms * (8 + math.ceil(math.log2(self.coefficients.shape[1]))) + 16
        return self.channels * bits / 8.0

    def reconstruct(self) -> NDArray[np.float32]:
        """(V, channels, (L+1)²) transfer vectors."""
        vectors = np.asarray(self.coefficients @ self.back, dtype=np.float32)
        return vectors.reshape(-1, self.channels, vectors.shape[1])

    def radiance(self, lighting: NDArray) -> NDArray[np.float32]:
        """(V, 3) outgoing radiance under lighting (3, (L+1)²)."""
        lit = np.asarray(self.coefficients @ (self.back @ lighting.T.astype(np.float32)), dtype=np.float32)
        if self.channels == 3:
            lit = np.einsum("vcc->vc", lit.reshape(-1, 3, 3))
        return lit * self.albedo


def haar_transfer(vectors: NDArray, terms: int, albedo: NDArray) -> HaarTransfer:
    """Keep the ``terms`` largest Haar coefficients of each of (V, channels, (L+1)²) transfer vectors."""
    channels, size = vectors.shape[1:]
    bandlimit = round(math.sqrt(size)) - 1
    side = 1 << max(2, math.ceil(math.log2(bandlimit + 1)))
    directions, solid_angles = cube_texels(side)
    samples = real_sh(bandlimit, directions) * np.sqrt(solid_angles)[:, None]
    forward = haar_faces(samples.reshape(6, side, side, size)).reshape(-1, size)
    # The texels are not quite a quadrature: least squares, so that all coefficients give all of the vector.
    back = np.linalg.pinv(forward).T.astype(np.float32)
    flat = vectors.reshape(-1, size)
    terms = min(terms, len(forward))
    values = np.empty((len(flat), terms), dtype=np.float32)
    places = np.empty((len(flat), terms), dtype=np.int32)
    for begin in range(0, len(flat), _BLOCK):
        block = slice(begin, begin + _BLOCK)
        rows = flat[block] @ forward.T.astype(np.float32)
        places[block] = np.argpartition(-np.abs(rows), terms - 1, axis=1)[:, :terms]
        chosen = np.take_along_axis(rows, places[block].astype(np.intp), axis=1)
        largest = np.abs(chosen).max(axis=1, keepdims=True)
        values[block] = np.rint(chosen / np.maximum(largest, 1e-30) * 127.0) * largest / 127.0
    starts = np.arange(len(flat) + 1) * terms
    kept = csr_array((values.ravel(), places.ravel(), starts), shape=(len(flat), len(forward)))
    return HaarTransfer(kept, back, albedo, terms, channels)


def cube_texels(side: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centres (6 n², 3) and solid angles (6 n²,) of the texels of a cube map."""
    edges = np.linspace(-1.0, 1.0, side + 1)
    middle = 0.5 * (edges[1:] + edges[:-1])
    u, v = np.meshgrid(middle, middle, indexing="ij")
    corner = np.arctan2(edges[:, None] * edges[None, :], np.sqrt(edges[:, None] ** 2 + edges[None, :] ** 2 + 1.0))
    area = corner[1:, 1:] - corner[1:, :-1] - corner[:-1, 1:] + corner[:-1, :-1]
    directions = []
    for axis in range(3):
        for sign in (1.0, -1.0):
            face = np.empty((side, side, 3))
            face[..., axis], face[..., (axis + 1) % 3], face[..., (axis + 2) % 3] = sign, u, v
            directions.append(face.reshape(-1, 3))
    points = np.concatenate(directions)
    return points / np.linalg.norm(points, axis=1, keepdims=True), np.tile(area.ravel(), 6)


def haar_faces(faces: NDArray) -> NDArray:
    """Orthonormal two-dimensional Haar transform of (6, n, n, …), n a power of two, levels of both axes together."""
    result = np.array(faces, dtype=np.float64)
    side = result.shape[1]
    while side > 1:
        for axis in (1, 2):
            part = np.moveaxis(result[:, :side, :side], axis, 0)
            even, odd = part[0::2], part[1::2]
            low, high = (even + odd) * math.sqrt(0.5), (even - odd) * math.sqrt(0.5)
            part[...] = np.concatenate([low, high])
        side //= 2
    return result


@dataclass(frozen=True)
class PaddedTransfer:
    """Compressed transfer of a lower bandlimit, taken for that of a higher one.

    Attributes
    ----------
    packed : CompressedTransfer
    size : int
        (L+1)² of the higher bandlimit L.
    """

    packed: CompressedTransfer
    size: int

    @property
    def bytes_per_vertex(self) -> float:
        return self.packed.bytes_per_vertex

    def reconstruct(self) -> NDArray[np.float32]:
        """(V, channels, (L+1)²) transfer vectors, zero above the lower bandlimit."""
        vectors = self.packed.reconstruct()
        return np.pad(vectors, [(0, 0), (0, 0), (0, self.size - vectors.shape[-1])])

    def radiance(self, lighting: NDArray) -> NDArray[np.float32]:
        """(V, 3) outgoing radiance under lighting (3, (L+1)²)."""
        return relight(self.packed, lighting[:, : num_coefficients(self.packed.bandlimit)])


def d3dx_transfer(transfer: Transfer, grouping: Grouping) -> PaddedTransfer:
    """Clustered PCA of degrees up to 5 with 24 terms."""
    bandlimit = min(transfer.bandlimit, D3DX_BANDLIMIT)
    terms = min(D3DX_TERMS, num_coefficients(bandlimit))
    packed = compress(transfer.at_bandlimit(bandlimit), "cpca", terms=terms, coding="float16", clusters=grouping)
    return PaddedTransfer(packed, num_coefficients(transfer.bandlimit))
