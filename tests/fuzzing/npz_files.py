"""Damaged and hostile files of `Transfer.save`: NumPy's archives, and JSON in one of the arrays."""

from __future__ import annotations

import contextlib
import io
import json
import random
import zipfile
from collections.abc import Callable

import numpy as np

from tests.fuzzing import mutations
from tests.fuzzing.prt_files import npy, spoil_array, spoil_value

Members = dict[str, bytes]


def mutate(content: bytes, random: random.Random) -> bytes:
    """A file that differs from a good one, most with checksums as they should be."""
    if random.randrange(6) == 0:
        return mutations.mutate(content, random)
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    kinds: tuple[Callable[[Members, random.Random], None], ...] = (_about, _about, _text, _array, _array, _missing)
    for _ in range(random.choice((1, 1, 1, 2))):
        random.choice(kinds)(members, random)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", random.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as archive:
        for name, member in members.items():
            archive.writestr(name, member)
    return buffer.getvalue()


def _about(members: Members, random: random.Random) -> None:
    """Values of what is told."""
    try:
        about = json.loads(str(_read(members["about.npy"])))
    except (KeyError, ValueError):
        return
    if isinstance(about, dict) and about:
        spoil_value(about, random)
        with contextlib.suppress(ValueError):  # it may stand in itself now, as no text can
            members["about.npy"] = npy(np.array(json.dumps(about)))


def _text(members: Members, random: random.Random) -> None:
    """What JSON itself may do."""
    if "about.npy" not in members:
        return
    depth = random.choice((100, 100_000))
    changed = ("[" * depth, '{"a":' * depth + "1" + "}" * depth, "null", "9" * 5000, "", "\ud800", " " * (1 << 21))
    members["about.npy"] = npy(np.array(random.choice(changed)))


def _array(members: Members, random: random.Random) -> None:
    name = random.choice([name for name in members if name != "about.npy"] or [""])
    try:
        array = _read(members[name])
    except (KeyError, ValueError):
        return
    spoilt = spoil_array(array, random)
    members[name] = spoilt if isinstance(spoilt, bytes) else npy(spoilt)


def _missing(members: Members, random: random.Random) -> None:
    """A member that is not there, or is another one."""
    names = list(members)
    name = random.choice(names)
    if random.randrange(2):
        del members[name]
    else:
        members[name] = members[random.choice(names)]


def _read(content: bytes) -> np.ndarray:
    return np.asarray(np.lib.format.read_array(io.BytesIO(content), allow_pickle=False))
