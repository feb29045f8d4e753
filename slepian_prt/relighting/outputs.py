"""Relit results as files: numbers per vertex, coloured meshes, pictures, series of them and films."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.files import atomic_output, check_folder, check_writable
from slepian_prt.relighting.pictures import Camera, Picture, exposure, to_srgb, write_picture
from slepian_prt.scene.mesh import Mesh

# Of one result; several go to a folder, to one .npz, or to a film.
SUFFIXES = (".npz", ".ply", ".png", ".exr")
FILM = ".mp4"

_FRAMES_PER_SECOND = 30


def write_radiance(path: str | Path, mesh: Mesh, radiance: NDArray) -> None:
    """``.npz`` with ``radiance`` (V, 3) or (B, V, 3) float32, linear RGB, and ``positions`` (V, 3) as in the mesh."""
    with atomic_output(path) as file:
        np.savez(file, radiance=np.asarray(radiance, dtype=np.float32), positions=mesh.positions)


def mesh_exposure(mesh: Mesh, radiance: NDArray) -> float:
    """The factor that shows radiance at the vertices well."""
    return exposure(Picture(radiance[None].astype(np.float32), mesh.receivers.active[None].astype(np.float32)))


def write_coloured_mesh(path: str | Path, mesh: Mesh, radiance: NDArray, scale: float | None = None) -> float:
    """``.ply`` with tone-mapped sRGB colours per vertex; returns the exposure that they were scaled with."""
    strip = Picture(radiance[None].astype(np.float32), mesh.receivers.active[None].astype(np.float32))
    scale = mesh_exposure(mesh, radiance) if scale is None else scale
    coloured = trimesh.Trimesh(
        mesh.positions, mesh.faces, vertex_normals=mesh.normals, vertex_colors=to_srgb(strip, scale)[0], process=False
    )
    with atomic_output(path) as file:
        file.write(coloured.export(file_type="ply"))
    return scale


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
    with _assembled(folder) as assembled:
        if suffix == ".npz":
            for name, one in zip(names, radiance, strict=True):
                write_radiance(assembled / f"{name}.npz", mesh, one)
        elif suffix == ".ply":
            scale = min(mesh_exposure(mesh, one) for one in radiance)
            for name, one in zip(names, radiance, strict=True):
                write_coloured_mesh(assembled / f"{name}.ply", mesh, one, scale)
        else:
            assert camera is not None
            scale = series_exposure(camera, radiance)
            for name, one in zip(names, radiance, strict=True):
                write_picture(assembled / f"{name}{suffix}", camera.picture(one), scale)


def series_exposure(camera: Camera, radiance: NDArray) -> float:
    """One exposure for all: that of the brightest."""
    return min(exposure(camera.picture(one)) for one in radiance)


@contextmanager
def _assembled(folder: str | Path) -> Iterator[Path]:
    """A new folder whose files are moved to their place when the with-block ends well."""
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise UserError(f"{folder}: is a file; name a folder for several results")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{folder.name}.", dir=folder.parent) as made:
            yield Path(made)
            folder.mkdir(exist_ok=True)
            for file in sorted(Path(made).iterdir()):
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
    found = shutil.which("ffmpeg")
    if found:
        return found
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
    scale = series_exposure(camera, radiance)
    # Encoders halve the resolution of colour: sides are even.
    height, width = (n - n % 2 for n in camera.alpha.shape)
    with atomic_output(path) as file, tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "film.mp4"
        command = [
            encoder, "-loglevel", "error", "-f", "rawvideo", "-pixel_format", "rgb24", "-video_size",
            f"{width}x{height}", "-framerate", str(_FRAMES_PER_SECOND), "-i", "-", "-pix_fmt", "yuv420p", str(made),
        ]  # fmt: skip
        frames = (to_srgb(camera.picture(one), scale)[:height, :width].tobytes() for one in radiance)
        run = subprocess.run(command, input=b"".join(frames), capture_output=True)
        if run.returncode != 0 or not made.is_file():
            said = run.stderr.decode(errors="replace").strip().splitlines()
            raise UserError(f"{path}: ffmpeg could not encode the film ({said[-1] if said else 'it says nothing'})")
        file.write(made.read_bytes())


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
