"""What of a material the file's light is for, and what is left: the diffuse lobe, and all the others."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from slepian_prt.relighting.mitsuba.cache import Cached
from slepian_prt.relighting.mitsuba.spectra import srgb_to_spectrum
from slepian_prt.scene.reflectance.bsdf_parts import all_bsdfs, is_textured

# Kinds of materials: without diffuse reflection; with nothing else (and no texture); with nothing else; with lobes that
# can be evaluated one by one; with lobes that cannot.
NOT_DIFFUSE, PLAIN, LAMBERTIAN, SPLIT, WHOLE = range(5)

# BSDFs that are nothing but Lambertian, and those whose lobes can be evaluated one by one.
_LAMBERTIAN = {"SmoothDiffuse", "TwoSidedBRDF"}
_SPLIT = _LAMBERTIAN | {
    "SmoothPlastic", "RoughPlastic", "SmoothConductor", "RoughConductor", "SmoothDielectric", "ThinDielectric",
    "RoughDielectric", "Null", "MaskBSDF", "BlendBSDF",
}  # fmt: skip

# How often the light of a material that cannot be split is looked for by the cosine alone: where the material itself
# never looks, what a Lambertian one would reflect must still be taken off.
_BY_COSINE = 0.25


def material_kind(mi: Any, bsdf: Any) -> int:
    """One of the kinds above.

    ``principled``, ``hair`` and measured materials take no notice of what lobe is asked for, and bumps give a lobe
    another shape; so do, for all we know, materials that are not known here.
    """
    flags, kinds = mi.BSDFFlags, {part.class_name() for part in all_bsdfs(mi, bsdf)}
    if not mi.has_flag(bsdf.flags(), flags.DiffuseReflection):
        return NOT_DIFFUSE
    if not kinds <= _SPLIT:
        return WHOLE
    others = (
        flags.Null, flags.DiffuseTransmission, flags.GlossyReflection, flags.GlossyTransmission,
        flags.DeltaReflection, flags.DeltaTransmission,
    )  # fmt: skip
    if any(mi.has_flag(bsdf.flags(), flag) for flag in others):
        return SPLIT
    return PLAIN if kinds <= _LAMBERTIAN and not is_textured(mi, bsdf) else LAMBERTIAN


class Lobes:
    """The lobes of all materials of a scene, at points that rays meet.

    Where a surface is held in a file, its diffuse reflection f_d is left to the file, and f - f_d goes on. Materials
    of Mitsuba tell f_d, or (kind `WHOLE`) f_d is taken to be Lambertian, ρ/π, which is right whatever ρ is.

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
        self._mi, self._albedo, self._spectra = mi, albedo, spectra
        materials = list(materials)
        self._kinds_of = _table(mi, materials, [material_kind(mi, one) for one in materials])
        both = [int(mi.has_flag(one.flags(), mi.BSDFFlags.BackSide)) for one in materials]
        self._sides_of = _table(mi, materials, both)
        self.kinds = set(np.unique(np.array(self._kinds_of)).tolist())
        self._all, self._diffuse, self._others = mi.BSDFContext(), mi.BSDFContext(), mi.BSDFContext()
        diffuse = int(mi.BSDFFlags.DiffuseReflection)
        self._diffuse.type_mask, self._others.type_mask = diffuse, 0xFFFFFFFF & ~diffuse

    def kind(self, bsdf: Any, active: Any) -> Any:
        """UInt32, one of the kinds above."""
        return self._look_up(self._kinds_of, bsdf, active, WHOLE)

    def has_back(self, bsdf: Any, active: Any) -> Any:
        """Bool, whether the material reflects on both sides."""
        return self._look_up(self._sides_of, bsdf, active, 1) == 1

    def _look_up(self, table: Any, bsdf: Any, active: Any, unknown: int) -> Any:
        import drjit as dr

        mi = self._mi
        number: Any = dr.reinterpret_array(mi.UInt32, bsdf)
        known = active & (number < dr.width(table))
        return dr.select(known, dr.gather(mi.UInt32, table, number, known), unknown)

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
        mi = lobes._mi
        self._mi, self._lobes, self._si, self._cached = mi, lobes, si, cached
        self._bsdf = si.bsdf()
        kind = lobes.kind(self._bsdf, active)
        self._toward_view = active & cached.valid & cached.toward_view  # all lobes but mirrors are in the file
        self.held = active & cached.valid & ((kind != NOT_DIFFUSE) | cached.toward_view)
        separable = self.held & ~cached.toward_view
        self._split = separable & (kind == SPLIT)
        self._whole = separable & (kind == WHOLE)
        self._open = active & ~self.held
        self._of_file = self.held & (cached.toward_view | (lobes._albedo == "file"))
        # With vertex normals the side that is seen may count as the back: Mitsuba's materials are black there.
        self._turned_away = mi.Bool(False)
        if lobes._albedo == "auto":
            plain = separable & (kind == PLAIN)
            self._of_file |= plain
            self._turned_away = plain & (si.wi.z <= 0.0) & ~lobes.has_back(self._bsdf, plain)
        self.scatters = self._split | self._whole | self._open
        self._lambertian = self._albedo_of_whole() if WHOLE in lobes.kinds else mi.UnpolarizedSpectrum(0.0)

    def _albedo_of_whole(self) -> Any:
        """ρ of materials that cannot be split."""
        import drjit as dr

        mi, si, whole = self._mi, self._si, self._whole
        albedo = mi.unpolarized_spectrum(self._bsdf.eval_diffuse_reflectance(si, whole))
        for part in ("metallic", "spec_trans"):
            albedo *= 1.0 - self._bsdf.eval_attribute_1(part, si, whole)
        return dr.select(whole & dr.isfinite(dr.max(albedo)), dr.clip(albedo, 0.0, 1.0), 0.0)

    def held_radiance(self, sampler: Any) -> Any:
        """What the diffuse lobe reflects of the light that the file holds; zero where none does.

        a B, with B the radiance of unit albedo and a = ∫ f_d cos dω, of which π f_d in one direction, drawn by the
        cosine, is an estimate without bias, and for Lambertian materials without noise.
        """
        import drjit as dr

        mi, lobes, si = self._mi, self._lobes, self._si
        srgb = dr.select(self._of_file, self._cached.radiance, self._cached.unlit)
        radiance = srgb_to_spectrum(mi, srgb, si.wavelengths, lobes._spectra)
        if lobes._albedo != "file":
            wo = self.by_cosine(sampler.next_2d())
            separate = self.held & ~self._of_file & ~self._whole
            reflected = mi.unpolarized_spectrum(self._bsdf.eval(lobes._diffuse, si, wo, separate))
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
        active &= self.held
        cosine = dr.select(wo.z * si.wi.z > 0.0, dr.abs(wo.z), 0.0) * dr.inv_pi
        whole = mi.unpolarized_spectrum(bsdf.eval(lobes._all, si, wo, active & self._toward_view))
        diffuse = mi.unpolarized_spectrum(bsdf.eval(lobes._diffuse, si, wo, active & ~self._of_file & ~self._whole))
        albedo = srgb_to_spectrum(mi, self._cached.albedo, si.wavelengths, lobes._spectra)
        held = dr.select(self._of_file, albedo * cosine, dr.select(self._whole, self._lambertian * cosine, diffuse))
        held = dr.select(self._toward_view, whole, held)
        return dr.select(active & ~self._turned_away, held, 0.0)

    def evaluate(self, wo: Any, active: Any) -> tuple[Any, Any]:
        """Value times cosine of the lobes that are not held, and the density with which `sample` draws them.

        Parameters
        ----------
        wo : Vector3f
            In the frame of the surface.
        active : Bool
        """
        import drjit as dr

        mi, lobes, si, bsdf = self._mi, self._lobes, self._si, self._bsdf
        others, pdf = bsdf.eval_pdf(lobes._all, si, wo, active & (self._open | self._whole))
        others = mi.unpolarized_spectrum(others)
        if WHOLE in lobes.kinds:
            cosine = dr.select(wo.z * si.wi.z > 0.0, dr.abs(wo.z), 0.0) * dr.inv_pi
            others = dr.select(self._whole, others - self._lambertian * cosine, others)
            pdf = dr.select(self._whole, dr.lerp(pdf, cosine, _BY_COSINE), pdf)
        if SPLIT in lobes.kinds:
            rest, rest_pdf = bsdf.eval_pdf(lobes._others, si, wo, active & self._split)
            others = dr.select(self._split, mi.unpolarized_spectrum(rest), others)
            pdf = dr.select(self._split, rest_pdf, pdf)
        return others, pdf

    def sample(self, sampler: Any) -> tuple[Any, Any]:
        """A direction for the lobes that are not held: BSDFSample3f, and value times cosine over its density."""
        import drjit as dr

        mi, lobes, si, bsdf = self._mi, self._lobes, self._si, self._bsdf
        u, point = sampler.next_1d(), sampler.next_2d()
        by_cosine = self._whole & (u < _BY_COSINE) if WHOLE in lobes.kinds else mi.Bool(False)
        spread = dr.select(self._whole, (u - _BY_COSINE) / (1.0 - _BY_COSINE), u)
        drawn, weight = bsdf.sample(lobes._all, si, spread, point, self._open | (self._whole & ~by_cosine))
        weight = mi.unpolarized_spectrum(weight)
        if WHOLE in lobes.kinds:
            drawn.wo = dr.select(by_cosine, self.by_cosine(point), drawn.wo)
            drawn.eta = dr.select(by_cosine, 1.0, drawn.eta)
            drawn.sampled_type = dr.select(by_cosine, int(mi.BSDFFlags.DiffuseReflection), drawn.sampled_type)
            smooth = self._whole & ~mi.has_flag(drawn.sampled_type, mi.BSDFFlags.Delta)
            others, pdf = self.evaluate(drawn.wo, smooth)
            drawn.pdf = dr.select(smooth, pdf, drawn.pdf)
            mixed = dr.select(pdf > 0.0, others / pdf, 0.0)
            weight = dr.select(smooth, mixed, dr.select(self._whole, weight / (1.0 - _BY_COSINE), weight))
        if SPLIT in lobes.kinds:
            rest, rest_weight = bsdf.sample(lobes._others, si, u, point, self._split)
            drawn = dr.select(self._split, rest, drawn)
            weight = dr.select(self._split, mi.unpolarized_spectrum(rest_weight), weight)
        return drawn, dr.select(self.scatters, weight, 0.0)

    def by_cosine(self, u: Any) -> Any:
        """A direction on the side of the surface that is looked at, of density cos/π; of ``u`` (Point2f) in [0, 1)."""
        import drjit as dr

        wo = self._mi.warp.square_to_cosine_hemisphere(u)
        return self._mi.Vector3f(wo.x, wo.y, dr.mulsign(wo.z, self._si.wi.z))


def _table(mi: Any, materials: list[Any], values: list[int]) -> Any:
    """UInt32 values by the numbers of materials in Mitsuba's registry."""
    import drjit as dr

    numbers = [int(mi.UInt32(dr.reinterpret_array(mi.UInt32, mi.BSDFPtr(one)))[0]) for one in materials]
    table = np.zeros(max(numbers, default=0) + 1, dtype=np.uint32)
    table[numbers] = values
    return mi.UInt32(table)
