"""References that owe nothing to spherical harmonics: path-traced pictures and Monte Carlo radiance per vertex."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.lighting.emitters import environment_emitter
from slepian_prt.lighting.environment import Environment
from slepian_prt.paths.media import media_of, medium_at
from slepian_prt.relighting.drawing.pictures import Picture, split_alpha
from slepian_prt.scene.mitsuba.shapes import without_emission
from slepian_prt.scene.reflectance.path_effects import PATH_EFFECTS
from slepian_prt.scene.scene import Scene, mitsuba_scene
from slepian_prt.scene.sensors import sensor
from slepian_prt.scene.view import View
from slepian_prt.transport.effects import SIMULATED, Effect
from slepian_prt.transport.hemisphere import upload_origins
from slepian_prt.transport.interior import find_interior

# Points of paths that pass mirrors, glass, holes and particles of media, which are no bounces of transfer.
_MANY_POINTS = 128

# Most samples of a pixel, and of a vertex.
LARGEST_PICTURE_SAMPLES, LARGEST_VERTEX_SAMPLES = 512, 2048

# The root of x⁵ = x + 1.
_RATIO = 1.1673039782614187


def path_bounces(bounces: int, effects: Sequence[Effect]) -> int:
    """How many bounces references follow for transfer of ``bounces``: many, where mirrors and the like are none."""
    by_paths = any(row.name in PATH_EFFECTS and row.verdict == SIMULATED for row in effects)
    return max(bounces, _MANY_POINTS) if by_paths else bounces


@dataclass(frozen=True)
class ReferencePicture:
    """A path-traced picture with the relative RMS of its own noise, from its two independent halves."""

    picture: Picture
    noise: float
    samples: int
    seconds: float


@dataclass(frozen=True)
class ReferenceVertices:
    """Radiance per vertex, (V, 3), without a bandlimit, and the relative RMS of its own noise."""

    radiance: NDArray[np.float32]
    noise: float
    samples: int
    seconds: float


class PictureHalf:
    """Renders halves of a path-traced picture; arguments as of `render_reference`."""

    def __init__(self, scene: Scene, environment: Environment, width: int | None, bounces: int) -> None:
        mi = scene.mi
        self._scene, self._width, self._dark = scene, width, _without_lamps(scene)
        self._integrator = mi.load_dict({"type": "path", "max_depth": bounces + 2, "hide_emitters": True})
        emitter = environment_emitter(mi, environment)
        self._emitter = mi.load_dict(emitter) if isinstance(emitter, dict) else emitter

    def __call__(self, samples: int, seed: int) -> NDArray[np.float64]:
        """(H, W, 4) of so many samples."""
        # Stratified samplers halve the noise of independent ones at the same cost, if they know the count.
        lit = mitsuba_scene(self._dark, sensor=sensor(self._scene, self._width, samples), emitter=self._emitter)
        picture = self._scene.mi.render(lit, integrator=self._integrator, spp=samples, seed=seed)
        return np.array(picture, dtype=np.float64)


class VertexHalf:
    """Samples halves of radiance at vertices; arguments as of `vertex_reference`."""

    def __init__(
        self,
        scene: Scene,
        environment: Environment,
        vertices: NDArray[np.int64] | None,
        bounces: int,
        view: View | None,
        seed: int = 0,
    ) -> None:
        self._scene, self._view, self._bounces, self._seed = scene, view, bounces, seed
        self._chosen = np.arange(len(scene.mesh.positions)) if vertices is None else vertices
        self._lit = mitsuba_scene(_without_lamps(scene), emitter=environment_emitter(scene.mi, environment))

    def __call__(self, samples: int, number: int) -> NDArray[np.float64]:
        """(n, 3) of so many samples."""
        seed, scene, chosen = 65537 * self._seed + number, self._scene, self._chosen
        if self._view is not None:
            return _sample_toward(scene, self._lit, self._view, samples, seed, self._bounces)[chosen]
        return _sample_vertices(scene, self._lit, chosen, samples, seed, self._bounces)


def render_reference(
    scene: Scene,
    environment: Environment,
    *,
    width: int | None = None,
    noise: float = 0.005,
    largest_samples: int = LARGEST_PICTURE_SAMPLES,
    bounces: int = 0,
) -> ReferencePicture:
    """Path-trace the scene until the noise of the picture is below ``noise`` (relative RMS), or to the largest count.

    ``bounces`` of light between surfaces are followed, as many as the transfer has.
    """
    started = time.perf_counter()
    half = PictureHalf(scene, environment, width, bounces)
    return picture_of(_converge(half, converge(noise, largest_samples, channels=3)), started)


def picture_of(found: Converged, started: float) -> ReferencePicture:
    """The picture that two halves make, which were ``started`` then, by `time.perf_counter`."""
    picture = split_alpha(found.halves.mean(axis=0))
    return ReferencePicture(picture, found.noise, found.samples, time.perf_counter() - started)


def vertex_reference(
    scene: Scene,
    environment: Environment,
    *,
    noise: float = 0.005,
    largest_samples: int = LARGEST_VERTEX_SAMPLES,
    bounces: int = 0,
    view: View | None = None,
    seed: int = 0,
    vertices: NDArray[np.int64] | None = None,
) -> ReferenceVertices:
    """Radiance at the vertices by light sampling and cosine sampling, combined by the balance heuristic.

    What the cosine samples see of other surfaces is path-traced by Mitsuba, with one bounce less. Of transfer toward
    ``view`` the radiance that leaves toward that camera, path-traced.

    Uses the same ray origins as the transfer, so that what differs from full SH is the bandlimit (and sampling). Of
    some ``vertices`` alone those inside other geometry stay black.
    """
    started = time.perf_counter()
    half = VertexHalf(scene, environment, vertices, bounces, view, seed)
    found = _converge(half, converge(noise, largest_samples, stratified=False))
    return vertices_of(scene, found, started, view, vertices)


def vertices_of(
    scene: Scene, found: Converged, started: float, view: View | None, vertices: NDArray[np.int64] | None = None
) -> ReferenceVertices:
    """The radiance that two halves make; arguments as of `vertex_reference` and `picture_of`."""
    chosen = np.arange(len(scene.mesh.positions)) if vertices is None else vertices
    albedo = scene.mesh.albedo[chosen] if view is None else 1.0
    mean = found.halves.mean(axis=0)
    if view is None:
        mean[scene.is_hidden[chosen]] = 0.0
    if view is None and vertices is None:
        # What transport does for vertices inside other geometry.
        find_interior(scene, np.flatnonzero(~mean.any(axis=1) & scene.mesh.receivers.active)).fill(mean)
    radiance = (mean * albedo).astype(np.float32)
    return ReferenceVertices(radiance, found.noise, found.samples, time.perf_counter() - started)


def _without_lamps(scene: Scene) -> Scene:
    """The scene with surfaces that do not shine: what is measured is distant light."""
    if not any(shape.is_emitter() for shape in scene.shapes):
        return scene
    low, high = scene.traced_bounds
    diagonal = float(np.linalg.norm(high - low))
    shapes = [without_emission(scene.mi, shape, diagonal) if shape.is_emitter() else shape for shape in scene.shapes]
    return replace(scene, shapes=tuple(shapes))


class Converged(NamedTuple):
    """Two independent halves (2, …), the relative RMS noise of their mean, and the samples of both."""

    halves: NDArray
    noise: float
    samples: int


# Asks for halves, of so many samples and by a seed each, and is sent them.
Rounds = Generator[list[tuple[int, int]], list[NDArray], Converged]


def converge(noise: float, largest: int, *, channels: int | None = None, stratified: bool = True) -> Rounds:
    """Rounds of two independent halves, until they have enough samples.

    Each round starts afresh with the count that the last one's noise asks for: a stratified set twice as large beats
    two sets.

    Parameters
    ----------
    noise, largest : wanted relative RMS noise, and the most samples
    channels : of the last axis, those that noise counts in; all by default
    stratified : whether samplers want a square number in each half
    """
    samples, seed = 32, 0
    while True:
        halves = np.stack((yield [(samples // 2, seed), (samples // 2, seed + 1)]))
        reached = _half_noise(*halves[..., :channels])
        if reached <= noise or samples >= largest:
            return Converged(halves, reached, samples)
        wanted = 1.1 * samples * (reached / noise) ** (1.0 / 0.7)
        if stratified:
            # Powers of four are squares.
            per_half = 4 ** math.ceil(math.log(wanted / 2, 4) - 1e-9)
            wanted = max(2 * per_half, 4 * samples)
        samples, seed = min(largest, max(2 * math.ceil(0.5 * wanted), 2 * samples)), seed + 2


def _converge(half: Callable[[int, int], NDArray], rounds: Rounds) -> Converged:
    """Go through the rounds in this process."""
    asked = next(rounds)
    while True:
        try:
            asked = rounds.send([half(*one) for one in asked])
        except StopIteration as end:
            found: Converged = end.value
            return found


def _sample_vertices(
    scene: Scene, lit: Any, vertices: NDArray[np.int64], samples: int, seed: int, bounces: int
) -> NDArray[np.float64]:
    """(n, 3) estimates for unit albedo, ``samples`` light and ``samples`` cosine samples per vertex."""
    mi = scene.mi
    import drjit as dr

    count = len(vertices)
    total = np.zeros((count, 3))
    rng = np.random.default_rng(seed)
    block = max(1, (1 << 21) // samples)
    for begin in range(0, count, block):
        chosen = slice(begin, min(begin + block, count))
        size = chosen.stop - chosen.start
        normals = scene.mesh.normals[vertices[chosen]]
        origin_of = upload_origins(mi, scene.ray_origins, vertices[chosen])
        normal = mi.Normal3f(normals.T.astype(np.float32))
        lane = dr.arange(mi.UInt32, size * samples)
        vertex = lane // dr.opaque(mi.UInt32, samples)
        si = dr.zeros(mi.SurfaceInteraction3f, size * samples)
        si.p = origin_of(vertex, mi.Vector3f(0.0))
        si.n = dr.gather(mi.Normal3f, normal, vertex)
        valid = dr.squared_norm(si.n) > 0.5
        # An additive recurrence in four dimensions (the generalised golden ratio), shifted at random per vertex.
        shifts = rng.integers(1 << 32, size=(4, size), dtype=np.uint32)
        steps = [int((1.0 / _RATIO**d % 1.0) * 2**32) for d in range(1, 5)]
        u = [
            mi.Float((lane - vertex * samples) * mi.UInt32(step) + dr.gather(mi.UInt32, mi.UInt32(shift), vertex))
            * 2.0**-32
            for step, shift in zip(steps, shifts, strict=True)
        ]
        emitter = lit.environment()

        ds, weight = emitter.sample_direction(si, mi.Point2f(u[0], u[1]), valid)
        cosine = dr.maximum(dr.dot(si.n, ds.d), 0.0)
        balance = ds.pdf / (ds.pdf + cosine * dr.inv_pi)
        visible = valid & (cosine > 0.0) & (ds.pdf > 0.0)
        visible &= ~lit.ray_test(mi.Ray3f(origin_of(vertex, ds.d), ds.d), visible)
        value = dr.select(visible, weight * cosine * dr.inv_pi * balance, 0.0)

        local = mi.warp.square_to_cosine_hemisphere(mi.Point2f(u[2], u[3]))
        outward = mi.Frame3f(si.n).to_world(local)
        ray = mi.Ray3f(origin_of(vertex, outward), outward)
        sky = dr.zeros(mi.SurfaceInteraction3f, size * samples)
        sky.wi = -ray.d
        cosine_pdf = local.z * dr.inv_pi
        sample = mi.DirectionSample3f()
        sample.d = ray.d
        light_pdf = emitter.pdf_direction(si, sample, valid)
        open_sky = valid & (local.z > 0.0)
        open_sky &= ~lit.ray_test(ray, open_sky)
        value += dr.select(open_sky, emitter.eval(sky) * (cosine_pdf / (cosine_pdf + light_pdf)), 0.0)

        if bounces > 0:
            value += _indirect(mi, lit, ray, valid & (local.z > 0.0) & ~open_sky, bounces, seed + begin)

        total[chosen] = _means(mi.Color3f(value), samples)
    return total


def _sample_toward(scene: Scene, lit: Any, view: View, samples: int, seed: int, bounces: int) -> NDArray[np.float64]:
    """(V, 3) radiance from the vertices toward a camera; zero where it sees the back."""
    mi = scene.mi
    import drjit as dr

    eye = (np.array(view.to_world)[:3, 3] - scene.origin) / scene.scale
    positions, normals = scene.traced_positions, scene.mesh.normals
    toward = eye - positions
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    cosine = np.einsum("ij,ij->i", toward, normals)
    facing = np.flatnonzero(cosine > 1e-4)
    # From a little above, back onto the surface under the point that transfer starts from.
    feet, heights = scene.ray_origins.feet[facing], scene.ray_heights[facing]
    origins = feet + (2.0 * heights / np.maximum(cosine[facing], 0.05))[:, None] * toward[facing]
    total = np.zeros((len(positions), 3))
    integrator = mi.load_dict({"type": "path", "max_depth": bounces + 2, "hide_emitters": True})
    block = max(1, (1 << 20) // samples)
    for begin in range(0, facing.size, block):
        chosen = slice(begin, min(begin + block, facing.size))
        size = chosen.stop - chosen.start
        vertex = dr.arange(mi.UInt32, size * samples) // dr.opaque(mi.UInt32, samples)
        origin = dr.gather(mi.Point3f, mi.Point3f(origins[chosen].T.astype(np.float32)), vertex)
        direction = dr.gather(mi.Vector3f, mi.Vector3f(-toward[facing[chosen]].T.astype(np.float32)), vertex)
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed((seed * 7919 + begin) % 2**32, size * samples)
        radiance, _, _ = integrator.sample(lit, sampler, mi.RayDifferential3f(mi.Ray3f(origin, direction)))
        total[facing[chosen]] = _means(mi.Color3f(radiance), samples)
    return total


def _means(value: Any, samples: int) -> NDArray[np.float64]:
    """(n, 3) means of a Color3f over ``samples`` lanes each, added up in the same order every time."""
    import drjit as dr

    dr.eval(value)  # at once: each channel would be traced by its own
    return np.stack([np.array(dr.block_sum(one, samples), dtype=np.float64) for one in value], axis=1) / samples


def _indirect(mi: Any, lit: Any, ray: Any, hits: Any, bounces: int, seed: int) -> Any:
    """Radiance that surfaces send back along rays that hit them."""
    import drjit as dr

    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, dr.width(ray))
    ray, media = mi.RayDifferential3f(ray), media_of(mi, lit)
    if not media:
        integrator = mi.load_dict({"type": "path", "max_depth": bounces + 1})
        return dr.select(hits, integrator.sample(lit, sampler, ray, active=hits)[0], 0.0)
    integrator = mi.load_dict({"type": "volpath", "max_depth": bounces + 1})
    around, total = medium_at(mi, lit, ray.o), mi.Spectrum(0.0)
    for medium in (None, *media):  # paths of one call begin in one medium
        there = hits & (around == mi.MediumPtr(medium))
        total += dr.select(there, integrator.sample(lit, sampler, ray, medium, there)[0], 0.0)
    return total


def _half_noise(first: NDArray, second: NDArray) -> float:
    """Relative RMS noise of the mean of two independent halves: RMS(a - b)/2 over the RMS of the mean."""
    scale = float(np.sqrt(np.mean((0.5 * (first + second)) ** 2)))
    return float(0.5 * np.sqrt(np.mean((first - second) ** 2)) / scale) if scale > 0.0 else 0.0
