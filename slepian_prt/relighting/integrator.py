"""The Mitsuba integrator ``slepian_prt``: shapes of a transfer file, lit by the scene's own distant light.

import mitsuba as mi, slepian_prt
mi.set_variant("llvm_ad_rgb")
slepian_prt.register()
scene = mi.load_file("scene.xml")          # <integrator type="slepian_prt">
mi.render(scene)                           #     <string name="transfer" value="skull.prt"/></integrator>
"""

from __future__ import annotations

import os
from functools import lru_cache
from typing import Any

import numpy as np

from slepian_prt.compression.compressed import CompressedTransfer, load
from slepian_prt.errors import UserError
from slepian_prt.relighting.emission import Relit, metameric_spectra
from slepian_prt.relighting.surfaces import Surfaces
from slepian_prt.scene.variants import imported_mitsuba

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


@lru_cache(maxsize=4)
def _loaded(path: str, _changed: int, _size: int) -> CompressedTransfer:
    return load(path)


def _transfer(path: str) -> CompressedTransfer:
    """A file, read once however many integrators and variants use it."""
    if not os.path.isfile(path):
        return load(path)  # which says what is wrong
    state = os.stat(path)
    return _loaded(path, state.st_mtime_ns, state.st_size)


def _integrator_class(mi: Any) -> Any:
    """The class for the current variant."""
    import drjit as dr

    class SlepianPRT(mi.SamplingIntegrator):
        """Radiance of the vertices where camera rays meet shapes of the file, else what ``direct`` would draw.

        Parameters of the plugin
        ------------------------
        transfer : string
            Path of a ``.prt`` file, relative to the scene.
        albedo : string
            ``file`` (default): what the file says that vertices reflect, which ``mi.traverse`` shows as ``albedo``.
            ``scene``: what the materials of the scene reflect diffusely.
        shading_samples, emitter_samples, bsdf_samples, hide_emitters
            As those of ``direct``.
        """

        def __init__(self, properties: Any) -> None:
            super().__init__(properties)
            if not properties.has_property("transfer"):
                raise UserError(f"integrator {NAME} needs a parameter 'transfer', the path of a .prt file")
            path = str(mi.file_resolver().resolve(str(properties["transfer"])))
            self.file = os.path.basename(path)
            self.packed = _transfer(path)
            source = str(properties.get("albedo", "file"))
            if source not in ("file", "scene"):
                raise UserError(f"albedo of integrator {NAME} must be 'file' or 'scene', not {source!r}")
            self.of_scene = source == "scene"
            if self.of_scene and self.packed.toward_view:
                raise UserError(f"{self.file}: transfer toward a camera has its materials in it; leave out albedo")
            others = {name: properties[name] for name in _OF_DIRECT if properties.has_property(name)}
            self.others = mi.load_dict({"type": "direct", **others})
            self.albedo = mi.TensorXf(np.ascontiguousarray(self.packed.mesh.albedo, dtype=np.float32))
            self.spectra = metameric_spectra(mi).tolist() if mi.is_spectral else None
            self._scene: Any = None
            self._surfaces: Any = None
            self._relit: Any = None

        def traverse(self, callback: Any) -> None:
            callback.put("albedo", self.albedo, mi.ParamFlags.Differentiable)

        def parameters_changed(self, keys: Any) -> None:
            wanted = self.packed.mesh.albedo.shape
            if self.albedo.shape != wanted:
                raise UserError(f"albedo must have shape {wanted}, not {self.albedo.shape}")

        def to_string(self) -> str:
            return f"SlepianPRT[transfer = {self.file}, {len(self.packed.mesh.positions)} vertices]"

        def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
            self._find(scene)
            unlit = self._relit.under(scene.environment())
            active = mi.Bool(active)
            with dr.suspend_grad():  # geometry is not differentiated
                skip = self._behind_emitters(scene, ray, active) if self.hide_emitters else None
                met, hit = self._surfaces.meet(scene, mi.Ray3f(ray), active, skip)
                self._check_camera(ray, met.held)
            others, valid, _ = self.others.sample(scene, sampler, ray, medium, active & ~met.held)
            colour = mi.Color3f(0.0)
            for vertex, weight in zip(met.vertices, met.weights, strict=True):
                lit = dr.gather(mi.Color3f, unlit, vertex, met.held)
                if not self.of_scene:
                    lit *= dr.gather(mi.Color3f, self.albedo.array, vertex, met.held)
                colour += weight * lit
            result = _as_spectrum(mi, colour, ray.wavelengths, self.spectra)
            si = hit.compute_surface_interaction(ray, mi.RayFlags.All, met.held)
            if self.of_scene:
                result *= mi.unpolarized_spectrum(si.bsdf(ray).eval_diffuse_reflectance(si, met.held))
            if not self.hide_emitters:
                result += mi.unpolarized_spectrum(si.emitter(scene, met.held).eval(si, met.held))
            return dr.select(met.held, _depolarized(mi, result), others), valid | met.held, []

        def _find(self, scene: Any) -> None:
            """Find the shapes of the file, again if another scene is drawn or vertices were moved."""
            if self._scene is scene and not self._surfaces.changed():
                return
            self._surfaces = Surfaces(mi, scene, self.packed, self.file)
            turn = self._surfaces.placement.rotation.T
            if self.packed.toward_view and np.abs(turn - np.eye(3)).max() > 1e-4:
                raise UserError(f"{self.file}: holds transfer toward a camera, so its shapes cannot be turned")
            self._relit = Relit(mi, self.packed, turn)
            self._scene = scene
            others = [e.id() or e.class_name() for e in scene.emitters() if not e.is_environment()]
            if others:
                names = ", ".join(others)
                _warn(mi, f"light of {names} does not reach the shapes of {self.file}, which know distant light only")
            if scene.environment() is None:
                _warn(mi, f"without distant light the shapes of {self.file} are black")

        def _check_camera(self, ray: Any, held: Any) -> None:
            view = self.packed.view
            if not self.packed.toward_view or view is None:
                return
            eye = mi.Point3f(np.array(view.to_world)[:3, 3].tolist())
            size = float(np.linalg.norm(np.ptp(self.packed.mesh.positions, axis=0)))
            if dr.any(held & (dr.norm(dr.cross(eye - ray.o, ray.d)) > 1e-3 * size)):
                raise UserError(f"{self.file}: holds transfer toward camera '{view.name}' alone; look from there")

        def _behind_emitters(self, scene: Any, ray: Any, active: Any) -> Any:
            """What lies behind the shapes that emit light, as ``hide_emitters`` of ``direct`` has it."""

            def skip(hit: Any) -> Any:
                hidden = hit.is_valid() & (hit.shape.emitter() != mi.EmitterPtr(None)) & active
                si = hit.compute_surface_interaction(ray, mi.RayFlags.Minimal, hidden)
                return dr.select(hidden, self.skip_area_emitters(scene, si.spawn_ray(ray.d), True, hidden), hit)

            return skip

    return SlepianPRT


def _as_spectrum(mi: Any, colour: Any, wavelengths: Any, spectra: list[list[float]] | None) -> Any:
    """Linear sRGB as an unpolarized spectrum of the variant."""
    if mi.is_rgb:
        return colour
    if spectra is None:
        return mi.Color1f(sum(part * weight for part, weight in zip(colour, _LUMINANCE, strict=True)))
    amounts = [sum(weight * colour[c] for c, weight in enumerate(row)) for row in spectra]
    spectrum = mi.UnpolarizedSpectrum(0.0)
    for i, wavelength in enumerate(wavelengths):
        matching = mi.cie1931_xyz(wavelength)
        spectrum[i] = sum(amount * part for amount, part in zip(amounts, matching, strict=True))
    return spectrum


def _depolarized(mi: Any, spectrum: Any) -> Any:
    """A spectrum of the variant; of a polarized one, light without polarization."""
    if not mi.is_polarized:
        return mi.Spectrum(spectrum)
    full = mi.Spectrum(0.0)
    full[0, 0] = spectrum
    return full


def _warn(mi: Any, text: str) -> None:
    mi.Log(mi.LogLevel.Warn, f"{NAME}: {text}")
