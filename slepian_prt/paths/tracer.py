"""Paths through a scene, followed until they escape, or meet a surface whose light is known, or die.

A path that escapes in direction ω with throughput β contributes β L(ω), whatever the distant light L is: β y_lm(ω) to
the coefficients of transfer. No light is looked for on the way (distant light is all around), so that a path has one
end, and one render serves any light.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

from slepian_prt.paths.lobes import MaterialTable, Remainder
from slepian_prt.paths.media import Media, media_of
from slepian_prt.paths.scattering import Drawn, Scatterer

# Longest path that can be asked for is none at all, as Mitsuba's ``max_depth`` -1.
_ENDLESS = 0xFFFFFFFF

# Of paths that meet known surfaces which are not only diffuse, so many end there; the others go on without that lobe.
_ENDING = 0.5


class KnownSurfaces(Protocol):
    """Surfaces whose diffuse reflection is known, so that paths need not go on from there."""

    def at(self, ray: Any, hit: Any, si: Any, active: Any) -> tuple[Any, Any]:
        """Where rays meet the scene, whether the diffuse reflection is known (Bool), and its albedo (Color3f).

        Parameters
        ----------
        ray : Ray3f
        hit : PreliminaryIntersection3f
        si : SurfaceInteraction3f
        active : Bool
        """
        ...


class Lights(Protocol):
    """Lamps whose light is added up along paths; ``found`` is a PyTree of Mitsuba's arrays that goes along."""

    def start(self, lanes: int) -> Any:
        """``found`` before the first segments."""
        ...

    def met(self, scene: Any, si: Any, covered: Any, throughput: Any, active: Any, found: Any) -> Any:
        """``found`` with what surfaces emit that paths met (SurfaceInteraction3f), of those that anything covered."""
        ...

    def sampled(self, scene: Any, sampler: Any, point: Scatterer, throughput: Any, active: Any, found: Any) -> Any:
        """``found`` with the light that comes to points straight from lamps, which the points scatter."""
        ...

    def left(self, point: Scatterer, drawn: Drawn, active: Any, found: Any) -> Any:
        """``found`` after the next directions were drawn."""
        ...


@dataclass(frozen=True, eq=False)
class PathEnds:
    """Where paths ended, on Mitsuba's arrays.

    Attributes
    ----------
    escaped : Bool
        Whether into the distance, in the direction of ``ray``.
    held : Bool
        Whether on a known surface, at ``hit``.
    covered : Bool
        Whether there was anything on the way but boundaries that all light passes.
    throughput : Color3f
        β, linear sRGB, without the albedo of the known surface; zero of paths that died.
    ray : Ray3f
        The last segment.
    hit : PreliminaryIntersection3f
        What that met.
    points : UInt32
        Number of points of the scene on the way.
    found : what `Lights` gathered, or an empty tuple
    """

    escaped: Any
    held: Any
    covered: Any
    throughput: Any
    ray: Any
    hit: Any
    points: Any
    found: Any = ()


