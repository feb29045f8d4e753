"""Final gathering: paths that end where a file holds the light."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

from slepian_prt.paths.media import Flight, Media
from slepian_prt.paths.scattering import Scatterer
from slepian_prt.relighting.mitsuba.cache import RadianceCache
from slepian_prt.relighting.mitsuba.lamps import HeldPoint, Lamps, power_heuristic
from slepian_prt.relighting.mitsuba.lobes import Lobes, Material

# Longest path that can be asked for is none at all, as Mitsuba's ``max_depth`` -1.
_ENDLESS = 0xFFFFFFFF


@dataclass(eq=False)
class _Path:
    """The state of the loop that follows paths, on Mitsuba's arrays."""

    active: Any  # Is the path still going on?
    ray: Any  # Its last segment
    hit: Any  # What that meets
    medium: Any  # What that goes through
    L: Any  # Radiance so far
    β: Any  # Throughput
    η: Any  # Relative index of refraction, all along
    depth: Any  # Number of points
    counts: Any  # Is what the point ahead sends part of L?
    covered: Any  # Is the ray covered?
    passed: Any  # What of it goes past everything?
    before: Any  # Point before
    before_pdf: Any  # Density of the direction that was drawn there
    before_delta: Any  # Was it a mirror's?


class Gathered(NamedTuple):
    """What paths bring, on Mitsuba's arrays.

    Attributes
    ----------
    radiance : UnpolarizedSpectrum
        Beyond emission and held light of the first point.
    covered : Bool
        Whether anything is on the way but boundaries that all light passes.
    passed : Float
        How much of what is behind everything is seen unbent, where nothing is; 0 where the environment is part of the
        picture.
    """

    radiance: Any
    covered: Any
    passed: Any


