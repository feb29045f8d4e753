"""Mitsuba scenes from files and dicts: parsed, freed of what transport does not need, moved if they are far, made."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.renderer.threads import two_threads
from slepian_prt.scene.mitsuba.errors import load_failure, unused_parameters
from slepian_prt.scene.mitsuba.inspection import check_named_files, inspect_xml
from slepian_prt.scene.mitsuba.objects import is_of_mitsuba, live_objects, scene_of
from slepian_prt.scene.mitsuba.recentering import far_center, move_scene

log = logging.getLogger(__name__)

# Names that the parser's own arguments have in Python, so that no parameter of a scene can be handed over by them.
_TAKEN = ("config", "filename")

# Our integrators may stand in a scene whose transfer is still to be computed, and need not be registered then.
_INTEGRATORS = ("slepian_prt", "slepian_prt_capture")


@dataclass(frozen=True)
class _Source:
    """A scene that is not made yet.

    Attributes
    ----------
    origin : str
        For messages.
    folder : path or None
        Where relative names of files are looked for first; a dict has none.
    parse : callable
        Gives Mitsuba's parsed scene for a configuration, a new one each time: what is made of it is spent.
    movable : bool
        Whether all of it is a description: what is made already stays where it is.
    """

    origin: str
    folder: Path | None
    parse: Callable[[Any], Any]
    movable: bool = True


def load_xml(
    mi: Any, path: Path, parameters: Mapping[str, str] | None = None, *, needs_camera: bool = False
) -> tuple[Any, NDArray[np.float64]]:
    """A scene from an .xml file, unoptimised: merged shapes lose their names, and rectangles their resolution.

    Parameters
    ----------
    mi : Mitsuba
    path : path
    parameters : dict of str to str, optional
        Values of the scene's ``$name``.
    needs_camera : bool
        Whether its cameras must be there; else they are left out, with a remark, where they cannot be loaded.

    Returns
    -------
    scene : Mitsuba scene
    origin : (3,)
        The point of the world that is its origin: another than zero if the scene is far from it.

    Raises
    ------
    UserError
        What Mitsuba cannot load, with file and line; a parameter that is missing or that the scene does not have.
    """
    parameters = parameters or {}
    if taken := [name for name in _TAKEN if name in parameters]:
        raise UserError(f"{path}: Mitsuba takes no parameter ${taken[0]} from outside; rename it in the scene")
    inspect_xml(path, parameters)

    def parse(config: Any) -> Any:
        try:
            return mi.parser.parse_file(config, str(path), **parameters)
        except Exception as error:
            if unused := unused_parameters(error):
                config.unused_parameters = mi.LogLevel.Debug
                files = mi.parser.parse_file(config, str(path), **parameters).files
                raise _no_such_parameters(str(path), unused, files) from None
            raise

    return _load(mi, _Source(str(path), path.parent, parse), needs_camera=needs_camera)


def load_dict(mi: Any, description: dict[str, Any], *, needs_camera: bool = False) -> tuple[Any, NDArray[np.float64]]:
    """A scene from a dict as of ``mi.load_dict``; as `load_xml`."""
    movable = not live_objects(description)
    source = _Source("scene", None, lambda config: mi.parser.parse_dict(config, description), movable)
    return _load(mi, source, needs_camera=needs_camera)


@contextmanager
def silent(mi: Any) -> Iterator[None]:
    """Mitsuba's warnings left out: they go to standard output, where the plan does."""
    level = mi.log_level()
    try:
        mi.set_log_level(mi.LogLevel.Error)
        yield
    finally:
        mi.set_log_level(level)


def _load(mi: Any, source: _Source, *, needs_camera: bool) -> tuple[Any, NDArray[np.float64]]:
    left_out: tuple[str, ...] = ("Integrator",)
    with silent(mi), _looking_in(mi, source.folder):
        state = _parsed(mi, source)
        _take_out(mi, state, *left_out)
        try:
            loaded = _made(mi, state, source.origin)
        except UserError as error:
            state = _parsed(mi, source)
            if needs_camera or not _take_out(mi, state, "Sensor"):
                raise
            left_out = ("Integrator", "Sensor")
            _take_out(mi, state, *left_out)
            try:
                loaded = _made(mi, state, source.origin)
            except UserError:
                raise error from None
            told = (
                str(error).removesuffix("; correct it there").replace("load the scene", "load a camera of the scene", 1)
            )
            log.info("%s; it is loaded without cameras", told)
        center = far_center(loaded) if source.movable else None
        if center is None:
            return loaded, np.zeros(3)
        state = _parsed(mi, source)
        _take_out(mi, state, *left_out)
        move_scene(mi, state, center)
        return _made(mi, state, source.origin), center


