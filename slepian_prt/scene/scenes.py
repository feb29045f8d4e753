"""A scene as transport sees it: receivers with vertices, everything that casts shadows, and a camera."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.errors import UserError
from slepian_prt.scene.meshes import Mesh, make_mesh, read_mesh
from slepian_prt.scene.variants import mitsuba

# Where rays start above the surface, relative to the diagonal of the bounding box. From the vertex itself 41 % of the
# rays of a convex icosphere are falsely blocked; from here none.
RAY_OFFSET = 1e-4

# A shape of fewer vertices hardly shows a shadow.
_COARSE = 100

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Part:
    """One receiving shape: vertices ``first : first + count`` of the scene's mesh."""

    name: str
    first: int
    count: int


@dataclass(frozen=True)
class Scene:
    """A loaded scene; usable inside the with-block of `open_scene` that made it.

    Attributes
    ----------
    path : str
    mesh : Mesh
        All receivers as one mesh, in world space.
    parts : tuple of Part
    origin : (3,), scale : float
        Mitsuba's geometry is ``(world - origin) / scale``: a mesh file is traced in a box of unit diagonal, because
        Mitsuba's own ray offsets are absolute and float32 loses what lies far from the origin.
    shapes : tuple
        Mitsuba shapes in the order of ``parts``, then the occluders.
    sensor : Mitsuba sensor, or None to frame the scene automatically
    not_simulated : tuple of str
        What the scene has and transport here leaves out.
    """

    path: str
    mesh: Mesh
    parts: tuple[Part, ...]
    origin: NDArray[np.float64]
    scale: float
    shapes: tuple[Any, ...]
    sensor: Any
    not_simulated: tuple[str, ...] = ()

    @property
    def traced_positions(self) -> NDArray[np.float64]:
        """(V, 3) vertex positions in the space that Mitsuba traces in."""
        return (self.mesh.positions - self.origin) / self.scale

    @property
    def traced_bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Corners of the box of all shapes, occluders too, in the space that Mitsuba traces in."""
        boxes = [shape.bbox() for shape in self.shapes]
        low = np.min([np.array(box.min) for box in boxes], axis=0).astype(np.float64)
        high = np.max([np.array(box.max) for box in boxes], axis=0).astype(np.float64)
        return low, high


@contextmanager
def open_scene(path: str | Path | Mesh) -> Iterator[tuple[Any, Scene]]:
    """Load a mesh file, a Mitsuba .xml or a `Mesh`, and yield Mitsuba in a working variant with the scene.

    Raises
    ------
    UserError
        As `read_mesh`; an XML file that Mitsuba refuses (its message is passed on); a scene with nothing to light.
    """
    if isinstance(path, Mesh):
        mesh, source = path, path.name
    elif Path(path).suffix.lower() == ".xml":
        if not Path(path).is_file():
            raise UserError(f"{path}: no such file; check the path")
        with mitsuba() as mi:
            yield mi, _read_xml(mi, Path(path))
        return
    else:
        mesh, source = read_mesh(path), str(path)
    with mitsuba() as mi:
        yield mi, _from_mesh(mi, mesh, source)


def mitsuba_scene(mi: Any, scene: Scene, **others: Any) -> Any:
    """A Mitsuba scene of the same shapes with other things (emitter, sensor) as given."""
    shapes = {f"shape_{i}": shape for i, shape in enumerate(scene.shapes)}
    return mi.load_dict({"type": "scene", **shapes, **others})


def sensor(mi: Any, scene: Scene, width: int, samples: int = 16) -> Any:
    """The scene's camera, or one that frames everything from the front, a little right and above.

    ``width`` is that of the picture in pixels; the height follows the shape of the scene's film or of what is framed.
    """
    if scene.sensor is not None:
        return scene.sensor
    low, high = scene.traced_bounds
    center, radius = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))
    radius = max(radius, 1e-6)
    fov = 28.0
    view = np.array([0.42, 0.22, 1.0])
    view /= np.linalg.norm(view)
    right = np.cross([0.0, 1.0, 0.0], view)
    right /= np.linalg.norm(right)
    up = np.cross(view, right)
    framed = scene.traced_positions[scene.mesh.receivers]
    x, y = framed @ right, framed @ up
    target = 0.5 * (right * (x.min() + x.max()) + up * (y.min() + y.max())) + view * (view @ center)
    offsets = framed - target
    tangent = math.tan(math.radians(fov / 2))
    depth = offsets @ view
    aspect = float(np.clip(np.ptp(x) / max(np.ptp(y), 1e-9), 0.6, 1.8))
    distance = 1.05 * max(
        float(np.max(np.abs(offsets @ up) / tangent + depth)),
        float(np.max(np.abs(offsets @ right) / (tangent * aspect) + depth)),
        1.2 * radius,
    )
    height = max(1, round(width / aspect))
    to_world = mi.ScalarTransform4f().look_at(
        origin=(target + distance * view).tolist(), target=target.tolist(), up=[0, 1, 0]
    )
    return mi.load_dict(
        {
            "type": "perspective",
            "fov": fov,
            "fov_axis": "y",
            "near_clip": 0.01 * radius,
            "far_clip": 100.0 * radius + 10.0 * distance,
            "to_world": to_world,
            "film": {
                "type": "hdrfilm",
                "width": width,
                "height": height,
                "pixel_format": "rgba",
                "rfilter": {"type": "box"},
            },
            "sampler": {"type": "multijitter", "sample_count": samples},
        }
    )


def _from_mesh(mi: Any, mesh: Mesh, source: str) -> Scene:
    low, high = mesh.positions.min(axis=0), mesh.positions.max(axis=0)
    diagonal = float(np.linalg.norm(high - low))
    origin, scale = 0.5 * (low + high), diagonal if diagonal > 0.0 else 1.0
    shape = mitsuba_mesh(mi, replace(mesh, positions=(mesh.positions - origin) / scale))
    return Scene(source, mesh, (Part(mesh.name, 0, len(mesh.positions)),), origin, scale, (shape,), None)


def mitsuba_mesh(mi: Any, mesh: Mesh) -> Any:
    """A Mitsuba mesh of the same geometry with a diffuse BSDF of its albedo."""
    constant = bool(np.all(mesh.albedo == mesh.albedo[0]))
    reflectance = (
        {"type": "rgb", "value": mesh.albedo[0].tolist()}
        if constant
        else {"type": "mesh_attribute", "name": "vertex_albedo"}
    )
    properties = mi.Properties()
    properties["mesh_bsdf"] = mi.load_dict(
        {"type": "twosided", "material": {"type": "diffuse", "reflectance": reflectance}}
    )
    shape = mi.Mesh(mesh.name, len(mesh.positions), len(mesh.faces), props=properties, has_vertex_normals=True)
    if not constant:
        add_vertex_attribute(mi, shape, "vertex_albedo", mesh.albedo)
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = mi.Float(mesh.positions.astype(np.float32).ravel())
    parameters["vertex_normals"] = mi.Float(mesh.normals.astype(np.float32).ravel())
    parameters["faces"] = mi.UInt32(mesh.faces.astype(np.uint32).ravel())
    parameters.update()
    return shape


def add_vertex_attribute(mi: Any, shape: Any, name: str, values: ArrayLike) -> None:
    """Give a Mitsuba mesh a three-channel attribute per vertex, or change the values of the one it has.

    Mitsuba does not check the length (it would read out of bounds) and returns zeros, silently, for channel counts
    other than one and three.
    """
    array = np.ascontiguousarray(values, dtype=np.float32)
    if array.shape != (shape.vertex_count(), 3):
        raise ValueError(f"{name} must have shape ({shape.vertex_count()}, 3), not {array.shape}")
    parameters = mi.traverse(shape)
    if name in parameters:
        parameters[name] = mi.Float(array.ravel())
        parameters.update()
    else:
        shape.add_attribute(name, 3, array.ravel())


# --- Mitsuba XML -----------------------------------------------------------------------------------------------------


def _read_xml(mi: Any, path: Path) -> Scene:
    try:
        loaded = mi.load_file(str(path))
    except Exception as error:  # whatever Mitsuba's parser and plugins raise
        reason = " ".join(str(error).split()) or type(error).__name__
        raise UserError(f"{path}: Mitsuba cannot load the scene ({reason}); mend it there") from None
    receivers, occluders, meshes, notes = [], [], [], []
    for index, shape in enumerate(loaded.shapes()):
        name = shape.id() or f"shape_{index}"
        if shape.is_emitter():
            notes.append(f"light emitted by shape '{name}'")
        mesh, reason = _receiver(mi, shape, name, str(path))
        if mesh is None:
            occluders.append(shape)
            notes.append(f"light received by shape '{name}' ({reason}; it casts shadows only)")
        else:
            receivers.append(shape)
            meshes.append(mesh)
            if mi.has_flag(shape.bsdf().flags(), mi.BSDFFlags.Glossy) or mi.has_flag(
                shape.bsdf().flags(), mi.BSDFFlags.Delta
            ):
                notes.append(f"glossy or mirror reflection of shape '{name}'")
    if not meshes:
        listed = "; ".join(notes) or "it has no shapes"
        raise UserError(f"{path}: nothing in the scene can be lit ({listed}); add a mesh with a diffuse material")
    notes += [
        f"light of emitter '{emitter.id() or emitter.class_name()}'"
        for emitter in loaded.emitters()
        if not emitter.is_environment() and not mi.has_flag(emitter.flags(), mi.EmitterFlags.Surface)
    ]
    parts, first = [], 0
    for mesh in meshes:
        parts.append(Part(mesh.name, first, len(mesh.positions)))
        first += len(mesh.positions)
    offsets = [part.first for part in parts]
    merged = Mesh(
        path.stem,
        np.concatenate([mesh.positions for mesh in meshes]),
        np.concatenate([mesh.normals for mesh in meshes]),
        np.concatenate([mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=True)]).astype(np.int32),
        np.concatenate([mesh.albedo for mesh in meshes]),
        tuple(note for mesh in meshes for note in mesh.notes),
    )
    sensors = loaded.sensors()
    return Scene(
        str(path),
        merged,
        tuple(parts),
        np.zeros(3),
        1.0,
        (*receivers, *occluders),
        sensors[0] if sensors else None,
        tuple(notes),
    )


def _receiver(mi: Any, shape: Any, name: str, origin: str) -> tuple[Mesh | None, str]:
    """The shape as a receiving mesh, or None and why not."""
    if not shape.is_mesh():
        return None, "not a mesh"
    bsdf = shape.bsdf()
    if bsdf is None or not mi.has_flag(bsdf.flags(), mi.BSDFFlags.DiffuseReflection):
        return None, "its material has no diffuse part"
    import drjit as dr

    # Not by `mi.traverse`: a rectangle is a mesh too, but does not expose its vertices there.
    vertex, face = dr.arange(mi.UInt32, shape.vertex_count()), dr.arange(mi.UInt32, shape.face_count())
    positions = np.array(shape.vertex_position(vertex), dtype=np.float64).T
    faces = np.array(shape.face_indices(face), dtype=np.int64).T
    normals = np.array(shape.vertex_normal(vertex), dtype=np.float64).T if shape.has_vertex_normals() else None
    uv = np.array(shape.vertex_texcoord(vertex), dtype=np.float32).T if shape.has_vertex_texcoords() else None
    if len(positions) < _COARSE:
        log.info(
            "%s: shape '%s' has only %d vertices; light is computed at vertices, so subdivide it to see shadows on it",
            origin,
            name,
            len(positions),
        )
    albedo = _diffuse_reflectance(mi, bsdf, len(positions), uv)
    return make_mesh(
        positions, faces, normals=normals, albedo=albedo, name=name, origin=f"{origin}: shape '{name}'"
    ), ""


def _diffuse_reflectance(mi: Any, bsdf: Any, count: int, uv: NDArray | None) -> NDArray[np.float32]:
    """(V, 3) albedo of the material's diffuse part at the vertices' texture coordinates."""
    import drjit as dr

    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.wi = mi.Vector3f(0.0, 0.0, 1.0)
    si.n = mi.Normal3f(0.0, 0.0, 1.0)
    si.sh_frame = mi.Frame3f(si.n)
    if uv is not None:
        si.uv = mi.Point2f(uv.T)
    reflectance = np.array(bsdf.eval_diffuse_reflectance(si)).T
    return np.broadcast_to(reflectance, (count, 3)).astype(np.float32)
