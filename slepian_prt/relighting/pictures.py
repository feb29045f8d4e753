"""Pictures through Mitsuba's rays and cameras: radiance per vertex interpolated, tone-mapped and written."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from slepian_prt.errors import UserError
from slepian_prt.files import atomic_output
from slepian_prt.renderer.variants import bitmap_module
from slepian_prt.scene.scene import Scene
from slepian_prt.scene.sensors import sensor

_SEED = 17


class Picture(NamedTuple):
    """Linear radiance (H, W, 3), premultiplied by ``alpha`` (H, W), the part of each pixel that receivers cover."""

    radiance: NDArray[np.float32]
    alpha: NDArray[np.float32]


@dataclass(frozen=True)
class Camera:
    """A view of a scene as a linear map from radiance per vertex to pixels.

    Tracing it takes a second or two; after that every relit picture is one sparse product.

    Attributes
    ----------
    weights : sparse (H W, V)
        Filtered barycentric weights of all camera rays that meet the front of a receiver.
    alpha : (H, W)
        Part of each pixel that shows the front of a receiver.
    behind : (H, W)
        Part that shows something else of the scene: the back of a surface, on which transfer knows no light, or a
        shape that only casts shadows.
    """

    weights: csr_array
    alpha: NDArray[np.float32]
    behind: NDArray[np.float32]

    def masked(self, picture: Picture) -> Picture:
        """Another renderer's picture of the same view, reduced to what `picture` shows."""
        share = self.alpha / np.maximum(self.alpha + self.behind, 1e-6)
        return Picture((picture.radiance * share[..., None]).astype(np.float32), self.alpha)

    def picture(self, radiance: NDArray) -> Picture:
        """Draw radiance per vertex, (V, 3), against an empty background."""
        pixels = np.asarray(self.weights @ radiance.astype(np.float32), dtype=np.float32)
        return Picture(pixels.reshape(*self.alpha.shape, 3), self.alpha)


