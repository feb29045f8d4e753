"""Lobes of materials: the diffuse reflection that may be known already, and what is left of the material without it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

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


def lets_straight_through(mi: Any, bsdf: Any) -> bool:
    """Whether light may go through a surface of the material unbent: ``hair`` says so, but does not."""
    null = mi.BSDFFlags.Null
    return any(part.class_name() != "Hair" and mi.has_flag(part.flags(), null) for part in all_bsdfs(mi, bsdf))


class MaterialTable:
    """What of the materials of a scene is known by their numbers in Mitsuba's registry.

    Parameters
    ----------
    mi : Mitsuba, in the variant of the scene
    materials : iterable of Mitsuba BSDFs

    Attributes
    ----------
    kinds : set of int
        All that there are.
    everything, diffuse, others : BSDFContext
        Of all lobes; of the diffuse reflection; of all but that.
    """

    def __init__(self, mi: Any, materials: Iterable[Any]) -> None:
        self.mi = mi
        materials = list(materials)
        self._kinds_of = self.by_number(materials, [material_kind(mi, one) for one in materials])
        both = [int(mi.has_flag(one.flags(), mi.BSDFFlags.BackSide)) for one in materials]
        self._sides_of = self.by_number(materials, both)
        self.kinds = set(np.unique(np.array(self._kinds_of)).tolist())
        self.everything, self.diffuse, self.others = mi.BSDFContext(), mi.BSDFContext(), mi.BSDFContext()
        diffuse = int(mi.BSDFFlags.DiffuseReflection)
        self.diffuse.type_mask, self.others.type_mask = diffuse, 0xFFFFFFFF & ~diffuse

    def kind(self, bsdf: Any, active: Any) -> Any:
        """UInt32, one of the kinds above."""
        return self.look_up(self._kinds_of, bsdf, active, WHOLE)

    def has_back(self, bsdf: Any, active: Any) -> Any:
        """Bool, whether the material reflects on both sides."""
        return self.look_up(self._sides_of, bsdf, active, 1) == 1

    def by_number(self, materials: list[Any], values: list[int]) -> Any:
        """UInt32 values by the numbers of materials, for `look_up`."""
        import drjit as dr

        mi = self.mi
        numbers = [int(mi.UInt32(dr.reinterpret_array(mi.UInt32, mi.BSDFPtr(one)))[0]) for one in materials]
        table = np.zeros(max(numbers, default=0) + 1, dtype=np.uint32)
        table[numbers] = values
        return mi.UInt32(table)

    def look_up(self, table: Any, bsdf: Any, active: Any, unknown: int) -> Any:
        """The value of a material (BSDFPtr) in a table of `by_number`; ``unknown`` of those that are not in it."""
        import drjit as dr

        mi = self.mi
        number: Any = dr.reinterpret_array(mi.UInt32, bsdf)
        known = active & (number < dr.width(table))
        return dr.select(known, dr.gather(mi.UInt32, table, number, known), unknown)


class Remainder:
    """What is left of the materials that rays meet, without the diffuse reflection where that is known.

    Materials of Mitsuba tell f_d, or (kind `WHOLE`) f_d is taken to be Lambertian, ρ/π, which is right whatever ρ is
    as long as whoever knows the reflection takes the same.

    Parameters
    ----------
    table : MaterialTable
    si : SurfaceInteraction3f
    known : Bool
        Whether the diffuse reflection is known.
    lambertian : UnpolarizedSpectrum
        ρ where materials cannot be split.
    active : Bool

    Attributes
    ----------
    diffuse, split, whole, open : Bool
        Where the diffuse reflection is known; is by asking for the lobes; is Lambertian; is not known.
    scatters : Bool
        Whether there is anything left.
    """

    def __init__(self, table: MaterialTable, si: Any, known: Any, lambertian: Any, active: Any) -> None:
        self._mi, self._table, self._si, self._bsdf = table.mi, table, si, si.bsdf()
        self.kind = table.kind(self._bsdf, active)
        self.diffuse = active & known & (self.kind != NOT_DIFFUSE)
        self.split = self.diffuse & (self.kind == SPLIT)
        self.whole = self.diffuse & (self.kind == WHOLE)
        self.open = active & ~self.diffuse
        self.scatters = self.split | self.whole | self.open
        self._lambertian = lambertian

    def evaluate(self, wo: Any, active: Any) -> tuple[Any, Any]:
        """Value times cosine, and the density with which `sample` draws the direction.

        Parameters
        ----------
        wo : Vector3f
            In the frame of the surface.
        active : Bool
        """
        import drjit as dr

        mi, table, si, bsdf = self._mi, self._table, self._si, self._bsdf
        others, pdf = bsdf.eval_pdf(table.everything, si, wo, active & (self.open | self.whole))
        others = mi.unpolarized_spectrum(others)
        if WHOLE in table.kinds:
            cosine = dr.select(wo.z * si.wi.z > 0.0, dr.abs(wo.z), 0.0) * dr.inv_pi
            others = dr.select(self.whole, others - self._lambertian * cosine, others)
            pdf = dr.select(self.whole, dr.lerp(pdf, cosine, _BY_COSINE), pdf)
        if SPLIT in table.kinds:
            rest, rest_pdf = bsdf.eval_pdf(table.others, si, wo, active & self.split)
            others = dr.select(self.split, mi.unpolarized_spectrum(rest), others)
            pdf = dr.select(self.split, rest_pdf, pdf)
        return others, pdf

    def sample(self, sampler: Any) -> tuple[Any, Any]:
        """A direction: BSDFSample3f, and value times cosine over its density."""
        import drjit as dr

        mi, table, si, bsdf = self._mi, self._table, self._si, self._bsdf
        u, point = sampler.next_1d(), sampler.next_2d()
        by_cosine = self.whole & (u < _BY_COSINE) if WHOLE in table.kinds else mi.Bool(False)
        spread = dr.select(self.whole, (u - _BY_COSINE) / (1.0 - _BY_COSINE), u)
        drawn, weight = bsdf.sample(table.everything, si, spread, point, self.open | (self.whole & ~by_cosine))
        weight = mi.unpolarized_spectrum(weight)
        if WHOLE in table.kinds:
            drawn.wo = dr.select(by_cosine, by_cosine_about(mi, si, point), drawn.wo)
            drawn.eta = dr.select(by_cosine, 1.0, drawn.eta)
            drawn.sampled_type = dr.select(by_cosine, int(mi.BSDFFlags.DiffuseReflection), drawn.sampled_type)
            smooth = self.whole & ~mi.has_flag(drawn.sampled_type, mi.BSDFFlags.Delta)
            others, pdf = self.evaluate(drawn.wo, smooth)
            drawn.pdf = dr.select(smooth, pdf, drawn.pdf)
            mixed = dr.select(pdf > 0.0, others / pdf, 0.0)
            weight = dr.select(smooth, mixed, dr.select(self.whole, weight / (1.0 - _BY_COSINE), weight))
        if SPLIT in table.kinds:
            rest, rest_weight = self._sample_rest(u, point, sampler.next_1d())
            drawn, weight = dr.select(self.split, rest, drawn), dr.select(self.split, rest_weight, weight)
        return drawn, dr.select(self.scatters, weight, 0.0)

    def _sample_rest(self, u: Any, point: Any, choice: Any) -> tuple[Any, Any]:
        """As `sample`, of materials whose lobes can be asked for: one of two directions, by what they weigh.

        Blends and masks choose between what is in them by ``u`` alone, whatever lobe is asked for: nothing comes of the
        choice of a diffuse material, and half a circle further is the other one. Weights stay those of one direction
        in the mean (resampled importance sampling, Talbot et al. 2005).
        """
        import drjit as dr

        mi, split = self._mi, self.split
        first, second = (
            self._bsdf.sample(self._table.others, self._si, one, point, split)
            for one in (u, u + dr.select(u < 0.5, 0.5, -0.5))
        )
        drawn, other = first[0], second[0]
        weight, other_weight = (mi.unpolarized_spectrum(one[1]) for one in (first, second))
        size, other_size = (dr.max(dr.abs(one)) for one in (weight, other_weight))
        taken = choice * (size + other_size) >= size
        chosen = dr.select(taken, other_weight, weight) * (
            0.5 * (size + other_size) / dr.select(taken, other_size, size)
        )
        return dr.select(taken, other, drawn), dr.select(size + other_size > 0.0, chosen, 0.0)


def by_cosine_about(mi: Any, si: Any, u: Any) -> Any:
    """A direction on the side of a surface that is looked at, of density cos/π; of ``u`` (Point2f) in [0, 1)."""
    import drjit as dr

    wo = mi.warp.square_to_cosine_hemisphere(u)
    return mi.Vector3f(wo.x, wo.y, dr.mulsign(wo.z, si.wi.z))
