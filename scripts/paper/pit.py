"""Partial occlusion, the setup of Lessig & Fiume, EGSR 2010, Fig. 4: a hemispherical pit under symmetric light."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from slepian_prt.scene.mesh import Mesh, make_mesh
from slepian_prt.sphere.harmonics import legendre_polynomials
from slepian_prt.sphere.quadrature import gauss_legendre
from slepian_prt.transport.transfer import precompute


def hemispherical_pit(inner: float, rings: int = 40, spokes: int = 90) -> Mesh:
    """The inside of a hemisphere open towards z, finer within the angle ``inner`` (radians) of its lowest point."""
    fine = np.linspace(0.0, inner, rings + 1)[1:]
    coarse = np.linspace(inner, 0.5 * np.pi, 46)[1:]
    theta = np.concatenate([fine, coarse])
    phi = 2.0 * np.pi * np.arange(spokes) / spokes
    x, y = np.outer(np.sin(theta), np.cos(phi)), np.outer(np.sin(theta), np.sin(phi))
    z = np.broadcast_to(-np.cos(theta)[:, None], x.shape)
    positions = np.concatenate([[[0.0, 0.0, -1.0]], np.stack([x, y, z], axis=-1).reshape(-1, 3)])
    k = np.arange(spokes)
    following = (k + 1) % spokes
    faces = [np.column_stack([np.zeros_like(k), 1 + k, 1 + following])]
    for ring in range(len(theta) - 1):
        a, b = 1 + ring * spokes + k, 1 + ring * spokes + following
        faces += [np.column_stack([a, a + spokes, b]), np.column_stack([b, a + spokes, b + spokes])]
    return make_mesh(positions, np.concatenate(faces), normals=-positions, name="pit")


def traced_pit_transfer(bandlimit: int, angles: NDArray, samples: int = 4096) -> NDArray[np.float64]:
    """Transfer on the floor of the pit by tracing rays: degree l, order 0, averaged around the axis, (n, L+1).

    ``angles`` (n,) from the axis are in radians, ascending by equal steps from zero.
    """
    pit = hemispherical_pit(float(angles[-1]), len(angles) - 1)
    l = np.arange(bandlimit + 1)
    vectors = precompute(pit, bandlimit, samples).vectors[:, 0][:, l * (l + 1)].astype(np.float64)
    spokes = 90
    rings = vectors[1 : 1 + spokes * (len(angles) - 1)].reshape(len(angles) - 1, spokes, -1)
    return np.concatenate([vectors[:1], rings.mean(axis=1)])


def exact_pit_transfer(bandlimit: int, angles: NDArray, nodes: int = 160) -> NDArray[np.float64]:
    """The same by integration over the open disk of the pit, on which nothing blocks, (n, L+1)."""
    rule = gauss_legendre(nodes)
    radius = 0.5 * (1.0 + rule.nodes)
    phi = 2.0 * np.pi * np.arange(2 * nodes) / (2 * nodes)
    area = (0.5 * rule.weights * radius)[:, None] * (2.0 * np.pi / phi.size)
    disk = np.stack(np.broadcast_arrays(np.outer(radius, np.cos(phi)), np.outer(radius, np.sin(phi)), 0.0), axis=-1)
    result = np.empty((len(angles), bandlimit + 1))
    for i, angle in enumerate(angles):
        normal = np.array([-math.sin(angle), 0.0, math.cos(angle)])
        to_disk = disk + normal  # from the point -n of the unit sphere
        distance = np.linalg.norm(to_disk, axis=-1)
        solid = area * to_disk[..., 2] / distance**3
        cosine = np.maximum(to_disk @ normal / distance, 0.0)
        harmonics = legendre_polynomials(bandlimit, 0, (to_disk[..., 2] / distance).ravel())
        result[i] = harmonics @ (solid * cosine / np.pi).ravel()
    return result


def pit_spectrum(transfer: NDArray, angles: NDArray) -> NDArray[np.float64]:
    """Squared singular values, the first being 1, from symmetric light to exit radiance on the floor.

    Parameters
    ----------
    transfer : (n, L+1)
        At ``angles`` from the axis, evenly spaced from zero.
    angles : (n,)
    """
    weight = np.sin(angles)
    weight[[0, -1]] = 0.25 * np.sin(angles[1]), 0.5 * weight[-1]
    squared = np.linalg.svd(np.sqrt(weight)[:, None] * transfer, compute_uv=False) ** 2
    return np.asarray(squared / squared[0])
