"""Which light of a scene a file does not know: that of effects which it was computed without."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import PurePath
from typing import Any

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.scene.mesh_files import MESH_SUFFIXES
from slepian_prt.scene.reflectance.materials import lets_all_light_through
from slepian_prt.scene.reflectance.path_effects import PATH_EFFECTS, path_effect
from slepian_prt.transport.effects import NOT_SIMULATED, OMITTED

_WORDS = {
    "media": "fog, smoke and the like",
    "opacity": "partly transparent surfaces",
    "glass": "glass",
    "transmission": "leaves",
    "mirrors": "mirrors",
    "gloss": "glossy surfaces",
}

# How rows begin that said of all of them that they are not simulated, in files of before.
_BEFORE = ("participating media", "light onto other surfaces")


def scene_effects(mi: Any, materials: Iterable[Any], *, media: bool) -> tuple[str, ...]:
    """Those of `PATH_EFFECTS` that there are in a scene.

    Parameters
    ----------
    mi : Mitsuba
    materials : iterable of Mitsuba BSDFs
    media : bool
        Whether there are participating media.
    """
    found = {path_effect(mi, one) for one in materials if not lets_all_light_through(mi, one)}
    if media:
        found.add("media")
    return tuple(effect for effect in PATH_EFFECTS if effect in found)


def unknown_effects(packed: CompressedTransfer, effects: Iterable[str]) -> tuple[str, ...]:
    """Words for those effects whose light on its shapes a file does not hold.

    The plan of a scene decides about all that is there. Files of meshes know of nothing around them.
    """
    verdicts = {row.name: row.verdict for row in packed.effects}
    of_mesh = PurePath(packed.source or "").suffix.lower() in MESH_SUFFIXES
    of_before = any(row.verdict == NOT_SIMULATED and row.name.startswith(_BEFORE) for row in packed.effects)
    otherwise = NOT_SIMULATED if of_mesh or of_before else OMITTED
    return tuple(_WORDS[effect] for effect in effects if verdicts.get(effect, otherwise) == NOT_SIMULATED)