class Gatherer:
    """Paths through a scene as Mitsuba's ``path`` follows them, with transfer files as the cache of their ends.

    At each point L += β (a B + lamps), where a file holds B; β becomes β f cos/p of the lobes that are left. What goes
    straight through a null lobe is no step, as of ``volpath``, and lamps are seen through it.

    Parameters
    ----------
    mi : Mitsuba, in the variant of the scene
    cache : RadianceCache
    lobes : Lobes
    lamps : Lamps
    media : Media
    through : bool
        Whether light may go straight through surfaces of the scene.
    fixed_lights : float
        Factor of what lamps send to held surfaces.
    max_depth, rr_depth : int
        As of ``path``.
    """

    def __init__(
        self,
        mi: Any,
        cache: RadianceCache,
        lobes: Lobes,
        lamps: Lamps,
        media: Media,
        *,
        through: bool,
        fixed_lights: float,
        max_depth: int,
        rr_depth: int,
    ) -> None:
        self._mi, self._cache, self._lobes, self._lamps, self._media = mi, cache, lobes, lamps, media
        self._through, self._fixed_lights = through or media.present, fixed_lights
        self._max_depth, self._rr_depth = max_depth if max_depth >= 0 else _ENDLESS, rr_depth

    def adds_to(self, material: Material) -> Any:
        """Bool, whether anything can be gathered from points of these materials."""
        return material.scatters | (material.held & (self._lamps.count > 0))

    def gather(
        self, scene: Any, sampler: Any, ray: Any, hit: Any, *, medium: Any = None, sees_environment: bool, active: Any
    ) -> Gathered:
        """What paths bring.

        Parameters
        ----------
        scene : Mitsuba scene
        sampler : Sampler
        ray : Ray3f
        hit : PreliminaryIntersection3f
            The first points.
        medium : Mitsuba medium or MediumPtr, optional
            That rays begin in. What first points send is weakened on the way, and is brought by the paths as well.
        sees_environment : bool
            Whether what of it comes through nothing but null materials is part of the picture.
        active : Bool
        """
        import drjit as dr

        mi = self._mi
        medium = dr.zeros(mi.MediumPtr, dr.width(ray)) if medium is None else mi.MediumPtr(medium)
        path = _Path(
            active=mi.Bool(active),
            ray=mi.Ray3f(ray),
            hit=hit,
            medium=medium,
            L=mi.UnpolarizedSpectrum(0.0),
            β=mi.UnpolarizedSpectrum(1.0),
            η=mi.Float(1.0),
            depth=mi.UInt32(0),
            counts=medium != mi.MediumPtr(None),
            covered=mi.Bool(active & (sees_environment and scene.environment() is not None)),
            passed=mi.Float(0.0),
            before=dr.zeros(mi.Interaction3f, dr.width(ray)),
            before_pdf=mi.Float(1.0),
            before_delta=mi.Bool(True),
        )
        step = partial(self._step, scene)
        _, path = dr.while_loop((sampler, path), lambda _, path: path.active, step, label="slepian_prt: gathering")
        return Gathered(path.L, path.covered, path.passed)

    def _step(self, scene: Any, sampler: Any, path: _Path) -> tuple[Any, _Path]:
        import drjit as dr

        mi = self._mi
        si = path.hit.compute_surface_interaction(path.ray, mi.RayFlags.All, path.active)
        flight = self._fly(sampler, path, si)
        arrives = path.active if flight is None else path.active & ~flight.scattered
        passes = arrives & ~si.is_valid() & ~path.covered
        path.passed = dr.select(passes, dr.mean(path.β), path.passed)
        self._add_emission(scene, path, si, arrives & ~passes)

        # ---------------- Light that a file holds ------------------

        going_on = path.depth + 1 < self._max_depth
        here = arrives & si.is_valid() & going_on
        cached = self._cache.at(path.ray, path.hit, si, here, first=path.depth == 0)
        material = self._lobes.at(si, cached, here)
        path.L += dr.select(path.counts, path.β * material.held_radiance(sampler), 0.0)

        # ---------------- Light straight from emitters -------------

        if self._lamps.count:
            on_held = self._lamps.on_held(scene, HeldPoint(si, material, path.medium), sampler, here)
            path.L += path.β * self._fixed_lights * on_held
        point = Scatterer(mi, self._media, si, material, path.medium, flight, path.active & going_on)
        path.active = here if flight is None else here | (path.active & going_on & flight.scattered)
        ds, arriving = self._lamps.sample(scene, point, sampler)
        others, pdf = point.evaluate(sampler, ds.d, ds.pdf != 0.0)
        path.L += path.β * arriving * others * dr.select(ds.delta, 1.0, power_heuristic(ds.pdf, pdf))

        self._go_on(scene, sampler, path, point)
        return sampler, path

    def _fly(self, sampler: Any, path: _Path, si: Any) -> Flight | None:
        """Through the medium that the path is in."""
        import drjit as dr

        if not self._media.present:
            return None
        # Where emitters are hidden, the hit does not say how far from the camera it is.
        distance = dr.select(si.is_valid(), dr.norm(si.p - path.ray.o), dr.inf)
        flight = self._media.fly(sampler, path.ray, distance, path.medium, path.β, path.active)
        path.β = flight.throughput
        path.covered |= flight.scattered
        return flight

    def _add_emission(self, scene: Any, path: _Path, si: Any, arrives: Any) -> None:
        """What emitters send that are met by chance, as far as it is not looked for."""
        mi = self._mi
        counts = arrives & path.counts
        ds = mi.DirectionSample3f(scene, si, path.before)
        emitter_pdf = self._lamps.density(path.before, ds, counts & ~path.before_delta)
        emitted = mi.unpolarized_spectrum(ds.emitter.eval(si, counts))
        path.L += path.β * emitted * power_heuristic(path.before_pdf, emitter_pdf)

    def _go_on(self, scene: Any, sampler: Any, path: _Path, point: Scatterer) -> None:
        """To the next point, unless roulette ends the path."""
        import drjit as dr

        mi = self._mi
        drawn = point.sample(sampler)
        path.β = path.β * drawn.weight
        path.η = path.η * drawn.eta
        null = mi.has_flag(drawn.sampled_type, mi.BSDFFlags.Null)
        path.covered |= path.active & ~(point.active & null)
        largest = dr.max(dr.abs(path.β))
        path.active = path.active & point.active & (largest != 0.0)
        scattered = ~point.goes_straight(drawn, path.active) if self._through else mi.Bool(True)
        path.depth = path.depth + dr.select(scattered, mi.UInt32(1), mi.UInt32(0))
        likely = dr.minimum(largest * dr.square(path.η), point.most_likely)
        roulette = path.depth >= self._rr_depth
        path.active &= ~roulette | (sampler.next_1d() < likely)
        path.β = dr.select(roulette, path.β / likely, path.β)
        path.ray = point.origin.spawn_ray(drawn.direction)
        path.medium = point.medium_toward(drawn.direction)
        path.hit = scene.ray_intersect_preliminary(path.ray, coherent=False, active=path.active)
        path.counts = mi.Bool(True)
        path.before = dr.select(scattered, point.origin, path.before)
        path.before_pdf = dr.select(scattered, drawn.pdf, path.before_pdf)
        delta = mi.has_flag(drawn.sampled_type, mi.BSDFFlags.Delta)
        path.before_delta = dr.select(scattered, delta, path.before_delta)
