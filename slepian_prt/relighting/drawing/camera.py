"""A camera as a linear map from radiance of the receivers to pixels, traced with Mitsuba's rays."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.errors import UserError
from slepian_prt.relighting.drawing.film_filter import FilmFilter
from slepian_prt.relighting.drawing.pictures import Picture
from slepian_prt.relighting.drawing.pixel_rays import NOTHING, OTHER, CameraRays, Corners, Seen, widened
from slepian_prt.relighting.drawing.texture_lookup import TextureLookup
from slepian_prt.scene.loading import open_scene
from slepian_prt.scene.receivers import Receivers
from slepian_prt.scene.reflectance.surface_detail import SurfaceDetail
from slepian_prt.scene.scene import Part, Scene
from slepian_prt.scene.sensors import sensor
from slepian_prt.scene.view import Aim, View, aimed_view

if TYPE_CHECKING:
    from slepian_prt.transport.transfer import Transfer

_SEED = 17

# By the side of the square that their rays fill: pixels that show small faces, but nothing that ends.
_SMALL_FACE_STRATA = 4

# An edge that few rays missed is followed for as many times the reach of the filter, which is a pixel at least.
_FOLLOWED = 30

# By the side of the square that their rays fill: pixels that it may go on into.
_LOOKING_STRATA = 3

# Of rays that need not be counted.
_NO_WEIGHT = 0.02

# Of a relit picture where the scene has no camera, in pixels.
DEFAULT_WIDTH = 800


@dataclass(frozen=True, eq=False)
class Camera:
    """A view of a scene as a linear map from radiance per receiver to pixels.

    Tracing it takes about a second; after that every relit picture is one sparse product.

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
    view = _aimed(scene.receivers, scene.view, aim, width, toward_view)
    return replace(scene, view=view, sensor=None)


def relit_view(packed: Transfer | CompressedTransfer, aim: Aim | None = None, width: int | None = None) -> View:
    """The view that `relit_camera` traces."""
    return _aimed(packed.mesh.receivers, packed.view, aim or Aim(), width or DEFAULT_WIDTH, packed.toward_view)


def _aimed(receivers: Receivers, own: View | None, aim: Aim, width: int, toward_view: bool) -> View:
    if toward_view and own is not None and aim.look_at is not None:
        eye = np.array(own.to_world)[:3, 3]
        if not np.allclose(aim.points[0], eye, rtol=1e-6, atol=1e-9):
            raise UserError(
                f"this is light toward the camera '{own.name}', which other places do not see; leave out "
                f"`look_at`, or give it the origin {', '.join(f'{x:.6g}' for x in eye)}"
            )
    points = receivers.positions[receivers.active] if receivers.active.any() else receivers.positions
    return aimed_view(aim, own, points, width)


def trace_camera(
    scene: Scene,
    width: int | None = None,
    strata: int = 6,
    *,
    backs: NDArray[np.integer] | None = None,
    detail: SurfaceDetail | None = None,
) -> Camera:
    """Trace the scene's camera, or one that frames it.

    Rays are weighted with the reconstruction filter of the film, so that the picture is comparable with Mitsuba's.
    Where a pixel shows one smooth surface, whose faces are not too small, rays through its corners are enough; they are
    shared with its neighbours. Elsewhere rays are spread as the filter is.

    Parameters
    ----------
    scene : Scene
    width : int, optional
        In pixels, by default that of the scene's film.
    strata : int
        A pixel in which something ends gets ``strata``² rays.
    backs : (V,), optional
        As of `back_vertices`, by default those of the parts of the scene.
    detail : SurfaceDetail, optional
        Textures, where the scene is a mesh.
    """
    import drjit as dr

    view = sensor(scene, width)
    backs = back_vertices(scene.parts, len(scene.mesh.positions)) if backs is None else backs
    rays = CameraRays(scene, view, backs, None if detail is None else TextureLookup(scene.mi, detail))
    film_filter = FilmFilter.of_film(scene.mi, view.film())
    weight = film_filter.middle_weight
    corners = Corners(rays, in_middle=weight is not None and abs(weight) > _NO_WEIGHT)
    rng = np.random.default_rng(_SEED)
    if weight is None:
        whole = np.ones((corners.rows, corners.columns), dtype=bool)
        pieces = [piece for piece, _ in _sampled_pixels(rays, film_filter, whole, strata, rng)]
    else:
        edge, small = corners.sort(_areas_about(scene))
        pieces, edge = _followed_edges(rays, film_filter, widened(edge, film_filter.reach), strata, rng)
        small &= ~edge
        few = min(strata, _SMALL_FACE_STRATA)
        pieces += [piece for piece, _ in _sampled_pixels(rays, film_filter, small, few, rng)]
        plain = ~(edge | small).ravel() & (corners.seen.face[corners.first_middle :] != NOTHING)
        pieces += _plain_pixels(corners, np.flatnonzero(plain).astype(np.int32), weight)
    dr.flush_malloc_cache()
    return _camera(pieces, corners, rays.corners, len(backs), middle_directions(scene.mi, view))


