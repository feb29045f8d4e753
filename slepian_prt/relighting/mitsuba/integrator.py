"""The Mitsuba integrator ``slepian_prt``, and its registration."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.lighting.windowing import window
from slepian_prt.paths.lobes import LAMBERTIAN, PLAIN, lets_straight_through, material_kind
from slepian_prt.paths.media import Media, media_of
from slepian_prt.relighting.mitsuba.bound_transfer import BoundTransfer, log_warning
from slepian_prt.relighting.mitsuba.cache import RadianceCache
from slepian_prt.relighting.mitsuba.capture_integrator import CAPTURE_NAME, capture_plugin
from slepian_prt.relighting.mitsuba.gathering import Gatherer
from slepian_prt.relighting.mitsuba.held_files import held_file, is_in_memory
from slepian_prt.relighting.mitsuba.lamps import Lamps
from slepian_prt.relighting.mitsuba.lobes import Lobes
from slepian_prt.relighting.mitsuba.missing_light import scene_effects
from slepian_prt.relighting.mitsuba.recording import without_collection
from slepian_prt.relighting.mitsuba.spectra import smooth_spectra, without_polarization
from slepian_prt.renderer.variants import imported_mitsuba

NAME = "slepian_prt"

_registered: set[str] = set()


# --- Registration ----------------------------------------------------------------------------------------------------


def register() -> None:
    """Make `slepian_prt` and `slepian_prt_capture` known to Mitsuba, in the current variant and all switched to later.

    May be called before or after a variant is set, and any number of times.
    """
    mi = imported_mitsuba()
    if not _registered:
        # Python plugins belong to the variant that they are registered in, and their classes derive from its classes.
        mi.detail.add_variant_callback(_on_variant)
        _registered.add("")
    if mi.variant() is not None:
        _register_in(mi, mi.variant())


def _on_variant(_old: str | None, new: str | None) -> None:
    if new is not None:
        _register_in(imported_mitsuba(), new)


def _register_in(mi: Any, variant: str) -> None:
    if variant not in _registered:
        scalar = variant.startswith("scalar_")
        for name, plugin_class in ((NAME, _plugin_class), (CAPTURE_NAME, capture_plugin)):
            plugin = partial(_refuse, name) if scalar else plugin_class(mi)
            mi.register_integrator(name, partial(_made, plugin))
        _registered.add(variant)


def _made(plugin: Any, properties: Any) -> Any:
    return plugin(properties)


def _refuse(name: str, _properties: Any) -> Any:
    raise UserError(
        f"the integrator {name} needs an llvm_* or cuda_* variant of Mitsuba; call mi.set_variant() with one"
    )


def _plugin_class(mi: Any) -> Any:
    """The class of the current variant, which all it does hands to a `SlepianIntegrator`.

    That cannot be a second base: Mitsuba's classes (nanobind's) allow one alone.
    """

    class SlepianPRT(mi.SamplingIntegrator):
        __doc__ = SlepianIntegrator.__doc__

        def __init__(self, properties: Any) -> None:
            super().__init__(properties)
            self.integrator = SlepianIntegrator(mi, properties)

        def traverse(self, callback: Any) -> None:
            self.integrator.traverse(callback)

        def parameters_changed(self, keys: Any) -> None:
            self.integrator.check_parameters()

        def to_string(self) -> str:
            return str(self.integrator)

        def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
            try:
                with without_collection():
                    return self.integrator.sample(scene, sampler, ray, medium, active, self.skip_area_emitters)
            except UserError as error:
                log_warning(mi, str(error))  # `mi.render` raises an error of its own that does not say what is wrong
                raise

        def sample_before_nothing(self, scene: Any, sampler: Any, ray: Any, medium: Any = None) -> tuple[Any, Any]:
            with without_collection():
                return self.integrator.sample_before_nothing(scene, sampler, ray, medium)

    return SlepianPRT


# --- The integrator --------------------------------------------------------------------------------------------------


class SlepianIntegrator:
    """Final gathering, with transfer files as the cache of diffusely reflected light.

    Paths are followed as by Mitsuba's ``path``: emitters and materials are sampled, mirrors and glass passed, until a
    surface is met that a ``.prt`` file holds. There the diffuse lobe ends: what it reflects is what the file says of
    the distant light, with all bounces, and of the bounces of lamps, times the albedo at that very point; lamps
    themselves are sampled. Other lobes of that material go on. For what files hold this is without bias. In scenes with
    participating media paths are those of ``volpath``.

    ====================  =======  ===================================================================================
    Parameter             Type     Meaning
    ====================  =======  ===================================================================================
    ``transfer``          string   Path of a ``.prt`` file, relative to the scene. Further ones are ``transfer_`` and
                                   anything.
    ``albedo``            string   ``auto`` (default): what the scene's material reflects diffusely at each point
                                   where it has a texture or more than one lobe, else what the file says that vertices
                                   reflect. ``file``: always that, which ``mi.traverse`` shows as ``albedo`` (of
                                   ``transfer_x`` as ``albedo_x``). ``scene``: always the scene's.
    ``fixed_lights``      float    Factor of what lamps send to diffuse lobes of held surfaces; 0 turns it off. By
                                   default 1.
    ``window``            string   ``hann`` or ``lanczos``: damps ringing under small bright lights. By default none.
    ``window_width``      float    The degree that the window falls to zero at.
    ``hide_emitters``     boolean  Whether the environment and shapes that emit are left out of the picture. By
                                   default not.
    ``max_depth``         integer  Longest path that is followed, as of ``path``; what files hold counts as one step.
                                   By default -1: no limit.
    ``rr_depth``          integer  Steps after which paths end by Russian roulette. By default 5.
    ====================  =======  ===================================================================================

    It works in all ``llvm_*`` and ``cuda_*`` variants: RGB, monochromatic and spectral, polarized too (its light is
    unpolarized). Light may come from ``envmap``, ``constant``, ``sunsky`` and other environment emitters, and from
    lamps, and may change between pictures; models may be moved, turned and evenly scaled since they were precomputed.
    Gradients, in both modes, go to what camera rays meet first: to the texels and scale of an ``envmap``, to
    ``albedo``, and to diffuse reflectance that is taken from the scene; not to what is gathered, and not to geometry.

    It does not work in ``scalar_*`` variants. Light that mirrors, glass, metals and media send onto held surfaces is as
    far in the picture as it was simulated when the file was made. Mitsuba's log says what the file does not know.

    .. code-block:: python

        mi.set_variant("llvm_ad_rgb")
        slepian_prt.register()
        scene = mi.load_dict({
            "type": "scene",
            "integrator": {"type": "slepian_prt", "transfer": "skull.prt"},
            "skull": {"type": "ply", "filename": "skull.ply"},
            "emitter": {"type": "envmap", "filename": "studio.exr"},
        })
        image = mi.render(scene)

    .. code-block:: xml

        <integrator type="slepian_prt">
            <string name="transfer" value="skull.prt"/>
        </integrator>
    """

    # Nothing here may refer to a scene or to the plugin, which Python could not tell to be garbage: a scene holds its
    # integrator in C++.
    def __init__(self, mi: Any, properties: Any) -> None:
        self._mi = mi
        self._hide_emitters = bool(properties.get("hide_emitters", False))
        self._fixed_lights = _not_negative(properties, "fixed_lights", 1.0)
        self._max_depth = _depth(properties, "max_depth", -1, least=-1)
        self._rr_depth = _depth(properties, "rr_depth", 5, least=1)
        self._albedo = str(properties.get("albedo", "auto"))
        if self._albedo not in ("auto", "file", "scene"):
            raise UserError(f"albedo of integrator {NAME} must be 'auto', 'file' or 'scene', not {self._albedo!r}")
        damping = _damping(str(properties.get("window", "")), properties.get("window_width", 0.0))
        self._transfers = {
            name: BoundTransfer(mi, held_file(path), damping, fixed_lights=self._fixed_lights)
            for name, path in _transfer_paths(mi, properties).items()
        }
        for transfer in self._transfers.values():
            if self._albedo == "scene" and transfer.packed.toward_view:
                raise UserError(f"{transfer.name}: transfer toward a camera has its materials in it; leave out albedo")
        self._cache = RadianceCache(mi, list(self._transfers.values()))
        self._spectra = smooth_spectra(mi).tolist() if mi.is_spectral else None
        self._lobes: Any = None
        self._media: Media | None = None
        self._gatherer: Any = None  # None where nothing calls for it
        self._warnings: set[str] = set()  # that were made

    def __str__(self) -> str:
        return f"SlepianPRT[{', '.join(f'{name} = {transfer.name}' for name, transfer in self._transfers.items())}]"

    def traverse(self, callback: Any) -> None:
        """Show the albedo of each file as a parameter of the scene."""
        for name, transfer in self._transfers.items():
            differentiable = self._mi.ParamFlags.Differentiable
            callback.put(name.replace("transfer", "albedo", 1), transfer.albedo, differentiable)

    def check_parameters(self) -> None:
        """Raise UserError if a parameter was changed to something that cannot be."""
        for transfer in self._transfers.values():
            transfer.check_albedo()

    def sample(
        self, scene: Any, sampler: Any, ray: Any, medium: Any, active: Any, skip_emitters: Callable[..., Any]
    ) -> tuple[Any, Any, list]:
        """Radiance along camera rays: spectrum, whether it is valid, and no AOVs.

        L = L_e + a Σ_i w_i Σ_lm e_lm t_lm(x_i), over the three vertices x_i of the triangle that is met, which is
        differentiated, and what is gathered beyond that, which is not. ``skip_emitters`` is the method of the plugin
        that finds what lies behind shapes that emit.
        """
        visible = not self._hide_emitters
        L, covered, _ = self._follow(scene, sampler, ray, medium, active, skip_emitters, sees_environment=visible)
        return without_polarization(self._mi, L), covered, []

    def sample_before_nothing(self, scene: Any, sampler: Any, ray: Any, medium: Any) -> tuple[Any, Any]:
        """Radiance along camera rays, UnpolarizedSpectrum, and how opaque what they meet is, Float.

        The environment lights all that is seen, but nothing is behind it: what goes straight on through null lobes,
        into the distance, is left out.
        """
        L, _, passed = self._follow(scene, sampler, ray, medium, True, None, sees_environment=False)
        return L, 1.0 - passed

    def _follow(
        self,
        scene: Any,
        sampler: Any,
        ray: Any,
        medium: Any,
        active: Any,
        skip_emitters: Callable[..., Any] | None,
        *,
        sees_environment: bool,
    ) -> tuple[Any, Any, Any]:
        """Radiance, whether anything is on the way (Bool), and how much goes straight past everything (Float)."""
        import drjit as dr

        mi = self._mi
        self._bind(scene, medium)
        active = mi.Bool(active)
        hit, si = self._first_hit(scene, ray, active, skip_emitters)  # What camera rays meet, detached
        L = mi.UnpolarizedSpectrum(0.0)
        covered = active & si.is_valid()
        if not self._hide_emitters and self._max_depth != 0:
            seen = active & (si.is_valid() | sees_environment)
            L += mi.unpolarized_spectrum(si.emitter(scene).eval(si, seen))
            covered = active & ((sees_environment and scene.environment() is not None) | si.is_valid())
        passed = dr.select(covered, 0.0, 1.0)

        met = active & si.is_valid() & (not 0 <= self._max_depth <= 1)
        cached = self._cache.at(ray, hit, si, met)
        material = self._lobes.at(si, cached, met)
        L += material.held_radiance(sampler)

        if self._gatherer is not None:
            with dr.suspend_grad():
                more = self._gatherer.adds_to(material) & met
                if medium is not None:  # all that comes through it is gathered
                    more, L = active & (self._max_depth != 0), mi.UnpolarizedSpectrum(0.0)
                found = self._gatherer.gather(
                    scene, sampler, ray, hit, medium=medium, sees_environment=sees_environment, active=more
                )
            L, covered = dr.select(more, L + found.radiance, L), dr.select(more, found.covered, covered)
            passed = dr.select(more, found.passed, passed)
        return L, covered, passed

    def meets_held(self, scene: Any, ray: Any) -> Any:
        """Bool, whether rays meet a surface first whose diffuse light the files hold."""
        mi = self._mi
        self._bind(scene)
        active = mi.Bool(True)
        hit, si = self._first_hit(scene, ray, active, None)
        met = active & si.is_valid()
        return self._lobes.at(si, self._cache.at(ray, hit, si, met), met).held

    def _first_hit(
        self, scene: Any, ray: Any, active: Any, skip_emitters: Callable[..., Any] | None
    ) -> tuple[Any, Any]:
        """What rays meet, as PreliminaryIntersection3f and as SurfaceInteraction3f; not differentiated.

        With ``hide_emitters``, that is what ``skip_emitters`` finds behind the shapes that emit light, as ``path`` has
        it; None leaves them.
        """
        import drjit as dr

        mi = self._mi
        with dr.suspend_grad():
            hit = scene.ray_intersect_preliminary(mi.Ray3f(ray), coherent=True, active=active)
            if self._hide_emitters and skip_emitters is not None:
                hidden = hit.is_valid() & (hit.shape.emitter() != mi.EmitterPtr(None)) & active
                si = hit.compute_surface_interaction(ray, mi.RayFlags.Minimal, hidden)
                behind = skip_emitters(scene, si.spawn_ray(ray.d), True, hidden)
                hit = dr.select(hidden, behind, hit)
            return hit, hit.compute_surface_interaction(mi.Ray3f(ray), mi.RayFlags.All, active)

    def _bind(self, scene: Any, medium: Any = None) -> None:
        """Match the files to a scene, and log what of it will not be seen, each thing once.

        A camera that is in a ``medium`` need not be one of the scene's.
        """
        mi = self._mi
        bound = [transfer for transfer in self._transfers.values() if transfer.bind(scene)]
        for transfer in self._transfers.values():
            transfer.light(scene)
        if not bound and self._media is not None and self._media.know(medium):
            return
        materials = [node for node in mi.traverse(scene).hierarchy if isinstance(node, mi.BSDF)]
        self._lobes = Lobes(mi, materials, self._albedo, self._spectra)
        around = [] if medium is None else [medium]
        self._media = Media(mi, [*media_of(mi, scene), *around])
        through = any(lets_straight_through(mi, material) for material in materials)
        lamps = Lamps(mi, scene, self._media, through=through)
        self._gatherer = None
        if self._media.present or self._calls_for_gathering(scene, lamps):
            self._gatherer = Gatherer(
                mi, self._cache, self._lobes, lamps, self._media, through=through, fixed_lights=self._fixed_lights,
                max_depth=self._max_depth, rr_depth=self._rr_depth,
            )  # fmt: skip
        effects = scene_effects(mi, materials, media=self._media.present)
        texts = [text for transfer in bound for text in transfer.warnings(scene, self._albedo, effects)]
        for text in texts:
            if text not in self._warnings:  # shapes that move are matched again for every picture
                self._warnings.add(text)
                log_warning(mi, text)

    def _calls_for_gathering(self, scene: Any, lamps: Lamps) -> bool:
        """Whether there are lamps, or anything but held surfaces, seen from held sides, that reflect only diffusely."""
        mi = self._mi
        if lamps.count:
            return True
        held = [entry for transfer in self._transfers.values() for entry in transfer.held_shapes()]
        numbers = {shape.ptr: sides for shape, sides in held}
        for shape in scene.shapes():
            sides = numbers.get(shape.ptr, 0)
            kind = material_kind(mi, shape.bsdf())
            two = mi.has_flag(shape.bsdf().flags(), mi.BSDFFlags.BackSide)
            if kind not in (PLAIN, LAMBERTIAN) or sides < (2 if two else 1):
                return True
        return False


def _not_negative(properties: Any, name: str, default: float) -> float:
    """A factor among the parameters."""
    value = properties.get(name, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value < np.inf:
        raise UserError(f"{name} of integrator {NAME} must be a finite number, not negative, not {value!r}")
    return float(value)


def _depth(properties: Any, name: str, default: int, *, least: int) -> int:
    """A number of points of a path among the parameters."""
    value = properties.get(name, default)
    if isinstance(value, bool) or not isinstance(value, int) or value < least:
        raise UserError(f"{name} of integrator {NAME} must be a whole number, {least} or more, not {value!r}")
    return value


def _transfer_paths(mi: Any, properties: Any) -> dict[str, str]:
    """Paths of files by the names of their parameters."""
    names = sorted(name for name in properties if re.fullmatch("transfer(_.*)?", name))
    if not names:
        raise UserError(f"integrator {NAME} needs a parameter 'transfer', the path of a .prt file")
    for name in names:
        if not isinstance(properties[name], str):
            raise UserError(f"{name} of integrator {NAME} must be the path of a file, not {properties[name]!r}")
    resolver = mi.file_resolver()
    return {
        name: properties[name] if is_in_memory(properties[name]) else str(resolver.resolve(properties[name]))
        for name in names
    }


def _damping(name: str, width: float) -> Callable[[int], NDArray[np.float64]]:
    """Factors of the degrees for a bandlimit."""
    if not name:
        if width:
            raise UserError(f"window_width of integrator {NAME} needs a window: hann or lanczos")
        return lambda bandlimit: np.ones(bandlimit + 1)
    window(name, 0, width)  # says now what is wrong
    return lambda bandlimit: window(name, bandlimit, width)
