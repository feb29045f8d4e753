"""Perspective cameras as plain data: a scene's own, one that was asked for, or one that frames a model."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.errors import UserError, check_choice

# Axes that may point up.
UPS = ("y", "z")

# Without a scene's camera: the angle across the width of a camera that is placed by hand; of one that frames a model,
# the angle across the height, the part of the picture that stays empty on each side, and how high above the model it
# stands.
_FOV = 35.0
_FRAMING_FOV = 28.0
_MARGIN = 0.04
_COSINE, _SINE = math.cos(math.radians(10.0)), math.sin(math.radians(10.0))

# Of a picture: along each side, and in all.
LARGEST_SIDE, MOST_PIXELS = 1 << 16, 1 << 28

# Distances that float32 holds, and how far from orthonormal axes may be in Mitsuba, which refuses others.
_NEAREST, _FURTHEST = 2.0**-126, 1e38
_RIGID = 1.2e-3

# Directions closer to each other than this leave no sense of what is up.
_PARALLEL = 1e-6


@dataclass(frozen=True)
class View:
    """A perspective camera in world space.

    Attributes
    ----------
    name : str
    to_world : nested lists, (4, 4)
    fov : float
        Across the width, in degrees.
    width, height : int
        Of the film, in pixels.
    near, far : float
        Clipping distances.
    """

    name: str
    to_world: list[list[float]]
    fov: float
    width: int
    height: int
    near: float
    far: float

    def moved(self, by: ArrayLike) -> View:
        """The same camera, its position moved by (3,)."""
        matrix = np.array(self.to_world)
        matrix[:3, 3] += by
        return replace(self, to_world=matrix.tolist())

    def as_dict(self) -> dict[str, Any]:
        """The attributes by name, for files."""
        return asdict(self)


def check_view(view: Any) -> None:
    """Raise ValueError for a view that Mitsuba makes no camera of, or no picture can be drawn of.

    Parameters
    ----------
    view : object with the attributes of `View`
    """
    if not 0.0 < np.float32(view.fov) < 180.0:
        raise ValueError("fov of the view")
    if not 1 <= min(view.width, view.height) <= max(view.width, view.height) <= LARGEST_SIDE:
        raise ValueError("sides of the view")
    if view.width * view.height > MOST_PIXELS:
        raise ValueError(f"a view of {view.width} x {view.height} pixels")
    if (
        not _NEAREST
        <= np.float32(min(view.near, _FURTHEST))
        < np.float32(min(view.far, 2.0 * _FURTHEST))
        < 1.5 * _FURTHEST
    ):
        raise ValueError("clipping distances of the view")
    matrix = np.array(view.to_world, dtype=np.float64)
    if matrix.shape != (4, 4) or not np.abs(matrix).max() <= _FURTHEST or not np.array_equal(matrix[3], [0, 0, 0, 1]):
        raise ValueError("matrix of the view")
    axes = matrix[:3, :3]
    if np.abs(axes).max() > 2.0 or np.abs(axes.T @ axes - np.eye(3)).max() > _RIGID:
        raise ValueError("axes of the view, which have to be orthonormal")


@dataclass(frozen=True)
class Aim:
    """Where a picture is wanted from; what is None is left to the scene's camera, or chosen so that all is seen.

    Attributes
    ----------
    look_at : (origin, target) or None
        Two points of world space.
    fov : float or None
        Across the width, in degrees.
    up : "y", "z" or None
        The axis that points up in the picture.

    Raises
    ------
    UserError
        Points that are not three finite numbers, or the same; a look straight up or down; an angle outside (0, 180).
    """

    look_at: tuple[ArrayLike, ArrayLike] | None = None
    fov: float | None = None
    up: str | None = None

    def __post_init__(self) -> None:
        if self.up is not None:
            check_choice(self.up, "up", UPS)
        if self.fov is not None:
            object.__setattr__(self, "fov", _checked_fov(self.fov))
        if self.look_at is not None:
            object.__setattr__(self, "look_at", _checked_points(self.look_at))
            origin, target = self.points
            look_matrix(origin, target - origin, self.axis)

    @property
    def asked(self) -> bool:
        """Whether anything is asked for."""
        return any(value is not None for value in (self.look_at, self.fov, self.up))

    @property
    def axis(self) -> str:
        """The axis that points up, by default y."""
        return self.up or "y"

    @property
    def points(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Origin and target of ``look_at``."""
        assert self.look_at is not None
        origin, target = (np.array(point, dtype=np.float64) for point in self.look_at)
        return origin, target


def _checked_fov(fov: Any) -> float:
    try:
        angle = float(fov)
    except (TypeError, ValueError):
        angle = math.nan
    if not 0.0 < angle < 180.0:
        raise UserError(f"fov must be an angle between 0 and 180 degrees, not {fov!r}")
    return angle


def _checked_points(look_at: Any) -> tuple[tuple[float, ...], tuple[float, ...]]:
    try:
        points = np.array(look_at, dtype=np.float64)
    except (TypeError, ValueError):
        points = np.zeros(0)
    if points.shape != (2, 3) or not np.all(np.isfinite(points)):
        raise UserError(f"look_at must be two points of three finite numbers, origin and target, not {look_at!r}")
    if np.linalg.norm(points[1] - points[0]) <= 1e-12 * np.abs(points).max():
        raise UserError(f"look_at must be two different points; origin and target are both {points[0].tolist()}")
    origin, target = (tuple(point.tolist()) for point in points)
    return origin, target


