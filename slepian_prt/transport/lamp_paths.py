"""Light of lamps that comes to receivers by way of mirrors, glass and the like, such as caustics.

Along the same paths as in `path_light`, lamps are looked for from every point that scatters, and what paths meet counts
as far as it emits, weighted by the power heuristic (Veach 1997, Sec. 9.2). What comes straight, or through nothing but
boundaries that all light passes, is left to `lamp_light`, and what held surfaces reflect to the exchange between them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.paths.media import Media, media_of
from slepian_prt.paths.scattering import Drawn, Scatterer
from slepian_prt.paths.tracer import PathTracer
from slepian_prt.scene.face_table import shape_numbers
from slepian_prt.scene.scene import Scene
from slepian_prt.transport.effects import PathPlan
from slepian_prt.transport.first_rays import FirstRays
from slepian_prt.transport.held_faces import HeldFaces
from slepian_prt.transport.lamp_light import Group, power_heuristic, shining_geometry
from slepian_prt.transport.planned import PlannedScene


class BroughtLight(NamedTuple):
    """Light of n groups of lamps at k receivers, for unit albedo.

    Attributes
    ----------
    rows : (k,)
        The receivers.
    radiance : (n, k, 3) float32
    error : (n, k, 3) float32
        Half the difference of its two halves.
    rays : int
    """

    rows: NDArray[np.int64]
    radiance: NDArray[np.float32]
    error: NDArray[np.float32]
    rays: int


def trace_lamp_paths(planned: PlannedScene, wanted: PathPlan) -> BroughtLight:
    """What the lamps of a planned scene send to its receivers on paths."""
    paths = LampPaths.planned(planned, wanted)
    return join_brought([paths.trace(block) for block in paths.blocks(wanted.receivers)])


def join_brought(parts: Sequence[BroughtLight]) -> BroughtLight:
    """The light of blocks of receivers, as if they had been one."""
    rows = np.concatenate([part.rows for part in parts])
    radiance, error = (np.concatenate([part[place] for part in parts], axis=1) for place in (1, 2))
    return BroughtLight(rows, radiance, error, sum(part.rays for part in parts))


class LampPaths:
    """Paths from receivers that look for lamps; arguments as of `PathRays`, and the lamps."""

    def __init__(self, scene: Scene, groups: list[Group], samples: int, effects: Iterable[str], seed: int) -> None:
        geometry = shining_geometry(scene)
        held = _HeldOrShining(scene, geometry)
        lights = _LampLights(scene, geometry, groups)
        self._groups, self._samples = len(groups), samples
        self._first = FirstRays(scene, geometry, held, samples, effects, seed)
        self._tracer = PathTracer(scene.mi, geometry, held.materials, known=held, lights=lights)

    @classmethod
    def planned(cls, planned: PlannedScene, wanted: PathPlan) -> LampPaths:
        """As a plan wants them."""
        groups, seed = planned.lamps.groups, planned.settings.seed + 3
        return cls(planned.scene, groups, wanted.samples, wanted.effects, seed)

    def blocks(self, vertices: NDArray[np.int64]) -> list[NDArray[np.int64]]:
        """The receivers in blocks to trace."""
        return self._first.blocks(vertices)

    def trace(self, block: NDArray[np.int64]) -> BroughtLight:
        """What comes to a block of receivers."""
        import drjit as dr

        samples = self._samples
        sums, rays = np.zeros((2, self._groups, block.size, 3)), block.size * samples
        gone = self._first.trace(block)
        if gone.lanes.size:
            sampler = self._first.sampler(block, gone.lanes.size)
            ends = self._tracer.follow(
                sampler, gone.ray, hit=gone.hit, medium=gone.medium, first_known=gone.first_known
            )
            dr.eval(ends.points, ends.found)  # together: the loop would run once for each
            rays += int(np.array(ends.points, dtype=np.int64).sum())
            half = (gone.lanes % samples >= samples // 2).astype(np.int64)
            place = half * block.size + gone.lanes // samples
            for number, colour in enumerate(ends.found[0]):
                for channel, values in enumerate(colour):
                    total = np.bincount(place, np.array(values, dtype=np.float64), minlength=2 * block.size)
                    sums[:, number, :, channel] = total.reshape(2, -1) / samples
        first, second = sums
        return BroughtLight(block, (first + second).astype(np.float32), (first - second).astype(np.float32), rays)


class _HeldOrShining(HeldFaces):
    """Held faces, and the surfaces of lamps that are held: in the geometry of lamps they are what they were at first.

    What they reflect is known, as of others; the sky and they are not gone on from.
    """

    def __init__(self, scene: Scene, geometry: Any) -> None:
        super().__init__(scene, geometry)
        shining = [shape for shape in scene.loaded.shapes() if shape.is_emitter()]
        numbers = shape_numbers(scene.mi, shining)
        table = np.zeros(int(numbers.max(initial=0)) + 1, dtype=bool)
        table[numbers] = True
        self._shining = scene.mi.Bool(table)

    def at(self, ray: Any, hit: Any, si: Any, active: Any) -> tuple[Any, Any]:
        valid, albedo = super().at(ray, hit, si, active)
        return valid | (active & self._shines(hit)), albedo

    def first_met(self, ray: Any, hit: Any) -> Any:
        import drjit as dr

        return dr.select(self._shines(hit), 0, super().first_met(ray, hit))

    def _shines(self, hit: Any) -> Any:
        import drjit as dr

        number: Any = dr.reinterpret_array(self._mi.UInt32, hit.shape)
        known = hit.is_valid() & (number < dr.width(self._shining))
        return dr.gather(self._mi.Bool, self._shining, number, known)


class _LampLights:
    """Adds up the light of groups of lamps; see `slepian_prt.paths.tracer.Lights`.

    ``found`` is: the light of each group (Color3f); the last point that scattered, unless by a boundary that all light
    passes (Interaction3f); the density with which the direction was drawn there; and whether it was a mirror's.
    """

    def __init__(self, scene: Scene, geometry: Any, groups: list[Group]) -> None:
        mi = scene.mi
        self._mi, self._count = mi, len(groups)
        self._media = Media(mi, media_of(mi, geometry))
        emitters = np.concatenate([group.emitters for group in groups])
        chances = np.concatenate([group.weights for group in groups]) / len(groups)
        of_group = np.repeat(np.arange(len(groups)), [group.emitters.size for group in groups])
        self._ends = mi.Float(np.cumsum(chances)[:-1].astype(np.float32))
        self._emitters = scene.loaded.emitters_dr()
        self._places = mi.UInt32(emitters.astype(np.uint32))
        self._chances = mi.Float(chances.astype(np.float32))
        self._groups = mi.UInt32(of_group.astype(np.uint32))
        numbers = self._numbers(scene)
        by_number = np.full(int(numbers.max()) + 1, -1, dtype=np.int32)
        by_number[numbers[emitters]] = np.arange(emitters.size)
        self._by_number = mi.Int32(by_number)

    def _numbers(self, scene: Scene) -> NDArray[np.uint32]:
        import drjit as dr

        return np.array(dr.reinterpret_array(self._mi.UInt32, scene.loaded.emitters_dr()))

    def start(self, lanes: int) -> Any:
        import drjit as dr

        mi = self._mi
        none = tuple(dr.zeros(mi.Color3f, lanes) for _ in range(self._count))
        return none, dr.zeros(mi.Interaction3f, lanes), mi.Float(0.0), mi.Bool(True)

    def met(self, scene: Any, si: Any, covered: Any, throughput: Any, active: Any, found: Any) -> Any:
        import drjit as dr

        mi = self._mi
        light, before, pdf, mirrored = found
        emitter = si.emitter(scene, active)
        number: Any = dr.reinterpret_array(mi.UInt32, emitter)
        known = active & covered & (emitter != mi.EmitterPtr(None)) & (number < dr.width(self._by_number))
        place = dr.gather(mi.Int32, self._by_number, number, known)
        known &= place >= 0
        place = mi.UInt32(place)
        ds = mi.DirectionSample3f(scene, si, before)
        looked = emitter.pdf_direction(before, ds, known & ~mirrored) * dr.gather(mi.Float, self._chances, place, known)
        value = mi.Color3f(mi.unpolarized_spectrum(emitter.eval(si, known)))
        value *= throughput * dr.select(mirrored, 1.0, power_heuristic(pdf, looked))
        return self._added(light, place, value, known), before, pdf, mirrored

    def sampled(self, scene: Any, sampler: Any, point: Scatterer, throughput: Any, active: Any, found: Any) -> Any:
        import drjit as dr

        mi = self._mi
        u, at = sampler.next_1d(), sampler.next_2d()
        last = dr.width(self._places) - 1
        pick = mi.UInt32(0)
        if last:
            pick = dr.binary_search(0, last, lambda i: dr.gather(mi.Float, self._ends, i) <= u)
        chance = dr.gather(mi.Float, self._chances, pick)
        emitter = dr.gather(mi.EmitterPtr, self._emitters, dr.gather(mi.UInt32, self._places, pick), active)
        ds, weight = emitter.sample_direction(point.origin, at, active)
        scattered, pdf = point.evaluate(sampler, ds.d, active)
        active = active & (ds.pdf > 0.0) & (dr.max(dr.abs(scattered)) > 0.0)
        ray = point.origin.spawn_ray_to(ds.p)
        _, _, passed = self._media.look_along(scene, sampler, ray, point.medium_toward(ds.d), active)
        part = dr.select(ds.delta, 1.0, power_heuristic(ds.pdf * chance, pdf))
        value = throughput * mi.Color3f(mi.unpolarized_spectrum(weight) * scattered * passed) * part / chance
        return self._added(found[0], pick, value, active), *found[1:]

    def left(self, point: Scatterer, drawn: Drawn, active: Any, found: Any) -> Any:
        import drjit as dr

        mi = self._mi
        light, before, pdf, mirrored = found
        turned = active & ~mi.has_flag(drawn.sampled_type, mi.BSDFFlags.Null)
        mirror = mi.has_flag(drawn.sampled_type, mi.BSDFFlags.Delta)
        return (
            light,
            dr.select(turned, point.origin, before),
            dr.select(turned, drawn.pdf, pdf),
            dr.select(turned, mirror, mirrored),
        )

    def _added(self, light: Any, place: Any, value: Any, active: Any) -> Any:
        """The light of all groups with the value added to that of the lamp in a place."""
        import drjit as dr

        group = dr.gather(self._mi.UInt32, self._groups, place, active)
        return tuple(part + dr.select(active & (group == number), value, 0.0) for number, part in enumerate(light))
