"""What a page holds beside its program: geometry, transfer, lights and text, as JSON with buffers.

    uint32 length of the JSON | JSON in UTF-8 | zeros to a multiple of 8 bytes | buffers

`buffers` says how arrays are coded. ``page/payload.js`` reads it.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.viewer.buffers import Buffers
from slepian_prt.viewer.drawn_mesh import DrawnMesh
from slepian_prt.viewer.light_maps import PageLight
from slepian_prt.viewer.models import Model, film_entry
from slepian_prt.viewer.page_textures import texture_entry
from slepian_prt.viewer.statistics import remarks, statistics

VERSION = 1

# The window that a page offers against ringing.
WINDOW = "hann"

_ALIGNMENT = 8


@dataclass(frozen=True)
class Display:
    """How a page shows the model at first.

    Attributes
    ----------
    background : str
        ``map``, ``transparent`` or #rrggbb.
    exposure : float
        In stops.
    scale : float or None
        What Python's picture multiplies radiance by, under the first light.
    turn : float
        Of lights, in degrees about the axis that is up, in [-180, 180].
    """

    background: str
    exposure: float
    scale: float | None
    turn: float = 0.0

    def entry(self) -> dict[str, Any]:
        """What the payload says of it."""
        return {"background": self.background, "exposure": self.exposure, "scale": self.scale, "turn": self.turn}


@dataclass(frozen=True, eq=False)
class Content:
    """All that a page shows.

    Attributes
    ----------
    title : str
    models : sequence of Model
        The first is the file, a second what it is compared with.
    drawn : sequence of DrawnMesh
        One for each model, whose receivers they name; those of one mesh share all but `receivers`. None of films.
    lights : sequence of PageLight
    camera : dict or None
        As of `cameras.camera_entry`; None of films.
    antialias : list
        As of `cameras.antialiasing`.
    display : Display
    up : "y" or "z"
    notes : sequence of str
        Beside those that `remarks` makes.
    words : callable
        What sentences of the library, which name parameters, are for the reader of the page.
    """

    title: str
    models: Sequence[Model]
    drawn: Sequence[DrawnMesh]
    lights: Sequence[PageLight]
    camera: dict[str, Any] | None
    antialias: list[list[float]]
    display: Display
    up: str
    notes: Sequence[str] = ()
    words: Callable[[str], str] = str

    @property
    def bandlimit(self) -> int:
        """Of the lights: the highest of the models."""
        return max(model.packed.bandlimit for model in self.models)


def make_payload(content: Content) -> bytes:
    """The payload of a page."""
    buffers, first = Buffers(), content.models[0].packed
    geometries, textures, models = _geometry(buffers, content)
    entry = {
        "version": VERSION,
        "title": content.title,
        "generator": f"slepian_prt {version('slepian_prt')}",
        "bandlimit": content.bandlimit,
        "statistics": statistics(content.models, content.words),
        "notes": [content.words(note) for note in (*remarks(first, textured=bool(textures)), *content.notes)],
        "camera": content.camera,
        "up": content.up,
        "antialias": content.antialias,
        "display": content.display.entry(),
        "lights": [light.entry(buffers) for light in content.lights],
        "geometries": geometries,
        "textures": textures,
        "models": models,
        "film": _film(buffers, first),
        "window": {"name": WINDOW},
    }
    text = json.dumps(entry, ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode()
    head = struct.pack("<I", len(text)) + text
    return head + bytes(-len(head) % _ALIGNMENT) + buffers.content()


def _geometry(buffers: Buffers, content: Content) -> tuple[list[Any], list[Any], list[Any]]:
    """Entries of geometries, textures and models; a mesh that several models are drawn on is there once."""
    meshes: list[DrawnMesh] = []
    models = []
    for number, model in enumerate(content.models):
        if not content.drawn:
            models.append(model.entry(buffers, content.bandlimit, None, None))
            continue
        drawn = content.drawn[number]
        known = [mesh.faces is drawn.faces for mesh in meshes]
        if not any(known):
            meshes.append(drawn)
            known.append(True)
        models.append(model.entry(buffers, content.bandlimit, known.index(True), drawn.receivers))
    geometries: list[Any] = []
    textures: list[Any] = []
    for drawn in meshes:
        geometries.append(drawn.entry(buffers, len(textures)))
        textures += [texture_entry(buffers, texture) for texture in drawn.textures]
    return geometries, textures, models


def _film(buffers: Buffers, packed: CompressedTransfer) -> dict[str, Any] | None:
    return None if packed.film is None else film_entry(buffers, packed.film)
