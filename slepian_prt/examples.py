"""Scenes and maps that are shipped with the package."""

from __future__ import annotations

from pathlib import Path

from slepian_prt.errors import UserError

_FOLDER = Path(__file__).parent / "scenes"
_FILES = {
    "knot": "knot.ply", "sky": "sky.exr", "cornell": "cornell.xml", "glossy": "glossy.xml", "room": "room.xml",
    "caustics": "caustics.xml",
}  # fmt: skip


def example(name: str = "knot") -> Path:
    """Path of a shipped scene or environment map.

    Parameters
    ----------
    name : {"knot", "sky", "cornell", "glossy", "room", "caustics"}
        A mesh that shadows itself (33,301 vertices), a sunny sky (.exr), a box of coloured walls that light each other
        (.xml), three glossy balls on a floor (.xml), a room with tiles, a mirror, glass, gold, instances
        and a lamp (.xml), and glass, a mirror and a ring of gold in an open corner (.xml).

    Raises
    ------
    UserError
        No example of that name.
    """
    if name not in _FILES:
        raise UserError(f"no example is named {name!r}; choose one of {', '.join(_FILES)}")
    return _FOLDER / _FILES[name]
