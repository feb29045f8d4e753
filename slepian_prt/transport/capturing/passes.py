"""Passes over all pixels until there are as many as are wanted, the noise is small enough, or the time is over."""

from __future__ import annotations

import contextlib
import hashlib
import logging
import math
import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.lighting.spectrum import falling_prior
from slepian_prt.paths.tracer import PathTracer
from slepian_prt.scene.film import Film, stored_axes
from slepian_prt.sphere.harmonics import degrees
from slepian_prt.transport.capturing.camera import CameraRays
from slepian_prt.transport.capturing.denoising import Pixels
from slepian_prt.transport.capturing.pixel_means import PixelMeans
from slepian_prt.transport.capturing.pixel_paths import LANES, PixelPaths
from slepian_prt.transport.capturing.settings import CaptureSettings

log = logging.getLogger(__name__)

# What Mitsuba calls objects without an id: by their addresses.
_UNNAMED = re.compile(r"object_\d+")


@dataclass(frozen=True, eq=False)
class Job:
    """What is captured.

    Attributes
    ----------
    mi : Mitsuba
    loaded : Mitsuba scene
    name : str
        Of the scene.
    sensor : Mitsuba sensor
    rays : CameraRays
    settings : CaptureSettings
    power : (L+1,) or None
        Of the light that noise counts under.
    """

    mi: Any
    loaded: Any
    name: str
    sensor: Any
    rays: CameraRays
    settings: CaptureSettings
    power: NDArray[np.float64] | None = None

    @property
    def pixels(self) -> int:
        """Their number."""
        return self.rays.width * self.rays.height

    @property
    def per_block(self) -> int:
        """Pixels that are traced at a time."""
        return max(1, min(self.pixels, LANES // self.settings.per_pass))

    @property
    def light(self) -> NDArray[np.float64]:
        """(L+1,) power that noise counts under."""
        return falling_prior(self.settings.bandlimit).weights ** 2 if self.power is None else self.power

    @cached_property
    def paths(self) -> PixelPaths:
        """What traces a block."""
        materials = [node for node in self.mi.traverse(self.loaded).hierarchy if isinstance(node, self.mi.BSDF)]
        tracer = PathTracer(self.mi, self.loaded, materials)
        settings = self.settings
        return PixelPaths(self.mi, tracer, self.rays, settings.bandlimit, settings.per_pass, settings.seed)


def fingerprint(job: Job) -> str:
    """Of everything that the means of passes depend on: all parameters of the scene, its camera and its numbers."""
    digest, settings = hashlib.sha256(), job.settings
    numbers = (version("slepian_prt"), job.mi.variant(), settings.bandlimit, settings.per_pass, settings.seed)
    digest.update(repr((*numbers, job.sensor.id(), str(job.loaded))).encode())
    parameters = job.mi.traverse(job.loaded)
    for name in parameters.keys():  # noqa: SIM118 (going through pairs, Mitsuba fails at what a hair BSDF leaves unset)
        digest.update(_UNNAMED.sub("", name).encode())
        with contextlib.suppress(TypeError):  # of which one is reading it
            value = parameters[name]
            # An array of a Mitsuba transform would hold its address.
            digest.update(np.ascontiguousarray(np.array(getattr(value, "matrix", value))).tobytes())
    return digest.hexdigest()[:32]


def add_passes(job: Job, held: PixelMeans, advance: Callable[[int, int], None]) -> int:
    """Trace until what is asked for is there; the number of passes, which all blocks have then."""
    settings, started = job.settings, time.perf_counter()
    kept = sum(held.passes(block) for block in range(held.blocks))
    if kept:
        log.info("%d of %d blocks of pixels were finished before and are kept", kept, held.blocks * settings.passes)
    done, wanted, told = 0, settings.passes, 0
    while done < wanted:
        for block in range(held.blocks):
            pixels = held.pixels(block)
            if held.passes(block) <= done:
                held.add(block, job.paths.trace(pixels, done))
            total = wanted * job.pixels
            advance(len(pixels), max(total, told))
            told = max(total, told)
        done += 1
        if settings.is_open and done >= settings.passes:
            wanted = _wanted_passes(job, held, done, time.perf_counter() - started)
    return done


def _wanted_passes(job: Job, held: PixelMeans, done: int, seconds: float) -> int:
    """How many passes the goals want, as the noise and the time of those that are done tell."""
    settings, wanted = job.settings, [job.settings.most_passes]
    if settings.max_error is not None:
        noise = _relative_noise(job, held)
        wanted.append(done if noise <= settings.max_error else math.ceil(done * (noise / settings.max_error) ** 2))
    if settings.max_seconds is not None:
        wanted.append(max(done, int(settings.max_seconds * done / max(seconds, 1e-9))))
    return min(wanted)


def _relative_noise(job: Job, held: PixelMeans) -> float:
    """Relative RMS noise of the picture, averaged over the rotations of the light."""
    noise, signal = 0.0, 0.0
    counts = np.bincount(degrees(job.settings.bandlimit))
    for block in range(held.blocks):
        means, variance = held.means(block)
        noise += float(variance.sum(axis=(0, 1), dtype=np.float64) @ (counts * job.light))
        signal += float(
            (means.vectors.astype(np.float64) ** 2).sum(axis=(0, 1)) @ job.light[degrees(job.settings.bandlimit)]
        )
    # The energy of the means holds that of their noise.
    return math.sqrt(noise / max(signal - noise, 1e-300)) if signal > 0.0 else 0.0


def collect(job: Job, held: PixelMeans) -> Pixels:
    """All pixels, their vectors on disk."""
    variance = np.empty((job.pixels, 3, job.settings.bandlimit + 1), dtype=np.float32)
    background, moments = (np.empty((job.pixels, 3), dtype=np.float32) for _ in range(2))
    traced = 0.0
    for block in range(held.blocks):
        pixels = held.pixels(block)
        means, variance[pixels] = held.means(block)
        background[pixels], moments[pixels] = means.background, means.moments
        traced += held.passes(block) * float(means.rays.sum(dtype=np.float64))
    return Pixels(held.vectors(), variance, background, moments, round(traced))


def film_of(job: Job, pixels: Pixels) -> Film:
    """The film of the camera, with the noise of its pixels."""
    rays, counts = job.rays, np.bincount(degrees(job.settings.bandlimit))
    # A light of mean radiance 1 has 4π in degree 0.
    falling = 4.0 * math.pi * falling_prior(job.settings.bandlimit).weights ** 2
    return Film(
        name=job.sensor.id(),
        width=rays.width,
        height=rays.height,
        crop=rays.crop,
        size=rays.size,
        background=pixels.background,
        directions=rays.directions(),
        noise=np.sqrt(pixels.variance.mean(axis=1) @ (counts * falling)).astype(np.float32),
        noise_power=pixels.variance.sum(axis=1).mean(axis=0, dtype=np.float64) * counts,
    )


def axes_of(vectors: NDArray[np.float32], normals: NDArray[np.float32]) -> NDArray[np.float64]:
    """(V, 3) axes of pixels, as files keep them: the normals of what they show, zero where no light arrives.

    Where no surface is met in the middle of a pixel, the mean direction of its light stands in. Of a picture that is
    all dark no axis is zero, as there must be some.
    """
    if vectors.shape[2] == 1:
        bent = np.zeros((len(vectors), 3))
    else:
        first = vectors[:, :, :4].mean(axis=1, dtype=np.float64)
        bent = np.stack([-first[:, 3], -first[:, 1], first[:, 2]], axis=1)
    length = np.linalg.norm(bent, axis=1, keepdims=True)
    bent = np.where(length > 0.0, bent / np.maximum(length, 1e-300), [0.0, 0.0, 1.0])
    known = np.any(normals != 0.0, axis=1)
    lit = np.asarray(vectors.any(axis=(1, 2)))
    lit |= not lit.any()
    return stored_axes(np.where(lit[:, None], np.where(known[:, None], normals, bent), 0.0))
