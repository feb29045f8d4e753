"""How many bytes a file spends on what: told by its directory, without packing anything again."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple
from weakref import WeakKeyDictionary

from slepian_prt.compression.files import container

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
    if packed not in _sizes:
        from slepian_prt.compression.files.prt_file import content_of

        remember_size(packed, container.sizes_of(*content_of(packed)))
    return _sizes[packed]


def remember_size(packed: CompressedTransfer, members: Mapping[str, int]) -> None:
    """Transfer was written or read, and its file has members of so many bytes."""
    kinds = {name: name.partition("/")[0] for name in members}
    mesh = sum(size for name, size in members.items() if kinds[name] in _MESH)
    others = sum(size for name, size in members.items() if kinds[name] in (*_LIGHT, "manifest.json"))
    whole = sum(members.values()) + container.END
    _sizes[packed] = FileSize(whole - mesh - others, mesh, whole)


_sizes: WeakKeyDictionary[CompressedTransfer, FileSize] = WeakKeyDictionary()
