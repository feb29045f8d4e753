"""The files that integrators draw from: on disk, read once, or handed over in memory."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.files.prt_file import load

_numbers = count()
_in_memory: dict[str, HeldFile] = {}


@dataclass(frozen=True, eq=False)
class HeldFile:
    """What an integrator draws from.

    Attributes
    ----------
    name : str
        For messages.
    packed : CompressedTransfer
    lighting : (3, (L+1)²) or None
        Distant light in the world of the file, in place of that of the scene.
    lamps : mapping of str to Mitsuba emitter, or None
        The lamps of the scene by the names that the file has for them, where these are known.
    """

    name: str
    packed: CompressedTransfer
    lighting: NDArray[np.float64] | None = None
    lamps: Mapping[str, Any] | None = None


@contextmanager
def named_in_memory(held: HeldFile) -> Iterator[str]:
    """Within the block, the name under which `held_file` finds it."""
    name = f"memory://{next(_numbers)}"
    _in_memory[name] = held
    try:
        yield name
    finally:
        del _in_memory[name]


def is_in_memory(name: str) -> bool:
    """Whether this is a name that `named_in_memory` gave."""
    return name in _in_memory


def held_file(path: str) -> HeldFile:
    """A file, read once however many integrators and variants use it, and again when it was changed.

    Parameters
    ----------
    path : str
        Of a ``.prt`` file, or a name that `named_in_memory` gave.
    """
    if path in _in_memory:
        return _in_memory[path]
    if not os.path.isfile(path):
        return HeldFile(os.path.basename(path), load(path))  # which says what is wrong
    state = os.stat(path)
    return HeldFile(os.path.basename(path), _load(path, state.st_mtime_ns, state.st_size))


@lru_cache(maxsize=8)
def _load(path: str, _changed: int, _size: int) -> CompressedTransfer:
    return load(path)
