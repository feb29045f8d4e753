"""Pages of transfer from Python, in one step."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.errors import UserError, check_transfer
from slepian_prt.examples import example
from slepian_prt.lighting.environment import Environment
from slepian_prt.relighting.drawing.camera import relit_camera, relit_view
from slepian_prt.relighting.drawing.film_pictures import FilmDrawing, check_taking
from slepian_prt.relighting.drawing.pictures import MAP, TRANSPARENT, Finish, exposure
from slepian_prt.relighting.drawing.taking import Taking
from slepian_prt.relighting.files.bitmap_detail import bitmap_detail
from slepian_prt.relighting.files.surfaces import split_surfaces
from slepian_prt.relighting.series import about_axis
from slepian_prt.relighting.source import find_source, locate_source
from slepian_prt.renderer.variants import mitsuba
from slepian_prt.runtime.gpu_transfer import as_compressed, gpu_transfer
from slepian_prt.scene.mesh import check_float32
from slepian_prt.scene.named_files import check_output_file
from slepian_prt.scene.reflectance.surface_detail import SurfaceDetail
from slepian_prt.scene.view import Aim
from slepian_prt.sphere.rotation import rotate_sh
from slepian_prt.transport.transfer import Transfer
from slepian_prt.viewer.cameras import antialiasing, camera_entry
from slepian_prt.viewer.comparison import check_pair, label_pair, matching_receivers
from slepian_prt.viewer.drawn_mesh import DrawnMesh, draw_mesh
from slepian_prt.viewer.light_maps import PageLight, map_lights, own_light
from slepian_prt.viewer.models import Model, lamp_radiance
from slepian_prt.viewer.page_file import check_page_name, write_page
from slepian_prt.viewer.payload import Content, Display, make_payload
from slepian_prt.viewer.statistics import lacks_textures

log = logging.getLogger(__name__)

# Bytes of a vertex that graphics hardware likes; full SH, to compare with, gets as many as make it exact to the eye.
FUNCTIONS = (8, 16, 24, 32)
_FUNCTIONS_OF_VECTORS = 64

Light = str | Path | Environment
Report = Callable[[str], None]


@dataclass(frozen=True)
class PageWish:
    """How a page is wanted.

    Attributes
    ----------
    maps : paths of maps or Environments
        None for the scene's own light, or the sky that is shipped where it has none.
    functions : one of `FUNCTIONS`
        Bytes of a vertex.
    aim : Aim
        Of the camera that the page opens at.
    background : str or None
        As of `Finish`; None for the map where there is one.
    exposure : float
        In stops.
    rotate : float
        Degrees that lights are turned by at first, about the axis that is up.
    clamp_negative : bool
        Whether negative texels that matter are set to zero.
    fixed_lights : number, or mapping of names to numbers
        What the light of the scene's lamps is multiplied by.
    scene : path or None
        What the transfer was made from, where it is not where it was.

    Raises
    ------
    UserError
        A number of functions, or a background, that there is not.
    """

    maps: tuple[Light, ...] = ()
    functions: int = 16
    aim: Aim = field(default_factory=Aim)
    background: str | None = None
    exposure: float = 0.0
    rotate: float = 0.0
    clamp_negative: bool = False
    fixed_lights: float | Mapping[str, float] = 1.0
    scene: str | Path | None = None

    def __post_init__(self) -> None:
        if self.functions not in FUNCTIONS:
            known = ", ".join(map(str, FUNCTIONS))
            raise UserError(f"functions must be one of {known}, not {self.functions!r}")
        self.finish(with_map=True)
        if self.background == MAP and not self.maps:
            raise UserError(
                "the light of the scene is kept as spherical harmonics, which are no background; name its map with "
                "`environment`"
            )

    def finish(self, *, with_map: bool) -> Finish:
        """Background and exposure, where there is a map or is none."""
        return Finish(self.background or (MAP if with_map else TRANSPARENT), self.exposure)


def save_page(
    path: str | Path,
    transfer: Transfer | CompressedTransfer,
    lighting: Light | Sequence[Light] | None = None,
    *,
    compare_with: Transfer | CompressedTransfer | None = None,
    functions: int = 16,
    look_at: tuple[ArrayLike, ArrayLike] | None = None,
    fov: float | None = None,
    up: str | None = None,
    background: str | None = None,
    exposure: float = 0.0,
    rotate: float = 0.0,
    clamp_negative: bool = False,
    fixed_lights: float | Mapping[str, float] = 1.0,
    scene: str | Path | None = None,
) -> None:
    """Write a page that any browser opens from a disk, and whose user turns the model and the light.

    Parameters
    ----------
    path : path
        Of an ``.html`` file.
    transfer : Transfer or CompressedTransfer
    lighting : path of a map or Environment, or a sequence of them, optional
        By default the scene's own light, or the sky that is shipped where it has none.
    compare_with : Transfer or CompressedTransfer, optional
        Shown beside it, behind a slider, such as full SH or another basis.
    functions : 8, 16, 24 or 32
        Bytes of a vertex, as of `gpu_transfer`.
    look_at, fov, up, exposure, fixed_lights, scene
        As of `render_picture`.
    background : str, optional
        As of `render_picture`; by default the map where there is one.
    rotate : float
        Degrees that lights are turned by at first, about the axis that is up.
    clamp_negative : bool
        Whether negative texels of maps are set to zero where they matter; such maps are refused otherwise.

    Raises
    ------
    UserError
        As `render_picture`; a name that is not that of a page; a page that would be too large.
    """
    check_transfer(transfer)
    given = [lighting] if isinstance(lighting, str | Path | Environment) else list(lighting or ())
    check_page_name(path)
    check_output_file(path, *(one for one in (*given, scene) if isinstance(one, str | Path)))
    wish = PageWish(
        tuple(given),
        functions,
        Aim(look_at, fov, up),
        background,
        exposure,
        rotate,
        clamp_negative,
        fixed_lights,
        scene,
    )
    content = page_content(transfer, wish, compare_with, report=log.info)
    write_page(path, content.title, make_payload(content))


def page_content(
    transfer: Transfer | CompressedTransfer,
    wish: PageWish,
    other: Transfer | CompressedTransfer | None = None,
    file: str | Path | None = None,
    report: Report = lambda _: None,
) -> Content:
    """What a page shows.

    Parameters
    ----------
    transfer : Transfer or CompressedTransfer
    wish : PageWish
    other : Transfer or CompressedTransfer, optional
        What it is compared with.
    file : path, optional
        Of the transfer, beside which its scene is looked for.
    report : callable
        Given a line about each thing worth knowing.

    Raises
    ------
    UserError
        See `save_page`.
    """
    packed = as_compressed(transfer)
    if packed.film is not None:
        check_taking(packed.film, Taking(None, wish.aim, wish.scene, None))
    models = [_model(transfer, packed, wish.functions, wish)]
    if other is not None:
        second = as_compressed(other)
        check_pair(packed, second)
        count = _FUNCTIONS_OF_VECTORS if isinstance(other, Transfer) else wish.functions
        models.append(_model(other, second, count, wish))
        labels = label_pair(packed, second, (models[0].label, models[1].label))
        models = [replace(model, label=label) for model, label in zip(models, labels, strict=True)]
    elif packed.fixed is None and wish.fixed_lights != 1.0:
        report("the file holds the light of no lamps; `fixed_lights` changes nothing")
    for model in models:
        if model.packed.film is None:
            check_float32(model.packed.mesh)
    lights = _lights([model.packed for model in models], wish, report)
    finish = wish.finish(with_map=any(light.map for light in lights))
    with mitsuba() as mi:
        drawn, detail = _drawn(mi, models, wish, file, report)
        view = None if packed.film is not None else relit_view(packed, wish.aim)
        places = [[0.0, 0.0, 1.0]] if view is None else antialiasing(mi, view)
        turned = rotate_sh(lights[0].coefficients, about_axis(wish.aim.axis, wish.rotate))
        scale = _scale(models[0], turned, wish.aim, detail)
    return Content(
        title=packed.name,
        models=models,
        drawn=drawn,
        lights=lights,
        camera=None if view is None else camera_entry([model.packed for model in models], view),
        antialias=places,
        display=Display(finish.shown, finish.exposure, scale, math.remainder(wish.rotate, 360.0)),
        up=wish.aim.axis,
        notes=_notes(packed),
    )


def _model(
    transfer: Transfer | CompressedTransfer, packed: CompressedTransfer, functions: int, wish: PageWish
) -> Model:
    basis = "full SH" if isinstance(transfer, Transfer) or packed.basis == "none" else packed.basis
    lamps = lamp_radiance(packed, wish.fixed_lights)
    return Model(basis, packed, gpu_transfer(packed, functions), lamps)


def _lights(packed: Sequence[CompressedTransfer], wish: PageWish, report: Report) -> tuple[PageLight, ...]:
    up, bandlimit = wish.aim.axis, max(one.bandlimit for one in packed)
    maps: tuple[Light, ...] = wish.maps
    if not maps and packed[0].lighting is None and packed[0].fixed is None:
        report("the scene has no light of its own; the page has the sky that is shipped, `environment` names others")
        maps = (example("sky"),)
    if not maps:
        return (own_light(packed),)
    lights = map_lights(maps, bandlimit, up, clamp_negative=wish.clamp_negative)
    for light in lights:
        if light.clamped:
            report(f"{light.name}: {light.clamped} negative texels set to zero")
    return lights


def _drawn(
    mi: Any, models: Sequence[Model], wish: PageWish, file: str | Path | None, report: Report
) -> tuple[list[DrawnMesh], SurfaceDetail | None]:
    """The mesh that each model is drawn on, and the textures of the first; a second on the same if it is the same."""
    packed = models[0].packed
    if packed.film is not None:
        return [], None
    detail = _textures(mi, packed, wish, file, report)
    drawn = [draw_mesh(packed.mesh, packed.parts, split_surfaces(packed.mesh, packed.parts, detail))]
    for model in models[1:]:
        other = model.packed
        same = matching_receivers(packed.mesh, other.mesh)
        if same is not None:
            drawn.append(drawn[0].of_receivers(same[drawn[0].receivers]))
        else:
            drawn.append(draw_mesh(other.mesh, other.parts, split_surfaces(other.mesh, other.parts, None)))
    return drawn, detail


def _textures(
    mi: Any, packed: CompressedTransfer, wish: PageWish, file: str | Path | None, report: Report
) -> SurfaceDetail | None:
    """Those of what the transfer was made from, which has no other use here."""
    if find_source(packed, file, wish.scene) is None:
        if lacks_textures(packed) and not packed.toward_view:
            report(f"{packed.source} is not found, so its textures are drawn as vertices have them; name its `scene`")
        return None
    source = locate_source(mi, packed, wish.scene, file, report)
    if source.scene is None or source.origin is None:
        return source.detail
    detail = bitmap_detail(mi, source.scene, source.origin, packed.mesh, packed.parts, report)
    if detail is None:
        return None
    albedo = packed.mesh.albedo[packed.mesh.faces]  # of the faces that have no texture there
    return replace(detail, colors=np.where((detail.choice >= 0)[:, None, None], detail.colors, albedo))


def _scale(model: Model, coefficients: NDArray, aim: Aim, detail: SurfaceDetail | None) -> float:
    """What exposes Python's picture from the camera that the page opens at."""
    packed, size = model.packed, (model.packed.bandlimit + 1) ** 2
    radiance = model.transfer.relight(coefficients[:, :size])
    if model.lamps is not None:
        radiance += model.lamps
    if packed.film is not None:
        return exposure(FilmDrawing(packed.film, radiance[None]).picture(0))
    camera = relit_camera(packed, None, aim, detail)
    return exposure(camera.picture(radiance if camera.is_textured else _coloured(packed, radiance)))


def _coloured(packed: CompressedTransfer, radiance: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.asarray(radiance * packed.mesh.receivers.albedo, dtype=np.float32)


def _notes(packed: CompressedTransfer) -> list[str]:
    return ["The lamps of the scene stand still while distant light turns."] if packed.fixed is not None else []
