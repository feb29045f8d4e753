"""Kinds of values that options take, and readers of values that belong together."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence
from dataclasses import fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from slepian_prt.cli.messages import note
from slepian_prt.errors import UserError

if TYPE_CHECKING:
    from slepian_prt.accuracy.goal import Light
    from slepian_prt.compression.compressed import CompressedTransfer
    from slepian_prt.lighting.environment import Environment

Settings = TypeVar("Settings")


class Names(click.Choice):
    """One of the names in a table of the library, which is imported when they are needed."""

    def __init__(self, option: str) -> None:
        self._option = option
        self.case_sensitive = True

    @cached_property
    def choices(self) -> tuple[str, ...]:  # type: ignore[override]
        return names_of(self._option)


def names_of(option: str) -> tuple[str, ...]:
    """What an option may be, from the tables of the library."""
    from slepian_prt.compression.settings import BASES, CODINGS, GROUPINGS
    from slepian_prt.compression.truncation import TRUNCATIONS
    from slepian_prt.lighting.windowing import WINDOWS

    tables = {
        "basis": (*BASES, "none"),
        "coding": CODINGS,
        "group_by": GROUPINGS,
        "truncate": TRUNCATIONS,
        "window": WINDOWS,
    }
    return tables[option]


class Albedo(click.ParamType):
    """One number, or three with commas between."""

    name = "albedo"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> list[float]:
        try:
            return [float(part) for part in value.split(",")]
        except ValueError:
            raise UserError(f"`albedo` must be one number between 0 and 1, or three as R,G,B; not {value!r}") from None


class Point(click.ParamType):
    """Three numbers with commas between."""

    name = "point"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> list[float]:
        try:
            coordinates = [float(part) for part in value.split(",")]
        except ValueError:
            coordinates = []
        if len(coordinates) != 3:
            assert param is not None
            raise UserError(f"`{param.name}` must be two points X,Y,Z of three numbers each; {value!r} is none")
        return coordinates


class LampScale(click.ParamType):
    """A number, of all lamps, or NAME=NUMBER, of one."""

    name = "scale"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, float]:
        name, is_named, number = value.rpartition("=")
        try:
            return (name if is_named else "*"), float(number)
        except ValueError:
            raise UserError(f"`fixed_lights` must be a number, or NAME=NUMBER for one lamp, not {value!r}") from None


class Several(click.ParamType):
    """Values of one kind with commas between."""

    name = "list"

    def __init__(self, kind: Callable[[str], Any]) -> None:
        self._kind = kind

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[Any, ...]:
        try:
            return tuple(self._kind(part) for part in value.split(","))
        except ValueError:
            assert param is not None
            raise UserError(f"`{param.name}` must be numbers with commas between, not {value!r}") from None


class Parameter(click.ParamType):
    """The name of a scene's parameter and its value."""

    name = "parameter"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, str]:
        name, equals, text = value.partition("=")
        if not equals or not name:
            raise UserError(f"-D must be NAME=VALUE, not {value!r}")
        return name, text


def as_dict(
    _context: click.Context, _option: click.Parameter, pairs: Sequence[tuple[str, str]]
) -> dict[str, str] | None:
    """Pairs as a dict, None if there are none; raise UserError for a name that is given twice."""
    if (name := _repeated(pairs)) is not None:
        raise UserError(f"-D {name} is given twice; give it once")
    return dict(pairs) or None


def as_scales(
    _context: click.Context, _option: click.Parameter, pairs: Sequence[tuple[str, float]]
) -> dict[str, float] | float:
    """What lamps are multiplied by, 1 if nothing is given; raise UserError for a lamp that is given twice."""
    if (name := _repeated(pairs)) is not None:
        raise UserError(f"`fixed_lights` is given twice for {'all lamps' if name == '*' else name}; give it once")
    return dict(pairs) or 1.0


def _repeated(pairs: Sequence[tuple[str, Any]]) -> str | None:
    return next((name for number, (name, _) in enumerate(pairs) if name in dict(pairs[:number])), None)


def settings_of(kind: Callable[..., Settings], options: dict[str, Any], **more: Any) -> Settings:
    """The dataclass ``kind`` from those options that are its fields."""
    names = {field.name for field in fields(kind)}  # type: ignore[arg-type]
    return kind(**{name: value for name, value in options.items() if name in names}, **more)


def read_maps(
    paths: Sequence[str], clamp_negative: bool, rotate: float = 0.0, up: str | None = None
) -> list[Environment]:
    """The environments that are named, turned, their sky put up; what was mended in them is noted."""
    from slepian_prt.lighting.environment import check_names
    from slepian_prt.scene.view import up_rotation

    check_names(paths)
    lights = [_read_map(path, clamp_negative).rotated(rotate) for path in paths]
    stand = up_rotation(up or "y")
    return [light.turned(stand) for light in lights]


def read_transfer(file: str, *, check: bool = True) -> CompressedTransfer:
    """The transfer file that is named, see `load`; of a mesh or scene it is said how to make one."""
    from slepian_prt.compression.files.prt_file import load

    try:
        return load(file, check=check)
    except UserError:
        from slepian_prt.scene.mesh_files import MESH_SUFFIXES

        path = Path(file)
        if path.is_file() and path.suffix.lower() in (*MESH_SUFFIXES, ".gltf", ".xml"):
            kind = "Mitsuba scene" if path.suffix.lower() == ".xml" else "mesh"
            command = shlex.join(["slepian-prt", "precompute", file, "-o", str(path.with_suffix(".prt"))])
            raise UserError(f"{file}: is a {kind}, not a transfer file; first run: {command}") from None
        raise


def _read_map(path: str, clamp_negative: bool) -> Environment:
    from slepian_prt.lighting.environment import read_environment

    light = read_environment(path, clamp_negative=clamp_negative)
    if light.clamped:
        note(f"{path}: {light.clamped} negative texels set to zero")
    return light


def read_light(environment: Sequence[str], light_prior: Sequence[str], clamp_negative: bool) -> Light:
    """The light that errors count under: maps, and what compression is made for."""
    from slepian_prt.accuracy.goal import Light
    from slepian_prt.lighting.spectrum import FALLING

    if "" in light_prior:
        raise UserError(f"`light_prior` is empty; give {FALLING} or a map")
    if FALLING in light_prior and len(light_prior) > 1:
        raise UserError(f"`light_prior` is either {FALLING} or maps, not both")
    known = () if FALLING in light_prior else tuple(_read_map(path, clamp_negative) for path in light_prior)
    named = ", ".join(light.name for light in known) or "".join(light_prior)
    return Light(tuple(read_maps(environment, clamp_negative)), named, known)
