"""One pass over a block of pixels: paths from the camera, added up."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.paths.harmonics import sum_paths
from slepian_prt.paths.tracer import PathTracer
from slepian_prt.transport.capturing.camera import CameraRays
from slepian_prt.transport.capturing.pixel_means import BlockMeans

# Paths that are followed at a time.
LANES = 1 << 19


def stratified_sampler(mi: Any, per_pixel: int, pixels: NDArray[np.int64], seed: int, *numbers: int) -> Any:
    """A sampler whose lanes are ``per_pixel`` for each pixel, side by side, stratified among themselves.

    Pixels are consecutive; ``numbers`` tell passes apart.
    """
    base = int(np.random.SeedSequence([seed, *numbers]).generate_state(1)[0])
    sampler = mi.load_dict({"type": "multijitter", "sample_count": per_pixel, "seed": base})
    sampler.set_samples_per_wavefront(per_pixel)
    # Each pixel has a sequence of its own: how many lanes there are before it.
    sampler.seed(int(pixels[0]) * per_pixel % (1 << 32), per_pixel * len(pixels))
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

    def trace(self, pixels: NDArray[np.int64], number: int) -> BlockMeans:
        """Pass ``number`` of some pixels, which are consecutive."""
        import drjit as dr

        mi, count = self._mi, self._per_pixel
        sampler = stratified_sampler(mi, count, pixels, self._seed, number)
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
        sums = sum_paths(mi, self._bandlimit, replace(ends, throughput=contribution), count)
        return BlockMeans(sums.vectors, background, sums.squares * np.float32(count), rays)
