"""Final gathering: paths that end where a file holds the light."""

from __future__ import annotations

from functools import partial
from typing import Any

from slepian_prt.relighting.mitsuba.cache import RadianceCache
from slepian_prt.relighting.mitsuba.lamps import Lamps, power_heuristic
from slepian_prt.relighting.mitsuba.lobes import Lobes, Material

# Longest path that can be asked for is none at all, as Mitsuba's ``max_depth`` -1.
_ENDLESS = 0xFFFFFFFF

# Paths go on with this probability at most, once roulette decides.
_MOST_LIKELY = 0.95


class Gatherer:
    """Paths through a scene as Mitsuba's ``path`` follows them, with transfer files as the cache of their ends.

    At each point L += β (a B + lamps), where a file holds B; β becomes β f cos/p of the lobes that are left.

    Parameters
    ----------
    mi : Mitsuba, in the variant of the scene
    cache : RadianceCache
    lobes : Lobes
    lamps : Lamps
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
        *,
        fixed_lights: float,
        max_depth: int,
        rr_depth: int,
    ) -> None:
        self._mi, self._cache, self._lobes, self._lamps = mi, cache, lobes, lamps
        self._fixed_lights = fixed_lights
        self._max_depth, self._rr_depth = max_depth if max_depth >= 0 else _ENDLESS, rr_depth

    def adds_to(self, material: Material) -> Any:
        """Bool, whether anything can be gathered from points of these materials."""
        return material.scatters | (material.held & (self._lamps.count > 0))

    def gather(
        self, scene: Any, sampler: Any, ray: Any, hit: Any, *, hide_emitters: bool, active: Any
    ) -> tuple[Any, Any]:
        """What paths bring beyond emission and held light of the first point: UnpolarizedSpectrum, and coverage.

        Parameters
        ----------
        scene : Mitsuba scene
        sampler : Sampler
        ray : Ray3f
        hit : PreliminaryIntersection3f
            The first points.
        hide_emitters : bool
            Whether what comes through nothing but null materials is no part of the picture.
        active : Bool
        """
        import drjit as dr

        mi = self._mi
        state = (
            sampler,
            mi.Bool(active),  # Is the path still going on?
            mi.Ray3f(ray),  # Its last segment
            hit,  # What that meets
            mi.UnpolarizedSpectrum(0.0),  # L: radiance so far
            mi.UnpolarizedSpectrum(1.0),  # β: throughput
            mi.Float(1.0),  # η: relative index of refraction, all along
            mi.UInt32(0),  # Number of points
            mi.Bool(active & (not hide_emitters and scene.environment() is not None)),  # Is the ray covered?
            dr.zeros(mi.Interaction3f, dr.width(ray)),  # Point before
            mi.Float(1.0),  # Density of the direction that was drawn there
            mi.Bool(True),  # Was it a mirror's?
        )
        step = partial(self._step, scene)
        state = dr.while_loop(state, lambda *state: state[1], step, label="slepian_prt: gathering")
        covered = state[8]
        return dr.select(covered, state[4], 0.0), covered

    def _step(
        self, scene: Any, sampler: Any, active: Any, ray: Any, hit: Any, L: Any, β: Any, η: Any, depth: Any,
        covered: Any, before: Any, before_pdf: Any, before_delta: Any,
    ) -> tuple[Any, ...]:  # fmt: skip
        import drjit as dr

        mi, lamps = self._mi, self._lamps
        si = hit.compute_surface_interaction(ray, mi.RayFlags.All, active)
        later = active & (depth > 0)

        # ----------------------- Emission --------------------------

        ds = mi.DirectionSample3f(scene, si, before)
        emitter_pdf = lamps.density(before, ds, later & ~before_delta)
        emitted = mi.unpolarized_spectrum(ds.emitter.eval(si, later))
        L += β * emitted * power_heuristic(before_pdf, emitter_pdf)

        # ---------------- Light that a file holds ------------------

        active = active & si.is_valid() & (depth + 1 < self._max_depth)
        cached = self._cache.at(ray, hit, si, active, first=depth == 0)
        material = self._lobes.at(si, cached, active)
        L += dr.select(depth > 0, β * material.held_radiance(sampler), 0.0)

        # ---------------- Light straight from emitters -------------

        if lamps.count:
            L += β * self._fixed_lights * lamps.on_held(scene, si, material, sampler, active)
        ds, arriving = lamps.sample(scene, si, sampler, active & material.scatters)
        others, pdf = material.evaluate(si.to_local(ds.d), active & (ds.pdf != 0.0))
        L += β * arriving * others * dr.select(ds.delta, 1.0, power_heuristic(ds.pdf, pdf))

        # ---------------------- The next point ---------------------

        drawn, weight = material.sample(sampler)
        β = β * weight
        η = η * drawn.eta
        covered |= active & ~(material.scatters & mi.has_flag(drawn.sampled_type, mi.BSDFFlags.Null))
        largest = dr.max(dr.abs(β))
        active = active & material.scatters & (largest != 0.0)
        depth = depth + 1
        likely = dr.minimum(largest * dr.square(η), _MOST_LIKELY)
        roulette = depth >= self._rr_depth
        active &= ~roulette | (sampler.next_1d() < likely)
        β = dr.select(roulette, β / likely, β)
        ray = si.spawn_ray(si.to_world(drawn.wo))
        hit = scene.ray_intersect_preliminary(ray, coherent=False, active=active)
        delta = mi.has_flag(drawn.sampled_type, mi.BSDFFlags.Delta)
        return sampler, active, ray, hit, L, β, η, depth, covered, mi.Interaction3f(si), drawn.pdf, delta
