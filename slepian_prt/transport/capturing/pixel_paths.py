"""One pass over a block of pixels: paths from the camera, added up; and what lies behind the pixels."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.paths.harmonics import sum_paths
from slepian_prt.paths.tracer import PathTracer
from slepian_prt.transport.capturing.camera import CameraRays
from slepian_prt.transport.capturing.sums import BlockSums

# Paths that are followed at a time.
LANES = 1 << 19


def stratified_sampler(mi: Any, per_pixel: int, pixels: int, seed: int, sequence: int) -> Any:
    """A sampler whose lanes are ``per_pixel`` for each pixel, side by side, stratified among themselves.

    ``sequence`` (below 2³²) is another for each pixel and pass: how many lanes came before.
    """
    base = int(np.random.SeedSequence(seed).generate_state(1)[0])
    sampler = mi.load_dict({"type": "multijitter", "sample_count": per_pixel, "seed": base})
    sampler.set_samples_per_wavefront(per_pixel)
    sampler.seed(sequence % (1 << 32), per_pixel * pixels)
    return sampler


def pixels_of_lanes(mi: Any, pixels: NDArray[np.int64], per_pixel: int) -> Any:
    """UInt32, the pixel of each lane; ``pixels`` are consecutive."""
    import drjit as dr

    return dr.arange(mi.UInt32, len(pixels) * per_pixel) // dr.opaque(mi.UInt32, per_pixel) + dr.opaque(
        mi.UInt32, int(pixels[0])
    )


class PixelPaths:
    """Paths from the pixels of a camera through a scene, whose ends are all distant light.

    Parameters
    ----------
    mi : Mitsuba, in the variant of the scene
    tracer : PathTracer
    rays : CameraRays
    bandlimit, per_pixel, seed : int
    """

    def __init__(
        self, mi: Any, tracer: PathTracer, rays: CameraRays, bandlimit: int, per_pixel: int, seed: int
    ) -> None:
        self._mi, self._tracer, self._rays = mi, tracer, rays
        self._bandlimit, self._per_pixel, self._seed = bandlimit, per_pixel, seed

    def trace(self, pixels: NDArray[np.int64], number: int) -> BlockSums:
        """Pass ``number`` of some pixels, which are consecutive."""
        import drjit as dr

        mi, count = self._mi, self._per_pixel
        sequence = (number * self._rays.width * self._rays.height + int(pixels[0])) * count
        sampler = stratified_sampler(mi, count, len(pixels), self._seed, sequence)
        ray, weight = self._rays.sample(sampler, pixels_of_lanes(mi, pixels, count))
        ends = self._tracer.follow(sampler, ray, medium=self._rays.medium)
        carried = dr.select(ends.escaped, ends.throughput, 0.0) * (weight * (1.0 / count))
        behind = dr.select(ends.covered, mi.Color3f(0.0), carried)
        segments = mi.Float(ends.points) + 1.0
        contribution = dr.select(ends.covered, carried, 0.0)
        # At once, or the paths would be followed for each of them.
        dr.eval(contribution, behind, segments, ends.escaped, ends.ray.d)
        background = np.stack([np.array(dr.block_sum(one, count)) for one in behind], axis=1)
        rays = np.array(dr.block_sum(segments, count))
        vectors = sum_paths(mi, self._bandlimit, replace(ends, throughput=contribution), count).vectors
        return BlockSums(vectors, background, rays)


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
