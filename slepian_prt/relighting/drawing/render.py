"""Pictures of relit transfer from Python, in one step."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.errors import UserError, check_integer, check_transfer
from slepian_prt.lighting.environment import Environment, read_environment
from slepian_prt.lighting.light_text import is_light_text
from slepian_prt.relighting.drawing.drawings import open_drawing
from slepian_prt.relighting.drawing.pictures import MAP, Finish, Picture, display, linear, write_picture
from slepian_prt.relighting.drawing.shots import Shots
from slepian_prt.relighting.drawing.taking import Lit, Taking
from slepian_prt.relighting.relight import relight, stand_lighting
from slepian_prt.renderer.variants import mitsuba
from slepian_prt.scene.named_files import check_output_file
from slepian_prt.scene.view import Aim, up_rotation
from slepian_prt.sphere.harmonics import num_coefficients
from slepian_prt.transport.transfer import Transfer

log = logging.getLogger(__name__)

SMALLEST_WIDTH, LARGEST_WIDTH = 16, 8192


def render_picture(
    transfer: Transfer | CompressedTransfer,
    lighting: str | Path | Environment | ArrayLike | None = None,
    *,
    width: int | None = None,
    look_at: tuple[ArrayLike, ArrayLike] | None = None,
    fov: float | None = None,
    up: str | None = None,
    background: str = "transparent",
    exposure: float = 0.0,
    fixed_lights: float | Mapping[str, float] = 1.0,
    scene: str | Path | None = None,
    spp: int | None = None,
    scene_linear: bool = False,
) -> NDArray[np.float32]:
    """Draw a model under a light; ``plt.imshow`` shows the result as it is.

    The camera is the one that is asked for, else that of the scene, else one that sees the whole model from the front.

    Parameters
    ----------
    transfer : Transfer or CompressedTransfer
    lighting : path of a map, Environment, or (3, (L+1)²) coefficients
        By default the scene's own light.
    width : int, optional
        In pixels, by default that of the scene's camera, or 800.
    look_at : (origin, target), optional
        Two points in the space of the model.
    fov : float, optional
        Across the width, in degrees.
    up : "y" or "z", optional
        The axis that points up in the picture, and that what is above in ``lighting`` shines from; only a scene's own
        light stays as it is. By default y, or as in the scene's camera.
    background : str
        ``transparent``, ``map`` (the environment behind the model), a name of a colour, or #rrggbb.
    exposure : float
        Stops brighter (or, below zero, darker) than an exposure that suits the model.
    fixed_lights : number, or mapping of names to numbers
        What the light of the scene's lamps is multiplied by, as of `relight`.
    scene : path, optional
        The scene or mesh file that the transfer was made from, where it is not where it was. Textures, mirrors, glass
        and whatever else the transfer does not hold are drawn from it.
    spp : int, optional
        Samples of each pixel, where a scene calls for gathering; by default as many as leave noise of 2 %, 128 at most.
    scene_linear : bool
        Linear radiance times 2^exposure, multiplied by the opacity, as ``.exr`` files hold it, instead of what a
        screen shows.

    Returns
    -------
    (H, W, 4) float32
        Red, green and blue, tone-mapped and sRGB-encoded in [0, 1], and opacity.

    Raises
    ------
    UserError
        A view, background or light that makes no sense; ``map`` without a map.
    """
    finish = Finish(background, exposure)
    picture, scale = _draw(transfer, lighting, Taking(width, Aim(look_at, fov, up), scene, spp), finish, fixed_lights)
    if scene_linear:
        return linear(picture, finish.factor, finish.colour)
    return display(picture, scale * finish.factor, finish.colour).astype(np.float32)


def save_picture(
    path: str | Path,
    transfer: Transfer | CompressedTransfer,
    lighting: str | Path | Environment | ArrayLike | None = None,
    *,
    width: int | None = None,
    look_at: tuple[ArrayLike, ArrayLike] | None = None,
    fov: float | None = None,
    up: str | None = None,
    background: str = "transparent",
    exposure: float = 0.0,
    fixed_lights: float | Mapping[str, float] = 1.0,
    scene: str | Path | None = None,
    spp: int | None = None,
) -> None:
    """Write what `render_picture` draws: ``.png`` as screens show it, ``.exr`` with linear radiance.

    Parameters
    ----------
    path : path
    transfer, lighting, width, look_at, fov, up, background, exposure, fixed_lights, scene, spp
        As of `render_picture`.

    Raises
    ------
    UserError
        As `render_picture`; another suffix; a folder that cannot be written to; a map in the place of the picture.
    """
    path = Path(path)
    if path.suffix.lower() not in (".png", ".exr"):
        raise UserError(f"{path}: pictures are written as .png or .exr, not '{path.suffix}'")
    check_output_file(path, *(given for given in (lighting, scene) if isinstance(given, str | Path)))
    finish = Finish(background, exposure)
    picture, scale = _draw(transfer, lighting, Taking(width, Aim(look_at, fov, up), scene, spp), finish, fixed_lights)
    write_picture(path, picture, scale, finish)


def _draw(
    transfer: Transfer | CompressedTransfer,
    lighting: Any,
    taking: Taking,
    finish: Finish,
    fixed_lights: float | Mapping[str, float],
) -> tuple[Picture, float]:
    """A picture with the map behind it if it is to be seen, and the exposure that suits the model."""
    check_transfer(transfer)
    if taking.width is not None:
        taking = replace(taking, width=check_integer(taking.width, "width", SMALLEST_WIDTH, LARGEST_WIDTH))
    environment, up = _light_of(transfer, lighting), taking.aim.axis
    if lighting is None:
        up = "y"  # it stands as its scene has it
    if isinstance(environment, str | Path) and finish.background == MAP:
        environment = read_environment(environment)
    if finish.background == MAP and not isinstance(environment, Environment):
        raise UserError("the map cannot be the background: the light is given as spherical harmonics; name the map")
    if environment is None:
        coefficients = np.zeros((3, num_coefficients(transfer.bandlimit)))
    else:
        coefficients = stand_lighting(environment, transfer.bandlimit, up)
    if coefficients.ndim == 3:
        raise UserError(f"a picture is of one light, not of {len(coefficients)}; draw them one by one")

    def environments() -> tuple[Environment, ...]:
        of_file = isinstance(environment, str | Path) and not is_light_text(environment)
        read = read_environment(environment) if of_file else environment
        return (read.turned(up_rotation(up)),) if isinstance(read, Environment) else ()

    own = (np.eye(3),) if lighting is None else None
    radiance = relight(transfer, coefficients, fixed_lights=fixed_lights)
    lit = Lit(coefficients[None], radiance[None], fixed_lights, environments, own)
    with mitsuba() as mi:
        drawing = open_drawing(mi, transfer, lit, taking, report=log.info)
        return Shots(drawing, 1, finish, environments() if finish.background == MAP else ()).take(0)


def _light_of(transfer: Transfer | CompressedTransfer, lighting: Any) -> Any:
    """The light that is given, or the scene's own; None where its lamps are all of that."""
    if lighting is not None:
        return lighting
    own = transfer.environment if isinstance(transfer, Transfer) else transfer.lighting
    if own is None and transfer.fixed is None:
        raise UserError("the scene has no light of its own; give the path of a map")
    return own
