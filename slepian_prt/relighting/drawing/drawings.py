"""How pictures of a transfer file are drawn: with its scene or textures where they can be found, else from it alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.errors import UserError
from slepian_prt.relighting.drawing.camera import relit_camera
from slepian_prt.relighting.drawing.film_pictures import FilmDrawing, check_taking
from slepian_prt.relighting.drawing.shots import Drawing, SceneDrawing, VertexDrawing
from slepian_prt.relighting.drawing.taking import Lit, Taking
from slepian_prt.relighting.relight import white_radiance
from slepian_prt.relighting.source import Source, locate_source

if TYPE_CHECKING:
    from slepian_prt.lighting.environment import Environment
    from slepian_prt.transport.transfer import Transfer


def open_drawing(
    mi: Any,
    packed: Transfer | CompressedTransfer,
    lit: Lit,
    taking: Taking,
    file: str | Path | None = None,
    report: Callable[[str], None] = lambda _: None,
) -> Drawing:
    """Pictures of a model, usable as long as Mitsuba keeps its variant.

    Parameters
    ----------
    mi : Mitsuba
    packed : Transfer or CompressedTransfer
    lit : Lit
    taking : Taking
    file : path, optional
        Of the transfer, beside which its scene is looked for.
    report : callable
        Given a line about what the pictures lack.

    Raises
    ------
    UserError
        A scene that is named and cannot be used, or a view that cannot be taken.
    """
    if packed.film is not None:
        check_taking(packed.film, taking)
        return FilmDrawing(packed.film, lit.radiance)
    source = locate_source(mi, packed, taking.scene, file, report)
    if source.scene is not None:
        drawing = _scene_drawing(mi, packed, lit, taking, source, report)
        try:
            drawing.picture(0)
            return drawing
        except UserError as error:  # the scene is another one now
            if taking.scene is not None:
                raise
            report(f"{error}; until then pictures are drawn from the file alone")
    camera = relit_camera(packed, taking.width, taking.aim, source.detail)
    return VertexDrawing(
        camera, white_radiance(packed, lit.lighting, lit.fixed_lights) if camera.is_textured else lit.radiance
    )


def _scene_drawing(
    mi: Any,
    packed: Transfer | CompressedTransfer,
    lit: Lit,
    taking: Taking,
    source: Source,
    report: Callable[[str], None],
) -> SceneDrawing:
    # What gathers in scenes takes as long to import as to draw a mesh by itself.
    from slepian_prt.compression.stream import compress
    from slepian_prt.lighting.lamps import scale_lamps
    from slepian_prt.relighting.drawing.scene_pictures import Light, own_environment, scene_camera

    assert source.origin is not None
    if not isinstance(packed, CompressedTransfer):  # the integrator draws what files hold; float32 loses nothing of it
        packed = compress(packed, "none", clusters=1, coding="float32")
    scale_lamps(mi, source.scene, lit.fixed_lights)
    camera = scene_camera(mi, packed, source.scene, source.origin, taking.width, taking.aim)
    camera = replace(camera, samples=taking.spp)
    environments: list[Environment | None] = list(lit.environments()) or [None] * len(lit.lighting)
    if lit.own_turns is not None:
        own = own_environment(mi, source.scene, str(source.path))
        if own is not None:
            environments = [own.turned(turn) for turn in lit.own_turns]
    lights = tuple(Light(one, shown) for one, shown in zip(lit.lighting, environments, strict=True))
    return SceneDrawing(camera, lights, report)
