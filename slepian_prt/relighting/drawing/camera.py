"""A camera as a linear map from radiance of the receivers to pixels, traced with Mitsuba's rays."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.errors import UserError
from slepian_prt.relighting.drawing.pictures import Picture
from slepian_prt.relighting.drawing.texture_lookup import TextureLookup
from slepian_prt.scene.loading import open_scene
from slepian_prt.scene.reflectance.surface_detail import SurfaceDetail
from slepian_prt.scene.scene import Part, Scene
from slepian_prt.scene.sensors import sensor
from slepian_prt.scene.view import Aim, aimed_view
from slepian_prt.transport.transfer import Transfer

_SEED = 17

# Of a relit picture where the scene has no camera, in pixels.
DEFAULT_WIDTH = 800


@dataclass(frozen=True, eq=False)
class Camera:
    """A view of a scene as a linear map from radiance per receiver to pixels.

    Tracing it takes a second or two; after that every relit picture is one sparse product.

    Attributes
    ----------
    weights : one sparse (H W, V), or three of them
        Filtered barycentric weights of all camera rays that meet the front of a receiver's surface; with textures
        times what it reflects there, for red, green and blue.
    alpha : (H, W)
        Part of each pixel that shows the front of such a surface, or a back that has receivers of its own.
    behind : (H, W)
        Part that shows something else of the scene: the back of a surface, on which transfer knows no light, or a
        shape that only casts shadows.
    directions : (H, W, 3)
        From the camera through the middles of the pixels, in world space.
    """

    weights: tuple[csr_array, ...]
    alpha: NDArray[np.float32]
    behind: NDArray[np.float32]
    directions: NDArray[np.float32]

    def masked(self, picture: Picture) -> Picture:
        """Another renderer's picture of the same view, reduced to what `picture` shows."""
        share = self.alpha / np.maximum(self.alpha + self.behind, 1e-6)
        return Picture((picture.radiance * share[..., None]).astype(np.float32), self.alpha)

    @property
    def is_textured(self) -> bool:
        """Whether reflectance is in the weights, so that radiance is wanted for unit albedo."""
        return len(self.weights) > 1

    def picture(self, radiance: NDArray) -> Picture:
        """Draw radiance per receiver, (V, 3), against an empty background; with textures that for unit albedo."""
        values = radiance.astype(np.float32)
        if self.is_textured:
            columns = zip(self.weights, values.T, strict=True)
            pixels = np.stack([weights @ np.ascontiguousarray(column) for weights, column in columns], axis=1)
        else:
            pixels = np.asarray(self.weights[0] @ values, dtype=np.float32)
        return Picture(pixels.reshape(*self.alpha.shape, 3), self.alpha)


def relit_camera(
    packed: Transfer | CompressedTransfer,
    width: int | None = None,
    aim: Aim | None = None,
    detail: SurfaceDetail | None = None,
) -> Camera:
    """The camera that is asked for, else that of the scene, else one that frames the mesh, by default 800 pixels wide.

    Parameters
    ----------
    packed : Transfer or CompressedTransfer
    width : int, optional
    aim : Aim, optional
    detail : SurfaceDetail, optional
        Textures of the mesh, looked up by each ray.

    Raises
    ------
    UserError
        The transfer is that toward another camera.
    """
    backs = back_vertices(packed.parts, len(packed.mesh.positions))
    # Both sides are at the same places: rays would meet either.
    fronts = replace(packed.mesh, faces=packed.mesh.faces[~is_back(packed.parts, packed.mesh.faces)])
    with open_scene(fronts) as scene:
        viewed = replace(scene, view=packed.view)
        aimed = aim_camera(viewed, aim, width or DEFAULT_WIDTH, toward_view=packed.toward_view)
        return trace_camera(aimed, width, backs=backs, detail=detail)


def back_vertices(parts: Sequence[Part], count: int) -> NDArray[np.int64]:
    """(count,) the vertex on the back of each vertex; -1 where there is none."""
    backs = np.full(count, -1, dtype=np.int64)
    for part in parts:
        if part.sides == 2:
            backs[part.first : part.first + part.count] = np.arange(part.first + part.count, part.end)
    return backs