class _Pixels(NamedTuple):
    """Some pixels (n,), ascending, and what each of k rays sees there; ``weights`` (n, k) sum to one."""

    pixels: NDArray[np.integer]
    weights: NDArray[np.float32]
    seen: Seen


def _plain_pixels(corners: Corners, pixels: NDArray[np.int32], middle_weight: float) -> list[_Pixels]:
    """Pixels of which the middle and the corners tell all; those of one face as if it was met once."""
    weights = np.array([middle_weight, *[0.25 * (1.0 - middle_weight)] * 4], dtype=np.float32)
    rays = corners.around(pixels)
    if abs(middle_weight) < _NO_WEIGHT:
        rays, weights = rays[:, 1:], np.full(4, 0.25, dtype=np.float32)
    face = corners.seen.face[rays]
    # Reflectance is the same as good as everywhere in a pixel.
    alone = (face[:, 1:] == face[:, :1]).all(axis=1)
    first = corners.seen.of(rays[alone, 0])
    one = first._replace(u=corners.seen.u[rays[alone]] @ weights, v=corners.seen.v[rays[alone]] @ weights)
    several = np.broadcast_to(weights, (len(pixels) - int(alone.sum()), weights.size))
    return [
        _Pixels(pixels[alone], np.ones((one.face.size, 1), dtype=np.float32), one),
        _Pixels(pixels[~alone], several, corners.seen.of(rays[~alone].ravel())),
    ]


def _followed_edges(
    rays: CameraRays, film_filter: FilmFilter, edge: NDArray[np.bool_], strata: int, rng: np.random.Generator
) -> tuple[list[_Pixels], NDArray[np.bool_]]:
    """Pixels (H, W) in which something ends, and those that it goes on into though few rays did not meet it there."""
    pieces, looked = [], edge.copy()
    done = np.zeros_like(edge)
    for _ in range(_FOLLOWED):
        ends = np.zeros_like(edge)
        for piece, found in _sampled_pixels(rays, film_filter, edge, strata, rng):
            pieces.append(piece)
            ends.ravel()[piece.pixels] = found
        done |= edge
        near = widened(ends, max(1, film_filter.reach)) & ~looked
        if not near.any():
            break
        looked |= near
        edge = np.zeros_like(edge)
        for piece, found in _sampled_pixels(rays, film_filter, near, _LOOKING_STRATA, rng):
            edge.ravel()[piece.pixels] = found
    return pieces, done


