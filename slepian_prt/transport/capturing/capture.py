"""All the light that a camera sees, as transfer toward its pixels: rendered once, relit under any distant light."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.distributed.given import given_crew
from slepian_prt.errors import UserError
from slepian_prt.lighting.environment import Environment
from slepian_prt.lighting.lamps import Lamp, lamps_of
from slepian_prt.scene.film import film_mesh
from slepian_prt.scene.loading import open_mitsuba
from slepian_prt.scene.mitsuba.files import silent
from slepian_prt.scene.mitsuba.scenes import distant_light
from slepian_prt.scene.scene import Part
from slepian_prt.scene.view import view_of
from slepian_prt.transport.capturing.camera import CameraRays, find_camera
from slepian_prt.transport.capturing.denoising import Pixels, guide_table, smoothed
from slepian_prt.transport.capturing.guides import Guides, look_at_surfaces
from slepian_prt.transport.capturing.lamp_pictures import LampPictures, mean_pictures
from slepian_prt.transport.capturing.memory import check_capture_memory
from slepian_prt.transport.capturing.passes import (
    Job,
    Tracer,
    TracerHere,
    add_passes,
    axes_of,
    collect,
    film_of,
    fingerprint,
    noise_of,
)
from slepian_prt.transport.capturing.pixel_means import PixelMeans, kept_means
from slepian_prt.transport.capturing.remarks import remark_on_light, remark_on_media
from slepian_prt.transport.capturing.settings import CaptureSettings
from slepian_prt.transport.planned import Clock
from slepian_prt.transport.smoothing import relative_noise
from slepian_prt.transport.transfer import Transfer

if TYPE_CHECKING:
    from slepian_prt.distributed.crew import Crew
    from slepian_prt.scene.loading import SceneSource


def capture(
    scene: SceneSource,
    sensor: str | int | None = None,
    bandlimit: int = 10,
    samples: int | None = None,
    *,
    max_error: float | None = None,
    max_seconds: float | None = None,
    power: NDArray[np.float64] | None = None,
    seed: int = 0,
    parameters: Mapping[str, object] | None = None,
    smooth: bool = True,
    advance: Callable[[int, int], None] = lambda _done, _total: None,
    client: Any = None,
) -> Transfer:
    """Transfer toward the pixels of a camera, of everything that Mitsuba's paths bring: glass, caustics, hair, media.

    Parameters
    ----------
    scene : path of a Mitsuba .xml, mitsuba.Scene or dict
        As of `precompute`.
    sensor : id or number of a camera, optional
        By default the first. Its film, with its crop and its filter, its aperture and its shutter are those of
        ``mitsuba.render``.
    bandlimit : int in [0, 50]
        Of the light. What mirrors show of a map is as soft as this makes it.
    samples : int in [2, 65536], optional
        Paths of each pixel, 256 by default; a few more where they stratify better.
    max_error : float in (0, 1), optional
        Instead: as many as bring the noise of the relit picture (relative RMS), smoothed if it is, down to this.
    max_seconds : float, optional
        Instead, or beside ``max_error``: as many as take so long.
    power : (L+1,), optional
        Power per harmonic of the light that ``max_error`` is about, as of `light_power`; falling as 1/(l+1)² by
        default.
    seed : int
        The same seed gives the same result, to rounding.
    parameters : dict of str to number, bool or str, optional
        Values of the parameters of an .xml scene, which stand there as ``$name``.
    smooth : bool
        Take out noise along the picture, as far as it can be told from light.
    advance : callable
        Given (pixels finished since the last call, pixels in all), each pixel once for each pass.
    client : distributed.Client, or address of a scheduler, optional
        Whose workers trace; the result is the same to rounding.

    Returns
    -------
    Transfer
        Its receivers are the pixels of ``film``. What the scene's lamps send is in ``fixed``.

    Raises
    ------
    UserError
        The scene cannot be used; a camera that is not there, or has no pixels; a number out of range.
    """
    settings = CaptureSettings(sensor, bandlimit, samples, max_error, max_seconds, seed, parameters, smooth)
    with given_crew(client) as crew, open_capture(scene, settings, power, advance, crew=crew) as transfer:
        return transfer


@contextmanager
def open_capture(
    scene: SceneSource,
    settings: CaptureSettings,
    power: NDArray[np.float64] | None = None,
    advance: Callable[[int, int], None] = lambda _done, _total: None,
    report: Callable[[str], None] = lambda _: None,
    crew: Crew | None = None,
) -> Iterator[Transfer]:
    """As `capture`; what was traced is kept for the same capture until the with-block ends well.

    Parameters
    ----------
    scene, power, advance : as of `capture`
    settings : CaptureSettings
    report : callable
        Told what is being done.
    crew : Crew, optional
        Workers that trace.
    """
    clock = Clock()
    power = None if power is None else _checked_power(power, settings.bandlimit)
    with open_mitsuba(scene, settings.parameters) as (mi, loaded, name):
        camera = find_camera(loaded.sensors(), settings.sensor, name)
        with silent(mi):
            own, lamps = distant_light(mi, loaded.emitters(), name), lamps_of(mi, loaded, name)
        job = Job(mi, loaded, name, camera, CameraRays(mi, camera), settings, power)
        check_capture_memory(job.pixels, job.per_block, settings.bandlimit, settings.smooth)
        with silent(mi):
            remark_on_media(mi, loaded, name, job.rays)
        clock.stop("load")
        name_of_it = fingerprint(job)
        with (
            kept_means(name_of_it, job.pixels, job.per_block, settings.bandlimit) as held,
            _tracer(job, crew, scene, name_of_it) as tracer,
        ):
            finish = _Finish(job, tracer, held, look_at_surfaces(mi, loaded, job.rays), own, lamps)
            passes = add_passes(job, tracer, held, lambda passes: noise_of(job, finish.pixels(passes)), advance)
            clock.stop("transport")
            pictures = finish.pictures(passes)
            if pictures is not None:
                clock.stop("fixed lights")
            if settings.smooth:
                report("smoothing")
            pixels = finish.pixels(passes)
            clock.stop("smooth")
            yield finish.transfer(pixels, pictures, passes, dict(clock.seconds))


def _tracer(job: Job, crew: Crew | None, scene: SceneSource, name: str) -> AbstractContextManager[Tracer]:
    if crew is None:
        return nullcontext(TracerHere(job))
    from slepian_prt.transport.capturing.by_workers import open_tracer

    return open_tracer(job, crew, scene, name)


def _checked_power(power: ArrayLike, bandlimit: int) -> NDArray[np.float64]:
    values = np.asarray(power, dtype=np.float64)
    if values.shape != (bandlimit + 1,) or not (np.isfinite(values).all() and values.min() >= 0.0 and values.any()):
        raise UserError(
            f"power must be {bandlimit + 1} numbers for bandlimit {bandlimit}, not negative and not all zero; "
            "leave it out, or give those of a map"
        )
    return values


@dataclass(frozen=True, eq=False)
class _Finish:
    """What becomes of passes: pixels with less noise, and transfer.

    Attributes
    ----------
    job : Job
    tracer : Tracer
    held : PixelMeans
        What was traced.
    guides : Guides
    own : Environment or None
        Distant light of the scene.
    lamps : list of Lamp
    """

    job: Job
    tracer: Tracer
    held: PixelMeans
    guides: Guides
    own: Environment | None
    lamps: list[Lamp]

    @cached_property
    def neighbours(self) -> NDArray[np.int64]:
        """(E, 2) pixels side by side."""
        rays = self.job.rays
        if min(rays.width, rays.height) == 1:  # a line of pixels has no faces
            line = np.arange(self.job.pixels)
            return np.stack([line[:-1], line[1:]], axis=1)
        return film_mesh("", rays.width, rays.height, np.zeros((self.job.pixels, 3))).receivers.neighbours

    @cached_property
    def table(self) -> NDArray[np.float64]:
        """(V, k) guides of `smooth`."""
        return guide_table(self.guides, collect(self.job, self.held).background)

    def pixels(self, passes: int) -> Pixels:
        """All pixels after so many passes."""
        found = collect(self.job, self.held)
        if not self.job.settings.smooth:
            return found
        return smoothed(found, self.neighbours, self.table, passes * self.job.settings.per_pass)

    def pictures(self, passes: int) -> LampPictures | None:
        """What the scene's lamps send, by as many paths."""
        job, settings = self.job, self.job.settings
        pictures = mean_pictures(self.lamps, job.pixels, passes, self.tracer.lamp_pictures(self.lamps, passes))
        return pictures.smoothed(self.neighbours, self.table) if pictures is not None and settings.smooth else pictures

    def transfer(
        self, pixels: Pixels, pictures: LampPictures | None, passes: int, seconds: dict[str, float]
    ) -> Transfer:
        """The result."""
        job, settings, film = self.job, self.job.settings, film_of(self.job, pixels)
        axes = axes_of(self.held.vectors(), self.guides.normals)
        remark_on_light(job.name, film, pixels, pictures, passes * settings.per_pass)
        return Transfer(
            vectors=pixels.vectors,
            axes=axes,
            mesh=film_mesh(film.name, film.width, film.height, axes),
            parts=(Part(film.name, 0, job.pixels),),
            bandlimit=settings.bandlimit,
            samples=passes * settings.per_pass,
            seed=settings.seed,
            effects=(),
            bounces=0,
            rays_traced=pixels.rays,
            seconds=seconds,
            source=job.name,
            parameters=dict(settings.parameters or {}),
            environment=self.own,
            view=view_of(job.mi, job.sensor),
            toward_view=True,
            fixed=None if pictures is None else pictures.fixed_lights(),
            film=film,
            noise=relative_noise(pixels.variance, pixels.vectors),
        )
