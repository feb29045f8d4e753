"""Mesh files and Mitsuba scenes, loaded for transport."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from slepian_prt.arrays import real_numbers
from slepian_prt.errors import UserError
from slepian_prt.files import check_readable
from slepian_prt.renderer.variants import mitsuba
from slepian_prt.scene.mesh import Mesh
from slepian_prt.scene.mesh_files import read_mesh
from slepian_prt.scene.mitsuba.files import load_dict, load_xml, silent
from slepian_prt.scene.mitsuba.objects import is_of_mitsuba, left_usable, parts_of, scene_of, variant_of
from slepian_prt.scene.mitsuba.parameters import scene_parameters
from slepian_prt.scene.mitsuba.recentering import coarse_receivers
from slepian_prt.scene.mitsuba.scenes import scene_from_mitsuba
from slepian_prt.scene.mitsuba.shapes import mitsuba_mesh
from slepian_prt.scene.scene import Part, Scene
from slepian_prt.scene.trimesh_objects import is_of_trimesh, mesh_from_trimesh

if TYPE_CHECKING:
    import mitsuba as mi
    import trimesh

    SceneSource: TypeAlias = str | Path | Mesh | trimesh.Trimesh | trimesh.Scene | mi.Scene | mi.Shape | dict[str, Any]

log = logging.getLogger(__name__)

# Textures of Mitsuba that are looked up at texture coordinates.
_LAID_OUT = re.compile("BitmapTexture|Checkerboard")


@contextmanager
def open_scene(
    source: SceneSource,
    *,
    albedo: ArrayLike | None = None,
    view: str | int | None = None,
    crease_angle: float | None = None,
    parameters: Mapping[str, object] | None = None,
) -> Iterator[Scene]:
    """Load a mesh file, a Mitsuba scene or what is in memory, and yield the scene, with Mitsuba in a working variant.

    Parameters
    ----------
    source : path, Mesh, trimesh.Trimesh, trimesh.Scene, mitsuba.Scene, mitsuba.Shape or dict
        A path is that of a mesh file or a Mitsuba .xml. Of trimesh's objects as `mesh_from_trimesh` has it. Mitsuba's
        are used in their own variant, as they are, and may be used afterwards; a dict is one as of
        ``mitsuba.load_dict``.
    albedo : one or three numbers in [0, 1], optional
        Of a mesh, instead of what its file says. Where neither says anything, it is 1, and nothing is known of
        interreflection.
    view : id or number of a camera of a Mitsuba scene, optional
        Glossy receivers are included, as that camera sees them.
    crease_angle : float in [0, 180], optional
        Degrees from which on edges of a mesh file are hard, as of `read_mesh`.
    parameters : dict of str to number, bool or str, optional
        Values of the ``$name`` in an .xml scene.

    Raises
    ------
    UserError
        As `read_mesh` and `mesh_from_trimesh`; a scene that Mitsuba cannot load (why, with file and line); a parameter
        without a value, or that the scene does not have; a scene with nothing to light; an albedo or a crease angle
        for a scene that has its own; a camera that is not there; objects of a variant that cannot be used.
    """
    if is_of_trimesh(source):
        source = mesh_from_trimesh(source)
    if isinstance(source, dict):
        source_name = "scene"
    elif is_of_mitsuba(source):
        source_name = source.id() or "scene"
    elif isinstance(source, str | Path | Mesh):
        source_name = source.name if isinstance(source, Mesh) else str(source)
    else:
        raise UserError(
            "the scene must be the path of a file, a Mesh, or a mesh or scene of trimesh or of Mitsuba (its dict, or a "
            f"shape, too), not a {type(source).__name__}"
        )
    is_xml = isinstance(source, str | Path) and Path(source).suffix.lower() == ".xml"
    if parameters and not is_xml:
        raise UserError(f"{source_name}: is no Mitsuba .xml scene, and no other takes parameters; leave them out")
    if not is_xml and isinstance(source, str | Path | Mesh):
        yield from _open_mesh(source, source_name, albedo, view, crease_angle)
        return
    if is_xml:
        check_readable(source_name, "a Mitsuba .xml scene")
    if albedo is not None:
        raise UserError(f"{source_name}: its materials say what it reflects; leave out the albedo, or change it there")
    if crease_angle is not None:
        raise UserError(f"{source_name}: its shapes say themselves which edges are hard; leave out the crease angle")
    yield from _open_mitsuba(source, source_name, view, scene_parameters(parameters))


def _open_mitsuba(
    source: SceneSource, name: str, view: str | int | None, parameters: dict[str, str]
) -> Iterator[Scene]:
    """A scene of Mitsuba: a file, a dict, or objects."""
    with mitsuba(variant_of(source)) as mi, left_usable(mi, parts_of(mi, source)), _without_gradients():
        with silent(mi):
            origin = np.zeros(3)
            if isinstance(source, dict):
                loaded, origin = load_dict(mi, source, needs_camera=view is not None)
            elif isinstance(source, str | Path):
                loaded, origin = load_xml(mi, Path(source), parameters, needs_camera=view is not None)
            else:
                loaded = scene_of(mi, source, name)
            _remark_on_coordinates(loaded, name)
            with np.errstate(all="ignore"):  # numbers that leave the range of floats are found where they come out
                scene = scene_from_mitsuba(mi, loaded, Path(name), origin, view)
        yield _told_of_steps(scene)


@contextmanager
def open_mitsuba(source: SceneSource, parameters: Mapping[str, object] | None = None) -> Iterator[tuple[Any, Any, str]]:
    """Load a scene of Mitsuba as it is, with its cameras, and yield Mitsuba in a working variant, the scene, its name.

    Parameters
    ----------
    source : path of an .xml, mitsuba.Scene or dict
    parameters : dict of str to number, bool or str, optional
        Values of the ``$name`` in an .xml scene.

    Raises
    ------
    UserError
        Something else; a scene that Mitsuba cannot load; objects of a variant that cannot be used.
    """
    is_xml = isinstance(source, str | Path) and Path(source).suffix.lower() == ".xml"
    if not is_xml and not isinstance(source, dict) and not is_of_mitsuba(source):
        what = str(source) if isinstance(source, str | Path) else f"a {type(source).__name__}"
        raise UserError(f"{what}: has no camera; give a Mitsuba .xml scene, its dict, or a mitsuba.Scene")
    if parameters and not is_xml:
        raise UserError("scene: is no Mitsuba .xml scene, and no other takes parameters; leave them out")
    if is_xml:
        check_readable(str(source), "a Mitsuba .xml scene")
    with mitsuba(variant_of(source)) as mi, left_usable(mi, parts_of(mi, source)), _without_gradients():
        with silent(mi):
            if isinstance(source, dict):
                name, (loaded, _) = "scene", load_dict(mi, source, needs_camera=True)
            elif isinstance(source, str | Path):
                given = scene_parameters(parameters)
                name, (loaded, _) = str(source), load_xml(mi, Path(source), given, needs_camera=True)
            else:
                name = source.id() or "scene"  # type: ignore[union-attr]
                loaded = scene_of(mi, source, name)
        yield mi, loaded, name


@contextmanager
def _without_gradients() -> Iterator[None]:
    """Nothing recorded for derivatives, which parameters of the user's scene may be prepared for."""
    import drjit as dr  # not before Mitsuba, which knows where LLVM is

    with dr.suspend_grad():
        yield


