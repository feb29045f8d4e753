"""Models for engines: with all of their transfer, or with the part of it that engines have a place for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.errors import UserError, check_choice
from slepian_prt.export.ambient import Ambient, ambient_part
from slepian_prt.export.ambient_files import write_ambient_glb, write_ambient_ply
from slepian_prt.export.games202_files import check_games202, write_games202
from slepian_prt.export.kinds import ATTRIBUTES, FUNCTIONS, GAMES202, PLY, TRANSFER, check_export, check_exportable
from slepian_prt.export.transfer_glb import write_transfer_glb
from slepian_prt.lighting.fitting import each_remark_once, one_light
from slepian_prt.relighting.files.surfaces import Surface, split_surfaces
from slepian_prt.runtime.gpu_transfer import gpu_transfer
from slepian_prt.scene.view import UPS

# How the rows of the plan begin that textures make up for.
_TEXTURE = "texture "


@dataclass(frozen=True)
class Exported:
    """What an exported model is, and what it lost.

    Attributes
    ----------
    path : Path
    vertices : int
        Of the transfer.
    error : float
        Relative RMS error of radiance that the export adds, under light that falls as 1/(l+1)², averaged over its
        rotations.
    relit_error : float
        Together with what the file lost.
    measured : dict of str to float
        What the export adds under the lights that were named.
    """

    path: Path
    vertices: int
    error: float
    relit_error: float
    measured: dict[str, float]


@each_remark_once()
def export_model(
    packed: CompressedTransfer,
    path: str | Path,
    what: str = TRANSFER,
    *,
    functions: int | None = None,
    attributes: str | None = None,
    lights: Mapping[str, NDArray] | None = None,
    scene: str | Path | None = None,
    up: str = "y",
    file: str | Path = "",
    report: Callable[[str], None] = lambda _: None,
) -> Exported:
    """Write a model that engines relight, or shade with what they have a place for.

    Parameters
    ----------
    packed : CompressedTransfer
    path : path
        ``.glb``; all but transfer may be ``.ply`` too; ``.txt`` of GAMES202.
    what : "transfer", "occlusion", "bent-normals", "sky-visibility", "l1" or "games202"
        Transfer in the run-time format, for shaders of one's own. Or, for what engines have: radiance of white vertices
        under a constant light of 1; where unblocked light comes from; the visibility of the sky as probe volumes of
        Unity hold it; transfer of degree 0 and 1. Or transfer of degree 0 to 2 as GAMES202 has it, ``transport.txt``,
        with its mesh beside it as .obj and .mtl and the ``lights`` as light.txt (light-NAME.txt of several).
    functions : int, optional
        Bytes per vertex of the run-time format, see `gpu_transfer`; by default 16.
    attributes : "bytes", "float" or "texture", optional
        How they are carried: as four bytes in each of the attributes ``_CUSTOM0`` and on, by default; as floats, for
        Blender, which takes bytes for colours; or in an image, for what keeps texture coordinates alone.
    lights : dict of str to (3, n²), optional
        Under which the loss is told too.
    scene : path, optional
        What the transfer was made from, whose textures are wanted, if that is not where it was.
    up : "y" or "z"
        What is up in the model; a node puts it upright. The files of GAMES202 are turned to y, lights with them.
    file : path, optional
        Of the transfer: what it was made from is looked for beside it.
    report : callable, optional
        Given a line about each thing worth knowing.

    Raises
    ------
    UserError
        Another kind of file, transfer that has no place in an engine, or a file that cannot be written.
    """
    _check_arguments(packed, lights or {})
    check_export(path, what, functions, attributes)
    if what == GAMES202:
        check_games202(path, tuple(lights or ()))
    check_choice(up, "up", UPS)
    check_exportable(packed, what, file)
    lights = {name: one_light(light, packed.bandlimit) for name, light in (lights or {}).items()}
    if what == TRANSFER:
        gpu = gpu_transfer(packed, FUNCTIONS if functions is None else functions)
        write_transfer_glb(
            path, packed, gpu, _surfaces(packed, path, scene, file, report), attributes or ATTRIBUTES[0], up
        )
        measured = {name: gpu.error(light) for name, light in lights.items()}
        return Exported(Path(path), packed.vertex_count, gpu.error(), gpu.relit_error(), measured)
    ambient = ambient_part(packed, what, lights)
    if what == GAMES202:
        _write_games202(path, packed, ambient, lights, up, report)
    elif Path(path).suffix.lower() == PLY:
        write_ambient_ply(path, packed, ambient, what)
    else:
        write_ambient_glb(path, packed, ambient, what, _surfaces(packed, path, scene, file, report), up)
    error = ambient.error()
    relit = (error**2 + packed.predicted_relit_error() ** 2) ** 0.5
    return Exported(Path(path), packed.vertex_count, error, relit, ambient.measured)


def _check_arguments(packed: object, lights: Mapping[str, NDArray]) -> None:
    """Raise UserError for transfer that is not compressed, and for lights whose names are no words."""
    if not isinstance(packed, CompressedTransfer):
        raise UserError(
            f"what is exported must be a CompressedTransfer, not {type(packed).__name__}; compress it first"
        )
    if not isinstance(lights, Mapping) or not all(isinstance(name, str) for name in lights):
        raise UserError("lights must be a dict of names, which are str, to coefficients (3, n²); name each of them")


def _write_games202(
    path: str | Path,
    packed: CompressedTransfer,
    ambient: Ambient,
    lights: Mapping[str, NDArray],
    up: str,
    report: Callable[[str], None],
) -> None:
    if packed.bandlimit > 2:
        left = "3 is" if packed.bandlimit == 3 else f"3 to {packed.bandlimit} are"
        report(f"{path}: GAMES202 has degrees 0 to 2; {left} left out")
    if packed.channels == 3:
        report(f"{path}: GAMES202 has one number for all colours; transfer of three channels is their mean")
    write_games202(path, packed.mesh, ambient.values[:, 0], lights, up)


def _surfaces(
    packed: CompressedTransfer,
    path: str | Path,
    scene: str | Path | None,
    file: str | Path,
    report: Callable[[str], None],
) -> tuple[Surface, ...]:
    """The surfaces of the model, with the textures of what it was made from."""
    from slepian_prt.relighting.files.bitmap_detail import source_detail
    from slepian_prt.relighting.source import missing_in_picture
    from slepian_prt.renderer.variants import mitsuba

    with mitsuba() as mi:
        detail = source_detail(mi, packed, scene, file or None, report)
    lacking = [row for row in missing_in_picture(packed) if detail is None or not row.startswith(_TEXTURE)]
    if lacking:
        textures = any(row.startswith(_TEXTURE) for row in lacking)
        where = "; textures that are found beside the file, or in `scene`, are written" if textures else ""
        report(f"{path}: engines draw the model without what transfer does not hold ({'; '.join(lacking)}){where}")
    return split_surfaces(packed.mesh, packed.parts, detail)
