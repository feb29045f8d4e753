"""What a Mitsuba scene has and transfer at vertices does not hold: rows of the plan by effect and material."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

from slepian_prt.scene.left_out import GATHERED, NOT_SIMULATED, TEXTURE_LOST, LeftOut
from slepian_prt.scene.reflectance import materials
from slepian_prt.scene.reflectance.bsdf_parts import PERTURBING, all_bsdfs

# Normals that lean less than this, as those of any smooth mesh do, need no row.
_LEANING = 0.03

# Materials or shapes that a row names.
_NAMED = 3

# Readers know these by other words than Mitsuba's class names.
_MATERIALS = {
    "SmoothDielectric": "glass",
    "ThinDielectric": "thin glass",
    "RoughDielectric": "rough glass",
    "PrincipledThin": "thin surface",
    "SmoothConductor": "metal",
    "RoughConductor": "rough metal",
}
_SHAPES = {"BSplineCurve": "curve", "LinearCurve": "curve", "SDFGrid": "implicit surface", "Instance": "instance"}

# Effects of materials, each with what names its row, and why vertices do not hold it.
_EFFECTS = {
    "gloss": (
        "glossy reflection of",
        "vertices hold the diffuse part; pictures of the scene gather the gloss, and `view` holds it toward a camera",
    ),
    "mirror": ("mirror reflection of", "not held at vertices; pictures of the scene follow its rays"),
    "transmission": ("transmission through", "not held at vertices; pictures of the scene follow rays through it"),
    "opacity": (
        "opacity of",
        "vertices hold what it leaves of the reflectance; pictures of the scene show what is behind",
    ),
    "bump": ("bump map of", "vertices have the normal of the mesh; pictures of the scene turn it at each pixel"),
    "normal": ("normal map of", "vertices have the normal of the mesh; pictures of the scene turn it at each pixel"),
}
# BSDFs that have the flags of those nested in them, and the effect that is their own.
_WRAPPING = {"TwoSidedBRDF": "", "BlendBSDF": "", "MaskBSDF": "opacity", **PERTURBING}

# BSDFs with a null lobe that are not seen through as holes are.
_WITHOUT_HOLES = ("ThinDielectric", "Hair")

_TOWARD_VIEW = "transfer toward a camera does not hold it"


class ShapeOutcome(NamedTuple):
    """What became of a shape of the scene.

    Attributes
    ----------
    shape : Mitsuba shape
        As the scene has it.
    name : str
    area : float
        Of its surface.
    sides : 0, 1 or 2
        That light is computed on.
    reason : str
        Why that is none, or not both of a surface that reflects on both.
    texture_lost : float
        `materials.VertexReflectance.lost` of its albedo.
    leaning : float
        `normals.leaning_normals` of its faces.
    """

    shape: Any
    name: str
    area: float
    sides: int
    reason: str = ""
    texture_lost: float = 0.0
    leaning: float = 0.0


class _Described(NamedTuple):
    """An outcome with what its rows are made of.

    Attributes
    ----------
    outcome : ShapeOutcome
    area : float
        0 where it is not known.
    material : str
        Its id; empty if it has none, or shares it with another material.
    effects : dict of str to list of str
        Keys of `_EFFECTS`, with words for the materials that have them.
    """

    outcome: ShapeOutcome
    area: float
    material: str
    effects: dict[str, list[str]]


def effects_left_out(mi: Any, outcomes: Sequence[ShapeOutcome], *, view: bool) -> tuple[LeftOut, ...]:
    """Rows of the plan about shapes and their materials, one for each effect.

    Parameters
    ----------
    mi : Mitsuba
    outcomes : sequence of ShapeOutcome
        Of all shapes of the scene.
    view : bool
        Whether transfer is toward a camera: it holds gloss, and pictures of it are not gathered.
    """
    named = zip(outcomes, _material_ids(mi, outcomes), strict=True)
    shapes = [_described(mi, outcome, name) for outcome, name in named]
    shapes.sort(key=lambda shape: -shape.area)
    whole = sum(shape.area for shape in shapes)
    verdict = NOT_SIMULATED if view else GATHERED

    def row(name: str, some: Sequence[_Described], reason: str, verdict: str, words: Iterable[str] = ()) -> LeftOut:
        share = sum(shape.area for shape in some) / whole if whole > 0.0 else 0.0
        return LeftOut(f"{name} {_listed(some, words)}", share or None, reason, verdict)

    rows = []
    for effect, (name, reason) in _EFFECTS.items():
        some = [shape for shape in shapes if effect in shape.effects]
        if some and not (view and effect == "gloss"):
            words = [word for shape in some for word in shape.effects[effect]]
            rows.append(row(name, some, _TOWARD_VIEW if view else reason, verdict, words))
    rows += _texture_rows(shapes, verdict)
    rows += _leaning_rows(shapes)
    rows += _without_light(mi, shapes, whole, view=view)
    if view and len(shapes) > 1:  # else they have rows by effect, with what they contribute
        sending = [shape for shape in shapes if {"gloss", "mirror"} & shape.effects.keys()]
        if sending:
            reason = "light between surfaces is diffuse: no caustics, nothing that mirrors and metals throw on a floor"
            found = row("light onto other surfaces by reflection of", sending, reason, NOT_SIMULATED)
            rows.append(found._replace(by_paths=True))
        letting = [shape for shape in shapes if {"transmission", "opacity"} & shape.effects.keys()]
        if letting:
            reason = "where they hide the light, they cast the shadow of opaque surfaces; no light goes through them"
            found = row("light onto other surfaces through", letting, reason, NOT_SIMULATED)
            rows.append(found._replace(by_paths=True))
    if view:
        rows += _media(shapes)
    return tuple(rows)


def _material_ids(mi: Any, outcomes: Sequence[ShapeOutcome]) -> list[str]:
    """What each shape's material is called: not what several materials are called, as from a dict all are ``bsdf``."""
    bsdfs = [outcome.shape.bsdf() for outcome in outcomes]
    names = ["" if bsdf is None else next(filter(None, (b.id() for b in all_bsdfs(mi, bsdf))), "") for bsdf in bsdfs]
    last = dict(zip(names, bsdfs, strict=True))
    shared = {name for name, bsdf in zip(names, bsdfs, strict=True) if bsdf is not last[name]}
    return ["" if name in shared else name for name in names]


