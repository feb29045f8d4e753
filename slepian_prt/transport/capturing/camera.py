"""Rays of a camera, a fixed number for each pixel, as its film filters them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.scene.mitsuba.scenes import wanted_sensor

# Cameras that have a picture; the others measure, or are several.
_CAMERAS = ("PerspectiveCamera", "ThinLensCamera", "OrthographicCamera")

# Cells that a reconstruction filter is tabulated in.
_CELLS = 256

# Corners of a film whose directions span less than this are taken for equally far.
_PARALLEL = 1e-3

# Points of an aperture, by an additive recurrence (Roberts 2018).
_APERTURE = 16
_STEPS = (0.7548776662466927, 0.5698402909980532)


def find_camera(sensors: Sequence[Any], wanted: str | int | None, origin: str) -> Any:
    """The camera of that id or number, or the first.

    Raises
    ------
    UserError
        It is not there, or has no pixels of its own.
    """
    sensor = wanted_sensor(sensors, wanted, origin)
    if sensor is None:
        raise UserError(f"{origin}: the scene has no camera to capture; add a sensor")
    kind = sensor.class_name()
    if kind not in _CAMERAS:
        other = next((one.id() for one in sensors if one.class_name() in _CAMERAS), None)
        remedy = (
            f"name another with `sensor={other}`" if other else "add a perspective, thinlens or orthographic sensor"
        )
        raise UserError(f"{origin}: sensor '{sensor.id()}' is a {kind}, which takes no picture; {remedy}")
    return sensor


class Filter(NamedTuple):
    """A reconstruction filter along one axis, in cells of equal width.

    Attributes
    ----------
    radius : float
        In pixels.
    magnitude, signed : (cells + 1,) float64
        Integrals, up to the beginning of each cell, of its absolute value and of its value.
    values : (cells,) float64
    """

    radius: float
    magnitude: NDArray[np.float64]
    signed: NDArray[np.float64]
    values: NDArray[np.float64]


def filter_of(mi: Any, film: Any) -> Filter:
    """The filter of a film."""
    rfilter = film.rfilter()
    if rfilter.is_box_filter():
        radius, values = 0.5, np.ones(1)
    else:
        radius = float(rfilter.radius())
        middles = ((np.arange(_CELLS) + 0.5) / _CELLS * 2.0 - 1.0) * radius
        values = np.array(rfilter.eval(mi.Float(middles.astype(np.float32))), dtype=np.float64)
    width = 2.0 * radius / values.size
    magnitude = np.concatenate([[0.0], np.cumsum(np.abs(values)) * width])
    return Filter(radius, magnitude, np.concatenate([[0.0], np.cumsum(values) * width]), values)


class CameraRays:
    """Rays through the pixels of a camera, drawn as their filter weighs the film (Ernst et al. 2006).

    All rays of a pixel count for it alone, each with the sign of the filter: their mean is what Mitsuba's film tends
    to, which at the borders of a film (without ``sample_border``) knows only what lies inside.

    Parameters
    ----------
    mi : Mitsuba, in the variant of the sensor
    sensor : Mitsuba sensor

    Attributes
    ----------
    width, height : int
        Of the picture, in pixels.
    crop, size : (int, int)
        As of `Film`.
    medium : Mitsuba medium or None
        That the camera is in.
    """

    def __init__(self, mi: Any, sensor: Any) -> None:
        film = sensor.film()
        self._mi, self._sensor = mi, sensor
        self.width, self.height = (int(n) for n in film.crop_size())
        self.crop = int(film.crop_offset()[0]), int(film.crop_offset()[1])
        self.size = int(film.size()[0]), int(film.size()[1])
        self._filter = filter_of(mi, film)
        self._beyond = bool(film.sample_border())
        self.medium = sensor.get_medium()
        self._magnitude = mi.Float(self._filter.magnitude.astype(np.float32))
        self._signed = mi.Float(self._filter.signed.astype(np.float32))
        self._signs = mi.Float(np.sign(self._filter.values).astype(np.float32))

    def sample(self, sampler: Any, pixel: Any) -> tuple[Any, Any]:
        """A ray through each pixel (UInt32), and its weight (Color3f), 1 in the mean for a constant picture."""
        mi, sensor = self._mi, self._sensor
        row = pixel // self.width
        column = pixel - row * self.width
        u = sampler.next_2d()
        x, across = self._offset(u.x, mi.Float(column) + 0.5, self.width)
        y, down = self._offset(u.y, mi.Float(row) + 0.5, self.height)
        place = mi.Point2f((mi.Float(column) + 0.5 + x) / self.width, (mi.Float(row) + 0.5 + y) / self.height)
        aperture = sampler.next_2d() if sensor.needs_aperture_sample() else mi.Point2f(0.5)
        time = mi.Float(sensor.shutter_open())
        if sensor.shutter_open_time() > 0.0:
            time += sampler.next_1d() * sensor.shutter_open_time()
        ray, weight = sensor.sample_ray(time, mi.Float(0.5), place, aperture)
        return ray, mi.Color3f(mi.unpolarized_spectrum(weight)) * (across * down)

    def middles(self, pixel: Any) -> Any:
        """A ray through the middle of each pixel (UInt32) and of the aperture."""
        mi = self._mi
        row = pixel // self.width
        place = mi.Point2f((mi.Float(pixel - row * self.width) + 0.5) / self.width, (mi.Float(row) + 0.5) / self.height)
        return self._sensor.sample_ray(self._sensor.shutter_open(), mi.Float(0.5), place, mi.Point2f(0.5))[0]

    def directions(self) -> NDArray[np.float32]:
        """(k, 2, 2, 3) as of `Film`: the corners tell all, as these cameras project on a plane."""
        mi, sensor = self._mi, self._sensor
        count = _APERTURE if sensor.needs_aperture_sample() else 1
        lens = np.modf(0.5 + np.arange(count)[:, None] * np.array(_STEPS))[0]
        u, v = np.meshgrid([0.0, 1.0], [0.0, 1.0])
        shape = (count, 2, 2)
        at = [np.broadcast_to(axis, shape).ravel().astype(np.float32) for axis in (u, v)]
        through = [np.broadcast_to(lens[:, axis, None, None], shape).ravel().astype(np.float32) for axis in (0, 1)]
        ray, _ = sensor.sample_ray(sensor.shutter_open(), mi.Float(0.5), mi.Point2f(*at), mi.Point2f(*through))
        found = np.broadcast_to(np.array(ray.d, dtype=np.float64), (3, at[0].size)).T.reshape(*shape, 3)
        return np.stack([_on_a_plane(corners) for corners in found]).astype(np.float32)

    def _offset(self, u: Any, place: Any, size: int) -> tuple[Any, Any]:
        """How far from the middle of a pixel (at ``place``, of ``size``) along an axis, and with what weight.

        Drawn as the filter's absolute value, inside the film.
        """
        import drjit as dr

        mi, radius = self._mi, self._filter.radius
        cells = self._filter.values.size
        low, high = mi.Float(0.0), mi.Float(float(cells))
        if not self._beyond:
            low = dr.maximum(low, (radius - place) * (cells / (2.0 * radius)))
            high = dr.minimum(high, (radius + size - place) * (cells / (2.0 * radius)))
        begin, end = self._at(self._magnitude, low), self._at(self._magnitude, high)
        wanted = dr.lerp(begin, end, u)
        cell = dr.binary_search(
            0, cells, lambda k: dr.gather(mi.Float, self._magnitude, dr.minimum(k + 1, cells)) < wanted
        )
        cell = dr.minimum(mi.UInt32(cell), cells - 1)
        before, after = (dr.gather(mi.Float, self._magnitude, cell + step) for step in (0, 1))
        part = dr.select(after > before, (wanted - before) / (after - before), 0.5)
        position = dr.clip(mi.Float(cell) + part, low, high)
        integral = self._at(self._signed, high) - self._at(self._signed, low)
        return position * (2.0 * radius / cells) - radius, dr.gather(mi.Float, self._signs, cell) * (
            end - begin
        ) / integral

    def _at(self, table: Any, place: Any) -> Any:
        """A running integral at a place in cells."""
        import drjit as dr

        mi = self._mi
        cell = dr.minimum(mi.UInt32(place), self._filter.values.size - 1)
        before, after = (dr.gather(mi.Float, table, cell + step) for step in (0, 1))
        return dr.fma(place - mi.Float(cell), after - before, before)


def _on_a_plane(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Directions (2, 2, 3) of such lengths that they end in a parallelogram, as the corners of a film do.

    The lengths s solve s00 d00 + s11 d11 = s01 d01 + s10 d10, and are equal where the directions are nearly so.
    """
    columns = np.stack([corners[0, 0], corners[1, 1], -corners[0, 1], -corners[1, 0]], axis=1)
    _, values, rows = np.linalg.svd(columns)
    lengths = np.abs(rows[3]) * 2.0 if values[2] > _PARALLEL * values[0] else np.ones(4)
    return corners * lengths[[[0, 2], [3, 1]]][..., None]
