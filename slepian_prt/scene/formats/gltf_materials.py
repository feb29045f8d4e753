"""Materials of glTF files: what they reflect diffusely, and the names of what else they do.

Source: glTF 2.0, sections 3.8 and 3.9; KHR_texture_transform, KHR_materials_pbrSpecularGlossiness, KHR_materials_unlit.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from slepian_prt.errors import UserError
from slepian_prt.scene.formats.gltf_accessors import read_view
from slepian_prt.scene.formats.gltf_file import Document, resolve_uri
from slepian_prt.scene.formats.gltf_json import Entry
from slepian_prt.scene.formats.parts import Material, Texture, Wrap

_WRAPS: dict[int, Wrap] = {10497: "repeat", 33071: "clamp", 33648: "mirror"}

# Extensions with the source of a texture in another format, the readable ones first.
_READABLE = ("EXT_texture_webp", "EXT_texture_avif")
_UNREADABLE = ("KHR_texture_basisu", "MSFT_texture_dds")

# Effects by the extension and the factor in it that switches them on; all factors are 0 by default.
_EFFECTS = {
    ("KHR_materials_transmission", "transmissionFactor"): "transmission",
    ("KHR_materials_diffuse_transmission", "diffuseTransmissionFactor"): "transmission",
    ("KHR_materials_volume", "thicknessFactor"): "transmission",
    ("KHR_materials_clearcoat", "clearcoatFactor"): "clearcoat",
    ("KHR_materials_iridescence", "iridescenceFactor"): "iridescence",
}


@dataclass(frozen=True)
class Mapping:
    """How a texture lies on a surface.

    Attributes
    ----------
    channel : int
        Set of texture coordinates.
    matrix : two rows of three numbers
        What is done to them: ``matrix @ (u, v, 1)``.
    """

    channel: int
    matrix: tuple[tuple[float, float, float], tuple[float, float, float]] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))


@dataclass(frozen=True, eq=False)
class Surface:
    """A material with the mappings of its textures; None where it has no texture."""

    material: Material
    color: Mapping | None = None
    metallic: Mapping | None = None


def read_surface(document: Document, entry: Entry, notes: Counter[str]) -> Surface:
    """A material.

    A material without ``pbrMetallicRoughness`` says nothing of what it reflects; the default of glTF, which is a metal,
    would turn everything black that an exporter merely named.

    Raises
    ------
    UserError
        Malformed.
    """
    name = " ".join(entry.text("name", "").split()) or entry.place
    glossy = entry.extension("KHR_materials_pbrSpecularGlossiness")
    rough = entry.entry("pbrMetallicRoughness")
    metallic = 0.0
    metal: tuple[Texture | None, Mapping | None] = (None, None)
    color: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0)
    paint: tuple[Texture | None, Mapping | None] = (None, None)
    if glossy is not None:
        color = _read_glossy_color(glossy, name, notes)
        paint = _read_texture(document, glossy, "diffuseTexture", notes)
    elif rough is not None:
        color = rough.numbers("baseColorFactor", color)
        paint = _read_texture(document, rough, "baseColorTexture", notes)
        metallic = min(max(rough.number("metallicFactor", 1.0), 0.0), 1.0)
        if metallic > 0.0 and "metallicRoughnessTexture" in rough.values:
            metal = _read_texture(document, rough, "metallicRoughnessTexture", notes)
            # Which parts are metal is not known without it; most of most surfaces are not.
            metallic = metallic if metal[0] else 0.0
    if entry.extension("KHR_materials_unlit") is not None:
        notes[f"material {name!r} is unlit; it is lit as a diffuse one of its colour"] += 1
        metallic, metal = 0.0, (None, None)
    rgb = (color[0], color[1], color[2])
    material = Material(name, rgb, paint[0], metallic, metal[0], tuple(dict.fromkeys(_list_effects(entry))))
    return Surface(material, paint[1], metal[1])


def _read_glossy_color(glossy: Entry, name: str, notes: Counter[str]) -> tuple[float, ...]:
    """The diffuse factor, less what the specular one takes: c = diffuse (1 - max specular).

    Files that leave the specular factor out hardly mean its default, a perfect mirror.
    """
    color = glossy.numbers("diffuseFactor", (1.0, 1.0, 1.0, 1.0))
    if "specularGlossinessTexture" in glossy.values:
        notes[f"the specular texture of material {name!r} is not read: its diffuse colour is taken as it is"] += 1
    elif "specularFactor" in glossy.values:
        specular = max(glossy.numbers("specularFactor", (1.0, 1.0, 1.0)))
        color = tuple(value * (1.0 - min(max(specular, 0.0), 1.0)) for value in color)
    return color


def _list_effects(entry: Entry) -> list[str]:
    """What a material has beside diffuse reflection."""
    effects = []
    mode = entry.text("alphaMode", "OPAQUE")
    if mode not in ("OPAQUE", "MASK", "BLEND"):
        raise entry.fault(f"has an unknown alphaMode ({mode[:16]!r})")
    if mode != "OPAQUE":
        effects.append("transparency")
    if any(entry.numbers("emissiveFactor", (0.0, 0.0, 0.0))):
        effects.append("emitted light")
    if entry.entry("normalTexture") is not None:
        effects.append("normal map")
    for (extension, factor), effect in _EFFECTS.items():
        found = entry.extension(extension)
        if found and found.number(factor, 0.0) > 0.0:
            effects.append(effect)
    sheen = entry.extension("KHR_materials_sheen")
    if sheen and any(sheen.numbers("sheenColorFactor", (0.0, 0.0, 0.0))):
        effects.append("sheen")
    return effects


def _read_texture(
    document: Document, user: Entry, key: str, notes: Counter[str]
) -> tuple[Texture | None, Mapping | None]:
    """A texture and its mapping; no texture if nothing here can read its image."""
    info = user.entry(key)
    if info is None:
        return None, None
    index = info.integer("index")
    if index not in document.textures:
        document.textures[index] = _make_texture(document, document.at("textures", index, info), notes)
    texture = document.textures[index]
    return (None, None) if texture is None else (texture, _read_mapping(info))


def _make_texture(document: Document, entry: Entry, notes: Counter[str]) -> Texture | None:
    wrap = _read_wrap(document, entry)
    image = _find_image(document, entry, notes)
    if image is None:
        return None
    name = " ".join(image.text("name", "").split()) or image.place
    if image.place not in document.images:
        document.images[image.place] = _read_image(document, image, name, notes)
    source = document.images[image.place]
    return None if source is None else Texture(name, source, wrap)


def _read_wrap(document: Document, entry: Entry) -> tuple[Wrap, Wrap]:
    if "sampler" not in entry.values:
        return "repeat", "repeat"
    sampler = document.find("samplers", entry, "sampler")
    modes = [sampler.integer(key, 10497) for key in ("wrapS", "wrapT")]
    for mode in modes:
        if mode not in _WRAPS:
            raise sampler.fault(f"has an unknown wrap mode ({mode})")
    return _WRAPS[modes[0]], _WRAPS[modes[1]]


def _find_image(document: Document, entry: Entry, notes: Counter[str]) -> Entry | None:
    """The image of a texture in a format that can be read; None if there is none."""
    if "source" in entry.values:
        return document.find("images", entry, "source")
    for name in _READABLE:
        extension = entry.extension(name)
        if extension is not None:
            return document.find("images", extension, "source")
    formats = [name for name in _UNREADABLE if entry.extension(name) is not None]
    reason = f" ({formats[0]})" if formats else ""
    notes[f"{entry.place} left out: its image is in no format that can be read{reason}"] += 1
    return None


def _read_image(document: Document, image: Entry, name: str, notes: Counter[str]) -> bytes | Path | None:
    """An encoded image, or the file that it is in; None if it is elsewhere or in a format of graphics cards."""
    source: bytes | Path
    if "uri" in image.values:
        uri = image.text("uri")
        try:
            source = resolve_uri(image, uri)
        except UserError:
            notes[f"image {name!r} left out: it is at an address that is not fetched, or its data are broken"] += 1
            return None
    else:
        source = read_view(document, image.integer("bufferView"), image).tobytes()
    packed = source[:7] == b"\xabKTX 20" if isinstance(source, bytes) else source.suffix.lower() == ".ktx2"
    if packed:
        notes[f"image {name!r} left out: it is in the KTX2 format (KHR_texture_basisu), which is not read"] += 1
        return None
    return source


def _read_mapping(info: Entry) -> Mapping:
    """Translation after rotation after scale of KHR_texture_transform.

    Rotated counter-clockwise as one sees it, which is the other way where v runs down. The listing in the extension's
    text says otherwise (github.com/KhronosGroup/glTF/issues/1563); its examples and all viewers agree with this.
    """
    channel = info.integer("texCoord", 0)
    transform = info.extension("KHR_texture_transform")
    if transform is None:
        return Mapping(channel)
    channel = transform.integer("texCoord", channel)
    angle = transform.number("rotation", 0.0)
    cos, sin = math.cos(angle), math.sin(angle)
    x, y = transform.numbers("scale", (1.0, 1.0))
    u, v = transform.numbers("offset", (0.0, 0.0))
    return Mapping(channel, ((cos * x, sin * y, u), (-sin * x, cos * y, v)))
