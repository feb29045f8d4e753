"""What files are wanted, and whether they can be written: asked before any work, and without a renderer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.errors import UserError
from slepian_prt.files import check_folder, check_writable
from slepian_prt.relighting.drawing.film_pictures import check_taking
from slepian_prt.relighting.drawing.pictures import TRANSPARENT, Finish
from slepian_prt.relighting.drawing.taking import Taking
from slepian_prt.scene.named_files import all_behind, check_output_file
from slepian_prt.scene.view import Aim

if TYPE_CHECKING:
    from slepian_prt.transport.transfer import Transfer

# Of one result; several go to a folder, to one .npz, or to a film.
PICTURES = (".png", ".exr")
PLY, GLB = ".ply", ".glb"
MESHES = (PLY, GLB)
SUFFIXES = (".npz", *MESHES, *PICTURES)
FILM = ".mp4"

# Bytes of a mesh file that tell who wrote it: the header of a .ply file, what stands before all else in a .glb file.
_HEAD = 256


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
        from slepian_prt.relighting.files.films import film_encoder  # only here: few outputs are films

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
                check_output_file(file, *inputs)
        return
    check_output_file(output, *inputs)


def check_film(output: str, packed: CompressedTransfer, wish: Wish) -> None:
    """Raise UserError for what a picture of pixels cannot become: a mesh, or a picture of another camera."""
    if packed.film is None:
        return
    if wish.of(output) in MESHES:
        raise UserError(
            f"{output}: the file holds the pixels of a camera, which are no mesh; name one of .png, .exr, .npz"
        )
    check_taking(packed.film, wish.taking)


def check_source(
    output: str, packed: CompressedTransfer | Transfer, file: str, names: Sequence[str] = (), suffix: str = ""
) -> None:
    """Raise UserError if the output is what the transfer file was made from, or a file which that names.

    The file holds the path of its source as it was given; if nothing is there, it is looked for beside the file. A mesh
    of the same name may be the source wherever it lies, unless it was written here.

    Parameters
    ----------
    output : str
        A file, or a folder of one for each name, with the suffix.
    packed : CompressedTransfer or Transfer
    file : str
    names : of str
    suffix : str
    """
    path, folder = Path(output), Path(file).parent
    written = [path / f"{name}{suffix}" for name in names] if path.is_dir() else [path]
    there = [path for path in written if path.is_file()]
    if not packed.source or not there:
        return
    source = Path(packed.source)
    known = [place for place in (source, folder / source, folder / source.name) if place.is_file()]
    inputs = all_behind(known[:1], packed.parameters) if known else []
    for path in there:
        check_writable(path, *inputs)
        if path.name == source.name and path.suffix.lower() in MESHES and not _is_ours(path):
            raise UserError(
                f"{path}: may be the mesh that {file} was made from, and was not written here; choose another name for "
                "the output, or remove it"
            )


def _is_ours(path: Path) -> bool:
    """Whether a mesh file was written here, which its head says."""
    with path.open("rb") as mesh:
        return b"slepian_prt" in mesh.read(_HEAD)
