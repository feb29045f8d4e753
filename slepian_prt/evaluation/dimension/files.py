"""The effective dimension of a model as a picture, a coloured mesh, or arrays."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.errors import UserError
from slepian_prt.evaluation.dimension.estimate import EffectiveDimension
from slepian_prt.evaluation.dimension.picture import LEAST_WIDTH, ColourScale, draw_dimension, encode_picture
from slepian_prt.files import atomic_output
from slepian_prt.relighting.drawing.camera import Camera, relit_camera
from slepian_prt.relighting.drawing.pictures import MAP, Finish
from slepian_prt.relighting.files.coloured_mesh import as_in_source, write_ply
from slepian_prt.renderer.variants import mitsuba
from slepian_prt.scene.mesh import Mesh
from slepian_prt.scene.named_files import check_output_file
from slepian_prt.scene.view import Aim
from slepian_prt.transport.transfer import Transfer

PICTURE = ".png"
SUFFIXES = (PICTURE, ".ply", ".npz")


def check_dimension_output(
    output: str | Path, finish: Finish, *inputs: str | Path, parameters: Mapping[str, Any] | None = None
) -> None:
    """Raise UserError now if the result could not be written as what the name says, or would replace an input."""
    check_output_file(output, *inputs, parameters=parameters)
    suffix = Path(output).suffix.lower()
    if suffix not in SUFFIXES:
        raise UserError(f"{output}: unknown kind of output '{suffix}'; name one of {', '.join(SUFFIXES)}")
    if finish.background == MAP:
        raise UserError("the map cannot be the background: no light falls on this picture; name a colour")


def write_dimension(
    output: str | Path,
    transfer: Transfer | CompressedTransfer,
    result: EffectiveDimension,
    width: int | None,
    aim: Aim,
    finish: Finish,
) -> tuple[str, ...]:
    """Write what the name of the output says.

    Parameters
    ----------
    output : path
        Found good by `check_dimension_output`.
    transfer : Transfer or CompressedTransfer
        Whose mesh and camera draw the result.
    result : EffectiveDimension
    width : int or None
        Of a picture, in pixels.
    aim : Aim
    finish : Finish

    Returns
    -------
    tuple of str
        What is to be said of it.
    """
    suffix, scale = Path(output).suffix.lower(), ColourScale.of(result)
    if suffix == PICTURE:
        with mitsuba():
            camera = relit_camera(transfer, width, aim)
        with atomic_output(output) as file:
            file.write(encode_picture(draw_dimension(camera, transfer.normals, result, scale), result, scale, finish))
        return _remarks(output, camera)
    if suffix == ".ply":
        _write_mesh(output, transfer.mesh, result, scale)
    else:
        _write_numbers(output, transfer.mesh, result)
    return ()


def _remarks(output: str | Path, camera: Camera) -> tuple[str, ...]:
    remarks, width = [], camera.alpha.shape[1]
    if not camera.alpha.any():
        remarks.append(f"{output}: the camera sees no front of any surface; the picture is empty")
    if width < LEAST_WIDTH:
        remarks.append(
            f"{output}: {width} pixels are too few for the scale of the colours, which is left out; give a `width` of "
            f"{LEAST_WIDTH} or more"
        )
    return tuple(remarks)


def _write_mesh(output: str | Path, mesh: Mesh, result: EffectiveDimension, scale: ColourScale) -> None:
    """With the vertices of the file that it was read from."""
    own, columns = as_in_source(mesh, result.dimension[:, None])
    dimension = columns[:, 0]
    colours = (scale.colours(dimension) * 255.0 + 0.5).astype(np.uint8)
    write_ply(output, own, colours, properties={"dimension": dimension})


def _write_numbers(output: str | Path, mesh: Mesh, result: EffectiveDimension) -> None:
    with atomic_output(output) as file:
        np.savez(
            file,
            dimension=result.dimension,
            areas=result.areas,
            functions=result.functions,
            error=result.error,
            radius=result.radius,
            positions=mesh.positions,
            normals=mesh.normals.astype(np.float32),
            faces=mesh.faces,
        )
