"""Relit pictures as a film."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from slepian_prt.errors import UserError
from slepian_prt.files import atomic_output
from slepian_prt.relighting.drawing.pictures import to_srgb

if TYPE_CHECKING:
    from slepian_prt.relighting.drawing.shots import Shots

_FRAMES_PER_SECOND = 30


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