class PathTracer:
    """Follows the samples of Mitsuba's materials and phase functions through a scene.

    Parameters
    ----------
    mi : Mitsuba, in an RGB variant, that of the scene
    scene : Mitsuba scene
        What emits light in it does not.
    materials : iterable of Mitsuba BSDFs
        Of its shapes.
    known : KnownSurfaces, optional
    lights : Lights, optional
    max_depth, rr_depth : int
        As of Mitsuba's ``path``.

    Attributes
    ----------
    has_media : bool
        Whether there are participating media in the scene.
    """

    def __init__(
        self,
        mi: Any,
        scene: Any,
        materials: Iterable[Any],
        *,
        known: KnownSurfaces | None = None,
        lights: Lights | None = None,
        max_depth: int = -1,
        rr_depth: int = 5,
    ) -> None:
        self._mi, self._scene, self._known, self._lights = mi, scene, known, lights
        self.table = MaterialTable(mi, materials)
        self._media = Media(mi, media_of(mi, scene))
        self.has_media = self._media.present
        self._max_depth, self._rr_depth = max_depth if max_depth >= 0 else _ENDLESS, rr_depth

    def follow(
        self,
        sampler: Any,
        ray: Any,
        *,
        hit: Any = None,
        throughput: Any = None,
        medium: Any = None,
        active: Any = True,
        first_known: Any = False,
    ) -> PathEnds:
        """Follow paths from their first segments.

        Parameters
        ----------
        sampler : Sampler
            Seeded, of as many lanes as there are rays.
        ray : Ray3f
        hit : PreliminaryIntersection3f, optional
            What they meet, where that is there already.
        throughput : Color3f, optional
            By default 1.
        medium : Mitsuba medium or MediumPtr, optional
            That the paths begin in, one of the scene's. By default none; `medium_at` finds it.
        active : Bool
        first_known : bool or Bool
            Whether somebody else accounts for the known reflection of the first points: paths then go on from there
            with what is left of the material, if anything.
        """
        import drjit as dr

        mi = self._mi
        active = mi.Bool(active)
        if hit is None:
            hit = self._scene.ray_intersect_preliminary(mi.Ray3f(ray), coherent=True, active=active)
        state = (
            sampler,
            active,  # Is the path still going on?
            mi.Ray3f(ray),  # Its last segment
            hit,  # What that meets
            dr.zeros(mi.MediumPtr, dr.width(ray)) if medium is None else mi.MediumPtr(medium),  # What it goes through
            mi.Color3f(1.0 if throughput is None else throughput),  # β: throughput
            mi.Float(1.0),  # η: relative index of refraction, all along
            mi.UInt32(0),  # Number of points
            mi.Bool(False),  # Has it escaped?
            mi.Bool(False),  # Has it ended on a known surface?
            mi.Bool(False),  # Was there anything on the way?
            () if self._lights is None else self._lights.start(dr.width(ray)),  # Light of lamps
        )
        step = partial(self._step, first_known)
        state = dr.while_loop(state, lambda *state: state[1], step, label="slepian_prt: paths")
        _, _, ray, hit, _, β, _, points, escaped, held, covered, found = state
        return PathEnds(escaped, held, covered, dr.select(escaped | held, β, 0.0), ray, hit, points, found)

    def _step(
        self, first_known: Any, sampler: Any, active: Any, ray: Any, hit: Any, medium: Any, β: Any, η: Any,
        points: Any, escaped: Any, held: Any, covered: Any, found: Any,
    ) -> tuple[Any, ...]:  # fmt: skip
        import drjit as dr

        mi = self._mi
        si = hit.compute_surface_interaction(ray, mi.RayFlags.All, active)
        flight, arrives = None, active
        if self.has_media:
            flight = self._media.fly(sampler, ray, hit.t, medium, β, active)
            β, arrives = flight.throughput, active & ~flight.scattered
        escaped |= arrives & ~si.is_valid()
        active &= ~escaped & (points + 1 < self._max_depth)
        arrives &= active
        if self._lights is not None:
            found = self._lights.met(self._scene, si, covered, β, arrives, found)

        # ----------------- Light that is known ---------------------

        known, albedo = mi.Bool(False), mi.Color3f(0.0)
        if self._known is not None:
            known, albedo = self._known.at(ray, hit, si, arrives)
        rest = Remainder(self.table, si, known, albedo, arrives)
        point = Scatterer(mi, self._media, si, rest, medium, flight, active)
        if self._known is not None:
            meets = rest.diffuse & ~((points == 0) & first_known)
            share = dr.select(rest.scatters, _ENDING, 1.0)
            ends = meets & (~rest.scatters | (sampler.next_1d() < _ENDING))
            β = dr.select(meets, β / dr.select(ends, share, 1.0 - _ENDING), β)
            held |= ends
            active &= ~ends & point.active
            covered |= ends

        # ---------------------- The next point ---------------------

        if self._lights is not None:
            found = self._lights.sampled(self._scene, sampler, point, β, active & point.active, found)
        drawn = point.sample(sampler)
        if self._lights is not None:
            found = self._lights.left(point, drawn, active & point.active, found)
        β = dr.select(active, β * mi.Color3f(drawn.weight), β)
        η = η * dr.select(active, drawn.eta, 1.0)
        covered |= active & ~mi.has_flag(drawn.sampled_type, mi.BSDFFlags.Null)
        largest = dr.max(dr.abs(β))
        active &= largest != 0.0
        points = points + dr.select(active, mi.UInt32(1), mi.UInt32(0))
        likely = dr.minimum(largest * dr.square(η), point.most_likely)
        roulette = active & (points >= self._rr_depth)
        survives = sampler.next_1d() < likely
        β = dr.select(roulette, β / likely, β)
        active &= ~roulette | survives
        onward = point.origin.spawn_ray(drawn.direction)
        medium = dr.select(active, point.medium_toward(drawn.direction), medium)
        ray = dr.select(active, onward, ray)
        hit = dr.select(active, self._scene.ray_intersect_preliminary(onward, coherent=False, active=active), hit)
        return sampler, active, ray, hit, medium, β, η, points, escaped, held, covered, found
