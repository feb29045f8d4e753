"""What the pixels of a camera show first."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.transport.capturing.camera import CameraRays


class Guides(NamedTuple):
    """What the middles of the pixels show first, which tells pixels that are alike from others.

    Attributes
    ----------
    normals : (V, 3) float32
        Shading normals toward the camera; zero where nothing is met.
    depth : (V,) float32
        Distance; zero where nothing is met.
    albedo : (V, 3) float32
        Diffuse reflectance.
    shapes : (V,) uint32
        Number of the shape; zero where nothing is met.
    """

    normals: NDArray[np.float32]
    depth: NDArray[np.float32]
    albedo: NDArray[np.float32]
    shapes: NDArray[np.uint32]


def look_at_surfaces(mi: Any, scene: Any, rays: CameraRays) -> Guides:
    """One ray through each pixel."""
    import drjit as dr

    count = rays.width * rays.height
    ray = rays.middles(dr.arange(mi.UInt32, count))
    si = scene.ray_intersect(ray)
    hit = si.is_valid()
    normal = dr.mulsign(si.sh_frame.n, -dr.dot(si.n, ray.d))
    albedo = mi.unpolarized_spectrum(si.bsdf().eval_diffuse_reflectance(si, hit))
    shape = dr.select(hit, dr.reinterpret_array(mi.UInt32, si.shape), 0)

    def table(value: Any) -> NDArray[np.float32]:
        chosen = np.array(dr.select(hit, value, 0.0), dtype=np.float32)
        return np.ascontiguousarray(np.broadcast_to(chosen, (3, count)).T)

    depth = np.array(dr.select(hit, si.t, 0.0), dtype=np.float32)
    return Guides(table(normal), depth, np.nan_to_num(table(mi.Color3f(albedo))), np.array(shape))