def _described(mi: Any, outcome: ShapeOutcome, material: str) -> _Described:
    area = outcome.area
    if area <= 0.0:
        try:
            area = float(outcome.shape.surface_area()[0])
        except Exception:  # Mitsuba's message for shapes that have none
            area = 0.0
    effects: dict[str, list[str]] = {}
    bsdf = outcome.shape.bsdf()
    if bsdf is not None and not materials.lets_all_light_through(mi, bsdf):
        for part in all_bsdfs(mi, bsdf):
            for effect in _own_effects(mi, part):
                word = _MATERIALS.get(part.class_name())
                effects.setdefault(effect, []).extend([word] if word else [])
    return _Described(outcome, area if math.isfinite(area) else 0.0, material, effects)


def _own_effects(mi: Any, bsdf: Any) -> list[str]:
    """Keys of `_EFFECTS` that a BSDF adds to those of the BSDFs nested in it."""
    flags, kind = mi.BSDFFlags, bsdf.class_name()
    if kind in _WRAPPING:
        return [_WRAPPING[kind]] if _WRAPPING[kind] else []
    wanted = {
        "gloss": (flags.GlossyReflection,),
        "mirror": (flags.DeltaReflection,),
        "transmission": (flags.DiffuseTransmission, flags.GlossyTransmission, flags.DeltaTransmission),
        # Thin glass, too, has what goes straight through it as a hole, and so does hair, which has none.
        "transmission" if kind in _WITHOUT_HOLES else "opacity": (flags.Null,),
    }
    return [effect for effect, some in wanted.items() if any(mi.has_flag(bsdf.flags(), flag) for flag in some)]


