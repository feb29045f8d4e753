"""Passes over all pixels until there are as many as are wanted, the noise is small enough, or the time is over."""

from __future__ import annotations

import contextlib
import hashlib
import logging
import math
import re
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from slepian_prt.lighting.lamps import Lamp
from slepian_prt.lighting.spectrum import falling_prior
from slepian_prt.paths.tracer import PathTracer
from slepian_prt.scene.film import Film, stored_axes
from slepian_prt.sphere.harmonics import degrees
from slepian_prt.transport.capturing.camera import CameraRays
from slepian_prt.transport.capturing.denoising import Pixels
from slepian_prt.transport.capturing.lamp_pictures import picture_lamp
from slepian_prt.transport.capturing.pixel_means import BlockMeans, PixelMeans
from slepian_prt.transport.capturing.pixel_paths import LANES, PixelPaths
from slepian_prt.transport.capturing.remarks import check_means
from slepian_prt.transport.capturing.settings import CaptureSettings
from slepian_prt.transport.smoothing import relative_noise

log = logging.getLogger(__name__)

# Passes are so many times as many at most, before the noise is looked at again.
_MOST_AT_ONCE = 4.0

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


class Tracer(Protocol):
    """What traces blocks of pixels, and pictures of lamps."""

    def blocks(self, items: Sequence[tuple[NDArray[np.int64], int]]) -> Iterator[BlockMeans]:
        """Passes of some pixels by their numbers, in order."""
        ...

    def lamp_pictures(self, lamps: Sequence[Lamp], passes: int) -> Iterator[NDArray[np.float32]]:
        """(V, 3) for each lamp and pass, in order."""
        ...


@dataclass(frozen=True, eq=False)
class TracerHere:
    """Traces in this process."""

    job: Job

    def blocks(self, items: Sequence[tuple[NDArray[np.int64], int]]) -> Iterator[BlockMeans]:
        """As of `Tracer`."""
        return (self.job.paths.trace(pixels, number) for pixels, number in items)

    def lamp_pictures(self, lamps: Sequence[Lamp], passes: int) -> Iterator[NDArray[np.float32]]:
        """As of `Tracer`."""
        return (
            lamp_picture(self.job, lamp, one, 1 + number) for number, lamp in enumerate(lamps) for one in range(passes)
        )


def lamp_picture(job: Job, lamp: Lamp, one: int, stream: int) -> NDArray[np.float32]:
    """(V, 3) of a lamp alone, in one of the passes."""
    settings = job.settings
    return picture_lamp(job.mi, job.loaded, job.rays, lamp, settings.per_pass, (settings.seed, one, stream))


def add_passes(
    job: Job, tracer: Tracer, held: PixelMeans, noise: Callable[[int], float], advance: Callable[[int, int], None]
) -> int:
    """Trace until what is asked for is there; the number of passes, which all blocks have then.

    Parameters
    ----------
    job : Job
    tracer : Tracer
        Of the job.
    held : PixelMeans
        With what was finished before.
    noise : callable
        Gives the relative noise of what is held, of so many passes.
    advance : as of `capture`

    Raises
    ------
    UserError
        Light is not finite.
    """
    settings, started = job.settings, time.perf_counter()
    kept = [held.passes(block) for block in range(held.blocks)]
    done = first = min(kept)
    wanted = max(settings.passes, max(kept))
    if sum(kept):
        log.info("%d of %d blocks of pixels were finished before and are kept", sum(kept), held.blocks * wanted)
        advance(sum(passes * len(held.pixels(block)) for block, passes in enumerate(kept)), wanted * job.pixels)
    while done < wanted:
        left = [(b, p) for p in range(done, wanted) for b in range(held.blocks) if held.passes(b) <= p]
        for (block, _), means in zip(left, tracer.blocks([(held.pixels(b), p) for b, p in left]), strict=True):
            check_means(job.name, means)
            held.add(block, means)
            advance(len(held.pixels(block)), wanted * job.pixels)
        done = wanted
        if settings.is_open:
            each = (time.perf_counter() - started) / max(done - first, 1)
            wanted = _wanted_passes(settings, done, noise, each)
    return done


def _wanted_passes(settings: CaptureSettings, done: int, noise: Callable[[int], float], seconds: float) -> int:
    """How many passes the goals want, where each takes so many seconds: no more than are done if they are met."""
    wanted = [settings.most_passes]
    if settings.max_error is not None:
        reached = noise(done)
        times = (reached / settings.max_error) ** 2  # or more, where smoothing takes out less of less noise
        wanted.append(done if times <= 1.0 else max(done + 1, math.ceil(min(times, _MOST_AT_ONCE) * done)))
    if settings.max_seconds is not None:
        wanted.append(int(settings.max_seconds / max(seconds, 1e-9)))
    return min(wanted)


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


def noise_of(job: Job, pixels: Pixels) -> float:
    """Relative RMS noise of the picture, averaged over the rotations of the light that noise counts under."""
    return relative_noise(pixels.variance, pixels.vectors, job.light)


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