def is_back(parts: Sequence[Part], faces: NDArray) -> NDArray[np.bool_]:
    """(F,) which faces are backs of others."""
    backs = np.zeros(len(faces), dtype=bool)
    for part in parts:
        if part.sides == 2:
            backs |= (faces[:, 0] >= part.first + part.count) & (faces[:, 0] < part.end)
    return backs


def aim_camera(scene: Scene, aim: Aim | None, width: int, *, toward_view: bool = False) -> Scene:
    """The scene with the camera that is asked for, or one that frames its receivers if it has none.

    Parameters
    ----------
    scene : Scene
    aim : Aim or None
    width : int
        In pixels, unless the scene has a camera.
    toward_view : bool
        Whether the transfer is that toward the scene's camera.

    Raises
    ------
    UserError
        Such transfer is wanted from elsewhere.
    """
    aim = aim or Aim()
    if scene.sensor is not None and not aim.asked:
        return scene  # no plain perspective camera, but the scene's own
    if toward_view and scene.view is not None and aim.look_at is not None:
        eye = np.array(scene.view.to_world)[:3, 3]
        if not np.allclose(aim.points[0], eye, rtol=1e-6, atol=1e-9):
            raise UserError(
                f"this is light toward the camera '{scene.view.name}', which other places do not see; leave out "
                f"`look_at`, or give it the origin {', '.join(f'{x:.6g}' for x in eye)}"
            )
    receivers = scene.receivers
    points = receivers.positions[receivers.active] if receivers.active.any() else receivers.positions
    return replace(scene, view=aimed_view(aim, scene.view, points, width), sensor=None)


def trace_camera(
    scene: Scene,
    width: int | None = None,
    strata: int = 5,
    *,
    backs: NDArray[np.integer] | None = None,
    detail: SurfaceDetail | None = None,
) -> Camera:
    """Trace the scene's camera, or one that frames it.

    Rays are weighted with the reconstruction filter of the film, so that the picture is comparable with Mitsuba's.

    Parameters
    ----------
    scene : Scene
    width : int, optional
        In pixels, by default that of the scene's film.
    strata : int
        Each pixel gets ``strata``² rays.
    backs : (V,), optional
        As of `back_vertices`, by default those of the parts of the scene.
    detail : SurfaceDetail, optional
        Textures, where the scene is a mesh.
    """
    import drjit as dr

    view = sensor(scene, width)
    backs = back_vertices(scene.parts, len(scene.mesh.positions)) if backs is None else backs
    textures = None if detail is None else TextureLookup(scene.mi, detail)
    columns, rows = (int(n) for n in view.film().size())
    pixels = rows * columns
    # Σ filter × barycentric, × reflectance
    weights = [csr_array((pixels, len(backs)), dtype=np.float32) for _ in range(1 if textures is None else 3)]
    filter_sum = np.zeros(pixels)  # Σ filter, of all rays
    met = np.zeros(pixels)  # of those that meet any shape
    covered = np.zeros(pixels)  # of those that meet the front of a receiver's surface
    for position, w in _film_samples(scene.mi, view.film(), strata):
        ray, _ = view.sample_ray(0.0, 0.5, position, scene.mi.Point2f(0.5, 0.5))
        valid, front, barycentric, reflectance = _trace_barycentric(scene, ray, backs, textures)
        filter_sum += w
        met += w * valid
        covered += w * front
        for channel, factors in enumerate(reflectance * w):
            weights[channel] = weights[channel] + _scaled(barycentric, factors)
    dr.flush_malloc_cache()
    scale = 1.0 / np.maximum(filter_sum, 1e-12)
    alpha, behind = ((part * scale).astype(np.float32).reshape(rows, columns) for part in (covered, met - covered))
    weights = [_scaled(one, scale) for one in weights]
    return Camera(tuple(weights), alpha, np.maximum(behind, 0.0), middle_directions(scene.mi, view))


