"""Relit results as files: numbers per vertex, coloured meshes, pictures, series of them and films.

From here on radiance is drawn: on the mesh that its receivers are the vertices of, or by a camera.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.errors import UserError
from slepian_prt.files import atomic_output, check_folder, check_writable
from slepian_prt.relighting.camera import Camera, relit_camera
from slepian_prt.relighting.pictures import Picture, exposure, to_srgb, write_picture
from slepian_prt.relighting.series import Series
from slepian_prt.scene.mesh import Mesh

# Of one result; several go to a folder, to one .npz, or to a film.
PICTURES = (".png", ".exr")
SUFFIXES = (".npz", ".ply", *PICTURES)
FILM = ".mp4"

_FRAMES_PER_SECOND = 30


def write_relit(
    output: str,
    packed: CompressedTransfer,
    series: Series,
    suffix: str,
    width: int | None,
    report: Callable[[str], None] = lambda _: None,
) -> None:
    """Write radiance as what the name of the output says.

    Parameters
    ----------
    output : str
        Found good by `check_output`.
    packed : CompressedTransfer
        Its mesh and its camera draw the radiance.
    series : Series
    suffix : one of `SUFFIXES`
        Of the files, where the output is a folder.
    width : int, optional
        Of pictures, in pixels.
    report : callable
        Given a line about each thing worth knowing.
    """
    mesh, kind = packed.mesh, Path(output).suffix.lower()
    several = kind not in (*SUFFIXES, FILM)
    camera = None
    if kind in (*PICTURES, FILM) or (several and suffix in PICTURES):
        camera = relit_camera(packed, width)
        if not camera.alpha.any():
            report(f"{output}: the camera sees no front of any surface; the picture is empty")
    if several:
        write_series(output, series.names, mesh, series.radiance, suffix, camera)
    elif kind == ".npz":
        write_radiance(output, mesh, series.radiance if len(series.names) > 1 else series.radiance[0])
    elif kind == ".ply":
        scale = write_coloured_mesh(output, mesh, series.radiance[0])
        report(f"{output}: colours are radiance x {scale:.4g}, tone-mapped")
    elif kind == FILM:
        assert camera is not None
        write_film(output, camera, series.radiance)
    else:
        assert camera is not None
        write_picture(output, camera.picture(series.radiance[0]))


def write_radiance(path: str | Path, mesh: Mesh, radiance: NDArray) -> None:
    """``.npz`` with ``radiance`` (V, 3) or (B, V, 3) float32, linear RGB, and ``positions`` (V, 3) as in the mesh."""
    with atomic_output(path) as file:
        np.savez(file, radiance=np.asarray(radiance, dtype=np.float32), positions=mesh.positions)


def write_coloured_mesh(path: str | Path, mesh: Mesh, radiance: NDArray, scale: float | None = None) -> float:
    """``.ply`` with tone-mapped sRGB colours per vertex; returns the exposure that they were scaled with."""
    vertices = _vertex_picture(mesh, radiance)
    scale = exposure(vertices) if scale is None else scale
    coloured = trimesh.Trimesh(
        mesh.positions, mesh.faces, vertex_normals=mesh.normals, vertex_colors=to_srgb(vertices, scale)[0],
        process=False,
    )  # fmt: skip
    with atomic_output(path) as file:
        file.write(coloured.export(file_type="ply"))
    return scale


def _vertex_picture(mesh: Mesh, radiance: NDArray) -> Picture:
    """Radiance (V, 3) as a picture of one row, whose pixels are the vertices."""
    return Picture(radiance[None].astype(np.float32), mesh.receivers.active[None].astype(np.float32))


def write_series(
    folder: str | Path, names: Sequence[str], mesh: Mesh, radiance: NDArray, suffix: str, camera: Camera | None
) -> None:
    """One file for each light, all with the same exposure; complete or none of them.

    Parameters
    ----------
    folder : path
        Made if it is not there; its other files are left alone.
    names : of the files, without the suffix
    mesh : Mesh
    radiance : (B, V, 3)
    suffix : one of `SUFFIXES`
    camera : Camera
        For pictures.
    """
    with _complete_folder(folder) as unfinished:
        files = [(unfinished / f"{name}{suffix}", one) for name, one in zip(names, radiance, strict=True)]
        if suffix == ".npz":
            for path, one in files:
                write_radiance(path, mesh, one)
        elif suffix == ".ply":
            scale = min(exposure(_vertex_picture(mesh, one)) for one in radiance)
            for path, one in files:
                write_coloured_mesh(path, mesh, one, scale)
        else:
            assert camera is not None
            scale = _series_exposure(camera, radiance)
            for path, one in files:
                write_picture(path, camera.picture(one), scale)


def _series_exposure(camera: Camera, radiance: NDArray) -> float:
    """One exposure for all: that of the brightest."""
    return min(exposure(camera.picture(one)) for one in radiance)


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


def write_film(path: str | Path, camera: Camera, radiance: NDArray) -> None:
    """``.mp4`` of relit pictures (B, V, 3) over white, all with the same exposure.

    Raises
    ------
    UserError
        There is no encoder, or it fails.
    """
    encoder = film_encoder()
    scale = _series_exposure(camera, radiance)
    # Encoders halve the resolution of colour: sides are even.
    height, width = (n - n % 2 for n in camera.alpha.shape)
    with atomic_output(path) as file, tempfile.TemporaryDirectory() as folder:
        film = Path(folder) / "film.mp4"
        command = [
            encoder, "-loglevel", "error", "-f", "rawvideo", "-pixel_format", "rgb24", "-video_size",
            f"{width}x{height}", "-framerate", str(_FRAMES_PER_SECOND), "-i", "-", "-pix_fmt", "yuv420p", str(film),
        ]  # fmt: skip
        frames = (to_srgb(camera.picture(one), scale)[:height, :width].tobytes() for one in radiance)
        run = subprocess.run(command, input=b"".join(frames), capture_output=True)
        if run.returncode != 0 or not film.is_file():
            said = run.stderr.decode(errors="replace").strip().splitlines()
            raise UserError(f"{path}: ffmpeg could not encode the film ({said[-1] if said else 'it says nothing'})")
        file.write(film.read_bytes())


# --- Before the work -------------------------------------------------------------------------------------------------


def check_output(output: str, *inputs: str, several: bool) -> None:
    """Raise UserError unless results can be written there: one, or several of them."""
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
        return
    check_writable(output, *inputs)
