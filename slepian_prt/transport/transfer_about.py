"""What a file of `Transfer.save` has to be: the keys of ``about``, and the types and shapes of its arrays."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import UNSET, Meta, Struct, UnsetType
from numpy.typing import NDArray

from slepian_prt.scene.left_out import LeftOut
from slepian_prt.scene.mesh import LARGEST_COORDINATE
from slepian_prt.scene.view import LARGEST_SIDE, MOST_PIXELS, View, check_view
from slepian_prt.sphere.harmonics import num_coefficients
from slepian_prt.transport.effects import Effect
from slepian_prt.transport.json_text import with_characters
from slepian_prt.transport.settings import LARGEST_BANDLIMIT

FORMAT = "slepian_prt uncompressed transfer"
VERSION = 1

# Numbers whose products with those of lights are finite in float32.
_LARGEST_NUMBER = 2.0**64

_MOST = (1 << 31) - 1

# What the length of a direction may be off.
_UNIT = 1e-3

Count = Annotated[int, Meta(ge=0, le=_MOST)]
Whole = Annotated[int, Meta(ge=0, le=(1 << 63) - 1)]
Side = Annotated[int, Meta(ge=1, le=LARGEST_SIDE)]
Finite = Annotated[float, Meta(ge=-1e300, le=1e300)]


class Begin(Struct):
    """What tells a file of ours, of whatever version."""

    format: Any = None
    version: Any = None


class StoredLight(Struct):
    """Of the scene's own light."""

    name: str
    clamped: Count


class StoredLamps(Struct):
    """Of the scene's lamps."""

    names: list[str]
    kinds: list[str]


class StoredFilm(Struct):
    """Of the camera whose pixels the receivers are."""

    name: str
    width: Side
    height: Side
    crop: Annotated[list[Count], Meta(min_length=2, max_length=2)]
    size: Annotated[list[Side], Meta(min_length=2, max_length=2)]


class StoredPart(Struct, array_like=True):
    """A shape of the scene."""

    name: str
    first: Count
    count: Count
    sides: Literal[1, 2] = 1


class About(Struct):
    """All of it; other keys are passed over."""

    bandlimit: Annotated[int, Meta(ge=0, le=LARGEST_BANDLIMIT)]
    samples: Whole
    seed: Annotated[int, Meta(ge=0)]
    bounces: Whole
    rays_traced: Whole
    seconds: dict[str, Finite]
    source: str
    toward_view: bool
    name: str
    notes: list[str]
    known_albedo: bool
    not_simulated: list[LeftOut]
    parts: list[StoredPart]
    effects: list[Effect]
    view: View | None
    environment: StoredLight | None
    parameters: dict[str, Any] | UnsetType = UNSET
    noise: Annotated[float, Meta(ge=0.0, le=1e100)] | UnsetType | None = UNSET
    fixed: StoredLamps | UnsetType = UNSET
    film: StoredFilm | UnsetType = UNSET


_begin, _about = msgspec.json.Decoder(Begin), msgspec.json.Decoder(About)


def begin_of(text: str) -> tuple[Any, Any]:
    """Format and version; ValueError for what is not JSON."""
    begin: Begin = _decode(_begin, text)
    return begin.format, begin.version


def read_about(text: str) -> dict[str, Any]:
    """As plain data; ValueError for what has other keys, types or ranges."""
    about: About = _decode(_about, text)
    ends = [0]
    for part in about.parts:
        if part.first != ends[-1]:
            raise ValueError("parts do not follow each other")
        ends.append(part.first + part.sides * part.count)
    if isinstance(about.film, StoredFilm) and about.film.width * about.film.height > MOST_PIXELS:
        raise ValueError(f"a film of {about.film.width} x {about.film.height} pixels")
    if about.view is not None:
        check_view(about.view)
    plain: dict[str, Any] = msgspec.to_builtins(about)
    return plain


def _decode(decoder: Any, text: str) -> Any:
    try:
        return decoder.decode(with_characters(text.encode()))
    except (msgspec.MsgspecError, RecursionError, UnicodeEncodeError) as error:
        raise ValueError(str(error).replace("`", "")) from None