def _open_mesh(
    source: str | Path | Mesh, name: str, albedo: ArrayLike | None, view: str | int | None, crease_angle: float | None
) -> Iterator[Scene]:
    """A mesh file, or a mesh in memory."""
    if view is not None:
        raise UserError("a view is that of a camera in a Mitsuba .xml scene; this scene has none")
    if not isinstance(source, Mesh):
        mesh = read_mesh(source, crease_angle=180.0 if crease_angle is None else crease_angle)
    elif crease_angle is not None:
        raise UserError(f"{name}: a mesh in memory has normals; leave out the crease angle, or name a file")
    else:
        mesh = source
    if albedo is not None:
        constant = _constant_albedo(albedo, len(mesh.positions))
        mesh = replace(mesh, albedo=constant, known_albedo=True, not_simulated=())
    with mitsuba() as mi:
        yield _told_of_steps(_from_mesh(mi, mesh, name))


def may_have_light(source: SceneSource) -> bool:
    """Whether a scene can have a light of its own; of a path this is known before the file is read."""
    if isinstance(source, str | Path):
        return Path(source).suffix.lower() == ".xml"
    return isinstance(source, dict) or is_of_mitsuba(source)


def _remark_on_coordinates(loaded: Any, origin: str) -> None:
    """Say which meshes have a texture and nothing that says where it lies on them."""
    names = [
        shape.id()
        for shape in loaded.shapes()
        if shape.is_mesh() and not shape.has_vertex_texcoords() and re.search(_LAID_OUT, str(shape.bsdf()))
    ]
    if names:
        listed = ", ".join(f"'{name}'" for name in names[:3]) + (", …" if len(names) > 3 else "")
        subject = f"shape {listed} has" if len(names) == 1 else f"{len(names)} shapes ({listed}) have"
        log.info(
            "%s: %s a texture and no texture coordinates, so that each face shows a triangle of it; give the mesh "
            "coordinates",
            origin,
            subject,
        )


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
    values = real_numbers(albedo, "albedo").ravel()
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
