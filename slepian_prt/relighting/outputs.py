"""Relit results as files: numbers per vertex, coloured meshes, pictures, series of them and films.

From here on radiance is drawn: on the mesh that its receivers are the vertices of, or by a camera.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.errors import UserError
from slepian_prt.files import atomic_output, check_folder, check_writable
from slepian_prt.relighting.coloured_mesh import write_ply
from slepian_prt.relighting.drawings import Lit, Taking, open_drawing
from slepian_prt.relighting.pictures import TRANSPARENT, Finish, Picture, exposure, to_srgb, write_picture
from slepian_prt.relighting.series import Series, read_environments
from slepian_prt.relighting.shots import Shots
from slepian_prt.renderer.variants import mitsuba
from slepian_prt.scene.mesh import Mesh
from slepian_prt.scene.view import Aim

# Of one result; several go to a folder, to one .npz, or to a film.
PICTURES = (".png", ".exr")
SUFFIXES = (".npz", ".ply", *PICTURES)
FILM = ".mp4"

_FRAMES_PER_SECOND = 30


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
    samples : int or None
        Of each pixel of a gathered picture.
    """

    suffix: str = ".png"
    width: int | None = None
    aim: Aim = field(default_factory=Aim)
    finish: Finish = field(default_factory=Finish)
    scene: str | None = None
    samples: int | None = None

    @property
    def taking(self) -> Taking:
        """How pictures are taken."""
        return Taking(self.width, self.aim, self.scene, self.samples)

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
            "samples": self.samples is not None,
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
        shots = _shots(mi, packed, series, wish, file, report) if wish.draws(output) else None
        if shots is not None and not shots.drawing.picture(0).alpha.any():
            report(f"{output}: the camera sees no front of any surface; the picture is empty")
        _write(output, packed, series, wish, shots, report)


def _shots(
    mi: Any, packed: CompressedTransfer, series: Series, wish: Wish, file: str, report: Callable[[str], None]
) -> Shots:
    assert series.lighting is not None
    lights, lit = series.lights, Lit(series.lighting, series.radiance)
    if lights is not None:
        maps = (lambda: series.environments) if lights.shown else (lambda: read_environments(lights))
        lit = replace(lit, environments=maps, own_turns=None if lights.maps else lights.own_turns)
    drawing = open_drawing(mi, packed, lit, wish.taking, file, report)
    return Shots(drawing, len(series.names), wish.finish, series.environments)


def _write(
    output: str,
    packed: CompressedTransfer,
    series: Series,
    wish: Wish,
    shots: Shots | None,
    report: Callable[[str], None],
) -> None:
    mesh, kind = packed.mesh, Path(output).suffix.lower()
    if kind not in (*SUFFIXES, FILM):
        write_series(output, series, mesh, wish, shots)
    elif kind == ".npz":
        write_radiance(output, mesh, series.radiance if len(series.names) > 1 else series.radiance[0], series.names)
    elif kind == ".ply":
        scale = write_coloured_mesh(output, mesh, series.radiance[0], factor=wish.finish.factor)
        report(f"{output}: colours are radiance x {scale:.4g}, tone-mapped")
    elif kind == FILM:
        assert shots is not None
        write_film(output, shots)
    else:
        assert shots is not None
        write_picture(output, *shots.take(0), finish=wish.finish)


def write_radiance(path: str | Path, mesh: Mesh, radiance: NDArray, names: Sequence[str]) -> None:
    """``.npz`` with radiance and the mesh.

    ``radiance`` (V, 3) or (B, V, 3) float32, linear RGB; ``names`` (B,) of the lights; ``positions`` (V, 3) float64,
    ``normals`` (V, 3) float32, ``faces`` (F, 3) int32.
    """
    with atomic_output(path) as file:
        np.savez(
            file,
            radiance=np.asarray(radiance, dtype=np.float32),
            names=np.array(names, dtype=np.str_),
            positions=mesh.positions,
            normals=mesh.normals.astype(np.float32),
            faces=mesh.faces,
        )


