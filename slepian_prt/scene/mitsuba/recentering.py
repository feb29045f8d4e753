"""Scenes far from the origin, moved to where float32 is fine enough; and what is too coarse all the same.

Mitsuba keeps positions in float32, where map coordinates of 5 million metres have steps of half a metre. Its parser
keeps transforms in float64, so that they can be moved before any shape is made.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.scene.pieces import connected_pieces
from slepian_prt.scene.receivers import Receivers

# A scene is moved if the middle of its box is so many diagonals from the origin.
_FAR = 16.0

# Properties that place something without a transform of its own.
_PLACES = ("center", "p0", "p1", "position", "origin")
_PLACED = ("Shape", "Sensor", "Emitter")

# What stands nowhere: its to_world only turns it.
_DISTANT = ("constant", "directional", "distant", "envmap", "sunsky", "timed_sunsky")

# What float32 resolves to less than this part of the size of a piece of surface is worth a remark.
_COARSE = 1e-3


def far_center(scene: Any) -> NDArray[np.float64] | None:
    """(3,) the middle of a Mitsuba scene if it is far from the origin for its size, in whole units."""
    box = scene.bbox()
    low, high = (np.array(corner, dtype=np.float64) for corner in (box.min, box.max))
    if not np.all(np.isfinite([low, high])):  # without shapes
        return None
    center = 0.5 * (low + high)
    return np.round(center) if np.linalg.norm(center) > _FAR * np.linalg.norm(high - low) else None


def move_scene(mi: Any, state: Any, center: NDArray) -> None:
    """Move a parsed Mitsuba scene so that ``center`` is its origin."""
    if state.root.type.name == "Shape":
        _move(mi, state.root.props, -center)
    else:
        _move_children(mi, state, state.root.props, -center)
    for node in state.nodes:  # those of media stand in the world, whatever the shapes are that they are in
        if node.type.name == "Volume" and node.props.plugin_name() != "constvolume":
            _move(mi, node.props, -center)


def _move_children(mi: Any, state: Any, parent: Any, by: NDArray) -> None:
    """Move what the scene, or a shape that is made of others, refers to."""
    for value in [parent[name] for name in parent]:
        if not isinstance(value, mi.Properties.ResolvedReference):
            continue
        node = state.nodes[value.index()]
        if node.props.plugin_name() == "merge":
            _move_children(mi, state, node.props, by)
        elif node.type.name in _PLACED and node.props.plugin_name() != "shapegroup":  # its instances are moved
            _move(mi, node.props, by)


def _move(mi: Any, properties: Any, by: NDArray) -> None:
    names = set(properties)
    shift = mi.ScalarAffineTransform4d().translate(by.tolist())
    if properties.plugin_name() in _DISTANT:
        return
    if "to_world" in names:
        properties["to_world"] = shift @ properties["to_world"]
    elif moved := [name for name in _PLACES if name in names]:
        for name in moved:
            properties[name] = (np.array(properties[name], dtype=np.float64) + by).tolist()
    else:
        properties["to_world"] = shift


def coarse_receivers(positions: NDArray, receivers: Receivers) -> tuple[int, float]:
    """How many receivers belong to pieces of surface that float32 hardly resolves, and the worst step of these.

    Parameters
    ----------
    positions : (V, 3)
        As they are traced.
    receivers : Receivers

    Returns
    -------
    count : int
    step : float
        Relative to the size of the piece.
    """
    piece = connected_pieces(receivers.neighbours, len(positions))
    count = int(piece.max(initial=-1)) + 1
    low, high, far = np.full((count, 3), np.inf), np.full((count, 3), -np.inf), np.zeros(count)
    np.minimum.at(low, piece, positions)
    np.maximum.at(high, piece, positions)
    np.maximum.at(far, piece, np.abs(positions).max(axis=1))
    size = np.linalg.norm(high - low, axis=1)
    # Pieces without a size are single vertices, of faces that belong to other receivers.
    step = np.where(size > 0.0, np.spacing(far.astype(np.float32)) / np.where(size > 0.0, size, 1.0), 0.0)
    coarse = (step > _COARSE)[piece] & receivers.active
    return int(coarse.sum()), float(step[piece[coarse]].max(initial=0.0))
