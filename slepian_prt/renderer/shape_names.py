"""What the shapes of a Mitsuba scene are called."""

from __future__ import annotations

from typing import Any


def shape_name(shape: Any, index: int) -> str:
    """The id of a shape, or a name by its place among the shapes of its scene or group."""
    return str(shape.id() or f"shape_{index}")
