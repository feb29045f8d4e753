"""Light straight from the emitters of a scene."""

from __future__ import annotations

from typing import Any, NamedTuple

from slepian_prt.paths.media import Media
from slepian_prt.paths.scattering import Scatterer
from slepian_prt.relighting.mitsuba.lobes import Material

# Shadow rays for the lamps at a held point, at most; and points on lamps, of one or of several lamps, that one of these
# is chosen from by what would arrive.
_RAYS, _CANDIDATES, _OF_SEVERAL = 4, 16, 8

# Additive recurrences: a lamp by the golden ratio, a point on it by the root of x³ = x + 1 (Roberts 2018).
_STEPS = (0.6180339887498949, 0.7548776662466927, 0.5698402909980532)


class HeldPoint(NamedTuple):
    """Where lamps light a surface that a file holds.

    Attributes
    ----------
    si : SurfaceInteraction3f
    material : Material
        There.
    medium : MediumPtr
        That it is looked at through.
    """

    si: Any
    material: Material
    medium: Any


class Lamps:
    """The emitters of a scene, to be sampled; those that are not distant are its lamps.

    Parameters
    ----------
    mi : Mitsuba, in the variant of the scene
    scene : Mitsuba scene
    media : Media
        Of the scene.
    through : bool
        Whether light may go straight through surfaces of the scene.

    Attributes
    ----------
    count : int
        Of lamps.
    """

    def __init__(self, mi: Any, scene: Any, media: Media, *, through: bool) -> None:
        self._mi, self._media, self._through = mi, media, through or media.present
        lamps = [emitter for emitter in scene.emitters() if not emitter.is_environment()]
        self.count, self._all = len(lamps), len(scene.emitters())
        distant = [emitter for emitter in scene.emitters() if emitter.is_environment()]
        self._emitters = _joined(mi, [mi.EmitterPtr(emitter) for emitter in (*lamps, *distant)])
        self._has_surfaces = any(emitter.get_shape() is not None for emitter in lamps)
        self._rays = min(self.count, _RAYS)
        self._candidates = _CANDIDATES if self.count == 1 else _OF_SEVERAL
        if self.count <= _RAYS and not self._has_surfaces:
            self._candidates = 1

    def sample(self, scene: Any, point: Scatterer, sampler: Any) -> tuple[Any, Any]:
        """A direction to one of the emitters, each as likely.

        Parameters
        ----------
        scene : Mitsuba scene
        point : Scatterer
        sampler : Sampler

        Returns
        -------
        DirectionSample3f
            Of zero density where nothing arrives.
        UnpolarizedSpectrum
            What arrives, over that density.
        """
        import drjit as dr

        mi = self._mi
        active = point.active & (self._all > 0)
        ds, arriving = self._toward(point.origin, sampler.next_1d(), sampler.next_2d(), self._all, active)
        medium = point.medium_toward(ds.d)
        seen, passed = self._sees(scene, point.origin, ds.p, ds.delta, medium, sampler, active & (ds.pdf != 0.0))
        ds.pdf = dr.select(seen, ds.pdf, 0.0)
        return ds, dr.select(seen, arriving * passed, mi.UnpolarizedSpectrum(0.0))

    def density(self, before: Any, ds: Any, active: Any) -> Any:
        """With which `sample` draws a direction."""
        import drjit as dr

        density = ds.emitter.pdf_direction(before, ds, active)
        return dr.select(active, density / max(self._all, 1), 0.0)

    def on_held(self, scene: Any, point: HeldPoint, sampler: Any, active: Any) -> Any:
        """What held lobes reflect of the lamps: UnpolarizedSpectrum.

        Where lamps are surfaces, it is looked for toward them and along the cosine, and what both find is weighted by
        the power heuristic (Veach 1997, Sec. 9.2), so that near ones have little noise.

        Parameters
        ----------
        scene : Mitsuba scene
        point : HeldPoint
        sampler : Sampler
        active : Bool
        """
        light = self._mi.UnpolarizedSpectrum(0.0)
        if self.count:
            active = active & point.material.held
            light += self._on_held_toward(scene, point, sampler, active)
            if self._has_surfaces:
                light += self._on_held_along(scene, point, sampler, active)
        return light

    def _on_held_toward(self, scene: Any, point: HeldPoint, sampler: Any, active: Any) -> Any:
        """By shadow rays, each to a part of the lamps."""
        import drjit as dr

        mi = self._mi
        begin, on_it, choice = sampler.next_1d(), sampler.next_2d(), sampler.next_1d()

        def look(sampler: Any, ray: Any, light: Any) -> Any:
            drawn = [_fraction(value + mi.Float(ray) * _STEPS[0]) for value in (begin, *on_it, choice)]
            return sampler, ray + 1, light + self._one_ray(scene, point, sampler, ray, drawn, active)

        state = (sampler, mi.UInt32(0), mi.UnpolarizedSpectrum(dr.zeros(mi.Float, dr.width(active))))
        _, _, light = dr.while_loop(
            state, lambda _sampler, ray, _: active & (ray < self._rays), look, label="slepian_prt: lamps"
        )
        return light / self._rays

    def _one_ray(self, scene: Any, point: HeldPoint, sampler: Any, ray: Any, drawn: list[Any], active: Any) -> Any:
        """Resampled (Talbot et al. 2005): of M candidates one by w ∝ what it would bring, which counts as Σ w / (M w).

        The candidates are spread evenly over the lamps, so that Σ w has little noise, and only shadows have more.
        """
        import drjit as dr

        mi, count = self._mi, self._candidates
        si, material = point.si, point.material
        *begin, choice = drawn

        def look(number: Any, total: Any, choice: Any, place: Any, delta: Any, arriving: Any, chosen: Any) -> Any:
            steps = zip(begin, _STEPS, strict=True)
            which, first, second = (_fraction(value + mi.Float(number) * step) for value, step in steps)
            which = (mi.Float(ray) + which) / self._rays
            ds, light = self._toward(si, which, mi.Point2f(first, second), self.count, active)
            cosine = material.reflects_toward(si.to_local(ds.d))
            light *= dr.select(ds.delta, 1.0, self._share(count * self._rays * ds.pdf, cosine * dr.inv_pi))
            weight = dr.select(active & (ds.pdf != 0.0), cosine * dr.mean(light), 0.0)
            weight = dr.select(dr.isfinite(weight) & (weight > 0.0), weight, 0.0)
            total = total + weight
            part = weight / total
            taken = (weight > 0.0) & (choice <= part)
            choice = dr.select(taken, choice / part, dr.select(part < 1.0, (choice - part) / (1.0 - part), choice))
            place, delta = dr.select(taken, ds.p, place), dr.select(taken, ds.delta, delta)
            arriving, chosen = dr.select(taken, light, arriving), dr.select(taken, weight, chosen)
            return number + 1, total, choice, place, delta, arriving, chosen

        none = dr.zeros(mi.Float, dr.width(active))
        state = (
            mi.UInt32(0), none, mi.Float(choice), mi.Point3f(si.p), mi.Bool(False), mi.UnpolarizedSpectrum(none),
            mi.Float(none),
        )  # fmt: skip
        _, total, _, place, delta, arriving, chosen = dr.while_loop(
            state, lambda number, *_: active & (number < count), look, label="slepian_prt: candidates"
        )
        direction = dr.normalize(place - si.p)
        medium = self._media.beyond(si, direction, point.medium, active)
        seen, passed = self._sees(scene, si, place, delta, medium, sampler, active & (chosen > 0.0))
        reflected = material.held_from(si.to_local(direction), seen) * arriving * passed
        return dr.select(seen, reflected * (total / (count * chosen)), 0.0)

    def _on_held_along(self, scene: Any, point: HeldPoint, sampler: Any, active: Any) -> Any:
        """By a ray that is drawn by the cosine, of the lamp that it meets."""
        import drjit as dr

        mi, si, material = self._mi, point.si, point.material
        wo = material.by_cosine(sampler.next_2d())
        density = material.reflects_toward(wo) * dr.inv_pi
        ray = si.spawn_ray(si.to_world(wo))
        active = active & (density > 0.0)
        passed: Any = 1.0
        if self._through:
            medium = self._media.beyond(si, ray.d, point.medium, active)
            ray, hit, passed = self._media.look_along(scene, sampler, ray, medium, active, stop_at_emitters=True)
        else:
            hit = scene.ray_intersect_preliminary(ray, coherent=False, active=active)
        shines = active & hit.is_valid() & (hit.shape.emitter() != mi.EmitterPtr(None))
        there = hit.compute_surface_interaction(ray, mi.RayFlags.All, shines)
        ds = mi.DirectionSample3f(scene, there, si)
        of_lamps = ds.emitter.pdf_direction(si, ds, shines) * (self._candidates * self._rays / self.count)
        light = mi.unpolarized_spectrum(ds.emitter.eval(there, shines)) * self._share(density, of_lamps) * passed
        return dr.select(shines, material.held_from(wo, shines) * light / density, 0.0)

    def _sees(
        self, scene: Any, origin: Any, place: Any, delta: Any, medium: Any, sampler: Any, active: Any
    ) -> tuple[Any, Any]:
        """Whether a place is seen from an Interaction3f, and what passes of what it sends there.

        What emits from a point (``delta``) is hidden by all surfaces where there are no media, as of ``path``.
        """
        import drjit as dr

        ray = origin.spawn_ray_to(place)
        if not self._through:
            return active & ~scene.ray_test(ray, active), 1.0
        blocked = not self._media.present and delta
        _, _, passed = self._media.look_along(scene, sampler, ray, medium, active, blocked=blocked)
        return active & (dr.max(passed) > 0.0), passed

    def _toward(self, si: Any, which: Any, place: Any, count: int, active: Any) -> tuple[Any, Any]:
        """A sample of one of the first ``count`` emitters, and what arrives from there, over its density."""
        import drjit as dr

        mi = self._mi
        index = dr.minimum(mi.UInt32(which * mi.Float(count)), max(count, 1) - 1)
        emitter = dr.gather(mi.EmitterPtr, self._emitters, index, active)
        ds, arriving = emitter.sample_direction(si, place, active)
        ds.pdf /= max(count, 1)
        return ds, mi.unpolarized_spectrum(arriving) * count

    def _share(self, own: Any, other: Any) -> Any:
        """Of what is found in two ways, by their densities, that of the first; 1 where there is but one."""
        return power_heuristic(own, other) if self._has_surfaces else self._mi.Float(1.0)


def _fraction(value: Any) -> Any:
    import drjit as dr

    return value - dr.floor(value)


def power_heuristic(own: Any, other: Any) -> Any:
    """Weight of a technique of density ``own`` beside one of density ``other`` (Veach 1997, 9.2.4)."""
    import drjit as dr

    weight = dr.square(own) / (dr.square(own) + dr.square(other))
    return dr.select(dr.isfinite(weight), weight, 0.0)


def _joined(mi: Any, emitters: list[Any]) -> Any:
    """Pointers as one array, with a null at the end."""
    import drjit as dr

    numbers = [int(mi.UInt32(dr.reinterpret_array(mi.UInt32, emitter))[0]) for emitter in emitters]
    return dr.reinterpret_array(mi.EmitterPtr, mi.UInt32([*numbers, 0]))
