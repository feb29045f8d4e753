"""Mitsuba's emitters that are not distant light: what they are called, and how bright they are set."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.lighting.emitters import check_radiance
from slepian_prt.lighting.fixed_lights import OTHERS, joined_count
from slepian_prt.lighting.formats.png_encoding import decode_srgb
from slepian_prt.renderer.shape_names import shape_name

_KINDS = {
    "AreaLight": "area",
    "DirectionalArea": "directionalarea",
    "DirectionalEmitter": "directional",
    "PointLight": "point",
    "Projector": "projector",
    "SpotLight": "spot",
}

# Plugins whose light no sample finds.
UNSEEN = ("directionalarea",)

# What plugins call their brightness.
_BRIGHTNESS = ("radiance", "intensity", "irradiance")

# Points of an emitting surface along each axis of its parameters, over which radiance that varies is averaged.
_POINTS = 64


class Lamp(NamedTuple):
    """An emitter of a Mitsuba scene that is not distant light.

    Attributes
    ----------
    place : int
        Among the emitters of the scene.
    name : str
        The id of the emitter, or of the shape that emits.
    kind : str
        Its plugin.
    emitted : (3,) float64
        Mean radiance, intensity or irradiance in linear sRGB.
    direction : (3,) float64
        Toward a ``directional`` lamp; zero of all others.
    """

    place: int
    name: str
    kind: str
    emitted: NDArray[np.float64]
    direction: NDArray[np.float64]


def lamps_of(mi: Any, loaded: Any, origin: str) -> list[Lamp]:
    """All emitters of a Mitsuba scene but its environment.

    Parameters
    ----------
    mi : Mitsuba, in the variant of the scene
    loaded : Mitsuba scene
    origin : str
        For messages.

    Raises
    ------
    UserError
        A lamp whose light is negative, not finite or too bright, or that Mitsuba cannot sample.
    """
    emitters = loaded.emitters()
    found: list[Lamp] = []
    for name, index in lamp_places(mi, loaded).items():
        emitter, kind = emitters[index], lamp_kind(emitters[index])
        emitted = check_radiance(_sampled(mi, emitter, f"{origin}: lamp '{name}'"), f"{origin}: lamp '{name}'")
        if emitted.min() < 0.0:
            raise UserError(f"{origin}: lamp '{name}': its light is negative ({emitted.min():.3g}); repair the light")
        found.append(Lamp(index, name, kind, emitted, _direction(emitter, kind)))
    return found


def lamp_places(mi: Any, loaded: Any) -> dict[str, int]:
    """Places of all lamps among the emitters of a Mitsuba scene, by the names that files know them by."""
    emitting = {
        _number(mi, shape.emitter()): shape_name(shape, index)
        for index, shape in enumerate(loaded.shapes())
        if shape.is_emitter()
    }
    places: dict[str, int] = {}
    for place, emitter in enumerate(loaded.emitters()):
        if not emitter.is_environment():
            name = emitting.get(_number(mi, emitter)) or emitter.id() or lamp_kind(emitter)
            places[_unused(name, list(places))] = place
    return places


def scale_lamps(mi: Any, loaded: Any, scales: float | Mapping[str, float]) -> None:
    """Make the lamps of a Mitsuba scene so many times as bright, by the names that files know them by.

    Raises
    ------
    UserError
        One of another brightness is wanted whose radiance is an image of bytes.
    """
    emitters = loaded.emitters()
    for name, place in lamp_places(mi, loaded).items():
        scale = _scale_of(name, scales)
        if scale == 1.0:
            continue
        parameters = mi.traverse(emitters[place])
        own = ["scale"] if "scale" in parameters else _brightness(parameters)
        if not own or any("u8" in type(parameters[one]).__name__.lower() for one in own):
            raise UserError(f"the brightness of lamp '{name}' cannot be changed in pictures; leave out `fixed_lights`")
        for one in own:
            parameters[one] = parameters[one] * scale
        parameters.update()


def _scale_of(name: str, scales: float | Mapping[str, float]) -> float:
    """Of one lamp; those that a file holds as one have that one's."""
    if not isinstance(scales, Mapping):
        return float(scales)
    joined = next((scale for known, scale in scales.items() if joined_count(known)), 1.0)
    return scales.get(name, scales.get(OTHERS, joined))