def trace_camera(scene: Scene, width: int | None = None, strata: int = 5) -> Camera:
    """Trace the scene's camera, or one that frames it, with ``strata``² rays per pixel.

    Rays are weighted with the reconstruction filter of the film, so that the picture is comparable with Mitsuba's.
    ``width`` is by default that of the scene's film.
    """
    mi = scene.mi
    import drjit as dr

    view = sensor(scene, width)
    geometry = scene.geometry
    columns, rows = (int(n) for n in view.film().size())
    reconstruction = view.film().rfilter()
    radius = float(reconstruction.radius())
    first_vertex = {shape: part.first for part, shape in zip(scene.parts, scene.shapes, strict=False)}
    vertices = len(scene.mesh.positions)
    rng = np.random.default_rng(_SEED)
    pixel = np.arange(rows * columns)
    x, y = (pixel % columns).astype(np.float32), (pixel // columns).astype(np.float32)
    weights = csr_array((pixel.size, vertices), dtype=np.float32)
    filter_sum = np.zeros(pixel.size)
    covered, behind = np.zeros(pixel.size), np.zeros(pixel.size)
    for stratum in range(strata * strata):
        jitter = (rng.random((2, pixel.size)) + [[stratum % strata], [stratum // strata]]) / strata
        dx, dy = ((2.0 * jitter - 1.0) * radius).astype(np.float32)
        w = np.array(reconstruction.eval(mi.Float(dx))) * np.array(reconstruction.eval(mi.Float(dy)))
        position = mi.Point2f((x + 0.5 + dx) / columns, (y + 0.5 + dy) / rows)
        ray, _ = view.sample_ray(0.0, 0.5, position, mi.Point2f(0.5, 0.5))
        hit = geometry.ray_intersect_preliminary(ray)
        # A ray that slips through an edge of a closed mesh meets its back too: without this test, bright speckles.
        front = hit.compute_surface_interaction(ray, mi.RayFlags.Minimal, hit.is_valid())
        facing = hit.is_valid() & (dr.dot(front.n, ray.d) < 0.0)
        filter_sum += w
        behind += w * np.array(hit.is_valid())
        for shape, first in first_vertex.items():
            on_shape = np.array(facing & (hit.shape == mi.ShapePtr(shape)))
            if not on_shape.any():
                continue
            corner = np.array(shape.face_indices(hit.prim_index, mi.Bool(on_shape)))[:, on_shape] + first
            u, v = np.array(hit.prim_uv)[:, on_shape]
            data = np.concatenate([1.0 - u - v, u, v]) * np.tile(w[on_shape], 3)
            hits = pixel[on_shape]
            covered[on_shape] += w[on_shape]
            weights = weights + csr_array(
                (data.astype(np.float32), (np.tile(hits, 3), corner.ravel())), shape=weights.shape
            )
    dr.flush_malloc_cache()
    scale = 1.0 / np.maximum(filter_sum, 1e-12)
    weights.data *= np.repeat(scale, np.diff(weights.indptr)).astype(np.float32)
    shown, other = ((part * scale).astype(np.float32).reshape(rows, columns) for part in (covered, behind - covered))
    return Camera(weights, shown, np.maximum(other, 0.0))


def split_alpha(pixels: NDArray) -> Picture:
    """A `Picture` from Mitsuba's RGBA pixels; without an alpha channel everything counts as covered."""
    pixels = np.asarray(pixels, dtype=np.float32)
    if pixels.shape[2] == 4:
        return Picture(pixels[..., :3], np.clip(pixels[..., 3], 0.0, 1.0))
    return Picture(pixels[..., :3], np.ones(pixels.shape[:2], dtype=np.float32))


def exposure(picture: Picture, target: float = 0.85) -> float:
    """The factor that brings the 95th percentile of covered pixels to ``target``."""
    covered = picture.alpha > 0.5
    if not covered.any():
        return 1.0
    level = float(np.percentile(picture.radiance[covered].max(axis=1), 95.0))
    return target / level if level > 0.0 else 1.0


def to_srgb(picture: Picture, scale: float = 1.0, background: float = 1.0) -> NDArray[np.uint8]:
    """8-bit sRGB over a plain background; radiance times ``scale``, bright parts rolled off above 0.8."""
    linear = np.maximum(picture.radiance * scale, 0.0)
    knee = 0.8
    linear = np.where(linear > knee, knee + (1 - knee) * np.tanh((linear - knee) / (1 - knee)), linear)
    linear = linear + (1.0 - picture.alpha[..., None]) * background
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-8) ** (1 / 2.4) - 0.055)
    return (np.clip(encoded, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)


def write_picture(path: str | Path, picture: Picture, scale: float | None = None) -> None:
    """Write ``.exr`` (linear radiance and alpha, float32) or ``.png`` (tone-mapped, transparent background).

    ``scale`` is the exposure of a ``.png``, by default that of `exposure`.

    Raises
    ------
    UserError
        Another suffix, or a folder that cannot be written to.
    """
    path = Path(path)
    mi = bitmap_module()
    if path.suffix.lower() == ".exr":
        bitmap = mi.Bitmap(np.dstack([picture.radiance, picture.alpha]).astype(np.float32), pixel_format=_rgba(mi))
        encoded = mi.Bitmap.FileFormat.OpenEXR
    elif path.suffix.lower() == ".png":
        colour = to_srgb(
            Picture(
                (picture.radiance / np.maximum(picture.alpha, 1e-4)[..., None]).astype(np.float32),
                np.ones_like(picture.alpha),
            ),
            exposure(picture) if scale is None else scale,
        )
        opacity = (picture.alpha * 255.0 + 0.5).astype(np.uint8)
        bitmap = mi.Bitmap(np.dstack([colour, opacity]), pixel_format=_rgba(mi))
        bitmap.set_srgb_gamma(True)
        encoded = mi.Bitmap.FileFormat.PNG
    else:
        raise UserError(f"{path}: pictures are written as .png or .exr, not '{path.suffix}'")
    stream = mi.MemoryStream()
    bitmap.write(stream, encoded)
    stream.seek(0)
    with atomic_output(path) as file:
        file.write(stream.raw_buffer())


def _rgba(mi: Any) -> Any:
    return mi.Bitmap.PixelFormat.RGBA
