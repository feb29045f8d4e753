"""Mesh files and Mitsuba scenes, loaded for transport."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.errors import UserError
from slepian_prt.lighting.emitters import emitted_environment
from slepian_prt.lighting.environment import Environment
from slepian_prt.renderer.variants import mitsuba
from slepian_prt.scene import materials
from slepian_prt.scene.left_out import LeftOut
from slepian_prt.scene.mesh import Mesh
from slepian_prt.scene.mesh_files import read_mesh
from slepian_prt.scene.recentering import coarse_receivers, far_center, load_about
from slepian_prt.scene.scene import Part, Scene
from slepian_prt.scene.shapes import ReceivingShape, fewest_cuts, mitsuba_mesh, receiving_shape
from slepian_prt.scene.trimesh_objects import is_of_trimesh, mesh_from_trimesh
from slepian_prt.scene.view import View, view_of

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
            yield _told_of_steps(_from_xml(mi, Path(path), view))
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


# --- Mitsuba XML -----------------------------------------------------------------------------------------------------


class _SortedShapes(NamedTuple):
    """The shapes of a scene by what light does with them.

    Attributes
    ----------
    receiving : list of ReceivingShape
    occluders : list of Mitsuba shapes
        Those that only cast shadows.
    notes : list of str
        What of them is not simulated.
    """

    receiving: list[ReceivingShape]
    occluders: list[Any]
    notes: list[str]


def _from_xml(mi: Any, path: Path, view: str | int | None) -> Scene:
    loaded, origin = _load_xml(mi, path)
    sensor, scene_view = _camera(mi, loaded.sensors(), view, path)
    if scene_view is not None:
        scene_view = scene_view.moved(origin)
    shapes = _sort_shapes(mi, loaded, path, toward_view=view is not None)
    if not shapes.receiving:
        listed = "; ".join(shapes.notes) or "it has no shapes"
        raise UserError(f"{path}: nothing in the scene can be lit ({listed}); add a shape with a diffuse material")
    environment, other_lights = _lights(mi, loaded.emitters(), str(path))
    meshes = [shape.mesh for shape in shapes.receiving]
    counts = np.array([len(mesh.positions) for mesh in meshes])
    offsets = np.cumsum(counts) - counts
    face_counts = np.array([len(shape.faces) for shape in shapes.receiving])
    faces = [shape.faces + offset for shape, offset in zip(shapes.receiving, offsets, strict=True)]
    return Scene(
        mi=mi,
        path=str(path),
        mesh=_joined(path.stem, meshes, offsets, origin),
        parts=tuple(
            Part(mesh.name, int(first), int(n)) for mesh, first, n in zip(meshes, offsets, counts, strict=True)
        ),
        origin=origin,
        scale=1.0,
        shapes=(*(shape.shape for shape in shapes.receiving), *shapes.occluders),
        faces=np.concatenate(faces).astype(np.int32),
        first_faces=tuple(int(first) for first in np.cumsum(face_counts) - face_counts),
        two_sided=tuple(materials.reflects_on_both_sides(mi, shape.shape.bsdf()) for shape in shapes.receiving),
        has_materials=True,
        view=scene_view,
        sensor=sensor if scene_view is None else None,
        environment=environment,
        not_simulated=tuple(map(LeftOut, (*shapes.notes, *other_lights))),
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


def _sort_shapes(mi: Any, loaded: Any, path: Path, *, toward_view: bool) -> _SortedShapes:
    box, shapes = loaded.bbox(), loaded.shapes()
    diagonal = float(np.linalg.norm(np.array(box.max) - np.array(box.min)))
    if shapes and not np.isfinite(diagonal):
        raise UserError(f"{path}: its shapes have no finite size; correct their transforms")
    result = _SortedShapes([], [], [])
    reflects = materials.reflects_toward_a_view if toward_view else materials.reflects_diffusely
    fewest = fewest_cuts(len(shapes))
    for index, shape in enumerate(shapes):
        name = shape.id() or f"shape_{index}"
        bsdf = shape.bsdf()
        if shape.class_name() in ("Instance", "ShapeGroup"):
            result.notes.append(f"shape '{name}' (instances are left out altogether, their shadows too)")
            continue
        if shape.is_emitter():
            result.notes.append(f"light emitted by shape '{name}'")
        lit = reflects(mi, bsdf)
        origin = f"{path}: shape '{name}'"
        receiving = receiving_shape(mi, shape, name, origin, diagonal, fewest) if lit else None
        if receiving is not None:
            result.receiving.append(receiving)
            result.notes.extend(materials.left_out(mi, bsdf, name, view=toward_view))
            continue
        result.occluders.append(shape)
        reason = "it has no vertices" if lit else "its material has no diffuse part"
        result.notes.append(f"light received by shape '{name}' ({reason}; it casts shadows only)")
    return result


def _joined(name: str, meshes: Sequence[Mesh], offsets: Sequence[int], origin: NDArray) -> Mesh:
    """All meshes as one in the world, the vertices of each from its offset on."""
    faces = [mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=True)]
    return Mesh(
        name,
        np.concatenate([mesh.positions for mesh in meshes]) + origin,
        np.concatenate([mesh.normals for mesh in meshes]),
        np.concatenate(faces).astype(np.int32),
        np.concatenate([mesh.albedo for mesh in meshes]),
        tuple(note for mesh in meshes for note in mesh.notes),
    )


def _camera(mi: Any, sensors: Sequence[Any], view: str | int | None, path: Path) -> tuple[Any, View | None]:
    """The wanted camera, or without a wish the first if there is one; and it as a `View`, None for another kind."""
    sensor = _wanted_sensor(sensors, view, path)
    scene_view = view_of(mi, sensor)
    if view is not None and scene_view is None:
        raise UserError(f"{path}: camera {view!r} is a {sensor.class_name()}; a view needs a plain perspective camera")
    if sensor is not None and scene_view is None:
        log.info(
            "%s: camera '%s' is no plain perspective one; pictures of relight are taken by a camera of its own",
            path,
            sensor.id(),
        )
    return sensor, scene_view


def _wanted_sensor(sensors: Sequence[Any], view: str | int | None, path: Path) -> Any:
    """The camera of that id or number; without one, the first, or None."""
    if view is None:
        return sensors[0] if sensors else None
    names = [camera.id() for camera in sensors]
    if isinstance(view, str) and view in names:
        return sensors[names.index(view)]
    if str(view).isdigit() and int(view) < len(sensors):
        return sensors[int(view)]
    known = ", ".join(f"{number} ('{name}')" for number, name in enumerate(names)) or "it has none"
    raise UserError(f"{path}: no camera {view!r}; name one by number or id: {known}")


def _lights(mi: Any, emitters: Sequence[Any], origin: str) -> tuple[Environment | None, list[str]]:
    """The scene's distant light, and what other light it has (shapes that emit are named with their shapes)."""
    environment, others = None, []
    for emitter in emitters:
        if emitter.is_environment():
            try:
                environment = emitted_environment(mi, emitter, origin)
            except UserError as error:  # transport does not need it; `relight` then asks for a map
                log.info("%s; its own light is left out, so name a map to relight with", error)
                continue
            if emitter.class_name() == "TimedSunskyEmitter":
                log.info("%s: of its timed_sunsky the light at time 0 is taken", origin)
            if environment.clamped:
                log.info("%s: %d negative texels of its light set to zero", origin, environment.clamped)
        elif not mi.has_flag(emitter.flags(), mi.EmitterFlags.Surface):
            others.append(f"light of emitter '{emitter.id() or emitter.class_name()}'")
    return environment, others
