"""What a transfer file was made from, where it can be found: its scene or textures, which pictures are drawn with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.errors import UserError
from slepian_prt.paths.lobes import PLAIN, material_kind
from slepian_prt.paths.media import media_of
from slepian_prt.renderer.shape_names import shape_name
from slepian_prt.scene.left_out import GATHERED, NOT_SIMULATED
from slepian_prt.scene.mitsuba.files import load_xml
from slepian_prt.scene.mitsuba.parameters import scene_parameters
from slepian_prt.scene.reflectance.surface_detail import SurfaceDetail, read_surface_detail

if TYPE_CHECKING:
    from slepian_prt.transport.transfer import Transfer


@dataclass(frozen=True, eq=False)
class Source:
    """What pictures are drawn with beside the transfer.

    Attributes
    ----------
    path : Path or None
    detail : SurfaceDetail or None
        Textures of a mesh file.
    scene : Mitsuba scene or None
        As its author has it, where its materials or lamps call for gathering; in the variant that was set.
    origin : (3,)
        The point of the world that is the origin of ``scene``.
    """

    path: Path | None = None
    detail: SurfaceDetail | None = None
    scene: Any = None
    origin: NDArray[np.float64] | None = None


def locate_source(
    mi: Any,
    packed: Transfer | CompressedTransfer,
    scene: str | Path | None,
    file: str | Path | None,
    report: Callable[[str], None],
) -> Source:
    """What the transfer was made from, with a remark where it is wanted and cannot be had.

    Raises
    ------
    UserError
        It is named and cannot be used.
    """
    if packed.toward_view:  # the reflectance is in the transfer
        return Source()
    path = find_source(packed, file, scene)
    if path is None:
        _report_missing(packed, report)
        return Source()
    try:
        return open_source(mi, packed, path)
    except UserError as error:
        if scene is not None:
            raise
        report(f"{error}; until then its colours are drawn as the vertices have them")
        return Source()


def _report_missing(packed: Transfer | CompressedTransfer, report: Callable[[str], None]) -> None:
    lacking = missing_in_picture(packed)
    if packed.source and lacking:
        shown = "; ".join(lacking[:3]) + ("; …" if len(lacking) > 3 else "")
        report(
            f"{packed.source} is not found, so pictures lack what the file does not hold ({shown}); name its `scene`"
        )


def find_source(
    packed: Transfer | CompressedTransfer, file: str | Path | None, scene: str | Path | None
) -> Path | None:
    """The file that transfer was made from: the one that is named, or where its own says, or beside it.

    Raises
    ------
    UserError
        The file that is named is not there.
    """
    if scene is not None:
        if not Path(scene).is_file():
            raise UserError(f"{scene}: no such file; check the path of `scene`")
        return Path(scene)
    if not packed.source:
        return None
    given = Path(packed.source)
    beside = [] if file is None else [Path(file).parent / given, Path(file).parent / given.name]
    return next((path for path in (given, *beside) if path.is_file()), None)


def open_source(mi: Any, packed: Transfer | CompressedTransfer, path: Path) -> Source:
    """The textures of a mesh file, or a scene whose materials or lamps call for more than vertices hold.

    Raises
    ------
    UserError
        It cannot be loaded, or is another model now.
    """
    if path.suffix.lower() != ".xml":
        return Source(path, detail=read_surface_detail(path, packed.mesh))
    loaded, origin = load_xml(mi, path, scene_parameters(packed.parameters))
    if not calls_for_gathering(mi, loaded, packed):
        return Source(path)
    return Source(path, scene=loaded, origin=origin)


def calls_for_gathering(mi: Any, loaded: Any, packed: Transfer | CompressedTransfer) -> bool:
    """Whether a Mitsuba scene has lamps, textures, gloss, media, or shapes that the file does not hold."""
    if any(not emitter.is_environment() for emitter in loaded.emitters()) or media_of(mi, loaded):
        return True
    held = {part.name for part in packed.parts}
    names = [shape_name(shape, index) for index, shape in enumerate(loaded.shapes())]
    return any(
        name not in held or not _is_plain(mi, shape.bsdf()) for name, shape in zip(names, loaded.shapes(), strict=True)
    )


def _is_plain(mi: Any, bsdf: Any) -> bool:
    """Whether a BSDF reflects one colour, diffusely, and does nothing else."""
    return bsdf is not None and material_kind(mi, bsdf) == PLAIN


def missing_in_picture(packed: Transfer | CompressedTransfer) -> tuple[str, ...]:
    """What pictures lack that are drawn from the file alone: the rows of its plan that its scene's pictures gather."""
    effects = packed.effects
    gathered = tuple(row.name for row in effects if row.verdict == GATHERED)
    # Files of before had one word for all that is left out.
    return gathered or tuple(row.name for row in effects if row.verdict == NOT_SIMULATED)
