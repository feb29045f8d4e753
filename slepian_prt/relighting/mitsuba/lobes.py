"""What of a material the file's light is for, and what is left: the diffuse lobe, and all the others."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from slepian_prt.paths.lobes import PLAIN, WHOLE, MaterialTable, Remainder, by_cosine_about
from slepian_prt.relighting.mitsuba.cache import Cached
from slepian_prt.relighting.mitsuba.spectra import srgb_to_spectrum


class Lobes:
    """The lobes of all materials of a scene, at points that rays meet.

    Where a surface is held in a file, its diffuse reflection f_d is left to the file, and f - f_d goes on, as of
    `Remainder`.

    Parameters
    ----------
    mi : Mitsuba, in the variant of the scene
    materials : iterable of Mitsuba BSDFs
    albedo : str
        ``auto``, ``file`` or ``scene``: see the integrator.
    spectra : nested lists (3, 3) or None
        See `srgb_to_spectrum`.
    """

    def __init__(self, mi: Any, materials: Iterable[Any], albedo: str, spectra: list[list[float]] | None) -> None:
        self.mi, self.albedo, self.spectra = mi, albedo, spectra
        self.table = MaterialTable(mi, materials)

    def at(self, si: Any, cached: Cached, active: Any) -> Material:
        """The material where rays meet the scene.

        Parameters
        ----------
        si : SurfaceInteraction3f
        cached : Cached
            What files hold there.
        active : Bool
        """
        return Material(self, si, cached, active)


class Material:
    """The lobes of the materials that rays meet; made by `Lobes.at`.

    Attributes
    ----------
    held : Bool
        Whether the diffuse lobe is left to a file.
    scatters : Bool
        Whether there are others.
    """

    def __init__(self, lobes: Lobes, si: Any, cached: Cached, active: Any) -> None:
        mi = lobes.mi
        self._mi, self._lobes, self._si, self._cached = mi, lobes, si, cached
        self._bsdf = si.bsdf()
        self._toward_view = active & cached.valid & cached.toward_view  # all lobes but mirrors are in the file
        self._lambertian = mi.UnpolarizedSpectrum(0.0)
        if WHOLE in lobes.table.kinds:
            known = active & cached.valid & ~cached.toward_view
            self._lambertian = self._albedo_of_whole(known & (lobes.table.kind(self._bsdf, active) == WHOLE))
        rest = Remainder(lobes.table, si, cached.valid, self._lambertian, active & ~self._toward_view)
        self._rest, self._whole = rest, rest.whole
        self.held, self.scatters = rest.diffuse | self._toward_view, rest.scatters
        self._of_file = self.held & (cached.toward_view | (lobes.albedo == "file"))
        # With vertex normals the side that is seen may count as the back: Mitsuba's materials are black there.
        self._turned_away = mi.Bool(False)
        if lobes.albedo == "auto":
            plain = rest.diffuse & (rest.kind == PLAIN)
            self._of_file |= plain
            self._turned_away = plain & (si.wi.z <= 0.0) & ~lobes.table.has_back(self._bsdf, plain)

    def _albedo_of_whole(self, whole: Any) -> Any:
        """ρ of materials that cannot be split."""
        import drjit as dr

        mi, si = self._mi, self._si
        albedo = mi.unpolarized_spectrum(self._bsdf.eval_diffuse_reflectance(si, whole))
        for part, taken in (("metallic", 1.0), ("spec_trans", 1.0), ("diff_trans", 0.5)):
            albedo *= 1.0 - taken * self._bsdf.eval_attribute_1(part, si, whole)
        return dr.select(whole & dr.isfinite(dr.max(albedo)), dr.clip(albedo, 0.0, 1.0), 0.0)

    def held_radiance(self, sampler: Any) -> Any:
        """What the diffuse lobe reflects of the light that the file holds; zero where none does.

        a B, with B the radiance of unit albedo and a = ∫ f_d cos dω, of which π f_d in one direction, drawn by the
        cosine, is an estimate without bias, and for Lambertian materials without noise.
        """
        import drjit as dr

        mi, lobes, si = self._mi, self._lobes, self._si
        srgb = dr.select(self._of_file, self._cached.radiance, self._cached.unlit)
        radiance = srgb_to_spectrum(mi, srgb, si.wavelengths, lobes.spectra)
        if lobes.albedo != "file":
            wo = self.by_cosine(sampler.next_2d())
            separate = self.held & ~self._of_file & ~self._whole
            reflected = mi.unpolarized_spectrum(self._bsdf.eval(lobes.table.diffuse, si, wo, separate))
            albedo = reflected * (dr.pi / dr.maximum(dr.abs(wo.z), 1e-6))
            radiance *= dr.select(self._of_file, 1.0, dr.select(self._whole, self._lambertian, albedo))
        return dr.select(self.held & ~self._turned_away, radiance, 0.0)

    def reflects_toward(self, wo: Any) -> Any:
        """Float, the cosine of a direction (Vector3f in the frame of the surface) where the held lobe may reflect."""
        import drjit as dr

        return dr.select((wo.z * self._si.wi.z > 0.0) | self._toward_view, dr.abs(wo.z), 0.0)

    def held_from(self, wo: Any, active: Any) -> Any:
        """Value times cosine of the held lobe; arguments as of `evaluate`."""
        import drjit as dr

        mi, lobes, si, bsdf = self._mi, self._lobes, self._si, self._bsdf
        table = lobes.table
        active &= self.held
        cosine = dr.select(wo.z * si.wi.z > 0.0, dr.abs(wo.z), 0.0) * dr.inv_pi
        whole = mi.unpolarized_spectrum(bsdf.eval(table.everything, si, wo, active & self._toward_view))
        diffuse = mi.unpolarized_spectrum(bsdf.eval(table.diffuse, si, wo, active & ~self._of_file & ~self._whole))
        albedo = srgb_to_spectrum(mi, self._cached.albedo, si.wavelengths, lobes.spectra)
        held = dr.select(self._of_file, albedo * cosine, dr.select(self._whole, self._lambertian * cosine, diffuse))
        held = dr.select(self._toward_view, whole, held)
        return dr.select(active & ~self._turned_away, held, 0.0)

    def evaluate(self, wo: Any, active: Any) -> tuple[Any, Any]:
        """Of the lobes that are not held, as of `Remainder.evaluate`."""
        return self._rest.evaluate(wo, active)

    def sample(self, sampler: Any) -> tuple[Any, Any]:
        """A direction for the lobes that are not held, as of `Remainder.sample`."""
        return self._rest.sample(sampler)

    def by_cosine(self, u: Any) -> Any:
        """A direction on the side of the surface that is looked at, of density cos/π; of ``u`` (Point2f) in [0, 1)."""
        return by_cosine_about(self._mi, self._si, u)
