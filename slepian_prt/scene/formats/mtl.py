"""MTL files: the materials of OBJ files."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

from slepian_prt.machine.file_content import read_content
from slepian_prt.scene.formats.files import decode, find_beside, to_utf8
from slepian_prt.scene.formats.parts import Material, Texture, Wrap

# Options of textures, and the numbers of their values; those of -o, -s and -t are one to three.
_OPTIONS = {
    "-blendu": 1, "-blendv": 1, "-boost": 1, "-bm": 1, "-cc": 1, "-clamp": 1, "-colorspace": 1, "-imfchan": 1,
    "-mm": 2, "-texres": 1, "-type": 1, "-o": 3, "-s": 3, "-t": 3,
}  # fmt: skip

# Blender gives every plastic Ks 0.5; only what is above is a highlight that one would miss.
_GLOSSY = 0.5


@dataclass(frozen=True)
class Mapped:
    """A material, and where its texture lies: at ``scale`` (u, v) + ``offset``."""

    material: Material
    scale: tuple[float, float] = (1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)


@dataclass
class _Statements:
    """What one material says: the words after each keyword, which is in small letters."""

    name: str
    words: dict[str, str] = field(default_factory=dict)

    def numbers(self, keyword: str) -> list[float]:
        return _leading_numbers(self.words.get(keyword, "").split())

    def number(self, keyword: str, otherwise: float) -> float:
        return next(iter(self.numbers(keyword)), otherwise)

    def has(self, *keywords: str) -> bool:
        return any(self.words.get(keyword) for keyword in keywords)


def read_mtl(path: Path, notes: list[str]) -> dict[str, Mapped]:
    """Read the materials of a file.

    Kd is linear, as in Blender and Mitsuba. A texture (map_Kd) is multiplied by it, but by 1 where Kd is missing or
    black: many writers write ``Kd 0 0 0`` next to a texture. Without either the colour is 1. ``d``, or 1 - Tr where it
    is missing, is the opacity; ``Tr 1`` alone is that of writers for which 1 is opaque.

    Parameters
    ----------
    path : Path
        Which exists.
    notes : list of str
        To which those on statements that are not understood are added.

    References
    ----------
    Wavefront, MTL material format, 1995; for Pm, map_Pm, Ke and norm: Exocortex, Extending the Wavefront MTL format
    for physically based rendering.
    """
    found: dict[str, _Statements] = {}
    current: _Statements | None = None
    for line in decode(to_utf8(read_content(path))).splitlines():
        keyword, _, rest = line.strip().lstrip("\ufeff").replace("\t", " ").partition(" ")
        keyword, rest = keyword.lower(), rest.strip()
        if keyword == "newmtl":
            current = found.setdefault(rest, _Statements(rest))
        elif current is not None and keyword and not keyword.startswith("#"):
            current.words[keyword] = rest
    return {name: _read_material(path, statements, notes) for name, statements in found.items()}


def _read_material(path: Path, said: _Statements, notes: list[str]) -> Mapped:
    texture, scale, offset = _read_texture(path, said, "map_kd", notes)
    metallic_texture = _read_texture(path, said, "map_pm", notes)[0]
    diffuse = said.numbers("kd")[:3]
    if said.words.get("kd", "").startswith(("spectral", "xyz")):
        notes.append(f"Kd of material {said.name} left out, as it is no RGB")
    if len(diffuse) in (1, 2):  # g and b are as r where they are missing
        diffuse = [diffuse[0]] * 3
    if not diffuse or (texture is not None and not any(diffuse)):
        diffuse = [1.0, 1.0, 1.0]
    material = Material(
        name=said.name,
        color=(diffuse[0], diffuse[1], diffuse[2]),
        texture=texture,
        metallic=min(max(said.number("pm", 1.0 if metallic_texture else 0.0), 0.0), 1.0),
        metallic_texture=metallic_texture,
        not_simulated=_effects(said),
    )
    return Mapped(material, scale, offset)


def _effects(said: _Statements) -> tuple[str, ...]:
    """What is not diffuse reflection."""
    illumination = said.number("illum", 2)
    transparency = said.number("tr", 0.0)
    opacity = said.number("d", 1.0 if transparency >= 1 else 1.0 - transparency)
    if "halo" in said.words.get("d", ""):
        opacity = 0.0
    highlight = max(said.numbers("ks")[:3], default=0.0)
    glossy = (illumination >= 2 and highlight > _GLOSSY) or (illumination in (3, 5, 8) and highlight > 0)
    effects = {
        "transparency": opacity < 1 or said.has("map_d", "map_tr"),
        "transmission": illumination in (4, 6, 7, 9),
        "emitted light": any(said.numbers("ke")[:3]) or said.has("map_ke"),
        "normal map": said.has("norm", "map_norm", "map_kn", "bump", "map_bump"),
        "displacement": said.has("disp", "map_disp"),
        "glossy reflection": glossy or said.has("refl", "map_refl"),
        "clearcoat": said.number("pc", 0.0) > 0,
        "sheen": any(said.numbers("ps")[:3]),
    }
    return tuple(name for name, there in effects.items() if there)


def _read_texture(
    path: Path, said: _Statements, keyword: str, notes: list[str]
) -> tuple[Texture | None, tuple[float, float], tuple[float, float]]:
    """A texture with its scale and offset, from options followed by a file name that may hold spaces."""
    scale, offset = (1.0, 1.0), (0.0, 0.0)
    rest = said.words.get(keyword, "")
    clamped = False
    while rest.startswith("-"):
        option, _, after = rest.partition(" ")
        count = _OPTIONS.get(option.lower())
        if count is None:
            break
        words = after.split(maxsplit=count)
        values = _leading_numbers(words[:count])
        taken = max(len(values), 1) if count == 3 else count
        if option in ("-s", "-o") and values:
            pair = (values[0], values[1] if len(values) > 1 else scale[1] if option == "-s" else offset[1])
            scale, offset = (pair, offset) if option == "-s" else (scale, pair)
        elif option == "-clamp":
            clamped = words[:1] == ["on"]
        elif option in ("-mm", "-t", "-cc", "-imfchan", "-boost"):
            notes.append(f"option {option} of the texture of material {said.name} left out")
        rest = after.split(maxsplit=taken)[taken] if len(after.split(maxsplit=taken)) > taken else ""
    name = rest.strip().strip('"')
    if not name:
        return None, scale, offset
    wrap: Wrap = "clamp" if clamped else "repeat"
    return Texture(name, find_beside(path, name), (wrap, wrap)), scale, offset


def _leading_numbers(words: list[str]) -> list[float]:
    numbers = []
    for word in words:
        try:
            number = float(word)
        except ValueError:
            break
        if not math.isfinite(number):
            break
        numbers.append(number)
    return numbers
