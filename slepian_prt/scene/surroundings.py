"""The faces around each vertex, corner by corner, and points just above them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from slepian_prt.scene.scene import Scene

# Rays start this part of the shortest edge at the vertex above the faces, but no less than so many units in the last
# place (float32) of the corners of those faces: Embree subtracts the origin of the ray from them. From the vertex
# itself 41 % of the rays of a convex icosphere are falsely blocked.
_PART_OF_EDGE = 1e-4
_UNITS = 32.0

# Points above the faces that an origin has to reach lie so many heights beside the vertex, and in the face.
_BESIDE = 4.0
_PART_OF_FACE = 0.25

# Cosines: the normal tells the side of the faces; faces that agree on one plane; a normal that lies in that plane.
_TELLS_SIDE, _IS_PLANE, _IN_PLANE = 0.1, 0.9, 0.5

# The least cosine between a face and the way up from the vertex that a lower height is made up for.
_STEEPEST = 0.1


def ray_heights(positions: NDArray, faces: NDArray) -> NDArray[np.float64]:
    """(V,) how far above the faces of a vertex its rays start; zero at vertices that no face uses."""
    shortest = np.full(len(positions), np.inf)
    largest = np.zeros(len(positions))
    extent = np.abs(positions[faces]).max(axis=(1, 2))
    for k in range(3):
        a, b = faces[:, k], faces[:, (k + 1) % 3]
        length = np.linalg.norm(positions[b] - positions[a], axis=1)
        np.minimum.at(shortest, a, length)
        np.minimum.at(shortest, b, length)
        np.maximum.at(largest, a, extent)
    shortest[~np.isfinite(shortest)] = 0.0
    rounding = np.where(largest > 0.0, np.spacing(largest.astype(np.float32)), 0.0)
    return np.maximum(_PART_OF_EDGE * shortest, _UNITS * rounding)


class PointsAbove(NamedTuple):
    """Points above the surface.

    Attributes
    ----------
    vertices : (n,)
        Whose they are.
    feet, points : (n, 3)
        On the surface, and above it.
    """

    vertices: NDArray[np.integer]
    feet: NDArray[np.float64]
    points: NDArray[np.float64]


class Surroundings:
    """The faces around each vertex, corner by corner.

    Attributes
    ----------
    scene : Scene
    positions, normals : (V, 3)
    heights : (V,)
    angle : (V,)
        Sum of the angles of the faces.
    up : (V, 3)
        Unit vectors: the mean of the faces' normals, on the side that the vertex normal tells.
    side : (V,)
        1, or -1 where the winding of the faces is against the normal; 0 where the faces do not agree, and each is
        taken on the side of the normal.
    sheets : (V,) bool
        See `RayOrigins`.
    """

    # Of each face at its three corners: angles (F, 3), unit vectors that halve them (F, 3, 3), and the shorter of the
    # two edges there (F, 3).
    _angles: NDArray[np.float32]
    _inward: NDArray[np.float32]
    _shorter: NDArray[np.float32]

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.positions, self.normals = scene.traced_positions, scene.receivers.normals
        self.heights = scene.ray_heights
        self._faces = scene.mesh.faces
        corner = self.positions[self._faces]
        edges = np.roll(corner, -1, axis=1) - corner
        face_normals = np.cross(edges[:, 0], edges[:, 1])
        area = np.linalg.norm(face_normals, axis=1, keepdims=True)
        self._face_normals = np.divide(face_normals, area, out=np.zeros_like(face_normals), where=area > 0.0)
        # Kept, as they are asked for again and again; float32, as there are three for each face.
        before = -np.roll(edges, 1, axis=1)
        self._angles = np.arctan2(area, np.einsum("fkc,fkc->fk", edges, before)).astype(np.float32)
        length = np.maximum(np.linalg.norm(edges, axis=2), 1e-300)
        length_before = np.roll(length, 1, axis=1)
        self._shorter = np.minimum(length, length_before).astype(np.float32)
        inward = edges / length[:, :, None] + before / length_before[:, :, None]
        inward /= np.maximum(np.linalg.norm(inward, axis=2, keepdims=True), 1e-300)
        self._inward = inward.astype(np.float32)
        count = len(self.positions)
        self.angle, mean = np.zeros(count), np.zeros((count, 3))
        for k in range(3):
            vertex, angle = self._faces[:, k], self._angles[:, k]
            self.angle += np.bincount(vertex, angle, minlength=count)
            for axis in range(3):
                mean[:, axis] += np.bincount(vertex, angle * self._face_normals[:, axis], minlength=count)
        size = np.linalg.norm(mean, axis=1)
        along = np.einsum("ij,ij->i", mean, self.normals)
        tells = np.abs(along) > _TELLS_SIDE * self.angle
        agree = size > _IS_PLANE * self.angle
        self.side = np.where(tells, np.sign(along), np.where(agree, 1.0, 0.0))
        self.up = self.normals.copy()
        known = self.side != 0.0
        self.up[known] = (self.side / np.maximum(size, 1e-300))[known, None] * mean[known]
        in_plane = np.abs(np.einsum("ij,ij->i", self.up, self.normals)) < _IN_PLANE
        self.sheets = agree & in_plane & scene.receivers.active

    def _upward(self, k: int) -> NDArray[np.float64]:
        """(F, 3) normals of the faces on the side that light is received on at corner k."""
        vertex = self._faces[:, k]
        side = self.side[vertex]
        toward = np.einsum("ij,ij->i", self._face_normals, self.normals[vertex])
        return np.where(side == 0.0, np.where(toward < 0.0, -1.0, 1.0), side)[:, None] * self._face_normals

    def above(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(V, 3) points above the vertices, and the points of the surface below them.

        At the border of a surface they are a little inward, because the border of a wall often lies in the plane of the
        next one, which rays would start in and never meet; everywhere they lean towards one of the faces, so that the
        plane of something that stands on the vertex does not hold them.
        """
        count = len(self.positions)
        middle, widest, lean = np.zeros((count, 3)), np.zeros(count), np.zeros((count, 3))
        lowest = np.ones(count)
        for k in range(3):
            vertex, angle, inward = self._faces[:, k], self._angles[:, k], self._inward[:, k]
            for axis in range(3):
                middle[:, axis] += np.bincount(vertex, angle * inward[:, axis], minlength=count)
            order = np.argsort(angle, kind="stable")  # the widest is written last
            wider = order[angle[order] > widest[vertex[order]]]
            lean[vertex[wider]], widest[vertex[wider]] = inward[wider], angle[wider]
            np.minimum.at(lowest, vertex, np.einsum("ij,ij->i", self._upward(k), self.up[vertex]))
        middle /= np.maximum(self.angle, 1e-300)[:, None]
        middle -= np.einsum("ij,ij->i", middle, self.up)[:, None] * self.up
        # The mean over a half plane, as at a border, has the length 2/π.
        feet = self.positions + self.heights[:, None] * (0.5 * np.pi * middle + 0.25 * lean)
        height = self.heights / np.maximum(lowest, _STEEPEST)
        return feet + height[:, None] * self.up, feet

    def beside(self, wanted: NDArray[np.bool_] | None = None) -> Iterator[tuple[NDArray[np.float32], PointsAbove]]:
        """Points above the faces of vertices (all, or the ones ``wanted``), with the angles of the faces there."""
        for k in range(3):
            vertex = self._faces[:, k]
            rows = slice(None) if wanted is None else np.flatnonzero(wanted[vertex])
            vertex, upward = vertex[rows], self._upward(k)[rows]
            angle, inward, shorter = (values[rows, k] for values in (self._angles, self._inward, self._shorter))
            distance = np.minimum(_BESIDE * self.heights[vertex], _PART_OF_FACE * shorter)
            feet = self.positions[vertex] + distance[:, None] * inward
            yield angle, PointsAbove(vertex, feet, feet + self.heights[vertex][:, None] * upward)

    def beside_widest(self, vertices: NDArray) -> PointsAbove:
        """The point above the face of the largest angle of each of some vertices."""
        wanted = np.zeros(len(self.positions), dtype=bool)
        wanted[vertices] = True
        angles, points = zip(*self.beside(wanted), strict=True)
        joined = join_points(points)
        order = np.lexsort([np.concatenate(angles), joined.vertices])
        last = order[np.append(np.diff(joined.vertices[order]) > 0, True)]
        return PointsAbove(*(values[last] for values in joined))


def join_points(points: tuple[PointsAbove, ...]) -> PointsAbove:
    """All of several sets."""
    return PointsAbove(*(np.concatenate(values) for values in zip(*points, strict=True)))
