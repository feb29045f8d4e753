"""What a Mitsuba BSDF is made of: the BSDFs nested in it, and its textures."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any

# Textures that are the same everywhere; others, unknown ones too, are taken to vary. (Mitsuba's own
# `is_spatially_varying` is false for attributes of meshes.)
_CONSTANT = {
    "BlackBodySpectrum",
    "D65Spectrum",
    "IrregularSpectrum",
    "RawConstantTexture",
    "RawConstantTextureImpl",
    "RegularSpectrum",
    "SRGBReflectanceSpectrum",
    "UniformSpectrum",
}

# BSDFs that turn the normal and leave to the one nested in them what is reflected.
PERTURBING = {"BumpMap": "bump", "NormalMap": "normal"}


@cache
def _collector(callback: Any) -> Any:
    """A class that collects what a Mitsuba object shows when it is traversed."""

    class Collector(callback):
        def __init__(self) -> None:
            super().__init__()
            self.found: dict[str, Any] = {}

        def put(self, name: str, value: Any, *_: Any) -> None:
            self.found[name] = value

    return Collector


def parts_of(mi: Any, bsdf: Any) -> dict[str, Any]:
    """The BSDFs and textures directly inside a BSDF, by the names of its parameters."""
    collector = _collector(mi.TraversalCallback)()
    bsdf.traverse(collector)
    return {name: part for name, part in collector.found.items() if isinstance(part, (mi.BSDF, mi.Texture))}


def all_bsdfs(mi: Any, bsdf: Any) -> Iterator[Any]:
    """A BSDF and those nested in it, from the outermost on."""
    yield bsdf
    for part in parts_of(mi, bsdf).values():
        if isinstance(part, mi.BSDF):
            yield from all_bsdfs(mi, part)


def is_textured(mi: Any, bsdf: Any) -> bool:
    """Whether what a BSDF reflects may vary over the surface; the normals of bump and normal maps apart."""
    parts = parts_of(mi, bsdf)
    if any(isinstance(part, mi.BSDF) and is_textured(mi, part) for part in parts.values()):
        return True
    textures = () if bsdf.class_name() in PERTURBING else parts.values()
    return any(varies(part) for part in textures if isinstance(part, mi.Texture))


def varies(texture: Any) -> bool:
    """Whether a texture may not be the same everywhere."""
    return bool(texture.is_spatially_varying()) or texture.class_name() not in _CONSTANT
