"""What the viewer of GAMES202 reads: ``transport.txt``, its mesh as ``.obj``, and ``light.txt``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slepian_prt.export.kinds import OBJ_HEAD, mesh_beside
from slepian_prt.files import atomic_output
from slepian_prt.lighting.light_text import light_text
from slepian_prt.scene.mesh import Mesh
from slepian_prt.sphere.conventions.layouts import cut_or_filled
from slepian_prt.transport.transport_text import transport_text


def games202_files(path: str | Path, light_names: tuple[str, ...] = ()) -> tuple[Path, ...]:
    """What is written: the transfer, the mesh beside it, then a file for each light."""
    path = Path(path)
    if len(light_names) == 1:
        return (path, mesh_beside(path), path.with_name("light.txt"))
    lights = (path.with_name(f"light-{Path(name).stem}.txt") for name in light_names)
    return (path, mesh_beside(path), *lights)


def write_games202(path: str | Path, mesh: Mesh, vectors: NDArray, lights: Mapping[str, NDArray]) -> None:
    """Write vectors (V, 9) of ours for each corner, the mesh whose corners those are, and lights (3, n²) cut at 9."""
    contents = [transport_text(vectors, mesh.faces), _obj(mesh)]
    contents += [light_text(cut_or_filled(light, 2)) for light in lights.values()]
    for file, content in zip(games202_files(path, tuple(lights)), contents, strict=True):
        with atomic_output(file) as output:
            output.write(content)


def _obj(mesh: Mesh) -> bytes:
    """Triangles in their order, with a normal for each vertex."""
    lines = [f"{OBJ_HEAD.decode()}: {mesh.name}\n"]
    lines += [f"v {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in mesh.positions.tolist()]
    lines += [f"vn {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in mesh.normals.tolist()]
    lines += [f"f {a}//{a} {b}//{b} {c}//{c}\n" for a, b, c in (np.asarray(mesh.faces) + 1).tolist()]
    return "".join(lines).encode()
