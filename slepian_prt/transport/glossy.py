"""Transfer of any non-delta BSDF toward one camera.

t_lm(x) = ∫ V(x,ω) f(x,ω,ω_o) (n·ω)₊ y_lm(ω) dω, with ω_o toward the camera: what Lessig & Fiume (EGSR 2010, Sec. 1
and 4) treat as a function of the reflection direction r, at twice the angle of the normal from the view. Two direction
sets are shared by all vertices, so that the projection on harmonics is a matrix product for each: a cosine one about
the normal, and one about r whose density in the angle from r is measured on the scene's own BSDFs. The balance
heuristic (Veach & Guibas 1995) joins them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.scene.materials import surface_points
from slepian_prt.scene.receivers import morton
from slepian_prt.scene.scene import Scene
from slepian_prt.scene.view import View
from slepian_prt.sphere.harmonics import num_coefficients, real_sh
from slepian_prt.sphere.quadrature import hemisphere_fibonacci
from slepian_prt.sphere.rotation import rotate_sh
from slepian_prt.transport.visibility import in_blocks, turned_frames

_RAYS_PER_BLOCK = 1 << 19
_PILOT_VERTICES, _PILOT_SAMPLES = 256, 256
_BINS = 512
# Part of the lobe's set that is spread over the whole sphere, so that no direction is left out.
_SPREAD = 0.1


class ViewTransfer(NamedTuple):
    """Transfer toward a camera.

    Attributes
    ----------
    vectors : (V, channels, (L+1)²) float32
        With the reflectance; zero where the camera sees the back.
    axes : (V, 3)
        Reflection direction of the view about the normal; zero where ``vectors`` are.
    rays : int
    """

    vectors: NDArray[np.float32]
    axes: NDArray[np.float64]
    rays: int


def view_transfer(
    scene: Scene,
    view: View,
    bandlimit: int,
    samples: int,
    seed: int,
    *,
    shadows: bool = True,
    advance: Callable[[int], None] = lambda _: None,
) -> ViewTransfer:
    """Transfer vectors of all vertices toward a camera, for direct light.

    Parameters
    ----------
    scene : Scene
    view : View
    bandlimit : int
    samples : int
        Rays per vertex, half about the normal and half about the reflection direction.
    seed : int
    shadows : bool
    advance : callable
        Told the number of vertices finished since its last call.
    """
    eye = np.array(view.to_world)[:3, 3]
    toward = eye - scene.mesh.positions
    toward /= np.maximum(np.linalg.norm(toward, axis=1, keepdims=True), 1e-300)
    normals = scene.mesh.normals
    cosine = np.einsum("ij,ij->i", normals, toward)
    facing = np.flatnonzero(cosine > 1e-4)
    if facing.size == 0:
        raise UserError(f"{scene.path}: camera '{view.name}' sees no front of any surface; move it or flip the faces")
    axes = np.zeros_like(normals)
    axes[facing] = 2.0 * cosine[facing, None] * normals[facing] - toward[facing]
    tracer = _Tracer(scene, toward, axes, facing, bandlimit, samples, seed, shadows)
    vectors = np.zeros((len(normals), 3, num_coefficients(bandlimit)), dtype=np.float32)
    advance(len(normals) - facing.size)
    block = max(1, _RAYS_PER_BLOCK // tracer.half)
    facing = facing[np.argsort(morton(scene.traced_positions[facing]), kind="stable")]

    def project(_: int, chosen: NDArray, seen: tuple[NDArray, NDArray]) -> None:
        vectors[chosen] = tracer.project(chosen, *seen)

    blocks = [facing[begin : begin + block] for begin in range(0, facing.size, block)]
    in_blocks(blocks, tracer.weights, project, advance)
    gray = np.abs(vectors - vectors[:, :1]).max(initial=0.0) <= 1e-6 * np.abs(vectors).max(initial=0.0)
    return ViewTransfer(vectors[:, :1].copy() if gray else vectors, axes, tracer.rays)


class _Tracer:
    """The two direction sets with their tables, and how much of each direction's light goes to the camera."""

    def __init__(
        self,
        scene: Scene,
        toward: NDArray,
        axes: NDArray,
        facing: NDArray,
        bandlimit: int,
        samples: int,
        seed: int,
        shadows: bool,
    ) -> None:
        mi = scene.mi
        self.mi, self.shadows, self.rays = mi, shadows, 0
        self.geometry = scene.geometry
        self._origins, self._normals, self._axes = scene.ray_origins, scene.mesh.normals, axes
        self._parts = _Parts(scene, toward)
        rng = np.random.default_rng(seed)
        self._turns = rng.random((2, len(axes))) * 2.0 * math.pi
        self.half = max(4, samples // 2)
        lobe = _measured_lobe(self._parts, axes, facing, rng)
        self._density = mi.Float(lobe.density.astype(np.float32))
        sets = [hemisphere_fibonacci(self.half), lobe.directions(self.half)]
        sets = [d[np.argsort(morton(d), kind="stable")] for d in sets]
        self._sets = [mi.Vector3f(d.T.astype(np.float32)) for d in sets]
        self._tables = [(real_sh(bandlimit, d) / self.half).astype(np.float32) for d in sets]

    def weights(self, vertices: NDArray) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(n, 3, half) of both sets: V f (n·ω)₊ over the density of the two sets together."""
        return self._weights(vertices, 0), self._weights(vertices, 1)

    def project(self, vertices: NDArray, cosine: NDArray, lobe: NDArray) -> NDArray[np.float32]:
        """(n, 3, (L+1)²) in the world frame."""
        result = np.zeros((vertices.size, 3, self._tables[0].shape[1]), dtype=np.float32)
        for which, values in enumerate((cosine, lobe)):
            local = (values.reshape(-1, self.half) @ self._tables[which]).reshape(vertices.size, 3, -1)
            result += rotate_sh(local, self._frames(vertices, which)[:, None])
        return result

    def _frames(self, vertices: NDArray, which: int) -> NDArray[np.float64]:
        """Rotations that take z to the axis of a direction set, after a turn about it."""
        return turned_frames((self._normals, self._axes)[which][vertices], self._turns[which, vertices])

    def _weights(self, vertices: NDArray, which: int) -> NDArray[np.float32]:
        import drjit as dr

        mi, half = self.mi, self.half
        frames = self._frames(vertices, which)
        x, y, z = (mi.Vector3f(frames[:, :, axis].T.astype(np.float32)) for axis in range(3))
        lane = dr.arange(mi.UInt32, vertices.size * half)
        place = lane // dr.opaque(mi.UInt32, half)
        local = dr.gather(mi.Vector3f, self._sets[which], lane - place * dr.opaque(mi.UInt32, half))
        outward = (
            dr.gather(mi.Vector3f, x, place) * local.x
            + dr.gather(mi.Vector3f, y, place) * local.y
            + dr.gather(mi.Vector3f, z, place) * local.z
        )
        normal = self._gathered(self._normals, vertices, place)
        above = dr.dot(normal, outward)
        origin = mi.Point3f(self._gathered(self._origins, vertices, place))
        alive = above > 0.0
        if self.shadows:
            self.rays += vertices.size * half
            alive &= ~self.geometry.ray_test(mi.Ray3f(origin, outward), alive)
        angle = dr.dot(self._gathered(self._axes, vertices, place), outward)
        bin = dr.clip(mi.UInt32(dr.safe_acos(angle) * (_BINS / math.pi)), 0, _BINS - 1)
        density = 0.5 * (dr.maximum(above, 0.0) / math.pi + dr.gather(mi.Float, self._density, bin))
        reflected = self._parts.evaluate(vertices, place, outward, alive)
        # Each set holds half of the samples, and its table divides by their number already.
        weight = dr.select(alive, reflected * (0.5 / density), 0.0)
        return np.ascontiguousarray(np.array(weight).reshape(3, vertices.size, half).transpose(1, 0, 2))

    def _gathered(self, values: NDArray, vertices: NDArray, place: Any) -> Any:
        import drjit as dr

        return dr.gather(self.mi.Vector3f, self.mi.Vector3f(values[vertices].T.astype(np.float32)), place)


class _Parts:
    """The BSDFs of all receivers at their vertices, with the direction to the camera set."""

    def __init__(self, scene: Scene, toward: NDArray) -> None:
        mi = scene.mi
        self.mi = mi
        self.first = np.array([part.first for part in scene.parts])
        self.shapes = scene.shapes[: len(scene.parts)]
        self.points = []
        for part, shape, first_face in zip(scene.parts, self.shapes, scene.first_faces, strict=False):
            own = slice(part.first, part.first + part.count)
            last = first_face + shape.face_count()
            faces = scene.faces[first_face:last] - part.first
            positions, normals = scene.traced_positions[own], scene.mesh.normals[own]
            point = surface_points(mi, shape, positions, normals, faces)
            point.wi = point.sh_frame.to_local(mi.Vector3f(toward[own].T.astype(np.float32)))
            self.points.append(point)

    def of(self, vertices: NDArray) -> NDArray[np.int64]:
        """Which part each vertex belongs to."""
        return np.searchsorted(self.first, vertices, side="right") - 1

    def evaluate(self, vertices: NDArray, place: Any, outward: Any, active: Any) -> Any:
        """f (n·ω)₊ toward the camera for lanes that belong to ``vertices[place]``."""
        import drjit as dr

        mi = self.mi
        parts = self.of(vertices)
        total = dr.zeros(mi.Spectrum, dr.width(outward))
        for number in np.unique(parts):
            chosen = active & (dr.gather(mi.UInt32, mi.UInt32(parts.astype(np.uint32)), place) == int(number))
            inside = np.where(parts == number, vertices - self.first[number], 0).astype(np.uint32)
            index = dr.gather(mi.UInt32, mi.UInt32(inside), place)
            point = dr.gather(mi.SurfaceInteraction3f, self.points[number], index, chosen)
            value = self.shapes[number].bsdf().eval(mi.BSDFContext(), point, point.to_local(outward), chosen)
            total += dr.select(chosen, value, 0.0)
        return total

    def sample(self, vertices: NDArray, count: int, rng: np.random.Generator) -> tuple[NDArray, NDArray]:
        """Directions that the BSDFs themselves choose, (n count, 3), and what each weighs."""
        import drjit as dr

        mi = self.mi
        parts, directions, weights = self.of(vertices), [], []
        for number in np.unique(parts):
            chosen = np.repeat(vertices[parts == number] - self.first[number], count)
            point = dr.gather(mi.SurfaceInteraction3f, self.points[number], mi.UInt32(chosen.astype(np.uint32)))
            u = rng.random((3, chosen.size)).astype(np.float32)
            drawn, value = (
                self.shapes[number].bsdf().sample(mi.BSDFContext(), point, mi.Float(u[0]), mi.Point2f(u[1:]), True)
            )
            kept = ~mi.has_flag(drawn.sampled_type, mi.BSDFFlags.Delta) & (mi.Frame3f.cos_theta(drawn.wo) > 0.0)
            weight = dr.select(kept, dr.mean(value), 0.0)
            directions.append(np.array(point.to_world(drawn.wo)).T)
            weights.append(np.broadcast_to(np.array(weight), chosen.size))
        return np.concatenate(directions), np.concatenate(weights)


class _Lobe(NamedTuple):
    """A density in the angle from an axis, per solid angle, constant on equal steps of the angle."""

    density: NDArray[np.float64]

    def directions(self, count: int) -> NDArray[np.float64]:
        """Directions about z of that density, (count, 3), on a golden spiral."""
        edges = np.linspace(0.0, math.pi, _BINS + 1)
        areas = 2.0 * math.pi * -np.diff(np.cos(edges))
        cumulative = np.concatenate([[0.0], np.cumsum(self.density * areas)])
        level = (np.arange(count) + 0.5) / count * cumulative[-1]
        index = np.clip(np.searchsorted(cumulative, level, side="right") - 1, 0, _BINS - 1)
        part = (level - cumulative[index]) / np.maximum(cumulative[index + 1] - cumulative[index], 1e-300)
        z = np.cos(edges[index]) + part * (np.cos(edges[index + 1]) - np.cos(edges[index]))
        phi = math.pi * (3.0 - math.sqrt(5.0)) * np.arange(count)
        sine = np.sqrt(np.maximum(0.0, 1.0 - z * z))
        return np.column_stack([sine * np.cos(phi), sine * np.sin(phi), z])


def _measured_lobe(parts: _Parts, axes: NDArray, facing: NDArray, rng: np.random.Generator) -> _Lobe:
    """How far from the reflection direction the light comes from that a pilot of vertices sends to the camera."""
    pilot = rng.choice(facing, min(_PILOT_VERTICES, facing.size), replace=False)
    pilot = pilot[np.argsort(parts.of(pilot), kind="stable")]
    directions, weights = parts.sample(pilot, _PILOT_SAMPLES, rng)
    angle = np.arccos(np.clip(np.einsum("ij,ij->i", directions, np.repeat(axes[pilot], _PILOT_SAMPLES, axis=0)), -1, 1))
    found, edges = np.histogram(angle, _BINS, (0.0, math.pi), weights=weights)
    areas = 2.0 * math.pi * -np.diff(np.cos(edges))
    # Smoothed over a few bins, more where there is little: the shape matters, not its noise.
    kernel = np.exp(-0.5 * (np.arange(-12, 13) / 4.0) ** 2)
    padded = np.pad(found, 12, mode="reflect")
    mass = np.convolve(padded, kernel / kernel.sum(), mode="valid")
    total = float(mass.sum())
    spread = 1.0 / (4.0 * math.pi)
    measured = mass / (total * areas) if total > 0.0 else np.full(_BINS, spread)
    return _Lobe((1.0 - _SPREAD) * measured + _SPREAD * spread)
