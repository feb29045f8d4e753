"""Cells of the vertices of a surface, a third of each face about them, and how much of them a ball holds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slepian_prt.scene.mesh import Mesh


class Cells:
    """Of each face three cells, of one vertex each: between it, the middles of its two edges and the centroid.

    Parameters
    ----------
    mesh : Mesh

    Attributes
    ----------
    extents : (V,)
        How far the cells of a vertex reach from it.
    """

    def __init__(self, mesh: Mesh) -> None:
        corners = mesh.faces.ravel()
        order = np.argsort(corners, kind="stable")  # a vertex has its cells side by side
        self._positions, self._face = mesh.positions, order // 3
        self._first = np.concatenate([[0], np.cumsum(np.bincount(corners, minlength=len(mesh.positions)))])
        a, b, c = (mesh.positions[mesh.faces[:, corner]] for corner in range(3))
        along, normal = _unit(b - a), _unit(np.cross(b - a, c - a))
        self._frames = np.stack([along, np.cross(normal, along), normal], axis=1)
        # Outlines (3F, 4) in the planes of the faces, x + iy, seen from the vertex.
        flat = np.stack([np.zeros(len(a), dtype=complex), self._flat(b - a), self._flat(c - a)], axis=1)
        following, before = (np.roll(flat, -step, axis=1) - flat for step in (1, 2))
        centroid = (following + before) / 3.0
        outlines = np.stack([np.zeros_like(flat), following / 2.0, centroid, before / 2.0], axis=2)
        self._outlines = outlines.reshape(-1, 4)[order]
        self.extents = np.zeros(len(mesh.positions))
        np.maximum.at(self.extents, corners[order], np.abs(self._outlines).max(axis=1))

    def _flat(self, points: NDArray) -> NDArray[np.complex128]:
        """(F, 3) in the plane of each face."""
        return np.einsum("fj,fj->f", self._frames[:, 0], points) + 1j * np.einsum(
            "fj,fj->f", self._frames[:, 1], points
        )

    def areas_within(self, vertices: NDArray, middle: NDArray, radius: float) -> NDArray[np.float64]:
        """(n,) the area of the cells of some vertices that lies in a ball, to rounding.

        Parameters
        ----------
        vertices : (n,) int
        middle : (3,)
        radius : float
        """
        counts = self._first[vertices + 1] - self._first[vertices]
        owners = np.repeat(np.arange(vertices.size), counts)
        cells = np.arange(owners.size) + (self._first[vertices] - np.cumsum(counts) + counts)[owners]
        away = (middle - self._positions[vertices])[owners]
        x, y, height = np.einsum("nij,nj->in", self._frames[self._face[cells]], away)
        areas = _areas_in_discs(self._outlines[cells] - (x + 1j * y)[:, None], radius * radius - height * height)
        return np.bincount(owners, areas, minlength=vertices.size).astype(np.float64)


def _areas_in_discs(p: NDArray[np.complex128], squared: NDArray) -> NDArray[np.float64]:
    """(n,) of flat polygons (n, k), x + iy, the area in discs about zero of these squared radii; none if negative.

    Twice the area is the sum over edges p → q of that of the triangle from the disc's centre to the part of the edge
    that lies in it, and of the sectors of the disc in which the parts before and after it are seen.
    """
    squared = np.maximum(squared, 0.0)[:, None]
    d = np.roll(p, -1, axis=1) - p
    pp, dd, pd = (p * p.conj()).real, (d * d.conj()).real, p.conj() * d
    # From where to where, in parts of the edge, |p + t d|² is at most the squared radius.
    root = np.sqrt(np.maximum(pd.real * pd.real - dd * (pp - squared), 0.0))
    scale = np.maximum(dd, 1e-300)
    enter, leave = np.clip((-pd.real - root) / scale, 0.0, 1.0), np.clip((-pd.real + root) / scale, 0.0, 1.0)
    sectors = np.angle(pp + enter * pd) + np.angle((pp + leave * pd.conj()) + (pd + leave * dd))
    twice = np.sum((leave - enter) * pd.imag + squared * sectors, axis=1)
    return np.maximum(0.5 * twice, 0.0)


def _unit(vectors: NDArray) -> NDArray[np.float64]:
    """Of length one; zero stays zero."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300)