def _sampled_pixels(
    rays: CameraRays, film_filter: FilmFilter, chosen: NDArray[np.bool_], strata: int, rng: np.random.Generator
) -> Iterator[tuple[_Pixels, NDArray[np.bool_]]]:
    """Pixels (H, W) whose filter is sampled, jittered in each of its strata; and whether something ends in each."""
    pixels, stratum = np.flatnonzero(chosen), np.arange(strata * strata)
    jitter = rng.random((2, pixels.size, stratum.size), dtype=np.float32)
    dx, sign_x = film_filter.sample((stratum % strata + jitter[0]) / strata)
    dy, sign_y = film_filter.sample((stratum // strata + jitter[1]) / strata)
    weights = sign_x * sign_y
    weights /= np.maximum(weights.sum(axis=1, keepdims=True), 1.0)
    for block, seen, ends in rays.see_many(pixels, dx, dy):
        yield _Pixels(pixels[block], weights[block], seen), ends


def _camera(
    pieces: Sequence[_Pixels],
    corners: Corners,
    table: NDArray[np.int32],
    receivers: int,
    directions: NDArray[np.float32],
) -> Camera:
    """Rows of the weights of all pixels put together; ``table`` is that of the receivers at the corners of faces."""
    pixels = corners.rows * corners.columns
    alpha, behind = np.zeros(pixels, dtype=np.float32), np.zeros(pixels, dtype=np.float32)
    counts = np.zeros(pixels + 1, dtype=np.int64)
    for piece in pieces:
        face = piece.seen.face.reshape(piece.weights.shape)
        alpha[piece.pixels] = np.sum(piece.weights * (face >= 0), axis=1)
        behind[piece.pixels] = np.sum(piece.weights * (face == OTHER), axis=1)
        counts[piece.pixels + 1] = 3 * np.sum(face >= 0, axis=1)
    starts = np.cumsum(counts)
    vertices = np.empty(starts[-1], dtype=np.int32 if starts[-1] < 2**31 else np.int64)
    channels = corners.seen.reflectance.shape[1]
    values = [np.empty(starts[-1], dtype=np.float32) for _ in range(channels)]
    for piece in pieces:
        front = np.flatnonzero(piece.seen.face >= 0)
        row = front // piece.weights.shape[1]
        # Where the rays of a pixel go, one after the other.
        first = np.concatenate([[0], np.cumsum(counts[piece.pixels + 1] // 3)])
        places = (starts[piece.pixels[row]] + 3 * (np.arange(front.size) - first[row]))[:, None] + np.arange(3)
        face, u, v, reflectance = piece.seen.of(front)
        vertices[places] = table[face]
        weighted = np.stack([1.0 - u - v, u, v], axis=1) * piece.weights.ravel()[front, None]
        for channel in range(channels):
            values[channel][places] = weighted * reflectance[:, channel, None]
    indices = starts.astype(vertices.dtype)
    weights = tuple(csr_array((data, vertices, indices), shape=(pixels, receivers)) for data in values)
    shape = corners.rows, corners.columns
    alpha, behind = np.clip(alpha, 0.0, 1.0).reshape(shape), np.maximum(behind, 0.0).reshape(shape)
    return Camera(weights, alpha, behind, directions)


def _areas_about(scene: Scene) -> NDArray[np.float64]:
    """(V,) mean area of the faces about each receiver, in the space that Mitsuba traces in."""
    faces, positions = scene.mesh.faces, scene.mesh.positions / scene.scale
    a, b, c = (positions[faces[:, corner]] for corner in range(3))
    area = np.repeat(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1), 3)
    count = np.bincount(faces.ravel(), minlength=len(positions))
    return np.bincount(faces.ravel(), area, minlength=len(positions)) / np.maximum(count, 1)


def middle_directions(mi: Any, view: Any) -> NDArray[np.float32]:
    """(H, W, 3) directions through the middles of the pixels."""
    columns, rows = (int(n) for n in view.film().size())
    pixel = np.arange(rows * columns)
    x, y = ((pixel % columns) + 0.5) / columns, ((pixel // columns) + 0.5) / rows
    place = mi.Point2f(x.astype(np.float32), y.astype(np.float32))
    ray, _ = view.sample_ray(0.0, 0.5, place, mi.Point2f(0.5, 0.5))
    return np.array(ray.d, dtype=np.float32).T.reshape(rows, columns, 3)
