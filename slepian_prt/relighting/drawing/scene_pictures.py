"""Pictures of a Mitsuba scene by final gathering, with the transfer file as the cache of radiance.

The integrator `slepian_prt` follows what the file does not hold (mirrors, glass, gloss, shapes without vertices) until
a surface is met that it does hold; textures are looked up at the point seen.
"""

from __future__ import annotations

import gc
import math
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.errors import UserError
from slepian_prt.lighting.emitters import emitted_environment, environment_emitter
from slepian_prt.lighting.environment import Environment
from slepian_prt.lighting.fixed_lights import OTHERS
from slepian_prt.lighting.lamps import lamps_of
from slepian_prt.relighting.drawing.camera import DEFAULT_WIDTH, aim_camera, middle_directions
from slepian_prt.relighting.drawing.pictures import Picture
from slepian_prt.relighting.mitsuba.scene_integrator import scene_integrator
from slepian_prt.scene.loading import open_scene
from slepian_prt.scene.mitsuba.ids import load_keeping_ids
from slepian_prt.scene.mitsuba.instances import groups_in
from slepian_prt.scene.sensors import sensor
from slepian_prt.scene.view import Aim
from slepian_prt.sphere.harmonics import bandlimit_of, real_sh

# Samples of each pixel are taken so many at a time, and no longer in tiles of so many pixels that have less than this
# noise (relative RMS, measured from one such batch to the next), or once so many are taken. Tiles darker than a part of
# the mean of the picture count as being that bright.
_BATCH, _NOISE, _MOST_SAMPLES = 8, 0.02, 128
_TILE, _DARK = 8, 0.1

# Parameters that say how bright an emitter is.
_BRIGHTNESS = r"(radiance|intensity|irradiance)\b.*(value|data)$"

# Rays that are followed at once.
_RAYS = 1 << 20

_SEED = 17

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

    def picture(self, light: Light) -> Picture:
        """The scene under a light, against an empty background."""
        mi = self.mi
        # Scenes of earlier pictures refer to themselves. While they live, their materials and emitters are compiled
        # into every kernel, which then takes longer, and which Dr.Jit has been seen to abort at.
        gc.collect()
        with _quiet(mi):
            integrator = scene_integrator(mi, self.packed, lighting=light.lighting)
            scene = _relit_scene(mi, self.loaded, light)
            return _gather(mi, scene, integrator, self.sensor, self.samples)


def scene_camera(
    mi: Any, packed: CompressedTransfer, loaded: Any, origin: NDArray[np.float64], width: int | None, aim: Aim | None
) -> SceneCamera:
    """The camera that `relit_camera` gives, in a Mitsuba scene whose origin is that point of the world."""
    with open_scene(packed.mesh) as scene:
        aimed = aim_camera(
            replace(scene, view=packed.view), aim, width or DEFAULT_WIDTH, toward_view=packed.toward_view
        )
    in_scene = replace(aimed, mi=mi, origin=origin, scale=1.0)
    return SceneCamera(mi, packed, loaded, sensor(in_scene, width))


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


def scale_lamps(mi: Any, loaded: Any, scales: float | Mapping[str, float]) -> None:
    """Make the lamps of a scene so many times as bright, by the names that transfer files know them by.

    Raises
    ------
    UserError
        One of another brightness is wanted whose radiance is an image of bytes.
    """
    emitters = loaded.emitters()
    for lamp in lamps_of(mi, loaded, "the scene"):
        scale = _scale_of(lamp.name, scales)
        if scale == 1.0:
            continue
        emitter = emitters[lamp.place]
        parameters = mi.traverse(emitter)
        found = [name for name, _ in parameters if re.match(_BRIGHTNESS, name)]
        own = [name for name, _ in parameters if name == "scale"] or found
        if not own or any("u8" in type(parameters[name]).__name__.lower() for name in own):
            raise UserError(
                f"the brightness of lamp '{lamp.name}' cannot be changed in pictures; leave out `fixed_lights`"
            )
        for name in own:
            parameters[name] = parameters[name] * scale
        parameters.update()