# Types by their kinds, and shapes in sizes: those of `about`, and others that the first array tells which has them.
_FLOAT, _WHOLE = "f", "iu"
_ARRAYS: dict[str, tuple[str, tuple[int | str, ...]]] = {
    "positions": (_FLOAT, ("V", 3)),
    "vectors": (_FLOAT, ("V", "channels", "M")),
    "normals": (_FLOAT, ("V", 3)),
    "faces": (_WHOLE, ("F", 3)),
    "albedo": (_FLOAT, ("V", 3)),
    "axes": (_FLOAT, ("V", 3)),
    "environment_texels": (_FLOAT, ("rows", "columns", 3)),
    "environment_to_world": (_FLOAT, (3, 3)),
    "sky_samples": (_FLOAT, ("directions", 3)),
    "sky_frame": (_FLOAT, (3, 3)),
    "sky_disk_directions": (_FLOAT, ("points", 3)),
    "sky_disk_evaluated": (_FLOAT, ("points", 3)),
    "sky_disk_solid_angles": (_FLOAT, ("points",)),
    "sky_sun": (_FLOAT, (4,)),
    "fixed_emitted": (_FLOAT, ("lamps", 3)),
    "fixed_direct": (_FLOAT, ("lamps", "V", 3)),
    "fixed_bounced": (_FLOAT, ("lamps", "V", 3)),
    "fixed_directions": (_FLOAT, ("lamps", 3)),
    "film_background": (_FLOAT, ("V", 3)),
    "film_directions": (_FLOAT, ("nodes", "lines", "stations", 3)),
    "film_noise": (_FLOAT, ("V",)),
    "film_noise_power": (_FLOAT, ("L+1",)),
}

NAMES = tuple(_ARRAYS)


class Shapes:
    """Sizes of a file's arrays, as far as they are known.

    Parameters
    ----------
    about : dict
        As `read_about` gives it.
    """

    def __init__(self, about: dict[str, Any]) -> None:
        self._sizes = {"L+1": about["bandlimit"] + 1, "M": num_coefficients(about["bandlimit"])}
        # Where parts end, and in a film, whose pixels are of none, all.
        ends = [0, *(first + sides * count for _, first, count, sides in about["parts"])]
        if "fixed" in about:
            self._sizes["lamps"] = len(about["fixed"]["names"])
            if len(about["fixed"]["kinds"]) != self._sizes["lamps"]:
                raise ValueError("kinds of lamps")
        if "film" in about:
            self._sizes["V"] = about["film"]["width"] * about["film"]["height"]
        else:
            self._sizes["V"] = ends[-1]

    def expect(self, name: str, dtype: np.dtype[Any], shape: tuple[int, ...]) -> None:
        """Raise ValueError for an array of another type or shape."""
        kinds, sizes = _ARRAYS[name]
        if dtype.kind not in kinds:
            raise ValueError(f"{name} of type {dtype}")
        wanted = [size if isinstance(size, int) else self._sizes.get(size) for size in sizes]
        if len(shape) != len(wanted) or any(size not in (None, n) for n, size in zip(shape, wanted, strict=True)):
            told = ", ".join("any" if size is None else str(size) for size in wanted)
            raise ValueError(f"{name} of shape ({', '.join(map(str, shape))}), not ({told})")
        for size, n in zip(sizes, shape, strict=True):
            if isinstance(size, str):
                self._sizes[size] = n
        if self._sizes.get("channels", 1) not in (1, 3) or min(shape) < (name not in _MAY_BE_EMPTY):
            raise ValueError(f"{name} of shape {shape}")

    def accept(self, name: str, array: NDArray) -> None:
        """Raise ValueError for numbers that cannot be."""
        if not array.size:
            return
        if name == "faces":
            low, high = 0.0, float(self._sizes["V"] - 1)
        else:
            high = _LARGEST.get(name, _LARGEST_NUMBER)
            low = -high
        if not low <= float(array.min()) <= float(array.max()) <= high:  # nor NaN
            raise ValueError(f"{name} outside of [{low:g}, {high:g}]")
        if name == "sky_sun" and not abs(float(np.linalg.norm(array[:3])) - 1.0) < _UNIT:
            raise ValueError(f"{name} is toward no direction")


def check_parts(parts: list[Any], faces: NDArray) -> None:
    """Raise ValueError where a face (F, 3) joins two parts."""
    ends = np.cumsum([sides * count for _, _, count, sides in parts], dtype=np.int64)
    part = np.searchsorted(ends, faces, side="right")
    if np.any(part != part[:, :1]):
        raise ValueError("a face joins two parts")


_LARGEST = {"positions": LARGEST_COORDINATE, "fixed_directions": 1.001}

# A scene may have no lamps, and a sky no sun.
_MAY_BE_EMPTY = (
    *(f"fixed_{name}" for name in ("emitted", "direct", "bounced", "directions")),
    *(f"sky_disk_{name}" for name in ("directions", "evaluated", "solid_angles")),
    "sky_samples",
    "faces",
)
