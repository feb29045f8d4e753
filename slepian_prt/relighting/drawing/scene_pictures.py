"""Pictures of a Mitsuba scene by final gathering, with the transfer file as the cache of radiance.

The integrator `slepian_prt` follows what the file does not hold (mirrors, glass, gloss, shapes without vertices) until
a surface is met that it does hold; textures are looked up at the point seen.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.lighting.emitters import emitted_environment, environment_emitter
from slepian_prt.lighting.environment import Environment
from slepian_prt.lighting.lamps import lamp_places
from slepian_prt.paths.media import media_of, medium_at
from slepian_prt.relighting.drawing.camera import DEFAULT_WIDTH, middle_directions
from slepian_prt.relighting.drawing.pictures import Picture
from slepian_prt.relighting.mitsuba.remarks import heard_remarks
from slepian_prt.relighting.mitsuba.scene_integrator import scene_integrator
from slepian_prt.scene.mitsuba.files import silent
from slepian_prt.scene.mitsuba.ids import load_keeping_ids
from slepian_prt.scene.mitsuba.instances import groups_in
from slepian_prt.scene.sensors import view_sensor
from slepian_prt.scene.view import Aim, aimed_view
from slepian_prt.sphere.harmonics import bandlimit_of, real_sh

# Samples of each pixel are taken so many at a time. How many a tile of pixels gets, for this noise (relative RMS), a
# pilot of some batches says, which is not part of the picture: means that stop where their own samples look quiet are
# too dark. Tiles darker than a part of the mean of the picture count as being that bright, and each gets as many as the
# noisiest beside it, so that bright paths that a pilot has missed do not stand out.
_BATCH, _NOISE, _LEAST_SAMPLES, _MOST_SAMPLES = 8, 0.02, 16, 128
_PILOT_BATCH, _PILOT_BATCHES = 4, 4
_TILE, _DARK = 8, 0.1

# Rays that are followed at once.
_RAYS = 1 << 20

_SEED = 17

# Radiance (UnpolarizedSpectrum) and opacity (Float) of a scene, for a sampler and rays.
Look = Callable[[Any, Any, Any], tuple[Any, Any]]

# Of a map that is made from coefficients, in texels.
_ROWS = 64


class Light(NamedTuple):
    """One light that a scene is drawn under.

    Attributes
    ----------
    lighting : (3, (L+1)²) or None
        What the file's surfaces are lit by, in the world of the file; None for nothing distant.
    environment : Environment or None
        What mirrors show; None for what the coefficients tell of it.
    """

    lighting: NDArray[np.float64] | None
    environment: Environment | None = None


@dataclass(frozen=True, eq=False)
class SceneCamera:
    """A view of a Mitsuba scene.

    Attributes
    ----------
    mi : Mitsuba, in the variant of the scene
    packed : CompressedTransfer
    loaded : Mitsuba scene
        Its shapes and lamps are drawn, its distant light is replaced.
    sensor : Mitsuba sensor
    samples : int or None
        Of each pixel; None for as many as the noise asks for.
    """

    mi: Any
    packed: CompressedTransfer
    loaded: Any
    sensor: Any
    samples: int | None = None

    @property
    def directions(self) -> NDArray[np.float32]:
        """(H, W, 3) through the middles of the pixels, in world space."""
        return middle_directions(self.mi, self.sensor)

    def picture(self, light: Light) -> tuple[Picture, list[str]]:
        """The scene under a light, against an empty background, and remarks on what of it is not drawn."""
        mi = self.mi
        with silent(mi):
            emitters = self.loaded.emitters()
            lamps = {name: emitters[place] for name, place in lamp_places(mi, self.loaded).items()}
            integrator = scene_integrator(mi, self.packed, lighting=light.lighting, lamps=lamps)
            scene = _relit_scene(mi, self.loaded, light)
            look = partial(integrator.sample_before_nothing, medium=_medium_around(mi, self.loaded, self.sensor))
        with heard_remarks(mi) as remarks:
            return _gather(mi, scene, look, self.sensor, self.samples), remarks


def scene_camera(
    mi: Any, packed: CompressedTransfer, loaded: Any, origin: NDArray[np.float64], width: int | None, aim: Aim
) -> SceneCamera:
    """The camera that `relit_camera` gives, in a Mitsuba scene whose origin is that point of the world."""
    receivers = packed.mesh.receivers
    points = receivers.positions[receivers.active] if receivers.active.any() else receivers.positions
    view = aimed_view(aim, packed.view, points, width or DEFAULT_WIDTH)
    return SceneCamera(mi, packed, loaded, view_sensor(mi, view, width, origin=origin))


def own_environment(mi: Any, loaded: Any, origin: str) -> Environment | None:
    """The scene's own distant light."""
    emitter = loaded.environment()
    return None if emitter is None else emitted_environment(mi, emitter, origin)


