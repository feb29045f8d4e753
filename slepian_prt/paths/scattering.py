"""Where paths go on from: surfaces, by the lobes that are left of them, and particles of media."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

from slepian_prt.paths.media import Flight, Media

# Paths go on with this probability at most, once roulette decides: from surfaces as Mitsuba has it, and from particles
# more often, since paths in clouds and milk are long, and the weights of the few that are left would be large.
_FROM_SURFACES, _FROM_PARTICLES = 0.95, 0.99


class SurfaceLobes(Protocol):
    """Lobes of materials at points of surfaces, as `Remainder` has them."""

    @property
    def scatters(self) -> Any:
        """Bool, whether there are any."""
        ...

    def evaluate(self, wo: Any, active: Any) -> tuple[Any, Any]:
        """Value times cosine, and the density with which `sample` draws the direction."""
        ...

    def sample(self, sampler: Any) -> tuple[Any, Any]:
        """A direction: BSDFSample3f, and value times cosine over its density."""
        ...


class Drawn(NamedTuple):
    """Directions that were drawn, on Mitsuba's arrays.

    Attributes
    ----------
    direction : Vector3f
        In the world.
    weight : UnpolarizedSpectrum
        Value times cosine over the density.
    pdf, eta : Float
        That density, and the relative index of refraction.
    sampled_type : UInt32
        Flags of the lobe.
    """

    direction: Any
    weight: Any
    pdf: Any
    eta: Any
    sampled_type: Any


class Scatterer:
    """What scatters light where paths are.

    Parameters
    ----------
    mi : Mitsuba, in the variant of the scene
    media : Media
    si : SurfaceInteraction3f
        What the paths meet, unless they meet a particle before.
    lobes : SurfaceLobes
        There.
    medium : MediumPtr
        That they come through.
    flight : Flight or None
        Through it; None where a scene has no media.
    active : Bool

    Attributes
    ----------
    origin : Interaction3f
    active : Bool
        Whether anything does scatter.
    most_likely : float or Float
        With what probability paths go on at most where roulette ends them.
    """

    def __init__(
        self, mi: Any, media: Media, si: Any, lobes: SurfaceLobes, medium: Any, flight: Flight | None, active: Any
    ) -> None:
        import drjit as dr

        self._mi, self._media, self._si, self._lobes = mi, media, si, lobes
        self._medium, self._flight = medium, flight
        self.origin, self.active = mi.Interaction3f(si), lobes.scatters
        self.most_likely: Any = _FROM_SURFACES
        if flight is not None:
            self._particle = active & flight.scattered
            self.origin = dr.select(self._particle, mi.Interaction3f(flight.place), self.origin)
            self.active = self.active | self._particle
            self.most_likely = dr.select(self._particle, _FROM_PARTICLES, _FROM_SURFACES)

    def medium_toward(self, direction: Any) -> Any:
        """MediumPtr, what lies in a direction (Vector3f, world)."""
        if self._flight is None:
            return self._medium
        return self._media.beyond(self._si, direction, self._medium, self.active & ~self._particle)

    def evaluate(self, sampler: Any, direction: Any, active: Any) -> tuple[Any, Any]:
        """Value times cosine toward directions (Vector3f, world), and the density with which `sample` draws them."""
        import drjit as dr

        value, pdf = self._lobes.evaluate(self._si.to_local(direction), active & self._lobes.scatters)
        if self._flight is not None:
            particle = active & self._particle
            phase, phase_pdf = self._media.evaluate(sampler, self._flight.place, direction, particle)
            value, pdf = dr.select(particle, phase, value), dr.select(particle, phase_pdf, pdf)
        return value, pdf

    def sample(self, sampler: Any) -> Drawn:
        """Directions in which the paths go on."""
        import drjit as dr

        lobe, weight = self._lobes.sample(sampler)
        drawn = Drawn(self._si.to_world(lobe.wo), weight, lobe.pdf, lobe.eta, lobe.sampled_type)
        if self._flight is None:
            return drawn
        direction, phase_weight, pdf = self._media.scatter(sampler, self._flight.place, self._particle)
        glossy = self._mi.UInt32(int(self._mi.BSDFFlags.Glossy))
        scattered = Drawn(direction, phase_weight, pdf, self._mi.Float(1.0), glossy)
        return Drawn(*(dr.select(self._particle, new, old) for new, old in zip(scattered, drawn, strict=True)))

    def goes_straight(self, drawn: Drawn, active: Any) -> Any:
        """Bool, where directions are those from before, and light is seen through (`Media.look_along`).

        Not through bumps on null lobes, of which Mitsuba's ``eval_null_transmission`` says nothing.
        """
        import drjit as dr

        mi, si = self._mi, self._si
        null = active & self._lobes.scatters & mi.has_flag(drawn.sampled_type, mi.BSDFFlags.Null)
        seen = mi.unpolarized_spectrum(si.bsdf().eval_null_transmission(si, null))
        return null & (dr.max(seen) > 0.0)
