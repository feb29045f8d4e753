"""Which scans there are, and what their outputs are called."""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

from slepian_prt.errors import UserError
from slepian_prt.files import check_readable


def read_list(path: str | Path) -> list[str]:
    """Paths that a text file names, one on each line, relative to its folder; ``-`` is the standard input.

    Blank lines and lines that begin with ``#`` are left out.

    Raises
    ------
    UserError
        The list is missing, no text, or empty.
    """
    if str(path) == "-":
        raw, folder, name = sys.stdin.buffer.read(), Path(), "the list on the standard input"
    else:
        check_readable(path, "a text file with a path on each line")
        raw, folder, name = Path(path).read_bytes(), Path(path).parent, str(path)
    try:
        lines = [line.strip() for line in raw.decode("utf-8-sig").split("\n")]
    except UnicodeDecodeError:
        raise UserError(f"{name}: is not UTF-8 text; write a path on each line") from None
    named = [str(folder / line) for line in lines if line and not line.startswith("#")]
    if not named:
        raise UserError(f"{name}: names no scene; write a path on each line")
    return named


def name_scans(sources: Sequence[str | Path]) -> dict[str, str]:
    """A name for the outputs of each source: that of its file, without the suffix.

    Files of the same name, as of scans that each have a folder, are told apart by as many folders before it as are
    needed, joined by ``-``. A source that is given twice is one.

    Returns
    -------
    dict of str to str
        Names, by sources, in their order. No two are the same, whatever the case of letters.

    Raises
    ------
    UserError
        Two sources in one folder, or whose names with folders are the same.
    """
    paths = {path: _parts(path) for path in dict.fromkeys(map(str, sources))}
    depth = dict.fromkeys(paths, 1)
    while True:
        names = {path: "-".join(parts[-depth[path] :]) for path, parts in paths.items()}
        same = defaultdict(list)
        for path, name in names.items():
            same[name.casefold()].append(path)
        longer = [path for alike in same.values() if len(alike) > 1 for path in alike if depth[path] < len(paths[path])]
        if not longer:
            break
        for path in longer:
            depth[path] += 1
    for alike in same.values():
        if len(alike) > 1:
            raise UserError(
                f"the outputs of {alike[0]} and {alike[1]} would have the same names; rename one of the two"
            )
    return names


def _parts(path: str) -> tuple[str, ...]:
    """Folders of a path and its name without the suffix; none for the root, and for the folders above this one."""
    folders = Path(path).absolute().parent.parts[1:]
    return (*(part for part in folders if part != ".."), Path(path).stem)
