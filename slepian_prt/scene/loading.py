"""Mesh files and Mitsuba scenes, loaded for transport."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.errors import UserError
from slepian_prt.renderer.variants import mitsuba
from slepian_prt.scene.mesh import Mesh
from slepian_prt.scene.mesh_files import read_mesh
from slepian_prt.scene.mitsuba_scenes import scene_from_mitsuba
from slepian_prt.scene.recentering import coarse_receivers, far_center, load_about
from slepian_prt.scene.scene import Part, Scene
from slepian_prt.scene.shapes import mitsuba_mesh
from slepian_prt.scene.trimesh_objects import is_of_trimesh, mesh_from_trimesh

if TYPE_CHECKING:
    import trimesh

log = logging.getLogger(__name__)


@contextmanager
def open_scene(
    path: str | Path | Mesh | trimesh.Trimesh | trimesh.Scene,
    *,
    albedo: ArrayLike | None = None,
    view: str | int | None = None,
    crease_angle: float | None = None,
) -> Iterator[Scene]:
    """Load a mesh file, a Mitsuba .xml or a mesh in memory, and yield the scene, with Mitsuba in a working variant.

    Parameters
    ----------
    path : path, Mesh, trimesh.Trimesh or trimesh.Scene
        Of trimesh's objects as `mesh_from_trimesh` has it.
    albedo : one or three numbers in [0, 1], optional
        Of a mesh, instead of what its file says. Where neither says anything, it is 1, and nothing is known of
        interreflection.
    view : id or number of a camera of an .xml scene, optional
        Glossy receivers are included, as that camera sees them.
    crease_angle : float in [0, 180], optional
        Degrees from which on edges of a mesh file are hard, as of `read_mesh`.

    Raises
    ------
    UserError
        As `read_mesh` and `mesh_from_trimesh`; an XML file that Mitsuba refuses (its message is passed on); a scene
        with nothing to light; an albedo or a crease angle for a scene that has its own; a camera that is not there.
    """
    if is_of_trimesh(path):
        path = mesh_from_trimesh(path)
    if not isinstance(path, str | Path | Mesh):
        kind = type(path).__name__
        raise UserError(f"the scene must be the path of a file, a Mesh, or a mesh or scene of trimesh, not a {kind}")
    if not isinstance(path, Mesh) and Path(path).suffix.lower() == ".xml":
        if not Path(path).is_file():
            raise UserError(f"{path}: no such file; check the path")
        if albedo is not None:
            raise UserError(f"{path}: its materials say what it reflects; leave out the albedo, or change it there")
        if crease_angle is not None:
            raise UserError(f"{path}: its shapes say themselves which edges are hard; leave out the crease angle")
        with mitsuba() as mi:
            loaded, origin = _load_xml(mi, Path(path))
            yield _told_of_steps(scene_from_mitsuba(mi, loaded, Path(path), origin, view))
        return
    if view is not None:
        raise UserError("a view is that of a camera in a Mitsuba .xml scene; this scene has none")
    if isinstance(path, Mesh):
        if crease_angle is not None:
            raise UserError(f"{path.name}: a mesh in memory has normals; leave out the crease angle, or name a file")
        mesh, source = path, path.name
    else:
        mesh, source = read_mesh(path, crease_angle=180.0 if crease_angle is None else crease_angle), str(path)
    if albedo is not None:
        constant = _constant_albedo(albedo, len(mesh.positions))
        mesh = replace(mesh, albedo=constant, known_albedo=True, not_simulated=())
    with mitsuba() as mi:
        yield _told_of_steps(_from_mesh(mi, mesh, source))


def _told_of_steps(scene: Scene) -> Scene:
    """The scene, after a remark if float32 is too coarse for a part of it."""
    count, step = coarse_receivers(scene.traced_positions, scene.receivers)
    if count:
        log.info(
            "%s: %d vertices are so far from the rest that float32, which rays are traced in, has steps of %.2g of the "
            "size of their part; move the parts together, or bring the model to the origin",
            scene.path,
            count,
            step,
        )
    return scene


def _constant_albedo(albedo: ArrayLike, count: int) -> Any:
    values = np.asarray(albedo, dtype=np.float64).ravel()
    if values.size not in (1, 3) or not np.all(np.isfinite(values)) or values.min() < 0.0 or values.max() > 1.0:
        raise UserError(f"albedo must be one or three numbers between 0 and 1, not {albedo!r}")
    return np.broadcast_to(values.astype(np.float32), (count, 3)).copy()


def _from_mesh(mi: Any, mesh: Mesh, source: str) -> Scene:
    used = mesh.positions[mesh.receivers.active]
    # float32 is finest about zero: there stands what most of the vertices belong to, however far a part of it is.
    origin = np.median(used, axis=0)
    diagonal = float(np.linalg.norm(np.ptp(used, axis=0)))
    scale = diagonal if diagonal > 0.0 else 1.0
    traced = np.where(mesh.receivers.active[:, None], (mesh.positions - origin) / scale, 0.0)
    return Scene(
        mi=mi,
        path=source,
        mesh=mesh,
        parts=(Part(mesh.name, 0, len(mesh.positions)),),
        origin=origin,
        scale=scale,
        shapes=(mitsuba_mesh(mi, replace(mesh, positions=traced)),),
        faces=mesh.faces,
        first_faces=(0,),
        two_sided=(mesh.known_albedo,),
        has_materials=mesh.known_albedo,
        view=None,
        sensor=None,
        environment=None,
        not_simulated=mesh.not_simulated,
    )


def _load_xml(mi: Any, path: Path) -> tuple[Any, NDArray[np.float64]]:
    """The scene, unoptimised, and the point of the world that is its origin: another than zero if it is far from it."""
    level = mi.log_level()
    try:
        mi.set_log_level(mi.LogLevel.Error)  # its warnings go to standard output, where the plan does
        # Unoptimised: merged shapes lose their names, and rectangles in them their resolution.
        loaded = mi.load_file(str(path), optimize=False)
        center = far_center(loaded)
        if center is None:
            return loaded, np.zeros(3)
        return load_about(mi, path, center), center
    except Exception as error:  # whatever Mitsuba's parser and plugins raise
        reason = " ".join(str(error).split()) or type(error).__name__
        raise UserError(f"{path}: Mitsuba cannot load the scene ({reason}); correct it there") from None
    finally:
        mi.set_log_level(level)
