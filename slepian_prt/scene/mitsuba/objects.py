"""Mitsuba's objects as they are in memory: scenes and shapes that the user has loaded, and uses afterwards."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TypeGuard

from slepian_prt.errors import UserError

# Dicts within dicts; Mitsuba's parser dies of too many.
_DEEPEST = 100


def is_of_mitsuba(thing: Any) -> TypeGuard[Any]:
    """Whether it is an object of Mitsuba; Mitsuba itself is not imported."""
    return any((kind.__module__, kind.__name__) == ("mitsuba", "Object") for kind in type(thing).__mro__)


def live_objects(thing: Any, depth: int = 0) -> list[Any]:
    """Mitsuba's objects in a dict, or the one given, if they belong to a variant; UserError for a dict in itself."""
    if isinstance(thing, dict):
        if depth > _DEEPEST:
            raise UserError(f"scene: its dict holds itself, or is nested more than {_DEEPEST} deep; correct it")
        return [found for value in thing.values() for found in live_objects(value, depth + 1)]
    return [thing] if is_of_mitsuba(thing) and thing.variant_name() else []


def variant_of(thing: Any) -> str | None:
    """The variant that an object, or what a dict holds of them, was made in; None for a mere description.

    Raises
    ------
    UserError
        Objects of several variants.
    """
    variants = sorted({found.variant_name() for found in live_objects(thing)})
    if len(variants) > 1:
        raise UserError(f"scene: its objects are of different variants, {', '.join(variants)}; make them all in one")
    return variants[0] if variants else None


def scene_of(mi: Any, thing: Any, origin: str) -> Any:
    """A Mitsuba scene, or one that is made of a shape.

    Raises
    ------
    UserError
        Something else.
    """
    if isinstance(thing, mi.Scene):
        return thing
    shapes = thing if isinstance(thing, list) else [thing]
    if all(isinstance(shape, mi.Shape) for shape in shapes):
        named = {f"shape_{number}": shape for number, shape in enumerate(shapes)}
        before = [shape.id() for shape in shapes]
        made = mi.load_dict({"type": "scene", **named}, optimize=False)
        for shape, name in zip(shapes, before, strict=True):
            shape.set_id(name)
        return made
    name = type(thing).__name__
    kind = "several objects" if isinstance(thing, list) else f"{'an' if name[0] in 'AEIOU' else 'a'} {name}"
    raise UserError(f"{origin}: is {kind} of Mitsuba, and light needs surfaces; give a scene or a shape")


# A mesh has a bare pointer to the scene that it was last put into, and one that shines by a texture follows it when it
# is changed: by mesh, a scene that stays.
_LAST_SCENES: dict[Any, Any] = {}


@contextmanager
def left_usable(mi: Any, things: list[Any]) -> Iterator[None]:
    """Objects that scenes of ours are made of for a while can be used afterwards, under the ids that they had."""
    before = [(thing, thing.id()) for thing in things]
    try:
        yield
    finally:
        for thing in things:
            if isinstance(thing, mi.Mesh) and _shines_by_a_texture(mi, thing):
                _LAST_SCENES[thing] = mi.load_dict({"type": "scene", "mesh": thing})
        for thing, name in before:
            thing.set_id(name)


def _shines_by_a_texture(mi: Any, shape: Any) -> bool:
    return shape.is_emitter() and bool(mi.has_flag(shape.emitter().flags(), mi.EmitterFlags.SpatiallyVarying))


def parts_of(mi: Any, thing: Any) -> list[Any]:
    """What a scene is made of, or what a dict holds, or the one object; shapes in groups, too."""
    found = live_objects(thing)
    for scene in [each for each in found if isinstance(each, mi.Scene)]:
        found += [*scene.shapes(), *scene.emitters(), *scene.sensors()]
    if any(each.class_name() in ("Instance", "ShapeGroup") for each in found):
        # No list of what is in groups is to be had, only its parameters, each with the object that it belongs to.
        found += [entry[2] for each in live_objects(thing) for entry in mi.traverse(each).properties.values()]
    return found
