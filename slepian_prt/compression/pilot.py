"""A few hundred vertices whose transfer is looked at before all others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.clustering import Clusters
from slepian_prt.slepian.kernels import SecondMoment, measured_moment, zonal_vectors
from slepian_prt.sphere.harmonics import bandlimit_of, degrees, real_sh
from slepian_prt.sphere.rotation import rotate_sh, rotation_to

# Vertices of each occlusion class.
PILOT_SIZE = 400


def channel_mixing(channels: int) -> NDArray[np.float32]:
    """Orthonormal rows that turn red, green and blue into channels that hardly correlate: their mean, then tints."""
    if channels == 1:
        return np.ones((1, 1), dtype=np.float32)
    rows = np.array([[1.0, 1.0, 1.0], [1.0, 0.0, -1.0], [1.0, -2.0, 1.0]])
    return (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32)


def decorrelate(vectors: NDArray) -> NDArray[np.float32]:
    """(n, channels, (L+1)²) transfer vectors with their channels mixed by `channel_mixing`."""
    channels = vectors.shape[1]
    return vectors if channels == 1 else np.einsum("dc,ncm->ndm", channel_mixing(channels), vectors)


@dataclass(frozen=True)
class MeanTransfer:
    """The mean transfer in the vertex's own frame, averaged over azimuth: what the normal alone tells of a vector.

    Attributes
    ----------
    zonal : (classes, L+1) float32
        Zonal coefficients t_l for each occlusion class, as of a kernel; of the first (decorrelated) channel.
    """

    zonal: NDArray[np.float32]

    def vectors(self, axes: NDArray, occlusion_class: int) -> NDArray[np.float32]:
        """(n, (L+1)²): t_l y_lm(axis); zero where the axis is."""
        return zonal_vectors(self.zonal[occlusion_class], axes)


@dataclass(frozen=True)
class PilotStatistics:
    """What the pilot's vertices tell, for each occlusion class.

    Attributes
    ----------
    moments : tuple of SecondMoment
        Of transfer vectors in their own frames; of what `mean` leaves of them if there is one.
    energies : (classes, L+1)
        Mean squared norm of a transfer vector in each degree, over vertices and channels.
    mean : MeanTransfer or None
    """

    moments: tuple[SecondMoment, ...]
    energies: NDArray[np.float64]
    mean: MeanTransfer | None = None


def pilot_vertices(clusters: Clusters, axes: NDArray, seed: int) -> NDArray[np.int64]:
    """Every n-th vertex in cluster order, for each occlusion class: stratified over the axes."""
    lit = np.any(axes != 0.0, axis=1)
    rng = np.random.default_rng(seed)
    chosen = []
    for occlusion_class in np.unique(clusters.occlusion_classes):
        in_order = np.concatenate(
            [clusters.members[c] for c in np.flatnonzero(clusters.occlusion_classes == occlusion_class)]
        )
        in_order = in_order[lit[in_order]]
        step = max(1, in_order.size // PILOT_SIZE)
        chosen.append(in_order[rng.integers(step) :: step])
    return np.concatenate(chosen)


def learn(
    clusters: Clusters, axes: NDArray, vertices: NDArray, vectors: NDArray, normals: NDArray | None = None
) -> PilotStatistics:
    """What bases are made from.

    Parameters
    ----------
    clusters : Clusters
    axes : (V, 3)
        Of the vertices' own frames.
    vertices : (n,) of `pilot_vertices`
    vectors : (n, channels, (L+1)²)
        Their transfer, channels decorrelated.
    normals : (V, 3), optional
        If given, the mean transfer about them is taken off first, because the decoder can add it again.
    """
    bandlimit = bandlimit_of(vectors.shape[2])
    classes = clusters.occlusion_classes[clusters.index[vertices]]
    moments, energies, zonal = [], [], []
    for occlusion_class in range(int(clusters.occlusion_classes.max()) + 1):
        chosen = vertices[classes == occlusion_class]
        seen = vectors[classes == occlusion_class].astype(np.float64)
        squares = (seen.reshape(-1, seen.shape[2]) ** 2).mean(axis=0)
        energies.append(np.bincount(degrees(bandlimit), squares, minlength=bandlimit + 1))
        if normals is not None:
            zonal.append(_zonal_mean(bandlimit, seen[:, 0], normals[chosen]))
            seen[:, 0] -= MeanTransfer(zonal[-1][None]).vectors(normals[chosen], 0)
        to_local = np.swapaxes(rotation_to(axes[chosen]), -1, -2)
        moments.append(measured_moment(rotate_sh(seen, to_local[:, None]).reshape(-1, seen.shape[2])))
    mean = MeanTransfer(np.array(zonal)) if normals is not None else None
    return PilotStatistics(tuple(moments), np.array(energies), mean)


def _zonal_mean(bandlimit: int, vectors: NDArray, normals: NDArray) -> NDArray[np.float32]:
    """(L+1,) kernel t_l whose copies about the normals, t_l y_lm(n), are nearest to vectors (n, (L+1)²)."""
    along = vectors * real_sh(bandlimit, normals)
    sums = np.bincount(degrees(bandlimit), along.mean(axis=0), minlength=bandlimit + 1)
    return np.asarray(sums * 4.0 * np.pi / (2.0 * np.arange(bandlimit + 1) + 1.0), dtype=np.float32)
