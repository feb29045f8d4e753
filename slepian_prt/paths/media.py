"""Free flight through participating media, as Mitsuba's ``volpath`` has it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

# Directions in which a boundary of media is looked for, in no symmetry with what people build.
_DIRECTIONS = ((0.36, 0.48, 0.8), (-0.64, 0.6, -0.48), (0.28, -0.9, 0.33), (0.71, -0.17, -0.68))

# Transmittance below this is followed at random, by as much as there is of it: dense smoke has long ways.
_FAINT = 0.05


@dataclass(frozen=True, eq=False)
class Flight:
    """Where rays within media went, on Mitsuba's arrays.

    Attributes
    ----------
    scattered : Bool
        Whether they met a particle, and not the surface ahead.
    place : MediumInteraction3f
        Where that was.
    throughput : UnpolarizedSpectrum
        Of the path up to there, or up to the surface.
    """

    scattered: Any
    place: Any
    throughput: Any


class Media:
    """The participating media of a scene; functions that fit into the body of a ``dr.while_loop``.

    Extinction may be coloured, and vary in space below a constant majorant σ̄. `volpath` takes distances by one channel
    for a whole path, which leaves the weights of the others without bound, and ends paths by absorption. Here what is
    left of the light in all channels c decides: with P_c = e^(-σ̄_c s) to a surface at s, and S_c = a_c (1 - P_c), a_c
    the albedo if that is the same everywhere, else 1,

        β_c ← β_c P_c Σ β (S + P) / Σ β P                      to the surface, with probability Σ β P / Σ β (S + P)
        β_c ← β_c e^(-σ̄_c t) Σ β (S + P) / Σ β a σ̄ e^(-σ̄ t)     to a collision at t, drawn by one channel of
                                                               probability β_c S_c / Σ β S

    and a collision scatters with probability Σ β σ_s / Σ β (σ_s + σ_n), β_c ← β_c σ_s,c / that, or is one with the
    fictitious matter σ_n that fills up to σ̄, so that Σ β never grows (one-sample model of multiple importance
    sampling, Veach 1997, Sec. 9.2.4; spectral tracking, Kutz et al. 2017).

    Parameters
    ----------
    mi : Mitsuba, in the variant of the scene
    media : iterable of Mitsuba media
        `media_of` a scene.

    Attributes
    ----------
    present : bool
        Whether there are any.
    """

    def __init__(self, mi: Any, media: Iterable[Any]) -> None:
        self._mi = mi
        known = list(media)
        self.present = bool(known)
        self._known = {medium.ptr for medium in known}
        self._vary = not all(medium.is_homogeneous() for medium in known)

    def know(self, medium: Any) -> bool:
        """Whether a Mitsuba medium is one of them; None is."""
        return medium is None or medium.ptr in self._known

    # --- Along a ray -----------------------------------------------------------------------------------------------

    def fly(self, sampler: Any, ray: Any, distance: Any, medium: Any, throughput: Any, active: Any) -> Flight:
        """Where rays go that set out within media: to a particle, or through to the surface ahead.

        Parameters
        ----------
        sampler : Sampler
        ray : Ray3f
        distance : Float
            To the surface ahead, infinite if there is none.
        medium : MediumPtr
            That rays set out in; null for none.
        throughput : UnpolarizedSpectrum
            β of the paths.
        active : Bool
        """
        import drjit as dr

        mi = self._mi
        active = active & (medium != mi.MediumPtr(None))
        begin, end = self._extent(ray, distance, medium, active)
        majorant = medium.get_majorant(self._place(ray, begin, medium), active)

        # What collisions leave of the light, where that is the same everywhere.
        scattering, _, _ = medium.get_scattering_coefficients(self._place(ray, begin, medium), active)
        kept = dr.select(medium.is_homogeneous(), _over(scattering, majorant), 1.0)

        def collide(sampler: Any, on: Any, t: Any, β: Any, scattered: Any) -> tuple[Any, ...]:
            shares = [dr.abs(part) for part in β]
            passed = dr.select(majorant > 0.0, dr.exp(-majorant * dr.maximum(end - t, 0.0)), 1.0)
            stops, goes = _weighted(kept * (1.0 - passed), shares), _weighted(passed, shares)
            met = on & (sampler.next_1d(on) * (stops + goes) < stops)
            of_channels = [share * part * (1.0 - p) for share, part, p in zip(shares, kept, passed, strict=True)]
            rate, part = _one_of((majorant, passed), of_channels, sampler.next_1d(on))
            to = t - dr.log(1.0 - sampler.next_1d(on) * (1.0 - part)) / rate
            crossed = dr.select(met, dr.exp(-majorant * dr.maximum(to - t, 0.0)), passed)
            density = dr.select(met, _weighted(kept * majorant * crossed, shares), goes)
            β = dr.select(on, _over(β * crossed * (stops + goes), density), β)

            place = self._place(ray, to, medium)
            scattering, fictitious, _ = medium.get_scattering_coefficients(place, met)
            shares = [dr.abs(part) for part in β]
            real, null = _weighted(scattering, shares), _weighted(dr.maximum(fictitious, 0.0), shares)
            hit = met & (sampler.next_1d(met) * (real + null) < real)
            change = dr.select(hit, scattering, fictitious) * (real + null)
            β = dr.select(met, _over(β * change, dr.select(hit, real, null)), β)
            goes_on = met & ~hit & (dr.max(dr.abs(β)) > 0.0)
            return sampler, goes_on, dr.select(met, to, t), mi.UnpolarizedSpectrum(β), scattered | hit

        state = (sampler, mi.Bool(active), mi.Float(begin), mi.UnpolarizedSpectrum(throughput), mi.Bool(False))
        if self._vary:
            state = dr.while_loop(state, lambda _sampler, on, *_: on, collide, label="slepian_prt: flight")
        else:  # no collision is fictitious
            state = collide(*state)
        _, _, t, β, scattered = state
        return Flight(scattered, self._place(ray, t, medium), β)

    def transmittance(self, sampler: Any, ray: Any, distance: Any, medium: Any, active: Any) -> Any:
        """What media let pass along rays: UnpolarizedSpectrum; exact, or estimated by ratio tracking (Novák 2014).

        Parameters
        ----------
        sampler, ray, distance, medium, active
            As of `fly`.
        """
        import drjit as dr

        mi = self._mi
        active = active & (medium != mi.MediumPtr(None))
        begin, end = self._extent(ray, distance, medium, active)
        majorant = medium.get_majorant(self._place(ray, begin, medium), active)
        length = dr.maximum(end - begin, 0.0)
        passed = mi.UnpolarizedSpectrum(dr.select(active & (majorant > 0.0), dr.exp(-majorant * length), 1.0))
        if not self._vary:
            return passed
        varies = active & ~medium.is_homogeneous()
        rate = dr.max(majorant)

        def collide(sampler: Any, on: Any, t: Any, passed: Any) -> tuple[Any, ...]:
            t = t - dr.log(1.0 - sampler.next_1d(on)) / rate
            on &= t < end
            _, _, extinction = medium.get_scattering_coefficients(self._place(ray, t, medium), on)
            passed = dr.select(on, passed * (1.0 - extinction / rate), passed)
            likely = dr.minimum(dr.max(passed) / _FAINT, 1.0)
            goes_on = sampler.next_1d(on) < likely
            passed = dr.select(on, dr.select(goes_on, _over(passed, likely), 0.0), passed)
            return sampler, on & goes_on, t, mi.UnpolarizedSpectrum(passed)

        tracked = (
            sampler,
            varies & (rate > 0.0),
            mi.Float(begin),
            mi.UnpolarizedSpectrum(dr.select(varies, 1.0, passed)),
        )
        return dr.while_loop(tracked, lambda _sampler, on, *_: on, collide, label="slepian_prt: transmittance")[3]

    def _extent(self, ray: Any, distance: Any, medium: Any, active: Any) -> tuple[Any, Any]:
        """Where on the way to a surface matter begins and ends: that of grids fills no more than their boxes."""
        import drjit as dr

        meets, begin, end = medium.intersect_aabb(ray)
        meets &= active & (dr.isfinite(begin) | dr.isfinite(end))
        begin = dr.select(meets, dr.maximum(begin, 0.0), 0.0)
        return begin, dr.select(meets, dr.minimum(end, distance), begin)

    def _place(self, ray: Any, t: Any, medium: Any) -> Any:
        """MediumInteraction3f at a distance along rays."""
        import drjit as dr

        place = dr.zeros(self._mi.MediumInteraction3f, dr.width(ray))
        place.t, place.p, place.wi = t, ray(t), -ray.d
        place.sh_frame = self._mi.Frame3f(place.wi)
        place.time, place.wavelengths, place.medium = ray.time, ray.wavelengths, medium
        return place

    # --- At particles ----------------------------------------------------------------------------------------------

    def scatter(self, sampler: Any, place: Any, active: Any) -> tuple[Any, Any, Any]:
        """A direction (Vector3f, world) drawn by the phase function, its weight, and its density."""
        import drjit as dr

        mi = self._mi
        phase = self._phase(place, active)
        context = mi.PhaseFunctionContext(sampler)
        wo, weight, pdf = phase.sample(context, place, sampler.next_1d(active), sampler.next_2d(active), active)
        weight = dr.select(active & (pdf > 0.0), mi.unpolarized_spectrum(weight), 0.0)
        return wo, weight, pdf

    def evaluate(self, sampler: Any, place: Any, wo: Any, active: Any) -> tuple[Any, Any]:
        """Phase function toward directions (Vector3f, world): UnpolarizedSpectrum; and its density."""
        mi = self._mi
        value, pdf = self._phase(place, active).eval_pdf(mi.PhaseFunctionContext(sampler), place, wo, active)
        return mi.unpolarized_spectrum(value), pdf

    def _phase(self, place: Any, active: Any) -> Any:
        import drjit as dr

        return dr.select(active, place.medium.phase_function(), self._mi.PhaseFunctionPtr(None))

    # --- Past surfaces ---------------------------------------------------------------------------------------------

    def look_along(
        self,
        scene: Any,
        sampler: Any,
        ray: Any,
        medium: Any,
        active: Any,
        *,
        blocked: Any = False,
        stop_at_emitters: bool = False,
    ) -> tuple[Any, Any, Any]:
        """Straight on through media and whatever surfaces let pass unbent, as null boundaries and masks.

        Parameters
        ----------
        scene : Mitsuba scene
        sampler, medium, active
            As of `fly`.
        ray : Ray3f
            Up to its ``maxt``, or to the first surface that lets nothing pass.
        blocked : Bool
            Where no surface lets anything pass.
        stop_at_emitters : bool
            Whether surfaces that emit end the way.

        Returns
        -------
        Ray3f, PreliminaryIntersection3f
            The last part of the way, and what it meets.
        UnpolarizedSpectrum
            What passes; zero where a surface is in the way that does not emit, or is not to be stopped at.
        """
        import drjit as dr

        mi = self._mi
        end = ray(ray.maxt)
        bounded = ray.maxt < dr.largest(mi.Float)

        def pass_on(sampler: Any, on: Any, ray: Any, _hit: Any, medium: Any, passed: Any) -> tuple[Any, ...]:
            hit = scene.ray_intersect_preliminary(ray, coherent=False, active=on)
            met = on & hit.is_valid()
            si = hit.compute_surface_interaction(ray, mi.RayFlags.All, met)
            if self.present:
                part = self.transmittance(sampler, ray, dr.minimum(hit.t, ray.maxt), medium, on)
                passed = dr.select(on, passed * part, passed)
            if stop_at_emitters:
                met &= hit.shape.emitter() == mi.EmitterPtr(None)
            null = mi.unpolarized_spectrum(si.bsdf().eval_null_transmission(si, met))
            passed = dr.select(met, passed * dr.select(blocked, 0.0, null), passed)
            on = met & (dr.max(passed) > 0.0)
            onward = dr.select(bounded, si.spawn_ray_to(end), si.spawn_ray(ray.d))
            medium = self.beyond(si, ray.d, medium, on)
            return sampler, on, dr.select(on, onward, ray), hit, medium, mi.UnpolarizedSpectrum(passed)

        start = (
            sampler, mi.Bool(active), mi.Ray3f(ray), dr.zeros(mi.PreliminaryIntersection3f, dr.width(ray)),
            mi.MediumPtr(medium), mi.UnpolarizedSpectrum(1.0),
        )  # fmt: skip
        _, _, ray, hit, _, passed = dr.while_loop(
            start, lambda _sampler, on, *_: on, pass_on, label="slepian_prt: looking through"
        )
        return ray, hit, dr.select(active, passed, 0.0)

    def beyond(self, si: Any, direction: Any, medium: Any, active: Any) -> Any:
        """MediumPtr, what lies in a direction (Vector3f, world) of surfaces; ``medium`` where they part none."""
        import drjit as dr

        if not self.present:
            return medium
        parts = active & si.is_valid() & si.is_medium_transition()
        return dr.select(parts, si.target_medium(direction), medium)


def media_of(mi: Any, scene: Any) -> list[Any]:
    """The participating media of a Mitsuba scene, on both sides of its surfaces and around its cameras."""
    return [node for node in mi.traverse(scene).hierarchy if isinstance(node, mi.Medium)]


def medium_at(mi: Any, scene: Any, points: Any) -> Any:
    """The medium that points lie in, by the nearest of its boundaries along some rays: MediumPtr, null for none.

    Parameters
    ----------
    mi : Mitsuba, in the variant of the scene
    scene : Mitsuba scene
    points : Point3f
    """
    import drjit as dr

    def look(on: Any, ray: Any, far: Any, found: Any) -> tuple[Any, ...]:
        si = scene.ray_intersect(ray, on)
        far = far + si.t
        on &= si.is_valid()
        parts = on & si.is_medium_transition()
        found = dr.select(parts, si.target_medium(-ray.d), found)
        return on & ~parts, si.spawn_ray(ray.d), far, found

    nearest, medium = mi.Float(dr.inf), dr.zeros(mi.MediumPtr, dr.width(points))
    for direction in _DIRECTIONS:
        ray = mi.Ray3f(points, dr.normalize(mi.Vector3f(*direction)))
        none = mi.Float(0.0), dr.zeros(mi.MediumPtr, dr.width(points))
        state = (mi.Bool(True), ray, *none)
        _, _, far, found = dr.while_loop(state, lambda on, *_: on, look, label="slepian_prt: boundaries of media")
        nearer = far < nearest
        nearest, medium = dr.select(nearer, far, nearest), dr.select(nearer, found, medium)
    return medium


def _one_of(spectra: tuple[Any, ...], shares: list[Any], u: Any) -> list[Any]:
    """One channel of some spectra, the same of each, drawn by the shares of channels."""
    import drjit as dr

    chosen, below, drawn = [spectrum[0] for spectrum in spectra], shares[0], u * dr.sum(shares)
    for channel, share in enumerate(shares[1:], start=1):
        here = drawn >= below
        chosen = [dr.select(here, spectrum[channel], one) for spectrum, one in zip(spectra, chosen, strict=True)]
        below = below + share
    return chosen


def _weighted(values: Any, shares: list[Any]) -> Any:
    import drjit as dr

    return dr.sum([value * share for value, share in zip(values, shares, strict=True)])


def _over(value: Any, divisor: Any) -> Any:
    """The quotient, zero where the divisor is."""
    import drjit as dr

    return dr.select(divisor > 0.0, value / divisor, 0.0)