def environment_of(lighting: NDArray[np.float64]) -> Environment:
    """A map of what coefficients (3, (L+1)²) tell of a light; where they ring below zero it is black."""
    v, u = np.meshgrid(
        np.pi * np.arange(_ROWS) / (_ROWS - 1), np.pi * (np.arange(2 * _ROWS) + 0.5) / _ROWS, indexing="ij"
    )
    directions = np.stack([np.sin(v) * np.sin(u), np.cos(v), -np.sin(v) * np.cos(u)], axis=-1)
    values = real_sh(bandlimit_of(lighting.shape[1]), directions.reshape(-1, 3)) @ lighting.T
    texels = np.maximum(values, 0.0).reshape(_ROWS, 2 * _ROWS, 3)
    return Environment("coefficients", texels.astype(np.float32), np.eye(3))


def _relit_scene(mi: Any, loaded: Any, light: Light) -> Any:
    """The shapes and lamps of a scene under another distant light."""
    entries: dict[str, Any] = {f"group_{index}": group for index, group in enumerate(groups_in(mi, loaded))}
    entries |= {f"shape_{index}": shape for index, shape in enumerate(loaded.shapes())}
    on_shapes = mi.EmitterFlags.Surface
    for index, emitter in enumerate(loaded.emitters()):
        if not emitter.is_environment() and not mi.has_flag(emitter.flags(), on_shapes):
            entries[f"emitter_{index}"] = emitter
    environment = light.environment
    if environment is None and light.lighting is not None and light.lighting.any():
        environment = environment_of(light.lighting)
    if environment is not None:
        entries["environment"] = environment_emitter(mi, environment)
    return load_keeping_ids(mi, {"type": "scene", **entries})


def _medium_around(mi: Any, loaded: Any, sensor: Any) -> Any:
    """The medium that a camera is in, if any: what the scene says of one in the same place, or what is around it."""
    place = _place(sensor)
    for own in loaded.sensors():
        if own.get_medium() is not None and np.allclose(_place(own), place, rtol=1e-5, atol=0.0):
            return own.get_medium()
    return medium_at(mi, loaded, mi.Point3f(*place))[0] if media_of(mi, loaded) else None


def _place(sensor: Any) -> list[float]:
    """Of a camera in its scene."""
    return [float(row) for row in np.array(sensor.world_transform().matrix, dtype=np.float64).reshape(4, 4)[:3, 3]]


def _gather(mi: Any, scene: Any, look: Look, view: Any, samples: int | None) -> Picture:
    """Mean radiance of each pixel over what rays meet, and the part of them that meet anything."""
    columns, rows = (int(n) for n in view.film().size())
    first = 0
    if samples is None:
        first = _PILOT_BATCH * _PILOT_BATCHES
        wanted = _samples_wanted(_pilot(mi, scene, look, view), rows, columns)
    else:
        wanted = np.full(rows * columns, samples)
    total = np.zeros((rows * columns, 4))
    for taken in range(0, int(wanted.max()), _BATCH):
        active = np.flatnonzero(wanted > taken)
        count = min(_BATCH, int(wanted.max()) - taken)
        numbers = range(first + taken, first + taken + count)
        total[active] += count * _trace_pixels(mi, scene, look, view, active, numbers)
    mean = (total / wanted[:, None]).reshape(rows, columns, 4)
    return Picture(mean[..., :3].astype(np.float32), mean[..., 3].astype(np.float32))


