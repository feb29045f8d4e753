"""Adaptive visibility on Mitsuba's arrays: what `VisibilityTracer` finds, left where it was found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.transport.hemisphere import HemisphereRays, divided, pairs
from slepian_prt.transport.visibility import bisected, may_leak, turned_aside


@dataclass(frozen=True, eq=False)
class DeviceVisibility:
    """What is blocked for n receivers, on Mitsuba's arrays; what belongs to one receiver side by side.

    Attributes
    ----------
    count : int
        n.
    blocked : Bool (n nodes)
        Whether a node of the direction set is blocked.
    quarter : UInt32 (n edges)
        In which quarter of an edge visibility changes, where it does.
    """

    count: int
    blocked: Any
    quarter: Any


class DeviceTracer(HemisphereRays):
    """Adaptive visibility: the nodes of the direction set, then bisection along edges whose ends disagree.

    Attributes
    ----------
    changes : int
        Edges along which visibility changed, so far.
    """

    changes = 0

    def trace(self, vertices: NDArray) -> DeviceVisibility:
        """Find what is blocked for the receivers given."""
        import drjit as dr

        mi, directions, count = self.mi, self.directions, len(vertices)
        size, edges = directions.size, len(directions.edges)
        frames = self.frames(vertices)
        rays = self.rays_from(vertices, frames)
        blocked = self.geometry.ray_test(rays(*self.to_nodes(count)))
        dr.eval(blocked)
        blocked = self._without_leaks(vertices, frames, blocked)
        ends = [mi.UInt32(np.ascontiguousarray(directions.edges[:, i], dtype=np.uint32)) for i in range(2)]
        place, edge = pairs(mi, count, edges)
        first, second = (
            dr.gather(mi.Bool, blocked, place * dr.opaque(mi.UInt32, size) + dr.gather(mi.UInt32, end, edge))
            for end in ends
        )
        quarter = dr.zeros(mi.UInt32, count * edges)
        changed = dr.compress(first ^ second)  # receiver after receiver, so that rays that run together are together
        if dr.width(changed):
            place, edge = divided(mi, changed, edges)
            begin = dr.gather(mi.UInt32, ends[0], edge)
            as_at_begin = dr.gather(mi.Bool, blocked, place * dr.opaque(mi.UInt32, size) + begin)
            found = bisected(mi, self.geometry, rays, place, dr.fma(edge, 3, dr.opaque(mi.UInt32, size)), as_at_begin)
            dr.scatter(quarter, found, changed, mode=dr.ReduceMode.NoConflicts)
            self.changes += dr.width(changed)
        dr.eval(quarter)
        return DeviceVisibility(count, blocked, quarter)

    def _without_leaks(self, vertices: NDArray, frames: NDArray, blocked: Any) -> Any:
        """As `VisibilityTracer` closes them: looked at again, beside them, where almost nothing is open."""
        import drjit as dr

        mi, size = self.mi, self.directions.size
        closed = dr.block_sum(dr.select(blocked, mi.UInt32(1), 0), size)
        few_open = dr.compress(may_leak(closed, dr.opaque(mi.UInt32, size)))
        if dr.width(few_open) == 0:
            return blocked
        which, node = pairs(mi, dr.width(few_open), size)
        lane = dr.gather(mi.UInt32, few_open, which) * dr.opaque(mi.UInt32, size) + node
        is_open: Any = dr.compress(~dr.gather(mi.Bool, blocked, lane))
        if dr.width(is_open) == 0:
            return blocked
        which, node, lane = (dr.gather(mi.UInt32, values, is_open) for values in (which, node, lane))
        some = np.array(few_open).astype(np.int64)
        rays = self.rays_from(vertices[some], turned_aside(frames[some]))
        dr.scatter(blocked, self.geometry.ray_test(rays(which, node)), lane, mode=dr.ReduceMode.NoConflicts)
        return blocked
