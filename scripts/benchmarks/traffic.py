"""A scheduler's preload that counts the bytes of all messages that it gets and sends."""

from __future__ import annotations

from typing import Any

from distributed.comm import tcp

counted = {"read": 0, "written": 0}

_write, _from_frames = tcp.TCP.write, tcp.from_frames


async def _counting_write(self: Any, *message: Any, **options: Any) -> int:
    size = await _write(self, *message, **options)
    counted["written"] += size
    return size


async def _counting_from_frames(frames: Any, *rest: Any, **options: Any) -> Any:
    counted["read"] += sum(len(frame) for frame in frames)
    return await _from_frames(frames, *rest, **options)


def dask_setup(_scheduler: Any) -> None:
    """Called by Dask when the scheduler begins."""
    tcp.TCP.write, tcp.from_frames = _counting_write, _counting_from_frames
