"""The Mitsuba integrator ``slepian_prt``: shapes of a transfer file, lit by the scene's own distant light.

import mitsuba as mi, slepian_prt
mi.set_variant("llvm_ad_rgb")
slepian_prt.register()
scene = mi.load_file("scene.xml")          # <integrator type="slepian_prt">
mi.render(scene)                           #     <string name="transfer" value="skull.prt"/></integrator>
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.lighting.windowing import window
from slepian_prt.relighting.mitsuba.bound_transfer import BoundTransfer, warn
from slepian_prt.relighting.mitsuba.emission import smooth_basis, smooth_spectra
from slepian_prt.renderer.variants import imported_mitsuba

NAME = "slepian_prt"

# What is handed on to the integrator that draws everything else.
_OF_DIRECT = ("shading_samples", "emitter_samples", "bsdf_samples", "hide_emitters")

# Rec. 709 luminance.
_LUMINANCE = (0.212671, 0.715160, 0.072169)

_registered: set[str] = set()


def register() -> None:
    """Make the integrator known to Mitsuba, in the current variant and all that are switched to later.

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
        made = _refused if variant.startswith("scalar_") else _integrator_class(mi)
        mi.register_integrator(NAME, lambda properties: made(properties))
        _registered.add(variant)


def _refused(_properties: Any) -> Any:
    raise UserError(
        f"the integrator {NAME} needs an llvm_* or cuda_* variant of Mitsuba; call mi.set_variant() with one"
    )


