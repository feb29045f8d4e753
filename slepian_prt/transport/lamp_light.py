"""What lamps send to receivers directly, by Mitsuba's own sampling of emitters.

A receiver of unit albedo sends back E/π. Lamps that are points or directions take one sample. Light of surfaces is
sampled twice, toward the lamp as Mitsuba does it, and along the cosine of the receiver; what both find is weighted by
the power heuristic (Veach 1997, Sec. 9.2). The first is right for small lamps, the second near large ones, where the
first would have the noise of 1/r².
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.paths.media import Media, media_of
from slepian_prt.renderer.shape_names import shape_name
from slepian_prt.scene.face_table import interactions
from slepian_prt.scene.scene import Scene, mitsuba_scene
from slepian_prt.transport.first_rays import media_around
from slepian_prt.transport.hemisphere import upload_origins

_RAYS_PER_BLOCK = 1 << 20

# Additive recurrences (Roberts 2018): two dimensions by the root of x³ = x + 1, a third by the golden ratio.
_STEPS = tuple(int(step * 2**32) for step in (0.7548776662466927, 0.5698402909980532, 0.6180339887498949))

# From 32 bits to [0, 1), so that rounding does not reach one.
_UNIT = (1.0 - 2.0**-24) * 2.0**-32

# Shadow rays stop this part of the way before the lamp, about as Mitsuba's own do (its ShadowEpsilon).
_SHORTENED = 1e-3

# Fewest samples of a lamp that is a surface, and of each lamp among those that are sampled as one; these take no more
# than so many times the samples that are asked for.
_FEWEST, _EACH_OF_SEVERAL, _MOST = 32, 8, 2

# Receivers whose light is put together at a time.
_RECEIVERS = 1 << 13


class Group(NamedTuple):
    """Emitters that are sampled as one.

    Attributes
    ----------
    emitters : (m,) int
        Places among the emitters of the scene.
    weights : (m,) float64
        With what probability each is chosen.
    sampled : bool
        Whether there is anything to choose: several emitters, or a surface.
    """

    emitters: NDArray[np.int64]
    weights: NDArray[np.float64]
    sampled: bool


class DirectLight(NamedTuple):
    """Radiance of unit albedo from n groups of lamps.

    Attributes
    ----------
    radiance : (n, V, 3) float32
    squared_noise : (n,) float64
        Sum of the squared errors, as the halves of the samples tell them; 0 of what is not sampled.
    rays : int
    """

    radiance: NDArray[np.float32]
    squared_noise: NDArray[np.float64]
    rays: int


def samples_of(groups: list[Group], samples: int) -> tuple[list[int], int]:
    """Samples toward each group, and along the cosine for all of them, of about ``samples`` for a receiver."""
    count = sum(group.sampled for group in groups)
    each = max(_FEWEST, samples // (count + 1))

    def toward(group: Group) -> int:
        if not group.sampled:
            return 1
        several = min(_EACH_OF_SEVERAL * group.emitters.size, _MOST * samples) if group.emitters.size > 1 else 0
        return _even(max(each, several))

    return [toward(group) for group in groups], _even(each) if count else 0


@dataclass(eq=False)
class LampTracer:
    """Samples lamps from receivers.

    Attributes
    ----------
    scene : Scene
    groups : list of Group
    samples : int
        For a receiver, of all lamps.
    seed : int
        Of the shifts of the sample set at each receiver.
    passes : bool
        Whether light comes through what lets it pass unbent: holes, thin glass, and media. Without media anywhere, that
        of points and directions does not, as in Mitsuba's ``path``.
    rays : int
        Traced so far.
    """

    scene: Scene
    groups: list[Group]
    samples: int
    seed: int
    passes: bool = False
    rays: int = 0

    def trace(self, vertices: NDArray[np.int64], *, shadows: bool) -> DirectLight:
        """Light at n receivers; without ``shadows`` as if nothing stood in its way.

        Returns
        -------
        DirectLight
            With the receivers given in the place of all.
        """
        return join_direct([self.trace_block(block, shadows) for block in cut_receivers(vertices)])

    def trace_block(self, vertices: NDArray[np.int64], shadows: bool) -> DirectLight:
        """As `trace`, of one of the pieces of `cut_receivers`."""
        before = self.rays
        halves = self._halves_at(vertices, shadows)
        squared_noise = np.sum((0.5 * (halves[:, 0] - halves[:, 1])) ** 2, axis=(1, 2))
        return DirectLight(halves.mean(axis=1).astype(np.float32), squared_noise, self.rays - before)

    def _halves_at(self, vertices: NDArray[np.int64], shadows: bool) -> NDArray[np.float64]:
        """(groups, 2, n, 3) estimates from both halves of the samples."""
        toward, along = samples_of(self.groups, self.samples)
        halves = np.zeros((len(self.groups), 2, vertices.size, 3))
        for number, count in enumerate(toward):
            for chosen in _blocks(vertices.size, count):
                light = self._toward(number, vertices[chosen], count, along if shadows else 0, shadows)
                halves[number, :, chosen] += light
        if shadows and along:
            for chosen in _blocks(vertices.size, along):
                halves[:, :, chosen] += self._along(vertices[chosen], toward, along)
        return halves

    @cached_property
    def _geometry(self) -> Any:
        return shining_geometry(self.scene)

    @cached_property
    def _media(self) -> Media:
        return Media(self.scene.mi, media_of(self.scene.mi, self._geometry))

    def _look_along(
        self, vertices: NDArray[np.int64], place: Any, ray: Any, active: Any, stream: int, *, stop_at_emitters: bool
    ) -> tuple[Any, Any, Any]:
        """As of `Media.look_along`, from receivers."""
        import drjit as dr

        mi = self.scene.mi
        medium = dr.zeros(mi.MediumPtr, dr.width(ray))
        if self._media.present:
            medium = dr.gather(mi.MediumPtr, media_around(self.scene, vertices), place)
        sampler = mi.load_dict({"type": "independent"})
        seed = np.random.SeedSequence([self.seed, stream, int(vertices[0])]).generate_state(1)[0]
        sampler.seed(mi.UInt32(int(seed)), dr.width(ray))
        return self._media.look_along(self._geometry, sampler, ray, medium, active, stop_at_emitters=stop_at_emitters)

    def _toward(
        self, number: int, vertices: NDArray[np.int64], count: int, along: int, shadows: bool
    ) -> NDArray[np.float64]:
        """(2, n, 3) estimates of the halves of ``count`` samples toward a group of lamps."""
        import drjit as dr

        mi, group = self.scene.mi, self.groups[number]
        place, u, origin_of, it = self._start(vertices, count, number)
        emitter, chance = self._emitter(group, u[2])
        ds, weight = emitter.sample_direction(it, mi.Point2f(u[0], u[1]), dr.squared_norm(it.n) > 0.5)
        cosine = dr.maximum(dr.dot(it.n, ds.d), 0.0) * dr.inv_pi
        lit = (ds.pdf > 0.0) & (cosine > 0.0)
        if shadows:
            ray = mi.Ray3f(origin_of(place, ds.d), ds.d)
            ray.maxt = ds.dist * (1.0 - _SHORTENED)
            stopped = lit & ds.delta if self.passes and not self._media.present else lit & (not self.passes)
            lit &= ~self._geometry.ray_test(ray, stopped)
            self.rays += dr.width(place)
        part = dr.select(ds.delta, 1.0, power_heuristic(count * chance * ds.pdf, along * cosine))
        value = mi.Color3f(mi.unpolarized_spectrum(weight)) * cosine * part / chance
        if shadows and self.passes:
            *_, passed = self._look_along(vertices, place, ray, lit, number, stop_at_emitters=False)
            value *= mi.Color3f(passed)
        return _halves(mi, dr.select(lit, value, 0.0), vertices.size, count)

    def _emitter(self, group: Group, u: Any) -> tuple[Any, Any]:
        """The emitter of a group, or of several one for each of the numbers ``u``; and the probability to pick it."""
        import drjit as dr

        mi, loaded = self.scene.mi, self.scene.loaded
        if group.emitters.size == 1:
            return loaded.emitters()[int(group.emitters[0])], mi.Float(1.0)
        ends = mi.Float(np.cumsum(group.weights)[:-1].astype(np.float32))
        pick = dr.binary_search(0, group.emitters.size - 1, lambda i: dr.gather(mi.Float, ends, i) <= u)
        place = dr.gather(mi.UInt32, mi.UInt32(group.emitters), pick)
        chance = dr.gather(mi.Float, mi.Float(group.weights.astype(np.float32)), pick)
        return dr.gather(mi.EmitterPtr, loaded.emitters_dr(), place), chance

    def _along(self, vertices: NDArray[np.int64], toward: list[int], count: int) -> NDArray[np.float64]:
        """(groups, 2, n, 3) estimates of the halves of ``count`` samples along the cosine, of the lamps they meet."""
        import drjit as dr

        mi, geometry = self.scene.mi, self._geometry
        place, u, origin_of, it = self._start(vertices, count, len(self.groups))
        outward = mi.Frame3f(it.n).to_world(mi.warp.square_to_cosine_hemisphere(mi.Point2f(u[0], u[1])))
        cosine = dr.maximum(dr.dot(it.n, outward), 0.0) * dr.inv_pi
        ray = mi.Ray3f(origin_of(place, outward), outward)
        active, passed = (dr.squared_norm(it.n) > 0.5) & (cosine > 0.0), None
        if self.passes:
            ray, met, passed = self._look_along(vertices, place, ray, active, len(self.groups), stop_at_emitters=True)
        else:
            met = geometry.ray_intersect_preliminary(ray, active=active)
        shining = [shape for shape in self.scene.loaded.shapes() if shape.is_emitter()]
        hit = interactions(mi, shining, ray, met, mi.RayFlags.All)
        self.rays += dr.width(place)
        emitter = hit.emitter(geometry)
        group_of, samples_of_it = self._groups_by_number(toward)
        valid = hit.is_valid() & (emitter != None)  # noqa: E711  # an array of pointers
        number: Any = dr.reinterpret_array(mi.UInt32, emitter)
        group = dr.select(valid, dr.gather(mi.Int32, group_of, number, valid), -1)
        valid &= group >= 0
        pdf = emitter.pdf_direction(it, mi.DirectionSample3f(geometry, hit, it), valid)
        pdf *= dr.gather(mi.Float, samples_of_it, number, valid)
        part = power_heuristic(count * cosine, pdf)
        value = dr.select(valid, mi.Color3f(mi.unpolarized_spectrum(emitter.eval(hit, valid))) * part, 0.0)
        if passed is not None:
            value *= mi.Color3f(passed)
        dr.eval(value, group)
        found = [
            _halves(mi, dr.select(group == i, value, 0.0), vertices.size, count)
            if self.groups[i].sampled
            else np.zeros((2, vertices.size, 3))
            for i in range(len(self.groups))
        ]
        return np.stack(found)

    def _start(self, vertices: NDArray[np.int64], count: int, stream: int) -> tuple[Any, Any, Any, Any]:
        """Places among the receivers, numbers in [0, 1)³, what gives origins of rays, and points to sample from."""
        import drjit as dr

        mi, scene = self.scene.mi, self.scene
        lane = dr.arange(mi.UInt32, vertices.size * count)
        place = lane // dr.opaque(mi.UInt32, count)
        # By the receiver, whatever block it is in, the same shifts.
        among, receiver = lane - place * count, dr.gather(mi.UInt32, mi.UInt32(vertices), place)
        keys = np.random.SeedSequence([self.seed, stream]).generate_state(2).tolist()
        shifts = [shift for key in keys for shift in mi.sample_tea_32(receiver, dr.opaque(mi.UInt32, key))]
        u = [mi.Float(among * mi.UInt32(step) + shift) * _UNIT for step, shift in zip(_STEPS, shifts, strict=False)]
        origin_of = upload_origins(mi, scene.ray_origins, vertices)
        normals = mi.Normal3f(scene.receivers.normals[vertices].T.astype(np.float32))
        it = dr.zeros(mi.SurfaceInteraction3f, vertices.size * count)
        it.p, it.n = origin_of(place, mi.Vector3f(0.0)), dr.gather(mi.Normal3f, normals, place)
        return place, u, origin_of, it

    def _groups_by_number(self, toward: list[int]) -> tuple[Any, Any]:
        """By Dr.Jit's number of an emitter, the group that it is in (-1: none) and its samples in the mean."""
        import drjit as dr

        mi = self.scene.mi
        numbers = np.array(dr.reinterpret_array(mi.UInt32, self.scene.loaded.emitters_dr()))
        group_of = np.full(int(numbers.max()) + 1, -1, dtype=np.int32)
        samples = np.zeros(group_of.size, dtype=np.float32)
        for index, group in enumerate(self.groups):
            if group.sampled:
                group_of[numbers[group.emitters]] = index
                samples[numbers[group.emitters]] = toward[index] * group.weights
        return mi.Int32(group_of), mi.Float(samples)