def _texture_rows(shapes: Sequence[_Described], verdict: str) -> list[LeftOut]:
    """What vertices miss of textures, as the RMS over the surfaces that miss enough to be told."""
    some = [shape for shape in shapes if shape.outcome.texture_lost >= TEXTURE_LOST]
    if not some:
        return []
    area = max(sum(shape.area for shape in some), 1e-300)
    lost = math.sqrt(sum(shape.area * shape.outcome.texture_lost**2 for shape in some) / area)
    reason = "relative RMS by which albedo differs from what vertices hold, for .npz and for light between surfaces"
    if verdict == GATHERED:
        reason += "; pictures of the scene take the texture at each pixel"
    return [LeftOut(f"texture between vertices of {_listed(some)}", lost, reason, verdict)]


def _leaning_rows(shapes: Sequence[_Described]) -> list[LeftOut]:
    """Meshes whose normals have little to do with their faces, as of boxes with one normal at each corner."""
    some = [shape for shape in shapes if shape.outcome.leaning >= _LEANING]
    if not some:
        return []
    area = max(sum(shape.area for shape in some), 1e-300)
    part = sum(shape.area * shape.outcome.leaning for shape in some) / area
    named = _listed([shape._replace(material="") for shape in some])
    reason = (
        "part of the light that normals at vertices ask for from behind the faces: Mitsuba lets it shine through, or "
        "draws dark backs, here it is that of the front; face_normals makes the edges of the shape hard"
    )
    return [LeftOut(f"leaning normals of {named}", part, reason)]


def _without_light(mi: Any, shapes: Sequence[_Described], whole: float, *, view: bool) -> list[LeftOut]:
    """Shapes that receive no light for another reason than that their material reflects none, by reason."""
    reflects = materials.reflects_toward_a_view if view else materials.reflects_diffusely
    groups: dict[tuple[str, str], list[_Described]] = {}
    for shape in shapes:
        outcome, bsdf = shape.outcome, shape.outcome.shape.bsdf()
        if bsdf is not None and materials.lets_all_light_through(mi, bsdf):
            continue
        told = bsdf is not None and not reflects(mi, bsdf) and shape.effects
        if outcome.sides == 0 and not told:
            kind = _SHAPES.get(outcome.shape.class_name(), "shape")
            groups.setdefault((outcome.reason, kind), []).append(shape)
    rows = []
    for (reason, kind), some in groups.items():
        names = ", ".join(f"'{shape.outcome.name}'" for shape in some[:_NAMED])
        more = ", …" if len(some) > _NAMED else ""
        name = f"{kind} {names}" if len(some) == 1 else f"{len(some)} {kind}s ({names}{more})"
        share = sum(shape.area for shape in some) / whole if whole > 0.0 else 0.0
        text, verdict = (reason, NOT_SIMULATED) if view else (f"{reason}; pictures of the scene gather it", GATHERED)
        rows.append(LeftOut(f"light received by {name}", share or None, text, verdict))
    return rows


def _media(shapes: Sequence[_Described]) -> list[LeftOut]:
    inside = [shape for shape in shapes if shape.outcome.shape.interior_medium() is not None]
    if not inside:
        return []
    kinds = dict.fromkeys(
        shape.outcome.shape.interior_medium().class_name().removesuffix("Medium").lower() for shape in inside
    )
    named = _listed([shape._replace(material="") for shape in inside], kinds)
    reason = "light is neither scattered nor absorbed in it: everything is lit and drawn as if it were not there"
    return [LeftOut(f"participating media inside {named}", None, reason)]


def _listed(shapes: Sequence[_Described], words: Iterable[str] = ()) -> str:
    """Up to three materials by id, or shapes whose material has none, and how many there are."""
    named = list(dict.fromkeys(shape.material for shape in shapes if shape.material))
    others = [shape.outcome.name for shape in shapes if not shape.material]
    parts = [
        f"{kind}{'s' * (len(some) > 1)} {', '.join(map(repr, some))}"
        for kind, some in (("material", named[:_NAMED]), ("shape", others[: max(0, _NAMED - len(named))]))
        if some
    ]
    more = len(named) + len(others) - _NAMED
    text = " and ".join(parts) + (f" and {more} more" if more > 0 else "")
    about = list(dict.fromkeys(words))
    if named:
        about.append(f"{len(shapes)} shapes" if len(shapes) > 1 else f"shape '{shapes[0].outcome.name}'")
    return f"{text} ({', '.join(about)})" if about else text