def middle_directions(mi: Any, view: Any) -> NDArray[np.float32]:
    """(H, W, 3) directions through the middles of the pixels."""
    columns, rows = (int(n) for n in view.film().size())
    pixel = np.arange(rows * columns)
    x, y = ((pixel % columns) + 0.5) / columns, ((pixel // columns) + 0.5) / rows
    place = mi.Point2f(x.astype(np.float32), y.astype(np.float32))
    ray, _ = view.sample_ray(0.0, 0.5, place, mi.Point2f(0.5, 0.5))
    return np.array(ray.d, dtype=np.float32).T.reshape(rows, columns, 3)


def _film_samples(mi: Any, film: Any, strata: int) -> Iterator[tuple[Any, NDArray[np.float32]]]:
    """A place on the film for each pixel, jittered in one stratum of its filter after the other, and filter weights.

    Places are Point2f in [0, 1]², row by row.
    """
    columns, rows = (int(n) for n in film.size())
    reconstruction = film.rfilter()
    radius = float(reconstruction.radius())
    rng = np.random.default_rng(_SEED)
    pixel = np.arange(rows * columns)
    x, y = (pixel % columns).astype(np.float32), (pixel // columns).astype(np.float32)
    for stratum in range(strata * strata):
        jitter = (rng.random((2, pixel.size)) + [[stratum % strata], [stratum // strata]]) / strata
        dx, dy = ((2.0 * jitter - 1.0) * radius).astype(np.float32)
        weight = np.array(reconstruction.eval(mi.Float(dx))) * np.array(reconstruction.eval(mi.Float(dy)))
        yield mi.Point2f((x + 0.5 + dx) / columns, (y + 0.5 + dy) / rows), weight


def _scaled(matrix: csr_array, factors: NDArray) -> csr_array:
    """Rows times factors."""
    data = matrix.data * np.repeat(factors, np.diff(matrix.indptr)).astype(np.float32)
    return csr_array((data, matrix.indices, matrix.indptr), shape=matrix.shape)


def _trace_barycentric(
    scene: Scene, ray: Any, backs: NDArray[np.integer], textures: TextureLookup | None
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], csr_array, NDArray[np.float32]]:
    """What P rays meet.

    Returns
    -------
    valid : (P,)
        Whether that is any shape.
    seen : (P,)
        Whether it is a side of a surface that has receivers.
    barycentric : sparse (P, V) float32
        Weights of the receivers there.
    reflectance : (1 or 3, P) float32
        By textures; one without any.
    """
    import drjit as dr

    mi = scene.mi
    hit = scene.geometry.ray_intersect_preliminary(ray)
    # A ray that slips through an edge of a closed mesh meets its back too: without this test, bright speckles.
    si = hit.compute_surface_interaction(ray, mi.RayFlags.Minimal, hit.is_valid())
    toward = hit.is_valid() & (dr.dot(si.n, ray.d) < 0.0)
    dr.eval(hit, toward)  # once: each array that is taken of them would trace the rays again
    facing = np.array(toward)
    seen = np.zeros(facing.size, dtype=bool)
    shape = (seen.size, len(scene.mesh.positions))
    face = np.array(scene.hit_faces(hit))
    rays = np.flatnonzero(face >= 0)
    corners = scene.faces[face[rays]].T.astype(np.int64)
    corners = np.where(facing[rays], corners, backs[corners])
    kept = (corners >= 0).all(axis=0)
    rays, corners = rays[kept], corners[:, kept]
    u, v = np.array(hit.prim_uv)[:, rays]
    entries = np.concatenate([1.0 - u - v, u, v]).astype(np.float32)
    barycentric = csr_array((entries, (np.tile(rays, 3), corners.ravel())), shape=shape)
    seen[rays] = True
    reflectance = np.ones((1, seen.size), dtype=np.float32)
    if textures is not None:
        u, v = hit.prim_uv
        reflectance = np.array(textures.reflectance(hit.prim_index, u, v, mi.Bool(seen)), dtype=np.float32)
    return np.array(hit.is_valid()), seen, barycentric, reflectance