def up_rotation(up: str) -> NDArray[np.float64]:
    """(3, 3) rotation that takes what is above in a y-up world, such as the sky of a map, to the axis ``up``.

    For z it is the quarter turn about x that takes y to z and the front, +z, to -y: how a y-up model is imported where
    z is up.
    """
    check_choice(up, "up", UPS)
    if up == "y":
        return np.eye(3)
    return np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def look_matrix(origin: NDArray, direction: NDArray, up: str) -> NDArray[np.float64]:
    """(4, 4) matrix of a camera as Mitsuba has it: its x is left in the picture, y up, and it looks along z.

    Raises
    ------
    UserError
        The camera looks along the axis that is up.
    """
    direction = direction / np.linalg.norm(direction)
    left = np.cross(up_rotation(up)[:, 1], direction)
    length = float(np.linalg.norm(left))
    if length < _PARALLEL:
        other = "y" if up == "z" else "z"
        raise UserError(
            f"`look_at` looks along the axis {up}, which is to be up in the picture; move the origin aside, or give "
            f"`up={other}`"
        )
    left /= length
    matrix = np.eye(4)
    matrix[:3] = np.stack([left, np.cross(direction, left), direction, origin], axis=1)
    return matrix


def aimed_view(aim: Aim, own: View | None, points: NDArray[np.float64], width: int) -> View:
    """The camera that is asked for.

    Parameters
    ----------
    aim : Aim
    own : View or None
        The scene's camera: what is not asked for is as there.
    points : (n, 3)
        Of what is to be seen, in world space.
    width : int
        In pixels, without a camera of the scene.
    """
    if aim.look_at is not None:
        origin, target = aim.points
        near, far = _clip(origin, points)
        size = (width, max(1, round(0.75 * width))) if own is None else (own.width, own.height)
        fov = aim.fov or (_FOV if own is None else own.fov)
        return View("look_at", look_matrix(origin, target - origin, aim.axis).tolist(), fov, *size, near, far)
    if own is None:
        return _framing_view(aim, points, width)
    if aim.fov is not None:
        own = replace(own, fov=aim.fov)
    if aim.up is not None:
        matrix = np.array(own.to_world)
        own = replace(own, to_world=look_matrix(matrix[:3, 3], matrix[:3, 2], aim.up).tolist())
    return own


def _framing_view(aim: Aim, points: NDArray[np.float64], width: int) -> View:
    """A camera in front of the points and a little above, that sees them all with a margin around."""
    turn = up_rotation(aim.axis)
    right, up, toward = (turn @ axis for axis in ([1.0, 0.0, 0.0], [0.0, _COSINE, -_SINE], [0.0, _SINE, _COSINE]))
    center = 0.5 * (points.min(axis=0) + points.max(axis=0))
    radius = max(float(np.linalg.norm(points - center, axis=1).max()), 1e-12 * float(np.abs(center).max()), 1e-30)
    x, y, depth = ((points - center) @ axis for axis in (right, up, toward))
    aspect = float(np.clip(np.ptp(x) / max(np.ptp(y), 1e-6 * radius), 0.6, 1.8))
    across = aim.fov or math.degrees(2.0 * math.atan(aspect * math.tan(math.radians(_FRAMING_FOV / 2.0))))
    tangent = (1.0 - 2.0 * _MARGIN) * math.tan(math.radians(across / 2.0))
    # From the place (m, d) a point at x is seen if |x - m| <= tangent (d - depth): the nearest place where both sides
    # are tight is m = (a - b)/2, d = (a + b)/(2 tangent), with the largest x + tangent depth as a, that of -x as b.
    middle, nearest = [], [1.2 * radius]
    for offset, slope in ((x, tangent), (y, tangent / aspect)):
        first, second = (float((side * offset + slope * depth).max()) for side in (1.0, -1.0))
        middle.append(0.5 * (first - second))
        nearest.append(0.5 * (first + second) / slope)
    distance = max(nearest)
    origin = center + middle[0] * right + middle[1] * up + distance * toward
    matrix = look_matrix(origin, -toward, aim.axis)
    near, far = _clip(origin, points)
    return View("framing", matrix.tolist(), across, width, max(1, round(width / aspect)), near, far)


def _clip(origin: NDArray[np.float64], points: NDArray[np.float64]) -> tuple[float, float]:
    """Clipping distances that cut off nothing near the points."""
    low, high = points.min(axis=0), points.max(axis=0)
    size = max(float(np.linalg.norm(high - low)), 1e-30)
    return 1e-4 * size, 1e3 * (size + float(np.linalg.norm(origin - 0.5 * (low + high))))


def view_of(mi: Any, sensor: Any) -> View | None:
    """A scene's own camera, or None if it is not a plain perspective one, or `check_view` refuses it."""
    if sensor is None or sensor.class_name() != "PerspectiveCamera":
        return None
    parameters = mi.traverse(sensor)
    columns, rows = (int(n) for n in sensor.film().size())
    shifted = [float(np.ravel(parameters[f"principal_point_offset_{axis}"])[0]) for axis in "xy"]
    if any(shifted) or [int(n) for n in sensor.film().crop_size()] != [columns, rows]:
        return None  # cropped, or with a shifted lens
    matrix = np.array(parameters["to_world"].matrix, dtype=np.float64).reshape(4, 4)
    view = View(
        sensor.id(),
        matrix.tolist(),
        float(np.ravel(parameters["x_fov"])[0]),
        columns,
        rows,
        float(parameters["near_clip"]),
        min(float(parameters["far_clip"]), _FURTHEST),
    )
    try:
        check_view(view)
    except ValueError:
        return None
    return view