@contextmanager
def _looking_in(mi: Any, folder: Path | None) -> Iterator[None]:
    """Names of files resolved from a folder first, and what the scene adds to that forgotten afterwards."""
    outside = mi.file_resolver()
    resolver = mi.FileResolver(outside)
    if folder is not None:
        resolver.prepend(str(folder))
    try:
        mi.set_file_resolver(resolver)
        yield
    finally:
        mi.set_file_resolver(outside)


def _parsed(mi: Any, source: _Source) -> Any:
    config = _configuration(mi)
    try:
        state = source.parse(config)
        mi.parser.transform_all(config, state)
    except UserError:
        raise
    except Exception as error:  # whatever Mitsuba's parser raises
        raise load_failure(error, source.origin, mi.variant(), in_dict=source.folder is None) from None
    _check_groups(mi, state, source.origin)
    return state


def _check_groups(mi: Any, state: Any, origin: str) -> None:
    """Raise UserError for an instance of nothing: with it Mitsuba cannot trace a single ray."""
    for node in state.nodes:
        if node.props.plugin_name() != "instance":
            continue
        for group in _references(mi, state, node):
            things = [group.props[name] for name in group.props]
            if group.props.plugin_name() == "shapegroup" and not any(
                isinstance(thing, mi.Properties.ResolvedReference) or is_of_mitsuba(thing) for thing in things
            ):
                place = mi.parser.file_location(state, node)
                reason = ValueError(f"At {place}: the shapegroup of this instance holds no shapes")
                raise load_failure(reason, origin, mi.variant())


def _references(mi: Any, state: Any, node: Any) -> list[Any]:
    """The nodes that one refers to."""
    values = [node.props[name] for name in node.props]
    return [state.nodes[value.index()] for value in values if isinstance(value, mi.Properties.ResolvedReference)]


def _made(mi: Any, state: Any, origin: str) -> Any:
    """The scene that was parsed."""

    def file_at(place: str) -> str | None:
        for node in state.nodes:
            if place and "filename" in node.props and mi.parser.file_location(state, node) == place:
                return str(node.props["filename"])
        return None

    def fault(node: Any, reason: str) -> UserError:
        place = mi.parser.file_location(state, node)
        return load_failure(ValueError(f"At {place}: {reason}" if place else reason), origin, mi.variant())

    check_named_files(mi, state, fault)
    try:
        with two_threads():
            made = mi.parser.instantiate(_configuration(mi), state)
    except Exception as error:  # whatever plugins raise
        raise load_failure(error, origin, mi.variant(), file_at) from None
    return scene_of(mi, made, origin)


def _configuration(mi: Any) -> Any:
    config = mi.parser.ParserConfig(mi.variant())
    config.merge_meshes = config.merge_equivalent = False
    return config


def _take_out(mi: Any, state: Any, *kinds: str) -> int:
    """Leave out what the scene refers to of some kinds of objects; how many these are.

    They need not even be loadable: integrators are of no use to transport, and ours asks for the very file that is to
    be computed.
    """
    properties, count = state.root.props, 0
    if properties.plugin_name() != "scene":
        return 0
    for name in list(properties):
        if isinstance(properties[name], mi.Properties.ResolvedReference):
            node = state.nodes[properties[name].index()]
            ours = "Integrator" in kinds and node.props.plugin_name() in _INTEGRATORS
            if ours or node.type.name in kinds:
                del properties[name]
                count += 1
    return count


def _no_such_parameters(origin: str, unused: list[str], files: list[Any]) -> UserError:
    """The parameters that a scene does not have, with those that it has."""
    texts = [Path(str(file)).read_text(errors="replace") for file in files]
    used = {name for text in texts for name in re.findall(r"(?<!\\)\$(\w+)", text)}
    known = ", ".join(f"${name}" for name in sorted(used)) or "no parameters"
    several = "s" if len(unused) > 1 else ""
    listed = ", ".join(f"${name}" for name in unused)
    return UserError(f"{origin}: has no parameter{several} {listed}; it has {known}")
