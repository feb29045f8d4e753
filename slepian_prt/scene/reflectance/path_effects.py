"""What light paths do at a material beside diffuse reflection, by the names of the effects plan."""

from __future__ import annotations

from typing import Any

import numpy as np

from slepian_prt.scene.reflectance.bsdf_parts import all_bsdfs
from slepian_prt.scene.reflectance.materials import lets_all_light_through

# By what a path meets first; of a material that does several of these, the first in this list counts.
PATH_EFFECTS = ("media", "opacity", "glass", "transmission", "mirrors", "gloss")

# What is left: diffuse reflection, where paths meet it on shapes that hold no light because they have no vertices.
DIFFUSE = "diffuse"

_GLASS = ("SmoothDielectric", "ThinDielectric", "RoughDielectric")
_MIRRORS = ("SmoothConductor",)

# BSDFs with a null lobe that is no hole: what goes straight through is one of several things that they do.
_NO_HOLES = ("ThinDielectric", "Hair")


def path_effect(mi: Any, bsdf: Any) -> str | None:
    """One of `PATH_EFFECTS`, `DIFFUSE` for a material that does none of these, or None if nothing comes back from it.

    ``media`` is that of boundaries which all light passes: they are there for what they enclose.
    """
    flags = mi.BSDFFlags
    lobes = int(bsdf.flags()) & int(flags.All)
    if lobes in (0, int(flags.DiffuseReflection)):
        return DIFFUSE if lobes else None
    if lets_all_light_through(mi, bsdf):
        return "media"
    parts = list(all_bsdfs(mi, bsdf))

    def has(part: Any, *some: Any) -> bool:
        return any(mi.has_flag(part.flags(), flag) for flag in some)

    glossy = (flags.GlossyReflection, flags.DeltaReflection)
    through = (flags.DiffuseTransmission, flags.GlossyTransmission, flags.DeltaTransmission)
    kinds = {part.class_name() for part in parts}
    if "MaskBSDF" in kinds or (has(bsdf, flags.Null) and not kinds & set(_NO_HOLES)):
        return "opacity"
    if has(bsdf, *through, flags.Null):
        bent = has(bsdf, flags.GlossyTransmission) and not has(bsdf, flags.DiffuseTransmission) and "Hair" not in kinds
        return "glass" if bent or kinds & set(_GLASS) else "transmission"
    if has(bsdf, *glossy):
        return "mirrors" if kinds & set(_MIRRORS) else "gloss"
    return DIFFUSE


def passes_light(mi: Any, bsdf: Any) -> bool:
    """Whether light comes through the material, so that to be behind it is not to be inside something."""
    return path_effect(mi, bsdf) in ("media", "opacity", "glass", "transmission")


def densest_glass(mi: Any, bsdf: Any) -> float:
    """The relative index of refraction of a boundary, from its denser side; 1 of what does not bend light."""
    if bsdf.class_name() not in ("SmoothDielectric", "RoughDielectric", "Principled"):
        return 1.0
    parameters = mi.traverse(bsdf)
    eta = float(np.max(np.array(parameters["eta"]))) if "eta" in parameters else 1.0
    return max(eta, 1.0 / eta)
