"""Transfer of any non-delta BSDF toward one camera.

t_lm(x) = ∫ V(x,ω) f(x,ω,ω_o) (n·ω)₊ y_lm(ω) dω, with ω_o toward the camera: what Lessig & Fiume (EGSR 2010, Sec. 1
and 4) treat as a function of the reflection direction r, at twice the angle of the normal from the view. Two direction
sets are shared by all vertices, so that the projection on harmonics is a matrix product for each: a cosine one about
the normal, and one about r whose density in the angle from r is measured on the scene's own BSDFs. The balance
heuristic (Veach & Guibas 1995) joins them.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.renderer import variants
from slepian_prt.scene.receivers import morton
from slepian_prt.scene.reflectance.materials import surface_points
from slepian_prt.scene.scene import Scene
from slepian_prt.scene.view import View
from slepian_prt.sphere.harmonics import num_coefficients, real_sh
from slepian_prt.sphere.quadrature import hemisphere_fibonacci
from slepian_prt.sphere.rotation import rotate_sh
from slepian_prt.transport.device.rotation import DeviceRotation, angles_of, padded_rows
from slepian_prt.transport.effects import SIMULATED, Plan
from slepian_prt.transport.estimator import Estimator, TransferBlock, cut_pieces, receivers_per_block
from slepian_prt.transport.hemisphere import turned_frames, upload_frames, upload_origins
from slepian_prt.transport.settings import TransportSettings

_RAYS_PER_BLOCK = 1 << 19
_PILOT_VERTICES, _PILOT_SAMPLES = 256, 256
_BINS = 512
# Part of the lobe's set that is spread over the whole sphere, so that no direction is left out.
_SPREAD = 0.1


class _ViewSamples(NamedTuple):
    """Receivers, which of them face the camera (their places), and the weights of both direction sets for those."""

    vertices: NDArray[np.int64]
    facing: NDArray[np.int64]
    weights: tuple[Any, Any]
    rays: int


class ViewTransfer(Estimator[_ViewSamples]):
    """Transfer toward a camera for direct light, with the reflectance; zero at receivers whose back it sees.

    Parameters
    ----------
    scene : Scene
    view : View
    bandlimit : int
    samples : int
        Rays per receiver, half about the normal and half about the reflection direction.
    seed : int
    shadows : bool
    on_device : bool, optional
        Whether weights of directions become vectors where they were traced; by default under CUDA.

    Raises
    ------
    UserError
        The camera sees no front of any surface.
    """

    channels = 3

    def __init__(
        self,
        scene: Scene,
        view: View,
        bandlimit: int,
        samples: int,
        seed: int,
        *,
        shadows: bool = True,
        on_device: bool | None = None,
    ) -> None:
        mi = scene.mi
        self._on_device = variants.is_on_device(mi) if on_device is None else on_device
        self.scene, self.bandlimit = scene, bandlimit
        self._mi, self._shadows, self._rays = mi, shadows, 0
        self._half = max(4, samples // 2)
        normals = scene.receivers.normals
        outgoing, self._is_facing = toward_camera(scene, view)
        cosine = np.einsum("ij,ij->i", normals, outgoing)
        if not self._is_facing.any():
            raise UserError(
                f"{scene.path}: camera '{view.name}' sees no front of any surface; move it or flip the faces"
            )
        self._axes = np.where(self._is_facing[:, None], 2.0 * cosine[:, None] * normals - outgoing, 0.0)
        self._bsdfs = ReceiverBSDFs(scene, outgoing)
        rng = np.random.default_rng(seed)
        self._turns = rng.random((2, len(normals))) * 2.0 * math.pi
        density = _measured_density(self._bsdfs, self._axes, np.flatnonzero(self._is_facing), rng)
        self._density = mi.Float(density.astype(np.float32))
        # About the normals, and about the reflection directions.
        sets = [hemisphere_fibonacci(self._half), _directions_of_density(density, self._half)]
        sets = [d[np.argsort(morton(d), kind="stable")] for d in sets]
        self._set_axes = (normals, self._axes)
        self._sets = [mi.Vector3f(d.T.astype(np.float32)) for d in sets]
        self._tables = [(real_sh(bandlimit, d) / self._half).astype(np.float32) for d in sets]

    @classmethod
    def planned(cls, scene: Scene, settings: TransportSettings, plan: Plan) -> ViewTransfer:
        """As a plan with a view wants it."""
        assert plan.view is not None
        shadows = plan.shadows.verdict == SIMULATED
        return cls(scene, plan.view, settings.bandlimit, settings.samples, settings.seed, shadows=shadows)

    @property
    def axes(self) -> NDArray[np.float64]:
        """(V, 3) reflection directions of the view about the normals; zero at receivers whose back the camera sees."""
        return self._axes

    @property
    def rays(self) -> int:
        """Number traced so far."""
        return self._rays

    @property
    def block_size(self) -> int:
        """Receivers that are traced at a time."""
        return receivers_per_block(self._half, _RAYS_PER_BLOCK, self.channels * num_coefficients(self.bandlimit))

    def pieces(self, receivers: NDArray[np.int64] | None = None) -> list[NDArray[np.int64]]:
        """All receivers, or some, in pieces of about as many rays."""
        return cut_pieces(self.scene, self._is_facing, self.block_size, receivers)

    @property
    def stays_on_device(self) -> bool:
        """Whether vectors are made where rays are traced."""
        return self._on_device

    def trace(self, vertices: NDArray) -> _ViewSamples:
        """Weigh the light of each direction of both sets, for those of the receivers that face the camera."""
        before, facing = self._rays, np.flatnonzero(self._is_facing[vertices])
        chosen = vertices[facing]
        weights = self._weights(chosen, 0), self._weights(chosen, 1)
        return _ViewSamples(vertices, facing, weights, self._rays - before)

    def project(self, samples: _ViewSamples) -> TransferBlock:
        """The weights of both sets as transfer vectors."""
        vertices, facing = samples.vertices, samples.facing
        vectors = np.zeros((vertices.size, 3, self._tables[0].shape[1]), dtype=np.float32)
        if self._on_device and facing.size:
            vectors[facing] = self._project_on_device(vertices[facing], samples.weights)
            return TransferBlock(vertices, vectors, np.zeros(vertices.size, dtype=np.float32), samples.rays)
        for number, weights in enumerate(samples.weights if facing.size else ()):
            local = (weights.reshape(-1, self._half) @ self._tables[number]).reshape(facing.size, 3, -1)
            vectors[facing] += rotate_sh(local, self._frames(vertices[facing], number)[:, None])
        return TransferBlock(vertices, vectors, np.zeros(vertices.size, dtype=np.float32), samples.rays)

    def _project_on_device(self, vertices: NDArray, weights: tuple[Any, Any]) -> NDArray[np.float32]:
        """(n, 3, (L+1)²) from the weights of both sets, tensors (3 n, half)."""
        import drjit as dr

        mi, count, rotation = self._mi, vertices.size, DeviceRotation(self._mi, self.bandlimit)
        total: Any = dr.zeros(mi.Float, 3 * count * rotation.columns)
        for number, part in enumerate(weights):
            local: Any = dr.matmul(part, mi.TensorXf(padded_rows(self._tables[number], rotation.columns)))
            angles = angles_of(self._set_axes[number][vertices], self._turns[number, vertices])
            total += rotation.into_world(local.array, np.tile(angles, 3))
        rows = np.array(total).reshape(3, count, rotation.columns)[:, :, : self._tables[0].shape[1]]
        return np.moveaxis(rows, 0, 1)

    def _frames(self, vertices: NDArray, number: int) -> NDArray[np.float64]:
        """Rotations that take z to the axis of a direction set, after a turn about it."""
        return turned_frames(self._set_axes[number][vertices], self._turns[number, vertices])

    def _weights(self, vertices: NDArray, number: int) -> Any:
        """(n, 3, half) of one of the sets: V f (n·ω)₊ over the density of both sets together.

        On a device a tensor (3 n, half), channel after channel.
        """
        import drjit as dr

        mi, half = self._mi, self._half
        if vertices.size == 0:
            return np.zeros((0, 3, half), dtype=np.float32)
        lane = dr.arange(mi.UInt32, vertices.size * half)
        place = lane // dr.opaque(mi.UInt32, half)
        local = dr.gather(mi.Vector3f, self._sets[number], lane - place * dr.opaque(mi.UInt32, half))
        outward = upload_frames(mi, self._frames(vertices, number))(place, local)
        above = dr.dot(self._gathered(self.scene.receivers.normals, vertices, place), outward)
        alive = above > 0.0
        if self._shadows:
            self._rays += vertices.size * half
            origin = upload_origins(mi, self.scene.ray_origins, vertices)(place, outward)
            alive &= ~self.scene.geometry.ray_test(mi.Ray3f(origin, outward), alive)
        angle = dr.dot(self._gathered(self._axes, vertices, place), outward)
        bin = dr.clip(mi.UInt32(dr.safe_acos(angle) * (_BINS / math.pi)), 0, _BINS - 1)
        density = 0.5 * (dr.maximum(above, 0.0) / math.pi + dr.gather(mi.Float, self._density, bin))
        reflected = self._bsdfs.evaluate(vertices, place, outward, alive)
        # Each set holds half of the samples, and its table divides by their number already.
        weight = dr.select(alive, reflected * (0.5 / density), 0.0)
        if self._on_device:
            rows, lanes = dr.zeros(mi.Float, 3 * dr.width(lane)), dr.width(lane)
            for c, value in enumerate(weight):
                dr.scatter(rows, value, lane + c * lanes, mode=dr.ReduceMode.NoConflicts)
            return mi.TensorXf(rows, (3 * vertices.size, half))
        return np.ascontiguousarray(np.array(weight).reshape(3, vertices.size, half).transpose(1, 0, 2))

    def _gathered(self, values: NDArray, vertices: NDArray, place: Any) -> Any:
        import drjit as dr

        return dr.gather(self._mi.Vector3f, self._mi.Vector3f(values[vertices].T.astype(np.float32)), place)


def toward_camera(scene: Scene, view: View) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """(V, 3) unit vectors from receivers to a camera, and (V,) which of them face it."""
    outgoing = np.array(view.to_world)[:3, 3] - scene.receivers.positions
    outgoing /= np.maximum(np.linalg.norm(outgoing, axis=1, keepdims=True), 1e-300)
    return outgoing, np.einsum("ij,ij->i", scene.receivers.normals, outgoing) > 1e-4


def merge_equal_channels(vectors: NDArray[np.float32]) -> NDArray[np.float32]:
    """Transfer vectors (V, channels, M) with one channel if all are the same to rounding."""
    if vectors.shape[1] == 1:
        return vectors
    gray = np.abs(vectors - vectors[:, :1]).max(initial=0.0) <= 1e-6 * np.abs(vectors).max(initial=0.0)
    return vectors[:, :1].copy() if gray else vectors


class ReceiverBSDFs:
    """The BSDFs of all receivers at their vertices, with the direction to the camera set."""

    def __init__(self, scene: Scene, toward: NDArray) -> None:
        mi = scene.mi
        self.mi = mi
        self.first = np.array([part.first for part in scene.parts])
        self.shapes = scene.shapes[: len(scene.parts)]
        self.points = []
        for part, shape, first_face in zip(scene.parts, self.shapes, scene.first_faces, strict=False):
            vertices = slice(part.first, part.first + part.count)
            last = first_face + shape.face_count()
            faces = scene.faces[first_face:last] - part.first
            positions, normals = scene.traced_positions[vertices], scene.receivers.normals[vertices]
            point = surface_points(mi, shape, positions, normals, faces)
            point.wi = point.sh_frame.to_local(mi.Vector3f(toward[vertices].T.astype(np.float32)))
            self.points.append(point)

    def part_of(self, vertices: NDArray) -> NDArray[np.int64]:
        """Which part each vertex belongs to."""
        return np.searchsorted(self.first, vertices, side="right") - 1

    def evaluate(self, vertices: NDArray, place: Any, outward: Any, active: Any) -> Any:
        """f (n·ω)₊ toward the camera for lanes that belong to ``vertices[place]``."""
        import drjit as dr

        mi = self.mi
        parts = self.part_of(vertices)
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
        parts, directions, weights = self.part_of(vertices), [], []
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


# --- Densities in the angle from an axis, per solid angle, constant on equal steps of the angle ----------------------


def _areas() -> NDArray[np.float64]:
    """Solid angles of the steps."""
    return 2.0 * math.pi * -np.diff(np.cos(np.linspace(0.0, math.pi, _BINS + 1)))


def _directions_of_density(density: NDArray, count: int) -> NDArray[np.float64]:
    """Directions about z of a density, (count, 3), on a golden spiral."""
    edges = np.linspace(0.0, math.pi, _BINS + 1)
    cumulative = np.concatenate([[0.0], np.cumsum(density * _areas())])
    level = (np.arange(count) + 0.5) / count * cumulative[-1]
    index = np.clip(np.searchsorted(cumulative, level, side="right") - 1, 0, _BINS - 1)
    part = (level - cumulative[index]) / np.maximum(cumulative[index + 1] - cumulative[index], 1e-300)
    z = np.cos(edges[index]) + part * (np.cos(edges[index + 1]) - np.cos(edges[index]))
    phi = math.pi * (3.0 - math.sqrt(5.0)) * np.arange(count)
    sine = np.sqrt(np.maximum(0.0, 1.0 - z * z))
    return np.column_stack([sine * np.cos(phi), sine * np.sin(phi), z])


def _measured_density(
    bsdfs: ReceiverBSDFs, axes: NDArray, facing: NDArray, rng: np.random.Generator
) -> NDArray[np.float64]:
    """How far from the reflection direction the light comes from that a pilot of vertices sends to the camera."""
    pilot = rng.choice(facing, min(_PILOT_VERTICES, facing.size), replace=False)
    pilot = pilot[np.argsort(bsdfs.part_of(pilot), kind="stable")]
    directions, weights = bsdfs.sample(pilot, _PILOT_SAMPLES, rng)
    angle = np.arccos(np.clip(np.einsum("ij,ij->i", directions, np.repeat(axes[pilot], _PILOT_SAMPLES, axis=0)), -1, 1))
    histogram, _ = np.histogram(angle, _BINS, (0.0, math.pi), weights=weights)
    # Smoothed over a few bins, more where there is little: the shape matters, not its noise.
    kernel = np.exp(-0.5 * (np.arange(-12, 13) / 4.0) ** 2)
    padded = np.pad(histogram, 12, mode="reflect")
    mass = np.convolve(padded, kernel / kernel.sum(), mode="valid")
    total = float(mass.sum())
    spread = 1.0 / (4.0 * math.pi)
    measured = mass / (total * _areas()) if total > 0.0 else np.full(_BINS, spread)
    return (1.0 - _SPREAD) * measured + _SPREAD * spread
