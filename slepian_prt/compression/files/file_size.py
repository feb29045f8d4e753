"""How many bytes a file spends on what: told by its directory, without packing anything again."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

from slepian_prt.compression.files import container
from slepian_prt.machine.kept import Kept

if TYPE_CHECKING:
    from slepian_prt.compression.compressed import CompressedTransfer

# Arrays that are not the transfer of distant light: by the first part of their names.
_MESH = ("mesh", "film")
_LIGHT = ("environment", "fixed")


class FileSize(NamedTuple):
    """Bytes of a file.

    Attributes
    ----------
    transfer : int
        For coefficients, bases, caps and indices, and for the directory's end.
    mesh : int
        For the mesh or the film.
    whole : int
        With the scene's own light, its lamps and the manifest.
    """

    transfer: int
    mesh: int
    whole: int


def file_size(packed: CompressedTransfer) -> FileSize:
    """Of the file that transfer was written to or read from last, or else of one that it would be written to."""

    def would_be() -> FileSize:
        from slepian_prt.compression.files.prt_file import content_of

        return _of_members(container.sizes_of(*content_of(packed)))

    return _sizes.of(packed, would_be)


def remember_size(packed: CompressedTransfer, members: Mapping[str, int]) -> None:
    """Transfer was written or read, and its file has members of so many bytes."""
    _sizes.put(packed, _of_members(members))


def _of_members(members: Mapping[str, int]) -> FileSize:
    kinds = {name: name.partition("/")[0] for name in members}
    mesh = sum(size for name, size in members.items() if kinds[name] in _MESH)
    others = sum(size for name, size in members.items() if kinds[name] in (*_LIGHT, "manifest.json"))
    whole = sum(members.values()) + container.END
    return FileSize(whole - mesh - others, mesh, whole)


_sizes: Kept[CompressedTransfer, FileSize] = Kept()
