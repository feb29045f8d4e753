"""Relit results as files: numbers per vertex, coloured meshes, pictures, series of them and films.

From here on radiance is drawn: on the mesh that its receivers are the vertices of, or by a camera.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.errors import UserError
from slepian_prt.files import check_folder, check_writable
from slepian_prt.relighting.drawing.drawings import Lit, Taking, open_drawing
from slepian_prt.relighting.drawing.film_pictures import check_taking
from slepian_prt.relighting.drawing.pictures import TRANSPARENT, Finish, write_picture
from slepian_prt.relighting.drawing.shots import Shots
from slepian_prt.relighting.files.films import film_encoder, write_film
from slepian_prt.relighting.files.mesh_outputs import (
    GLB,
    PLY,
    Canvas,
    Wanted,
    make_canvas,
    write_film_radiance,
    write_radiance,
)
from slepian_prt.relighting.series import Series, read_environments
from slepian_prt.renderer.variants import mitsuba
from slepian_prt.scene.view import Aim

# Of one result; several go to a folder, to one .npz, or to a film.
PICTURES = (".png", ".exr")
MESHES = (PLY, GLB)
SUFFIXES = (".npz", *MESHES, *PICTURES)
FILM = ".mp4"


@dataclass(frozen=True)
class Wish:
    """What files are wanted.

    Attributes
    ----------
    suffix : one of `SUFFIXES`
        Of the files, where the output is a folder.
    width : int or None
        Of pictures, in pixels.
    aim : Aim
        Of the camera.
    finish : Finish
        Background and exposure.
    scene : str or None
        What the transfer was made from, where it is not where it was.
    spp : int or None
        Samples of each pixel of a gathered picture.
    """

    suffix: str = ".png"
    width: int | None = None
    aim: Aim = field(default_factory=Aim)
    finish: Finish = field(default_factory=Finish)
    scene: str | None = None
    spp: int | None = None

    @property
    def taking(self) -> Taking:
        """How pictures are taken."""
        return Taking(self.width, self.aim, self.scene, self.spp)

    def of(self, output: str) -> str:
        """The kind of file that is written."""
        kind = Path(output).suffix.lower()
        return kind if kind in (*SUFFIXES, FILM) else self.suffix

    def draws(self, output: str) -> bool:
        """Whether that is a picture or a film."""
        return self.of(output) in (*PICTURES, FILM)

    def unused(self, output: str) -> list[str]:
        """What is asked for and does not show in that kind of file; `Aim.up` turns the light in any case."""
        kind = self.of(output)
        asked = {
            "width": self.width is not None,
            "look_at": self.aim.look_at is not None,
            "fov": self.aim.fov is not None,
            "background": self.finish.background != TRANSPARENT,
            "spp": self.spp is not None,
        }
        given = [] if self.draws(output) else [name for name, is_asked in asked.items() if is_asked]
        return [*given, *(["exposure"] if kind == ".npz" and self.finish.exposure else [])]


def write_relit(
    output: str,
    packed: CompressedTransfer,
    series: Series,
    wish: Wish,
    report: Callable[[str], None] = lambda _: None,
    file: str = "",
) -> None:
    """Write radiance as what the name of the output says.

    Parameters
    ----------
    output : str
        Found good by `check_output`.
    packed : CompressedTransfer
        Its mesh and its camera draw the radiance.
    series : Series
    wish : Wish
    report : callable
        Given a line about each thing worth knowing.
    file : str
        Of the transfer: what it was made from is looked for beside it.
    """
    if unused := wish.unused(output):
        report(f"{output}: {', '.join(f'`{name}`' for name in unused)} have no effect on {wish.of(output)} files")
    with mitsuba() as mi:
        if wish.draws(output):
            shots = _shots(mi, packed, series, wish, file, report)
            if not shots.drawing.picture(0).alpha.any():
                seen = "nothing of the scene" if packed.film is not None else "no front of any surface"
                report(f"{output}: the camera sees {seen}; the picture is empty")
            _write_shots(output, shots, series.names, wish)
        elif wish.of(output) == ".npz":
            _write_numbers(output, series, packed)
        else:
            wanted = Wanted(wish.of(output), wish.aim.axis, wish.scene)
            canvas = make_canvas(mi, packed, series, wanted, file, report)
            _write_meshes(output, canvas, series.names, wish, report)


def _shots(
    mi: Any, packed: CompressedTransfer, series: Series, wish: Wish, file: str, report: Callable[[str], None]
) -> Shots:
    lights, lit = series.lights, Lit(series.lighting, series.radiance, series.fixed_lights)
    if lights is not None:
        maps = (lambda: series.environments) if lights.shown else (lambda: read_environments(lights))
        lit = replace(lit, environments=maps, own_turns=None if lights.maps else lights.own_turns)
    drawing = open_drawing(mi, packed, lit, wish.taking, file, report)
    return Shots(drawing, len(series.names), wish.finish, series.environments)


def _write_shots(output: str, shots: Shots, names: Sequence[str], wish: Wish) -> None:
    """A picture, a film, or a folder of pictures with the same exposure."""
    kind = Path(output).suffix.lower()
    if kind == FILM:
        write_film(output, shots)
    elif kind in PICTURES:
        write_picture(output, *shots.take(0), finish=wish.finish)
    else:
        scale = shots.common_exposure()
        with complete_folder(output) as folder:
            for number, name in enumerate(names):
                write_picture(folder / f"{name}{wish.suffix}", shots.take(number)[0], scale, wish.finish)


def _write_numbers(output: str, series: Series, packed: CompressedTransfer) -> None:
    """Radiance of the receivers, in one file or a folder of them."""

    def write(path: str | Path, radiance: NDArray, names: Sequence[str]) -> None:
        if packed.film is not None:
            write_film_radiance(path, packed.film, radiance, names)
        else:
            write_radiance(path, packed.mesh, radiance, names)

    if Path(output).suffix.lower() == ".npz":
        write(output, series.radiance if len(series.names) > 1 else series.radiance[0], series.names)
        return
    with complete_folder(output) as folder:
        for name, one in zip(series.names, series.radiance, strict=True):
            write(folder / f"{name}.npz", one, [name])


def _write_meshes(output: str, canvas: Canvas, names: Sequence[str], wish: Wish, report: Callable[[str], None]) -> None:
    """A mesh with colours, or a folder of them with the same exposure."""
    if Path(output).suffix.lower() in MESHES:
        report(f"{output}: {canvas.write(output, 0, factor=wish.finish.factor)}")
        return
    scale = canvas.exposure()
    with complete_folder(output) as folder:
        for number, name in enumerate(names):
            canvas.write(folder / f"{name}{wish.suffix}", number, scale, wish.finish.factor, output)


@contextmanager
def complete_folder(folder: str | Path) -> Iterator[Path]:
    """A new folder whose files are moved to their place when the with-block ends well."""
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise UserError(f"{folder}: is a file; name a folder for several results")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{folder.name}.", dir=folder.parent) as unfinished:
            yield Path(unfinished)
            folder.mkdir(exist_ok=True)
            for file in sorted(Path(unfinished).iterdir()):
                file.replace(folder / file.name)
    except OSError as error:
        raise UserError(f"{folder}: cannot be written ({error.strerror or error}); choose another folder") from None


# --- Before the work -------------------------------------------------------------------------------------------------


def check_output(output: str, inputs: Sequence[str | Path], names: Sequence[str], wish: Wish, *, several: bool) -> None:
    """Raise UserError unless results can be written there, and none in the place of an input.

    Parameters
    ----------
    output : str
    inputs : paths
    names : of the lights
    wish : Wish
    several : bool
        Whether there are several results.
    """
    suffix = Path(output).suffix.lower()
    if several and suffix in (*PICTURES, *MESHES):
        raise UserError(f"{output}: is one file for several results; name a folder, or one .npz or .mp4")
    if suffix == FILM:
        if not several:
            raise UserError(f"{output}: a film needs several lights; give `turntable` or several maps")
        film_encoder()
    elif suffix not in SUFFIXES:
        if not several:
            known = ", ".join(SUFFIXES)
            raise UserError(f"{output}: unknown kind of output '{suffix}'; name one of {known}")
        if suffix and not Path(output).is_dir():
            raise UserError(f"{output}: unknown kind of output '{suffix}'; name a folder, or one .npz or .mp4")
        check_folder(output)
        for name in names:
            file = Path(output) / f"{name}{wish.suffix}"
            if file.exists():
                check_writable(file, *inputs)
        return
    check_writable(output, *inputs)


def check_film(output: str, packed: CompressedTransfer, wish: Wish) -> None:
    """Raise UserError for what a picture of pixels cannot become: a mesh, or a picture of another camera."""
    if packed.film is None:
        return
    if wish.of(output) in MESHES:
        raise UserError(
            f"{output}: the file holds the pixels of a camera, which are no mesh; name one of .png, .exr, .npz"
        )
    check_taking(packed.film, wish.taking)


def check_source(output: str, packed: CompressedTransfer, file: str) -> None:
    """Raise UserError if the output is the mesh or scene that the transfer file was made from, as far as that is known.

    The file holds its path as it was given; where that is relative, it is also looked for beside the file.
    """
    source, folder = Path(packed.source), Path(file).parent
    if packed.source and Path(output).is_file():
        check_writable(output, source, folder / source, folder / source.name)