def _pilot(mi: Any, scene: Any, look: Look, view: Any) -> NDArray[np.float64]:
    """(batches, pixels, 3) means of radiance over a few samples of each pixel."""
    columns, rows = (int(n) for n in view.film().size())
    pixels = np.arange(rows * columns)
    begins = range(0, _PILOT_BATCH * _PILOT_BATCHES, _PILOT_BATCH)
    return np.stack(
        [_trace_pixels(mi, scene, look, view, pixels, range(begin, begin + _PILOT_BATCH))[:, :3] for begin in begins]
    )


def _samples_wanted(pilot: NDArray[np.float64], rows: int, columns: int) -> NDArray[np.int64]:
    """(pixels,) how many samples bring each tile, and those around it, to the noise that is allowed, in whole batches.

    Parameters
    ----------
    pilot : (batches, pixels, 3)
    rows, columns : int
        Of the picture.
    """
    down, across = np.arange(rows * columns) // columns // _TILE, np.arange(rows * columns) % columns // _TILE
    shape = (int(down[-1]) + 1, int(across.max()) + 1)
    tile = down * shape[1] + across
    mean, variance = pilot.mean(axis=0), _PILOT_BATCH * pilot.var(axis=0, ddof=1)  # the latter of one sample
    error, power = (np.bincount(tile, values.sum(axis=1)) for values in (variance, mean**2))
    floor = (_DARK * float(mean.mean())) ** 2 * 3.0 * np.bincount(tile)
    relative = error / np.maximum(np.maximum(power, floor), 1e-300)
    around = maximum_filter(relative.reshape(shape), size=3, mode="nearest").ravel()
    batches = np.ceil(np.minimum(around / _NOISE**2, _MOST_SAMPLES) / _BATCH)
    return np.asarray(np.maximum(batches.astype(np.int64) * _BATCH, _LEAST_SAMPLES)[tile])


def _trace_pixels(
    mi: Any, scene: Any, look: Look, view: Any, pixels: NDArray[np.int64], numbers: range
) -> NDArray[np.float64]:
    """As `_trace`, as many at a time as memory allows."""
    each = max(_RAYS // len(numbers), 1)
    parts = (pixels[begin : begin + each] for begin in range(0, len(pixels), each))
    return np.concatenate([_trace(mi, scene, look, view, part, numbers) for part in parts])


def _trace(mi: Any, scene: Any, look: Look, view: Any, pixels: NDArray, numbers: range) -> NDArray[np.float64]:
    """(n, 4) means of radiance where rays meet something, and of whether they do, over some samples of pixels."""
    import drjit as dr

    columns, rows = (int(n) for n in view.film().size())
    lanes = len(pixels) * len(numbers)
    pixel = np.repeat(pixels, len(numbers))
    # Each pixel takes the points of one low-discrepancy sequence in turn (Roberts 2018), shifted by its own offset.
    step = np.array([0.7548776662466927, 0.5698402909980532])
    shift = np.random.default_rng(_SEED).random((rows * columns, 2))[pixel]
    inside = (shift + np.tile(np.array(numbers), len(pixels))[:, None] * step) % 1.0
    x, y = (pixel % columns + inside[:, 0]) / columns, (pixel // columns + inside[:, 1]) / rows
    sampler = mi.load_dict({"type": "independent"})
    # Mixed, so that no two calls have the same, however many there are.
    seed = np.random.SeedSequence([_SEED, numbers.start, int(pixels[0])]).generate_state(1)[0]
    sampler.seed(mi.UInt32(int(seed)), lanes)
    place = mi.Point2f(x.astype(np.float32), y.astype(np.float32))
    ray, _ = view.sample_ray_differential(0.0, 0.5, place, sampler.next_2d())
    ray.scale_differential(1.0 / math.sqrt(len(numbers)))
    with dr.suspend_grad():
        radiance, alpha = look(scene, sampler, ray)
        values = [*radiance, alpha]
        dr.eval(values)
    return np.stack(
        [np.array(value, dtype=np.float64).reshape(len(pixels), -1).mean(axis=1) for value in values], axis=1
    )
