"""Instances of groups of shapes: copies that receive light, or as many as there are that only cast shadows."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.renderer.shape_names import shape_name
from slepian_prt.scene.mitsuba.ids import load_keeping_ids
from slepian_prt.scene.mitsuba.shapes import ReceivingShape
from slepian_prt.scene.mitsuba.triangles import mesh_of

# Light is computed on the instances of a scene as far as they have no more vertices together, and are no more.
MOST_VERTICES = 2_000_000
MOST_COPIES = 2_000


class Instance(NamedTuple):
    """One instance of a group.

    Attributes
    ----------
    name : str
    matrix : (4, 4)
        From the space of the group to that of the scene.
    """

    name: str
    matrix: NDArray[np.float64]

    @property
    def stretch(self) -> float:
        """By how much it lengthens what it lengthens most."""
        return float(np.linalg.norm(self.matrix[:3, :3], 2))

    @property
    def enlargement(self) -> float:
        """About how many times the area is that of the group."""
        return float(abs(np.linalg.det(self.matrix[:3, :3])) ** (2.0 / 3.0))


class InstancedGroup(NamedTuple):
    """A group of shapes and where it stands.

    Attributes
    ----------
    name : str
    shapes : list of Mitsuba shapes
        In the space of the group.
    instances : list of Instance
    """

    name: str
    shapes: list[Any]
    instances: list[Instance]

    def member_name(self, index: int) -> str:
        """What a shape of the group is called."""
        return shape_name(self.shapes[index], index)

    def names(self) -> list[str]:
        """What its shapes are called in the scene."""
        return [f"{self.name}/{self.member_name(index)}" for index in range(len(self.shapes))]


def instanced_groups(mi: Any, loaded: Any, path: str) -> list[InstancedGroup]:
    """The groups of a Mitsuba scene that have instances.

    Raises
    ------
    UserError
        An instance whose transform cannot be used, or of a group without shapes, which Mitsuba cannot trace.
    """
    groups = {group.id(): InstancedGroup(group.id(), list(shapes_in(mi, group)), []) for group in groups_in(mi, loaded)}
    instances = [shape for shape in loaded.shapes() if shape.class_name() == "Instance"]
    for number, shape in enumerate(instances):
        name = shape.id() or f"instance_{number}"
        matrix = np.array(mi.traverse(shape)["to_world"].matrix, dtype=np.float64).reshape(4, 4)
        flat = abs(np.linalg.det(matrix[:3, :3])) <= 1e-12 * np.abs(matrix[:3, :3]).max() ** 3
        if flat or not np.all(np.isfinite(matrix)):
            raise UserError(f"{path}: instance '{name}': its to_world flattens it to nothing; correct the transform")
        # Of its group it shows the name alone.
        named = re.search(r'shapegroup = ShapeGroup\[\s*name = "(.*)",\s*prim_count', str(shape))
        group = groups.get(named.group(1)) if named else None
        if group is None:
            raise UserError(f"{path}: instance '{name}': its group of shapes cannot be found; give the group an id")
        if not group.shapes:
            raise UserError(f"{path}: instance '{name}': its group '{group.name}' has no shapes; give it some")
        group.instances.append(Instance(name, matrix))
    return [group for group in groups.values() if group.instances]


def groups_in(mi: Any, loaded: Any) -> list[Any]:
    """The groups of shapes of a Mitsuba scene; without them its instances cannot be put into another."""
    return [thing for thing in _objects_in(mi, loaded) if thing.class_name().startswith("ShapeGroup")]


def shapes_in(mi: Any, group: Any) -> list[Any]:
    """The shapes of a Mitsuba group, in its own space."""
    return [child for child in _objects_in(mi, group) if isinstance(child, mi.Shape)]


def _objects_in(mi: Any, parent: Any) -> list[Any]:
    """What an object of Mitsuba refers to, in order; `mitsuba.traverse` gives only numbers, and names with clashes."""
    found = []

    class Collector(mi.TraversalCallback):
        def put(self, _name: str, value: Any, _flags: int, _type: Any = None) -> None:
            if isinstance(value, mi.Object):
                found.append(value)

    parent.traverse(Collector())
    return found


def copy_name(name: str, instance: Instance) -> str:
    """What the copy of a shape is called that an instance places; the shape as `InstancedGroup.names` has it."""
    return f"{instance.name}/{name.rsplit('/', 1)[-1]}"


def placed(mi: Any, receiving: ReceivingShape, instance: Instance, name: str) -> ReceivingShape:
    """A copy of a shape of a group, where an instance has it."""
    linear, offset = instance.matrix[:3, :3], instance.matrix[:3, 3]

    def moved(normals: NDArray) -> NDArray[np.float64]:
        turned = normals @ np.linalg.inv(linear)
        return np.asarray(turned / np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1e-300))

    mirrored = np.linalg.det(linear) < 0.0
    triangles, mesh = receiving.triangles, receiving.mesh
    positions, normals = triangles.positions @ linear.T + offset, moved(mesh.normals)
    triangles = triangles._replace(
        positions=positions,
        normals=None,
        faces=triangles.faces[:, ::-1].copy() if mirrored else triangles.faces,
        are_own=False,
    )
    faces = mesh.faces[:, ::-1].copy() if mirrored else mesh.faces
    copy = replace(mesh, name=name, positions=positions, normals=normals, faces=faces, notes=())
    return ReceivingShape(
        mesh_of(mi, receiving.shape.bsdf(), name, triangles, normals), copy, triangles, original=receiving
    )


def casting_shadows(mi: Any, shapes: Sequence[Any], instances: Sequence[Instance]) -> tuple[Any, list[Any]]:
    """A Mitsuba group of some shapes of a group, and instances of it, which are traced but have no vertices."""
    members = {f"shape_{i}": shape for i, shape in enumerate(shapes)}
    group = load_keeping_ids(mi, {"type": "shapegroup", **members})
    return group, [
        mi.load_dict({"type": "instance", "group": group, "to_world": mi.ScalarTransform4f(instance.matrix)})
        for instance in instances
    ]