def write_coloured_mesh(
    path: str | Path, mesh: Mesh, radiance: NDArray, scale: float | None = None, factor: float = 1.0
) -> float:
    """``.ply`` with tone-mapped sRGB colours per vertex.

    Returns the exposure that they were scaled with: ``scale``, by default that of `exposure`, times ``factor``.
    """
    vertices = _vertex_picture(mesh, radiance)
    scale = (exposure(vertices) if scale is None else scale) * factor
    write_ply(path, mesh, to_srgb(vertices, scale)[0])
    return scale


def _vertex_picture(mesh: Mesh, radiance: NDArray) -> Picture:
    """Radiance (V, 3) as a picture of one row, whose pixels are the vertices."""
    return Picture(radiance[None].astype(np.float32), mesh.receivers.active[None].astype(np.float32))


def write_series(folder: str | Path, series: Series, mesh: Mesh, wish: Wish, shots: Shots | None) -> None:
    """One file for each light, all with the same exposure; complete or none of them.

    Parameters
    ----------
    folder : path
        Made if it is not there; its other files are left alone.
    series : Series
        Its names are those of the files.
    mesh : Mesh
    wish : Wish
    shots : Shots
        For pictures.
    """
    with _complete_folder(folder) as unfinished:
        files = [
            (unfinished / f"{name}{wish.suffix}", one) for name, one in zip(series.names, series.radiance, strict=True)
        ]
        if wish.suffix == ".npz":
            for (path, one), name in zip(files, series.names, strict=True):
                write_radiance(path, mesh, one, [name])
        elif wish.suffix == ".ply":
            scale = min(exposure(_vertex_picture(mesh, one)) for one in series.radiance)
            for path, one in files:
                write_coloured_mesh(path, mesh, one, scale, wish.finish.factor)
        else:
            assert shots is not None
            scale = shots.common_exposure()
            for number, (path, _) in enumerate(files):
                write_picture(path, shots.take(number)[0], scale, wish.finish)


@contextmanager
def _complete_folder(folder: str | Path) -> Iterator[Path]:
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


# --- Films -----------------------------------------------------------------------------------------------------------


def film_encoder() -> str:
    """Path of ffmpeg.

    Raises
    ------
    UserError
        There is none.
    """
    installed = shutil.which("ffmpeg")
    if installed:
        return installed
    try:
        import imageio_ffmpeg

        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except (ImportError, RuntimeError):
        raise UserError(
            "films need ffmpeg; install it, or `pip install imageio-ffmpeg`, or name a folder for the pictures"
        ) from None


def write_film(path: str | Path, shots: Shots) -> None:
    """``.mp4`` of relit pictures, over white unless there is a background, all with the same exposure.

    Raises
    ------
    UserError
        There is no encoder, or it fails.
    """
    encoder = film_encoder()
    scale = shots.common_exposure() * shots.finish.factor
    background = 1.0 if shots.finish.colour is None else shots.finish.colour
    # Encoders halve the resolution of colour: sides are even.
    height, width = (n - n % 2 for n in shots.size)
    with atomic_output(path) as file, tempfile.TemporaryDirectory() as folder:
        film = Path(folder) / "film.mp4"
        command = [
            encoder, "-loglevel", "error", "-f", "rawvideo", "-pixel_format", "rgb24", "-video_size",
            f"{width}x{height}", "-framerate", str(_FRAMES_PER_SECOND), "-i", "-", "-pix_fmt", "yuv420p", str(film),
        ]  # fmt: skip
        frames = (
            to_srgb(shots.take(number)[0], scale, background)[:height, :width].tobytes()
            for number in range(shots.count)
        )
        run = subprocess.run(command, input=b"".join(frames), capture_output=True)
        if run.returncode != 0 or not film.is_file():
            said = run.stderr.decode(errors="replace").strip().splitlines()
            raise UserError(f"{path}: ffmpeg could not encode the film ({said[-1] if said else 'it says nothing'})")
        file.write(film.read_bytes())


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
    if several and suffix in (".png", ".exr", ".ply"):
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


def check_source(output: str, packed: CompressedTransfer, file: str) -> None:
    """Raise UserError if the output is the mesh or scene that the transfer file was made from, as far as that is known.

    The file holds its path as it was given; where that is relative, it is also looked for beside the file.
    """
    source, folder = Path(packed.source), Path(file).parent
    if packed.source and Path(output).is_file():
        check_writable(output, source, folder / source, folder / source.name)