def cut_receivers(vertices: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Receivers in pieces whose light is put together."""
    return [vertices[begin : begin + _RECEIVERS] for begin in range(0, vertices.size, _RECEIVERS)]


def join_direct(parts: Sequence[DirectLight]) -> DirectLight:
    """The light of pieces of receivers, at least one, as if they had been one."""
    radiance = np.concatenate([part.radiance for part in parts], axis=1)
    noise = np.zeros_like(parts[0].squared_noise)
    for part in parts:
        noise += part.squared_noise
    return DirectLight(radiance, noise, sum(part.rays for part in parts))


def shining_geometry(scene: Scene) -> Any:
    """A Mitsuba scene of all shapes, those that shine as they were before they were cut into faces.

    A sphere that shines inward would be behind its own chords.
    """
    shining = {i: shape for i, shape in enumerate(scene.loaded.shapes()) if shape.is_emitter()}
    if not shining:
        return scene.geometry
    names = {shape_name(shape, i) for i, shape in shining.items()}
    receiving = [shape for shape, part in zip(scene.shapes, scene.parts, strict=False) if part.name not in names]
    occluders = [shape for shape in scene.occluders if not shape.is_emitter()]
    return mitsuba_scene(replace(scene, shapes=(*receiving, *occluders, *shining.values())))


def unshadowed_means(
    scene: Scene, emitters: NDArray[np.int64], vertices: NDArray[np.int64], samples: int
) -> NDArray[np.float64]:
    """(n,) mean radiance of unit albedo that emitters would cause at receivers, of all channels."""
    import drjit as dr

    mi, size = scene.mi, vertices.size * samples
    lane = dr.arange(mi.UInt32, emitters.size * size)
    which = lane // dr.opaque(mi.UInt32, size)
    among = lane - which * size
    place = among // dr.opaque(mi.UInt32, samples)
    first, second = (mi.Float(among * mi.UInt32(step)) * _UNIT for step in _STEPS[:2])
    it = dr.zeros(mi.SurfaceInteraction3f, emitters.size * size)
    it.p = upload_origins(mi, scene.ray_origins, vertices)(place, mi.Vector3f(0.0))
    it.n = dr.gather(mi.Normal3f, mi.Normal3f(scene.receivers.normals[vertices].T.astype(np.float32)), place)
    emitter = dr.gather(mi.EmitterPtr, scene.loaded.emitters_dr(), dr.gather(mi.UInt32, mi.UInt32(emitters), which))
    ds, weight = emitter.sample_direction(it, mi.Point2f(first, second))
    cosine = dr.select(ds.pdf > 0.0, dr.maximum(dr.dot(it.n, ds.d), 0.0), 0.0) * dr.inv_pi
    colour = mi.Color3f(mi.unpolarized_spectrum(weight))
    total = dr.block_sum((colour.x + colour.y + colour.z) / 3.0 * cosine, size)
    return np.array(total, dtype=np.float64) / size


def _even(number: int) -> int:
    """The number, or the next one if it is odd: samples have two halves."""
    return number + number % 2


def _blocks(size: int, count: int) -> list[slice]:
    """Receivers of ``count`` rays each that are traced at a time."""
    step = max(1, _RAYS_PER_BLOCK // count)
    return [slice(begin, min(begin + step, size)) for begin in range(0, size, step)]


def power_heuristic(own: Any, other: Any) -> Any:
    """What a sample counts for: the square of its density among those of both ways to find it."""
    import drjit as dr

    return dr.select(own > 0.0, dr.rcp(1.0 + dr.square(other / own)), 0.0)


def _halves(mi: Any, value: Any, size: int, count: int) -> NDArray[np.float64]:
    """(2, n, 3) means of the first and the second half of ``count`` values of each receiver; both the same of one."""
    import drjit as dr

    if count == 1:
        return np.repeat(np.array(value, dtype=np.float64).reshape(3, 1, size).transpose(1, 2, 0), 2, axis=0)
    half = count // 2
    sums = [np.array(dr.block_sum(channel, half), dtype=np.float64) for channel in value]
    return np.stack(sums, axis=-1).reshape(size, 2, 3).transpose(1, 0, 2) / half