def _integrator_class(mi: Any) -> Any:
    """The class for the current variant."""
    import drjit as dr

    class SlepianPRT(mi.SamplingIntegrator):
        """Radiance of the vertices where camera rays meet shapes of the files, else what ``direct`` would draw.

        Parameters of the plugin
        ------------------------
        transfer : string
            Path of a ``.prt`` file, relative to the scene. Further ones are ``transfer_`` and anything.
        albedo : string
            ``file`` (default): what the file says that vertices reflect, which ``mi.traverse`` shows as ``albedo``
            (of ``transfer_x`` as ``albedo_x``). ``scene``: what the materials of the scene reflect diffusely.
        window, window_width : string, float
            ``hann`` or ``lanczos`` and the degree that it ends at: damps ringing under small bright lights.
        shading_samples, emitter_samples, bsdf_samples, hide_emitters
            As those of ``direct``.
        """

        def __init__(self, properties: Any) -> None:
            super().__init__(properties)
            names = sorted(name for name in properties if re.fullmatch("transfer(_.*)?", name))
            if not names:
                raise UserError(f"integrator {NAME} needs a parameter 'transfer', the path of a .prt file")
            source = str(properties.get("albedo", "file"))
            if source not in ("file", "scene"):
                raise UserError(f"albedo of integrator {NAME} must be 'file' or 'scene', not {source!r}")
            self.of_scene = source == "scene"
            damping = _damping(str(properties.get("window", "")), properties.get("window_width", 0.0))
            self.files = {}
            for name in names:
                if not isinstance(properties[name], str):
                    raise UserError(f"{name} of integrator {NAME} must be the path of a file, not {properties[name]!r}")
                path = str(mi.file_resolver().resolve(properties[name]))
                self.files[name] = BoundTransfer(mi, path, damping, not self.of_scene)
            for file in self.files.values():
                if self.of_scene and file.packed.toward_view:
                    raise UserError(f"{file.name}: transfer toward a camera has its materials in it; leave out albedo")
            # Not by `load_dict`, which replaces the resolver of files for all threads that are loading this scene.
            others = mi.Properties("direct")
            for name in _OF_DIRECT:
                if name in properties:
                    others[name] = properties[name]
            self.others = mi.PluginManager.instance().create_object(others)
            self.spectra = smooth_spectra(mi).tolist() if mi.is_spectral else None

        def traverse(self, callback: Any) -> None:
            for name, file in self.files.items():
                callback.put(name.replace("transfer", "albedo", 1), file.albedo, mi.ParamFlags.Differentiable)

        def parameters_changed(self, keys: Any) -> None:
            for file in self.files.values():
                file.check_albedo()

        def to_string(self) -> str:
            return f"SlepianPRT[{', '.join(f'{name} = {file.name}' for name, file in self.files.items())}]"

        def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
            try:
                return self._sample(scene, sampler, ray, medium, active)
            except UserError as error:
                # `mi.render` raises an error of its own that does not say what is wrong.
                warn(mi, str(error))
                raise

        def _sample(self, scene: Any, sampler: Any, ray: Any, medium: Any, active: Any) -> Any:
            self._find(scene)
            active = mi.Bool(active)
            with dr.suspend_grad():
                hit = scene.ray_intersect_preliminary(mi.Ray3f(ray), coherent=True, active=active)
                if self.hide_emitters:
                    hit = self._behind_emitters(scene, ray, hit, active)
                minimal = hit.compute_surface_interaction(mi.Ray3f(ray), mi.RayFlags.Minimal, active & hit.is_valid())
            held, colour = mi.Bool(False), mi.Color3f(0.0)
            for file in self.files.values():
                here, radiance = file.colour(ray, hit, minimal, active & ~held)
                colour = dr.select(here, radiance, colour)
                held |= here
            result = _as_spectrum(mi, colour, ray.wavelengths, self.spectra)
            si = hit.compute_surface_interaction(ray, mi.RayFlags.All, held)
            if self.of_scene:
                result *= mi.unpolarized_spectrum(si.bsdf(ray).eval_diffuse_reflectance(si, held))
            if not self.hide_emitters:
                result += mi.unpolarized_spectrum(si.emitter(scene, held).eval(si, held))
            others, valid, _ = self.others.sample(scene, sampler, ray, medium, active & ~held)
            return dr.select(held, _depolarized(mi, result), others), valid | held, []

        def _find(self, scene: Any) -> None:
            found = [file for file in self.files.values() if file.find(scene)]
            if not found:
                return
            for file in found:
                for remark in file.remarks():
                    warn(mi, remark)
            names = ", ".join(file.name for file in found)
            others = [e.id() or e.class_name() for e in scene.emitters() if not e.is_environment()]
            if others:
                warn(mi, f"light of {', '.join(others)} does not reach shapes of {names}: they know distant light only")
            if scene.environment() is None:
                warn(mi, f"without distant light the shapes of {names} are black")

        def _behind_emitters(self, scene: Any, ray: Any, hit: Any, active: Any) -> Any:
            """What lies behind the shapes that emit light, as ``hide_emitters`` of ``direct`` has it."""
            hidden = hit.is_valid() & (hit.shape.emitter() != mi.EmitterPtr(None)) & active
            si = hit.compute_surface_interaction(ray, mi.RayFlags.Minimal, hidden)
            return dr.select(hidden, self.skip_area_emitters(scene, si.spawn_ray(ray.d), True, hidden), hit)

    return SlepianPRT


def _damping(name: str, width: float) -> Callable[[int], NDArray[np.float64]]:
    """Factors of the degrees for a bandlimit."""
    if not name:
        if width:
            raise UserError(f"window_width of integrator {NAME} needs a window: hann or lanczos")
        return lambda bandlimit: np.ones(bandlimit + 1)
    window(name, 0, width)  # says now what is wrong
    return lambda bandlimit: window(name, bandlimit, width)


def _as_spectrum(mi: Any, colour: Any, wavelengths: Any, spectra: list[list[float]] | None) -> Any:
    """Linear sRGB as an unpolarized spectrum of the variant."""
    if mi.is_rgb:
        return colour
    if spectra is None:
        return mi.Color1f(sum(part * weight for part, weight in zip(colour, _LUMINANCE, strict=True)))
    amounts = [sum(weight * colour[c] for c, weight in enumerate(row)) for row in spectra]
    spectrum = mi.UnpolarizedSpectrum(0.0)
    for i, wavelength in enumerate(wavelengths):
        spectrum[i] = sum(amount * part for amount, part in zip(amounts, smooth_basis(wavelength), strict=True))
    return spectrum


def _depolarized(mi: Any, spectrum: Any) -> Any:
    """A spectrum of the variant; of a polarized one, light without polarization."""
    if not mi.is_polarized:
        return mi.Spectrum(spectrum)
    full = mi.Spectrum(0.0)
    full[0, 0] = spectrum
    return full
