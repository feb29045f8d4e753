"""All the light that a camera sees, as transfer toward its pixels: rendered once, relit under any distant light."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slepian_prt.lighting.lamps import lamps_of
from slepian_prt.scene.film import film_mesh
from slepian_prt.scene.loading import open_mitsuba
from slepian_prt.scene.mitsuba.files import silent
from slepian_prt.scene.mitsuba.scenes import distant_light
from slepian_prt.scene.scene import Part
from slepian_prt.scene.view import view_of
from slepian_prt.transport.capturing.camera import CameraRays, find_camera
from slepian_prt.transport.capturing.denoising import guide_table, smoothed
from slepian_prt.transport.capturing.guides import look_at_surfaces
from slepian_prt.transport.capturing.lamp_pictures import picture_lamps
from slepian_prt.transport.capturing.passes import Job, add_passes, axes_of, collect, film_of, fingerprint
from slepian_prt.transport.capturing.pixel_means import kept_means
from slepian_prt.transport.capturing.settings import CaptureSettings
from slepian_prt.transport.planned import Clock
from slepian_prt.transport.smoothing import relative_noise
from slepian_prt.transport.transfer import Transfer

if TYPE_CHECKING:
    from slepian_prt.scene.loading import SceneSource

log = logging.getLogger(__name__)


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
        Instead: as many as bring the noise of the relit picture (relative RMS) down to this.
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
    with open_capture(scene, settings, power, advance) as transfer:
        return transfer


@contextmanager
def open_capture(
    scene: SceneSource,
    settings: CaptureSettings,
    power: NDArray[np.float64] | None = None,
    advance: Callable[[int, int], None] = lambda _done, _total: None,
    report: Callable[[str], None] = lambda _: None,
) -> Iterator[Transfer]:
    """As `capture`; what was traced is kept for the same capture until the with-block ends well.

    Parameters
    ----------
    scene, power, advance : as of `capture`
    settings : CaptureSettings
    report : callable
        Told what is being done.
    """
    clock = Clock()
    with open_mitsuba(scene, settings.parameters) as (mi, loaded, name):
        camera = find_camera(loaded.sensors(), settings.sensor, name)
        with silent(mi):
            own = distant_light(mi, loaded.emitters(), name)
        job = Job(mi, loaded, name, camera, CameraRays(mi, camera), settings, power)
        clock.stop("load")
        with kept_means(fingerprint(job), job.pixels, job.per_block, settings.bandlimit) as held:
            passes = add_passes(job, held, advance)
            pixels, samples = collect(job, held), passes * settings.per_pass
            clock.stop("transport")
            lamps = lamps_of(mi, loaded, name)
            pictures = picture_lamps(mi, loaded, job.rays, lamps, settings.per_pass, passes, settings.seed)
            if pictures is not None:
                clock.stop("fixed lights")
            guides = look_at_surfaces(mi, loaded, job.rays)
            mesh = film_mesh(camera.id(), job.rays.width, job.rays.height, axes_of(pixels.vectors, guides.normals))
            if settings.smooth:
                report("smoothing")
                neighbours, table = mesh.receivers.neighbours, guide_table(guides, pixels.background)
                pixels = smoothed(pixels, neighbours, table, samples)
                pictures = None if pictures is None else pictures.smoothed(neighbours, table)
                clock.stop("smooth")
            film = film_of(job, pixels)
            if not film.coverage.any():
                log.info("%s: camera '%s' sees nothing of the scene; the picture is its background", name, film.name)
            yield Transfer(
                vectors=pixels.vectors,
                axes=mesh.normals,
                mesh=mesh,
                parts=(Part(film.name, 0, job.pixels),),
                bandlimit=settings.bandlimit,
                samples=samples,
                seed=settings.seed,
                effects=(),
                bounces=0,
                rays_traced=pixels.rays,
                seconds=dict(clock.seconds),
                source=name,
                parameters=dict(settings.parameters or {}),
                environment=own,
                view=view_of(mi, camera),
                toward_view=True,
                fixed=None if pictures is None else pictures.fixed_lights(),
                film=film,
                noise=relative_noise(pixels.variance, pixels.vectors),
            )