def _scale_of(name: str, scales: float | Mapping[str, float]) -> float:
    """Of one lamp; those that a file holds as one have that one's."""
    if not isinstance(scales, Mapping):
        return float(scales)
    joined = next((scale for known, scale in scales.items() if known.endswith(" other lights")), 1.0)
    return scales.get(name, scales.get(OTHERS, joined))


@contextmanager
def _quiet(mi: Any) -> Iterator[None]:
    """Without Mitsuba's warnings, which go to standard output."""
    level = mi.log_level()
    try:
        mi.set_log_level(mi.LogLevel.Error)
        yield
    finally:
        mi.set_log_level(level)


def _gather(mi: Any, scene: Any, integrator: Any, view: Any, samples: int | None) -> Picture:
    """Mean radiance of each pixel over what rays meet, and the part of them that meet anything."""
    columns, rows = (int(n) for n in view.film().size())
    pixels = rows * columns
    total, squares = np.zeros((pixels, 4)), np.zeros((pixels, 4))  # Σ batch means, and of their squares
    batches, weights = np.zeros(pixels), np.zeros(pixels)  # how many, and of how many samples each
    tile = (np.arange(pixels) // columns // _TILE) * (columns // _TILE + 1) + np.arange(pixels) % columns // _TILE
    active, taken = np.arange(pixels), 0
    while len(active) and taken < (samples or _MOST_SAMPLES):
        count = min(_BATCH, (samples or _MOST_SAMPLES) - taken)
        each = max(_RAYS // count, 1)
        for first in range(0, len(active), each):
            chosen = active[first : first + each]
            mean = _trace(mi, scene, integrator, view, chosen, range(taken, taken + count))
            total[chosen] += count * mean
            squares[chosen] += count * mean**2
        weights[active] += count
        batches[active] += 1
        taken += count
        if samples is None and taken > _BATCH:
            noisy = _tile_noise(total[:, :3], squares[:, :3], weights, batches, tile) > _NOISE
            active = active[noisy[tile[active]]]
    mean = (total / weights[:, None]).reshape(rows, columns, 4)
    return Picture(mean[..., :3].astype(np.float32), mean[..., 3].astype(np.float32))


def _tile_noise(
    total: NDArray, squares: NDArray, weights: NDArray, batches: NDArray, tile: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Relative RMS error of each tile of pixels, from the variance of the means of equal batches."""
    mean = total / weights[:, None]
    variance = np.maximum(squares / weights[:, None] - mean**2, 0.0) / (batches[:, None] - 1.0)
    error, power = (np.bincount(tile, values.sum(axis=1)) for values in (variance, mean**2))
    size = np.bincount(tile)
    floor = (_DARK * float(mean.mean())) ** 2 * 3.0 * size
    return np.asarray(np.sqrt(error / np.maximum(np.maximum(power, floor), 1e-300)))


def _trace(mi: Any, scene: Any, integrator: Any, view: Any, pixels: NDArray, numbers: range) -> NDArray[np.float64]:
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
    sampler.seed(mi.UInt32(_SEED + numbers.start * (rows * columns) + int(pixels[0])), lanes)
    place = mi.Point2f(x.astype(np.float32), y.astype(np.float32))
    ray, _ = view.sample_ray_differential(0.0, 0.5, place, sampler.next_2d())
    ray.scale_differential(1.0 / math.sqrt(len(numbers)))
    with dr.suspend_grad():
        met = scene.ray_test(ray)
        radiance, _, _ = integrator.sample(scene, sampler, ray, None, met)
        values = [*(dr.select(met, channel, 0.0) for channel in radiance), mi.Float(met)]
        dr.eval(values)
    return np.stack(
        [np.array(value, dtype=np.float64).reshape(len(pixels), -1).mean(axis=1) for value in values], axis=1
    )
