"""Relit results as files: numbers per vertex, coloured meshes, pictures, series of them and films.

From here on radiance is drawn: on the mesh that its receivers are the vertices of, or by a camera.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.files import complete_folder
from slepian_prt.relighting.files.numbers import write_film_radiance, write_radiance
from slepian_prt.relighting.files.wishes import FILM, MESHES, PICTURES, Wish
from slepian_prt.relighting.series import Series, read_environments

# What draws is imported by what draws: numbers are written without a renderer, in a third of the time.
if TYPE_CHECKING:
    from slepian_prt.relighting.drawing.shots import Shots
    from slepian_prt.relighting.files.mesh_outputs import Canvas


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
    if wish.of(output) == ".npz":
        _write_numbers(output, series, packed)
        return
    from slepian_prt.renderer.variants import mitsuba

    with mitsuba() as mi:
        if wish.draws(output):
            shots = _shots(mi, packed, series, wish, file, report)
            if not shots.drawing.picture(0).alpha.any():
                seen = "nothing of the scene" if packed.film is not None else "no front of any surface"
                report(f"{output}: the camera sees {seen}; the picture is empty")
            _write_shots(output, shots, series.names, wish)
        else:
            canvas = _canvas(mi, packed, series, wish, output, file, report)
            _write_meshes(output, canvas, series.names, wish, report)


def _canvas(
    mi: Any,
    packed: CompressedTransfer,
    series: Series,
    wish: Wish,
    output: str,
    file: str,
    report: Callable[[str], None],
) -> Canvas:
    from slepian_prt.relighting.files.mesh_outputs import Wanted, make_canvas

    return make_canvas(mi, packed, series, Wanted(wish.of(output), wish.aim.axis, wish.scene), file, report)


def _shots(
    mi: Any, packed: CompressedTransfer, series: Series, wish: Wish, file: str, report: Callable[[str], None]
) -> Shots:
    from slepian_prt.relighting.drawing.drawings import open_drawing
    from slepian_prt.relighting.drawing.shots import Shots
    from slepian_prt.relighting.drawing.taking import Lit

    lights, lit = series.lights, Lit(series.lighting, series.radiance, series.fixed_lights)
    if lights is not None:
        maps = (lambda: series.environments) if lights.shown else (lambda: read_environments(lights))
        lit = replace(lit, environments=maps, own_turns=None if lights.maps else lights.own_turns)
    drawing = open_drawing(mi, packed, lit, wish.taking, file, report)
    return Shots(drawing, len(series.names), wish.finish, series.environments)


def _write_shots(output: str, shots: Shots, names: Sequence[str], wish: Wish) -> None:
    """A picture, a film, or a folder of pictures with the same exposure."""
    from slepian_prt.relighting.drawing.pictures import write_picture
    from slepian_prt.relighting.files.films import write_film

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
