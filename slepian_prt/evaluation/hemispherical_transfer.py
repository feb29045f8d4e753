"""Transfer as hemispherical harmonics about the normals of vertices, another way to use that light comes from above."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slepian_prt.sphere.harmonics import bandlimit_of
from slepian_prt.sphere.hemispherical import sh_over_hemisphere
from slepian_prt.sphere.rotation import rotate_sh, rotation_to
from slepian_prt.transport.transfer import Transfer

_BLOCK = 4096

# Directions of coefficient space in which hemispherical harmonics hold less than this are left out: float16, in which
# coefficients are kept, rounds by half of it.
_SMALLEST = 1e-3


@dataclass(frozen=True)
class HemisphericalTransfer:
    """Transfer of each vertex as hemispherical harmonics h_k of its own hemisphere (Gautron et al., EGSR 2004).

    Attributes
    ----------
    coefficients : (V, channels, K) float16
        K = n², degrees below n.
    frames : (V, 3, 3) float32
        Rotations that take z to the normals. They follow from normals, which the mesh has anyway.
    integrals : ((L+1)², K) float32
        ∫ y h over a hemisphere: how spherical harmonics of the light meet them.
    albedo : (V, 3)
    """

    coefficients: NDArray[np.float16]
    frames: NDArray[np.float32]
    integrals: NDArray[np.float32]
    albedo: NDArray[np.float32]

    @property
    def terms(self) -> int:
        """K."""
        return self.coefficients.shape[2]

    @property
    def bytes_per_vertex(self) -> float:
        """Two of each coefficient; nothing else needs to be stored."""
        return 2.0 * self.coefficients.shape[1] * self.terms

    def reconstruct(self) -> NDArray[np.float32]:
        """(V, channels, (L+1)²) transfer vectors: spherical harmonics of what is held, which vanishes below."""
        return np.concatenate([vectors for _, vectors in self._blocks()])

    def radiance(self, lighting: NDArray) -> NDArray[np.float32]:
        """(V, 3) outgoing radiance under lighting (3, (L+1)²).

        That is c · Aᵀ Rᵀ e, coefficients times the light as hemispherical harmonics in the vertex's frame; taken as
        (R A c) · e, which is the same and rotates one vector for each vertex instead of three.
        """
        light = lighting.astype(np.float32)
        radiance = np.empty((len(self.coefficients), 3), dtype=np.float32)
        for block, vectors in self._blocks():
            radiance[block] = np.einsum(
                "vcm,cm->vc", np.broadcast_to(vectors, (len(vectors), 3, light.shape[1])), light
            )
        return radiance * self.albedo

    def _blocks(self) -> Iterator[tuple[slice, NDArray[np.float32]]]:
        """Transfer vectors of some vertices at a time."""
        for begin in range(0, len(self.coefficients), _BLOCK):
            block = slice(begin, begin + _BLOCK)
            local = self.coefficients[block].astype(np.float32) @ self.integrals.T
            yield block, rotate_sh(local, self.frames[block, None])


def hemispherical_transfer(transfer: Transfer, terms: int) -> HemisphericalTransfer:
    """Transfer in the hemispherical harmonics of as many whole degrees as ``terms`` allow: n² <= terms functions.

    The coefficients are those that light of the transfer's bandlimit sees best, by least squares. What is traced is the
    bandlimited part of a function that vanishes below the horizon; where harmonics of the hemisphere hold that
    function, as they do (n·ω)₊ with two of them, this finds it, whereas the inner product with the part would not.

    Parameters
    ----------
    transfer : Transfer
    terms : int >= 1
    """
    vectors, normals = transfer.vectors, transfer.normals
    bandlimit = bandlimit_of(vectors.shape[2])
    integrals = sh_over_hemisphere(bandlimit, bandlimit_of(terms))
    solve = np.linalg.pinv(integrals, rcond=_SMALLEST).T.astype(np.float32)
    upward = np.where(np.any(normals != 0.0, axis=1)[:, None], normals, (0.0, 0.0, 1.0))
    frames = rotation_to(upward).astype(np.float32)
    coefficients = np.empty((*vectors.shape[:2], integrals.shape[1]), dtype=np.float16)
    for begin in range(0, len(vectors), _BLOCK):
        block = slice(begin, begin + _BLOCK)
        local = rotate_sh(vectors[block], np.swapaxes(frames[block], -1, -2)[:, None])
        coefficients[block] = local @ solve
    return HemisphericalTransfer(coefficients, frames, integrals.astype(np.float32), transfer.mesh.albedo)