def _brightness(parameters: Any) -> list[str]:
    """The parameters of an emitter that are its brightness: a colour, or texels."""
    names = parameters.keys()
    return [one for one in names if one.split(".")[0] in _BRIGHTNESS and one.rsplit(".")[-1] in ("value", "data")]


def _sampled(mi: Any, emitter: Any, named: str) -> NDArray[np.float64]:
    """What an emitter is set to, after a sample of it, which some textures on some shapes of Mitsuba's cannot give."""
    import drjit as dr

    try:
        emitter.sample_direction(dr.zeros(mi.SurfaceInteraction3f), mi.Point2f(0.5))
        return emitted_light(mi, emitter)
    except Exception as error:  # whatever a plugin raises
        reason = " ".join(str(error).split()) or type(error).__name__
        raise UserError(f"{named} cannot be sampled ({reason}); correct it or remove it") from None


def lamp_kind(emitter: Any) -> str:
    """The plugin of an emitter: ``area``, ``point``, ``spot``, …"""
    name = emitter.class_name()
    return _KINDS.get(name, name)


def emitted_light(mi: Any, emitter: Any) -> NDArray[np.float64]:
    """(3,) mean radiance, intensity or irradiance that an emitter is set to, in linear sRGB."""
    parameters = mi.traverse(emitter)
    names = [name for name in parameters.keys() if name.split(".")[0] in _BRIGHTNESS]  # noqa: SIM118
    constant = len(names) == 1 and names[0].count(".") == 1 and names[0].endswith(".value")
    if not constant and lamp_kind(emitter) == "area":
        return _mean_radiance(mi, emitter)
    values = [_mean_colour(np.array(parameters[name])) for name in _brightness(parameters)]
    if not values:
        return np.full(3, math.nan)
    scale = float(np.ravel(np.array(parameters["scale"]))[0]) if "scale" in parameters else 1.0
    return np.asarray(scale * np.mean(values, axis=0))


def _mean_colour(value: NDArray) -> NDArray[np.float64]:
    """(3,) of one colour (1 or 3 numbers, in any shape), or of texels (H, W, channels)."""
    if value.dtype == np.uint8:  # as the file has them, which Mitsuba decodes when it looks them up
        value = decode_srgb(value / 255.0)
    colour = value.mean(axis=(0, 1)) if value.ndim == 3 else np.ravel(value)
    return np.array(np.broadcast_to(colour[:3], 3), dtype=np.float64)


def _mean_radiance(mi: Any, emitter: Any) -> NDArray[np.float64]:
    """Of a surface, where radiance varies over it."""
    middle = (np.arange(_POINTS, dtype=np.float32) + 0.5) / _POINTS
    u, v = (axis.ravel() for axis in np.meshgrid(middle, middle))
    sample, weight = emitter.sample_position(0.0, mi.Point2f(u, v))
    si = mi.SurfaceInteraction3f(sample, mi.Color0f())
    si.wi = mi.Vector3f(0.0, 0.0, 1.0)
    radiance = mi.unpolarized_spectrum(emitter.eval(si)) * weight
    values = np.broadcast_to(np.array(radiance, dtype=np.float64), (3, u.size))
    area = float(np.ravel(np.array(emitter.get_shape().surface_area()))[0])
    return np.asarray(values.mean(axis=1) / area)


def _direction(emitter: Any, kind: str) -> NDArray[np.float64]:
    """Toward a directional lamp."""
    if kind != "directional":
        return np.zeros(3)
    matrix = np.array(emitter.world_transform().matrix, dtype=np.float64).reshape(4, 4)
    along = matrix[:3, 2]
    return np.asarray(-along / np.linalg.norm(along))


def _number(mi: Any, emitter: Any) -> int:
    """Dr.Jit's number of an emitter, which tells it from others of the scene."""
    import drjit as dr

    return int(np.array(dr.reinterpret_array(mi.UInt32, mi.EmitterPtr(emitter)))[0])


def _unused(name: str, taken: Sequence[str]) -> str:
    """The name, with a number behind it if another lamp has it already."""
    count = 1
    while (name if count == 1 else f"{name}_{count}") in taken:
        count += 1
    return name if count == 1 else f"{name}_{count}"
