"""What the viewer of GAMES202 reads: ``transport.txt``, its mesh as ``.obj`` with ``.mtl``, and ``light.txt``.

References
----------
GAMES202, homework 2 (Lingqi Yan, 2021): src/loads/loadOBJ.js, which loads NAME.mtl, and only when it is there NAME.obj.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.files import atomic_output, check_writable
from slepian_prt.lighting.light_text import is_written_here, light_text
from slepian_prt.scene.mesh import Mesh
from slepian_prt.scene.view import up_rotation
from slepian_prt.sphere.conventions.layouts import cut_or_filled
from slepian_prt.sphere.rotation import rotate_sh
from slepian_prt.transport.transport_text import transport_text

# How meshes and materials begin that were written beside a transport.txt.
_HEAD = b"# slepian_prt"

# Of all triangles, as transfer is of unit albedo.
_WHITE = "white"


def games202_files(path: str | Path, light_names: Sequence[str] = ()) -> tuple[Path, ...]:
    """What is written: the transfer, the mesh beside it, its material, then a file for each light."""
    path = Path(path)
    beside = (path, path.with_suffix(".obj"), path.with_suffix(".mtl"))
    if len(light_names) == 1:
        return (*beside, path.with_name("light.txt"))
    return (*beside, *(path.with_name(f"light-{Path(name).stem}.txt") for name in light_names))


def check_games202(path: str | Path, light_names: Sequence[str] = (), inputs: Sequence[str | Path] = ()) -> None:
    """Raise UserError unless all files can be written and replace nothing but the output and what was written before.

    Parameters
    ----------
    path : path of the transport.txt
    light_names : names of the lights
    inputs : paths that must not be replaced
    """
    files = games202_files(path, light_names)
    contents = ("the transfer", "the mesh", "the material", *(f"the light {name}" for name in light_names))
    for (file, content), (other, second) in combinations(zip(files, contents, strict=True), 2):
        if file == other:
            remedy = "the output" if content == contents[0] else "one of the lights"
            raise UserError(f"{file}: would be written twice, as {content} and as {second}; name {remedy} otherwise")
    check_writable(path, *inputs)
    for file, content in zip(files[1:], contents[1:], strict=True):
        check_writable(file)
        named = any(Path(one).exists() and file.exists() and file.samefile(one) for one in inputs)
        if named or (file.exists() and not _is_ours(file)):
            remedy = "write to another folder" if file.suffix == ".txt" else "name the output otherwise"
            raise UserError(f"{file}: would be replaced by {content} that goes with {path}; {remedy}")


def _is_ours(path: Path) -> bool:
    """Whether a file was written here, so that it may be written again."""
    if path.suffix == ".txt":
        return is_written_here(path)
    with path.open("rb") as file:
        return file.read(len(_HEAD)) == _HEAD


def write_games202(
    path: str | Path, mesh: Mesh, vectors: NDArray, lights: Mapping[str, NDArray], up: str = "y"
) -> None:
    """Write transfer, the mesh whose corners it is of, and lights: all of the files, or none if one cannot be written.

    Parameters
    ----------
    path : path of the transport.txt
    mesh : Mesh
        Written white.
    vectors : (V, 9)
        Ours.
    lights : dict of str to (3, n²)
        Cut at 9.
    up : "y" or "z"
        What is up in the mesh. The files have no nodes that put it upright: all that they hold is turned.
    """
    if up != "y":
        stand = up_rotation(up).T
        mesh = replace(mesh, positions=mesh.positions @ stand.T, normals=mesh.normals @ stand.T)
        vectors = rotate_sh(vectors, stand)
        lights = {name: rotate_sh(light, stand) for name, light in lights.items()}
    files = games202_files(path, tuple(lights))
    material = _HEAD + f"\nnewmtl {_WHITE}\nKd 1 1 1\n".encode()
    contents = [transport_text(vectors, mesh.faces), _obj(mesh, files[2].name), material]
    contents += [light_text(cut_or_filled(light, 2)) for light in lights.values()]
    with ExitStack() as outputs:
        for file, content in zip(files, contents, strict=True):
            output = outputs.enter_context(atomic_output(file))
            output.write(content)
            output.flush()  # all are on the disk before the first is put into its place


def _obj(mesh: Mesh, materials: str) -> bytes:
    """Triangles in their order, with a normal for each vertex; ``materials`` is the name of the .mtl file."""
    lines = [f"{_HEAD.decode()}: {mesh.name}\n", f"mtllib {materials}\n"]
    lines += [f"v {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in mesh.positions.tolist()]
    lines += [f"vn {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in mesh.normals.tolist()]
    lines += [f"usemtl {_WHITE}\n"]
    lines += [f"f {a}//{a} {b}//{b} {c}//{c}\n" for a, b, c in (np.asarray(mesh.faces) + 1).tolist()]
    return "".join(lines).encode()
