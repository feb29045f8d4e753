"""Control groups of Linux that this process runs in: where they are, and what their files say."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path


def folders_of(controller: str, root: Path = Path("/")) -> Iterator[Path]:
    """Our group of a controller and each around it, innermost first, where the system shows them; of both versions.

    Parameters
    ----------
    controller : str
        ``cpu`` or ``memory``.
    root : Path
        What stands for ``/``, for tests.
    """
    lines: list[str] = []
    with suppress(OSError):
        lines = (root / "proc/self/cgroup").read_text().splitlines()
    mounts = root / "sys/fs/cgroup"
    for line in lines:
        _, _, rest = line.partition(":")
        controllers, _, name = rest.partition(":")
        if not controllers:  # version 2, alone or beside the first
            mount = mounts if (mounts / "cgroup.controllers").exists() else mounts / "unified"
        elif controller in controllers.split(","):
            mount = next((m for m in (mounts / controllers, mounts / controller) if m.is_dir()), mounts / controller)
        else:
            continue
        yield from _upwards(mount, name)


def _upwards(mount: Path, name: str) -> Iterator[Path]:
    """The group of that name, and those around it.

    In a container the name may be that of the host, whose folders are not there: then the outermost that is there is
    our own.
    """
    parts = [part for part in name.split("/") if part not in ("", "..")]
    for depth in range(len(parts), -1, -1):
        folder = mount.joinpath(*parts[:depth])
        if folder.is_dir():
            yield folder


def read_number(path: Path) -> int | None:
    """The first number of a file; None where there is no such file, or it says ``max``."""
    with suppress(OSError, ValueError, IndexError):
        return int(path.read_text().split()[0])
    return None
