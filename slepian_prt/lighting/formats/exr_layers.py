"""Which of the images in an OpenEXR file is the light: the picture of all light, not one of what else is rendered."""

from __future__ import annotations

import logging
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from slepian_prt.errors import UserError
from slepian_prt.lighting.formats.exr_header import Channel, Part

log = logging.getLogger(__name__)

# What renderers and compositors call the picture itself.
# fmt: off
_BEAUTY = frozenset((
    "beauty", "c", "ci", "color", "colour", "combined", "composite", "default", "final", "hdr", "hdri", "master",
    "radiance", "rgb", "rgba",
))
# fmt: on

# Words of names that are not the whole light: its parts, and what is no light.
# fmt: off
_OTHER = frozenset((
    "albedo", "alpha", "ao", "aov", "base", "basecolor", "bump", "coat", "clearcoat", "coverage", "debug", "denoising",
    "depth", "diffuse", "diff", "direct", "displacement", "emission", "emissive", "emit", "flow", "fog", "fresnel",
    "fuzz", "gi", "gloss", "glossy", "heat", "id", "ids", "index", "indirect", "material", "mask", "masks", "matte",
    "mattes", "metallic", "metalness", "mist", "motion", "n", "noise", "noisy", "normal", "normals", "object",
    "objects", "occlusion", "opacity", "p", "pos", "position", "positions", "pref", "reflection", "reflections",
    "refraction", "refractions", "roughness", "samples", "scatter", "scattering", "selfillum", "shadow", "shadows",
    "sheen", "spec", "specular", "ss", "sss", "st", "subsurface", "thickness", "trans", "transmission", "transmissive",
    "transmit", "uv", "uvs", "variance", "vec", "vector", "vectors", "velocity", "volume", "z", "zdepth",
))
# fmt: on

# Words that tell nothing.
_NEUTRAL = frozenset(("layer", "left", "pass", "view"))

_COMPONENTS = {"r": "R", "red": "R", "g": "G", "green": "G", "b": "B", "blue": "B"}


@dataclass(frozen=True)
class Layer:
    """An image in a file.

    Attributes
    ----------
    part : int
    name : str
        Of the layer; empty for channels without one.
    label : str
        For users.
    channels : tuple of Channel
        Red, green and blue, or luminance alone.
    words : tuple of str
        Of the names that it goes by.
    other_view : bool
        Whether it is what another eye sees than the default.
    """

    part: int
    name: str
    label: str
    channels: tuple[Channel, ...]
    words: tuple[str, ...]
    other_view: bool


def choose_layer(path: Path, parts: Sequence[Part]) -> Layer:
    """The image that is the light.

    Images are red, green and blue (or luminance, where nothing has colours) of one layer of one part, of floating
    point and not deep. One that is alone is taken. Of several, those with a word for something else in their names
    (albedo, diffuse, shadow, id, …) and those of the right eye come last; one that is called beauty, rgba, combined
    or the like, or is named nothing at all, comes first; in a part, channels without a layer come before layers. What
    was chosen is said; if that leaves two, the user has to choose.

    Raises
    ------
    UserError
        No image, or none that is the light rather than another.
    """
    several = len(parts) > 1
    found = [layer for number, part in enumerate(parts) for layer in _layers(number, part, several)]
    images = [layer for layer in found if len(layer.channels) == 3] or found
    if not images:
        raise _nothing(path, parts)
    images.sort(key=_rank, reverse=True)
    best = [layer for layer in images if _rank(layer) == _rank(images[0])]
    if len({layer.part for layer in best}) == 1 and not best[0].name:
        best = best[:1]
    others = [layer for layer in images if layer.other_view == images[0].other_view]
    if len(best) > 1 or (_is_other(images[0]) and len(others) > 1):
        listed = ", ".join(layer.label for layer in images)
        raise UserError(
            f"{path}: holds several images, and their names do not tell which is the light: {listed}; keep the one "
            "that is, or name it beauty"
        )
    chosen = best[0]
    if any(channel.sampling != (1, 1) for channel in chosen.channels):
        raise UserError(f"{path}: its colours ({chosen.label}) are subsampled; write them at every texel")
    if len(images) > 1:
        left = ", ".join(layer.label for layer in images if layer is not chosen)
        log.info("%s: holds several images; the light is %s, not %s", path, chosen.label, left)
    elif _is_other(chosen):
        log.info("%s: holds no image but %s, which is taken as the light", path, chosen.label)
    return chosen


def _layers(number: int, part: Part, several: bool) -> list[Layer]:
    """The images of a part, those without a layer first."""
    if part.deep:
        return []
    groups: dict[str, dict[str, Channel]] = {}
    for channel in part.channels:
        layer, _, component = channel.name.rpartition(".")
        component = _COMPONENTS.get(component.lower(), component)
        groups.setdefault(layer, {}).setdefault(component, channel)
    found = []
    for layer, group in sorted(groups.items()):
        if {"R", "G", "B"} <= set(group):
            channels = tuple(group[component] for component in "RGB")
        elif "Y" in group and not {"X", "Z", "RY", "BY"} & set(group):
            channels = (group["Y"],)
        else:
            continue
        if any(channel.kind == "uint" for channel in channels):
            continue  # numbers of objects, not colours
        label = ("layer " + layer if layer else ", ".join(c.name for c in channels)) if layer or not several else ""
        if several:
            label = f"part {number} '{part.name}'" + (f" {label}" if label else "")
        # The name of the only part is that of the file.
        words = _words(f"{part.name} {layer}" if several else layer)
        views = part.views or ("left", "right")
        first = layer.partition(".")[0].lower()
        view = part.view.lower() or (first if first in (v.lower() for v in views) else "")
        other = view in (v.lower() for v in views[1:]) or "right" in words
        found.append(Layer(number, layer, label, channels, words, other))
    return found


def _words(name: str) -> tuple[str, ...]:
    """The words of a name in any style, in small letters: ViewLayer.Combined, shadow_matte, rgba2."""
    found = [word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name)]
    return tuple(word for word in found if word not in _NEUTRAL)


def _is_other(layer: Layer) -> bool:
    return any(word in _OTHER or word.startswith("crypto") for word in layer.words)


def _rank(layer: Layer) -> tuple[bool, bool, int]:
    """Higher is better: whole light before parts of it, the default view before others, names of a picture first."""
    known = sum(word in _BEAUTY for word in layer.words)
    named = 2 if known == len(layer.words) else 1 if known else 0
    return not _is_other(layer), not layer.other_view, named


def _nothing(path: Path, parts: Sequence[Part]) -> UserError:
    """Why there is no image."""
    if any(part.deep for part in parts):
        return UserError(f"{path}: holds deep data, several samples at each texel; flatten it and write it again")
    names = [channel.name for part in parts for channel in part.channels]
    if any(name.rpartition(".")[2] in ("RY", "BY") for name in names):
        return UserError(
            f"{path}: its colours are luminance and subsampled chroma (Y, RY, BY); write it again with R, G and B"
        )
    listed = ", ".join(names[:20]) + (", …" if len(names) > 20 else "") if names else "none"
    return UserError(f"{path}: has the channels {listed}, not R, G and B of half or float; write its colours as these")
