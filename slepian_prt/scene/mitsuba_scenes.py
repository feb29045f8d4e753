"""Mitsuba scenes as transport sees them: what receives light, what casts shadows, what shines."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.lighting.emitters import emitted_environment
from slepian_prt.lighting.environment import Environment
from slepian_prt.scene import materials
from slepian_prt.scene.left_out import LeftOut
from slepian_prt.scene.mesh import Mesh
from slepian_prt.scene.normals import face_areas
from slepian_prt.scene.scene import Part, Scene
from slepian_prt.scene.scene_effects import ShapeOutcome, effects_left_out
from slepian_prt.scene.shapes import ReceivingShape, fewest_cuts, receiving_shape
from slepian_prt.scene.view import View, view_of

log = logging.getLogger(__name__)


class _SortedShapes(NamedTuple):
    """The shapes of a scene by what light does with them.

    Attributes
    ----------
    receiving : list of ReceivingShape
    occluders : list of Mitsuba shapes
        Those that only cast shadows.
    outcomes : list of ShapeOutcome
        What became of each.
    """

    receiving: list[ReceivingShape]
    occluders: list[Any]
    outcomes: list[ShapeOutcome]


def scene_from_mitsuba(mi: Any, loaded: Any, path: Path, origin: NDArray[np.float64], view: str | int | None) -> Scene:
    """A Mitsuba scene as transport sees it.

    Parameters
    ----------
    mi : Mitsuba, in the variant of the scene
    loaded : Mitsuba scene
        Unoptimised, if it can be had: merged shapes have lost their names.
    path : path
        For messages, and as the source of files.
    origin : (3,)
        The point of the world that is the origin of the loaded scene.
    view : id or number of a camera, optional

    Raises
    ------
    UserError
        Nothing in it can be lit; a shape, material or light that cannot be used; a camera that is not there.
    """
    sensor, scene_view = _camera(mi, loaded.sensors(), view, path)
    if scene_view is not None:
        scene_view = scene_view.moved(origin)
    shapes = _sort_shapes(mi, loaded, path, toward_view=view is not None)
    left_out = effects_left_out(mi, shapes.outcomes, view=view is not None)
    if not shapes.receiving:
        listed = "; ".join(row.name for row in left_out) or "it has no shapes"
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
        not_simulated=(*left_out, *map(LeftOut, other_lights)),
        loaded=loaded,
    )


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
        if shape.class_name() in ("Instance", "ShapeGroup"):
            reason = "instances are left out altogether, their shadows too"
            result.outcomes.append(ShapeOutcome(shape, name, 0.0, 0, reason))
            continue
        lit = reflects(mi, shape.bsdf())
        origin = f"{path}: shape '{name}'"
        receiving = receiving_shape(mi, shape, name, origin, diagonal, fewest) if lit else None
        if receiving is not None:
            result.receiving.append(receiving)
            area = float(face_areas(receiving.mesh.positions, receiving.mesh.faces).sum())
            result.outcomes.append(ShapeOutcome(shape, name, area, 1))
            continue
        result.occluders.append(shape)
        reason = "it has no vertices" if lit else "its material has no diffuse part"
        result.outcomes.append(ShapeOutcome(shape, name, 0.0, 0, f"{reason}; it casts shadows only"))
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
