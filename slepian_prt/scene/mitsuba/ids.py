"""Mitsuba objects that are put into a scene of ours keep the ids that their own scene gives them."""

from __future__ import annotations

from typing import Any


def load_keeping_ids(mi: Any, content: dict[str, Any]) -> Any:
    """`mi.load_dict`, which calls objects that it is given by the keys they stand under, without that."""
    ids = [(thing, thing.id()) for thing in content.values() if isinstance(thing, mi.Object)]
    try:
        return mi.load_dict(content)
    finally:
        for thing, name in ids:
            thing.set_id(name)
