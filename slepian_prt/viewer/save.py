"""Pages of transfer from Python, in one step."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.errors import UserError
from slepian_prt.examples import example
from slepian_prt.files import check_writable
from slepian_prt.lighting.environment import Environment
from slepian_prt.relighting.drawing.camera import relit_view
from slepian_prt.relighting.drawing.film_pictures import check_taking
from slepian_prt.relighting.drawing.pictures import MAP, TRANSPARENT, Finish
from slepian_prt.relighting.drawing.taking import Taking
from slepian_prt.relighting.files.bitmap_detail import bitmap_detail
from slepian_prt.relighting.files.surfaces import split_surfaces
from slepian_prt.relighting.source import locate_source
from slepian_prt.renderer.variants import mitsuba
from slepian_prt.runtime.gpu_transfer import gpu_transfer
from slepian_prt.scene.view import Aim
from slepian_prt.viewer.cameras import antialiasing, camera_entry
from slepian_prt.viewer.drawn_mesh import DrawnMesh, draw_mesh
from slepian_prt.viewer.light_maps import PageLight, map_lights, own_light
from slepian_prt.viewer.models import Model, lamp_radiance
from slepian_prt.viewer.page_file import write_page
from slepian_prt.viewer.payload import Content, Display, make_payload

if TYPE_CHECKING:
    from slepian_prt.transport.transfer import Transfer

log = logging.getLogger(__name__)

FUNCTIONS = (8, 16, 24, 32)
_FUNCTIONS_OF_VECTORS = 64


@dataclass(frozen=True)
class PageWish:
    """How a page is wanted.

    Attributes
    ----------
    functions : one of `FUNCTIONS`
    aim : Aim
    background : str or None
        As of `Finish`; None for the map behind the model where there is one.
    exposure : float
    rotate : float
    clamp_negative : bool
    fixed_lights : number, or mapping of names to numbers
    scene : path or None
    """

    functions: int = 16
    aim: Aim = field(default_factory=Aim)
    background: str | None = None
    exposure: float = 0.0
    rotate: float = 0.0
    clamp_negative: bool = False
    fixed_lights: float | Mapping[str, float] = 1.0
    scene: str | Path | None = None


def page_payload(
    packed: CompressedTransfer,
    maps: Sequence[str | Path | Environment] = (),
    wish: PageWish | None = None,
    file: str | Path | None = None,
    report: Callable[[str], None] = lambda _: None,
) -> bytes:
    """The payload of a page about one file."""
    wish = wish or PageWish()
    lights = _lights(packed, maps, wish, report)
    model = Model(packed.name, packed, gpu_transfer(packed, wish.functions), lamp_radiance(packed, wish.fixed_lights))
    view = relit_view(packed, wish.aim) if packed.film is None else None
    with mitsuba() as mi:
        drawn = [] if packed.film is not None else [_drawn(mi, packed, wish, file, report)]
        places = antialiasing(mi, view) if view is not None else [[0.0, 0.0, 1.0]]
    finish = Finish(wish.background or (MAP if any(light.map for light in lights) else TRANSPARENT), wish.exposure)
    shown = finish.background
    if finish.colour is not None:
        from PIL import ImageColor

        shown = "#{:02x}{:02x}{:02x}".format(*ImageColor.getrgb(finish.background))
    content = Content(
        title=packed.name,
        models=[model],
        drawn=drawn,
        lights=lights,
        camera=None if view is None else camera_entry(packed, view),
        antialias=places,
        display=Display(shown, finish.exposure, None),
        up=wish.aim.axis,
    )
    return make_payload(content)


def _lights(packed: CompressedTransfer, maps: Any, wish: PageWish, report: Callable[[str], None]) -> Sequence[PageLight]:
    if maps:
        return map_lights(maps, packed.bandlimit, wish.aim.axis, wish.rotate, clamp_negative=wish.clamp_negative)
    if packed.lighting is None and packed.fixed is None:
        report("the scene has no light of its own; the page has the sky that is shipped")
        return map_lights([example("sky")], packed.bandlimit, wish.aim.axis, wish.rotate, clamp_negative=False)
    return (own_light(packed, wish.aim.axis, wish.rotate),)


def _drawn(mi: Any, packed: CompressedTransfer, wish: PageWish, file: Any, report: Callable[[str], None]) -> DrawnMesh:
    source = locate_source(mi, packed, wish.scene, file, report)
    detail = source.detail
    if source.scene is not None and source.origin is not None:
        detail = bitmap_detail(mi, source.scene, source.origin, packed.mesh, packed.parts, report)
    return draw_mesh(packed.mesh, packed.parts, split_surfaces(packed.mesh, packed.parts, detail))
