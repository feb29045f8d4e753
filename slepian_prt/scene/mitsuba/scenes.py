"""Mitsuba scenes as transport sees them: what receives light, what casts shadows, what shines."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.lighting.emitters import emitted_environment
from slepian_prt.lighting.environment import Environment
from slepian_prt.scene.mesh import Mesh
from slepian_prt.scene.mitsuba.effects import effects_left_out
from slepian_prt.scene.mitsuba.shapes import ReceivingShape, reflectance_behind
from slepian_prt.scene.mitsuba.sorting import sort_shapes
from slepian_prt.scene.mitsuba.two_sides import eyes_of, open_behind, with_back
from slepian_prt.scene.reflectance import materials
from slepian_prt.scene.scene import Part, Scene, traced_scene
from slepian_prt.scene.view import View, view_of

log = logging.getLogger(__name__)


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
    shapes = sort_shapes(mi, loaded, str(path), toward_view=view is not None)
    if not shapes.receiving:
        left_out = effects_left_out(mi, shapes.outcomes, view=view is not None)
        listed = "; ".join(row.name for row in left_out) or "it has no shapes"
        raise UserError(f"{path}: nothing in the scene can be lit ({listed}); add a shape with a diffuse material")
    environment = distant_light(mi, loaded.emitters(), str(path))
    traced = (*(shape.shape for shape in shapes.receiving), *shapes.occluders)
    geometry = traced_scene(mi, traced, shapes.groups)
    two_sided = np.array([materials.reflects_on_both_sides(mi, shape.shape.bsdf()) for shape in shapes.receiving])
    backs: list[materials.VertexReflectance | None] = [None] * len(shapes.receiving)
    if view is None:  # toward a camera, fronts alone are simulated
        open_backs = open_behind(mi, geometry, shapes.receiving, two_sided, eyes_of(mi, loaded))
        backs = _reflectance_behind(mi, shapes.receiving, open_backs, str(path))
    meshes = [
        shape.mesh if behind is None else with_back(shape.mesh, behind.albedo)
        for shape, behind in zip(shapes.receiving, backs, strict=True)
    ]
    sides = [1 if behind is None else 2 for behind in backs]
    lost = [None if behind is None else behind.lost for behind in backs]
    ends = np.cumsum([len(mesh.positions) for mesh in meshes])
    offsets = [0, *ends[:-1].tolist()]
    face_counts = np.array([len(shape.triangles.faces) for shape in shapes.receiving])
    faces = [shape.triangles.faces + offset for shape, offset in zip(shapes.receiving, offsets, strict=True)]
    left_out = effects_left_out(mi, shapes.outcomes_with(lost, two_sided), view=view is not None)
    scene = Scene(
        mi=mi,
        path=str(path),
        mesh=_joined(path.stem, meshes, offsets, origin),
        parts=tuple(
            Part(shape.mesh.name, first, len(shape.mesh.positions), of)
            for shape, first, of in zip(shapes.receiving, offsets, sides, strict=True)
        ),
        origin=origin,
        scale=1.0,
        shapes=traced,
        faces=np.concatenate(faces).astype(np.int32),
        first_faces=tuple(int(first) for first in np.cumsum(face_counts) - face_counts),
        two_sided=tuple(bool(both) for both in two_sided),
        has_materials=True,
        view=scene_view,
        sensor=sensor if scene_view is None else None,
        environment=environment,
        not_simulated=left_out,
        loaded=loaded,
        groups=tuple(shapes.groups),
        coarseness=shapes.coarseness,
        boundaries=tuple(shapes.boundaries),
    )
    vars(scene)["geometry"] = geometry  # the same shapes: building it takes as long as all the rest
    return scene


def _reflectance_behind(
    mi: Any, receiving: Sequence[ReceivingShape], open_backs: NDArray[np.bool_], path: str
) -> list[materials.VertexReflectance | None]:
    """What the back of each shape reflects, for those whose back is open."""
    known: dict[int, materials.VertexReflectance] = {}
    result: list[materials.VertexReflectance | None] = []
    for shape, is_open in zip(receiving, open_backs, strict=True):
        if not is_open:
            result.append(None)
            continue
        source = shape.original or shape  # copies reflect alike
        if id(source) not in known:
            origin = f"{path}: shape '{source.mesh.name}'"
            known[id(source)] = reflectance_behind(mi, source, origin)
        result.append(known[id(source)])
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
    sensor = wanted_sensor(sensors, view, path)
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


def wanted_sensor(sensors: Sequence[Any], view: str | int | None, path: str | Path) -> Any:
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


def distant_light(mi: Any, emitters: Sequence[Any], origin: str) -> Environment | None:
    """The scene's distant light; lamps are found in the scene as it was loaded."""
    environment = None
    for emitter in emitters:
        if not emitter.is_environment():
            continue
        try:
            environment = emitted_environment(mi, emitter, origin)
        except UserError as error:  # transport does not need it; `relight` then asks for a map
            log.info("%s; its own light is left out, so name a map to relight with", error)
            continue
        if emitter.class_name() == "TimedSunskyEmitter":
            log.info("%s: of its timed_sunsky the light at time 0 is taken", origin)
        if environment.clamped:
            log.info("%s: %d negative texels of its light set to zero", origin, environment.clamped)
    return environment
