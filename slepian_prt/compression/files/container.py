"""The container of ``.prt`` files: a zip archive of ``manifest.json`` and one ``.npy`` per array.

Any zip tool lists it, numpy reads its members, nothing in it is executable, and every member has a checksum. Float
arrays are stored as they are, so that they can be mapped or read in part, but for those that are all zero: these and
the others are deflated.
"""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from textwrap import shorten
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.files.array_schema import ARRAYS, ArrayRow
from slepian_prt.compression.files.known import Known, known_of
from slepian_prt.compression.files.manifest import FORMAT, VERSION, begin_of, read_manifest
from slepian_prt.errors import UserError
from slepian_prt.files import atomic_output, check_readable
from slepian_prt.machine.memory import check_memory
from slepian_prt.transport.archive_members import Misfit, members_of, open_archive, read_array, read_member
from slepian_prt.transport.json_text import with_characters, write_json

# A manifest is no longer, and only so many times longer than it is packed, but for short ones: those of thousands of
# shapes that are alike are 80 times as long.
_LARGEST_MANIFEST, _SMALL_MANIFEST, _RATIO = 1 << 27, 1 << 20, 128

# From this length on it is written without blanks. Read, a byte of it takes so many.
_LONG_MANIFEST, _TAKEN = 1 << 24, 32

# A fixed time stamp: the same content gives the same bytes.
_EPOCH = (1980, 1, 1, 0, 0, 0)

# Members of what Transfer.save writes, which is a zip archive too.
_UNCOMPRESSED = {"about.npy", "vectors.npy"}

# What a member takes beside its content and, twice, its name; and what the whole takes beside its members.
_OF_MEMBER = 30 + 46
END = 22


def write(path: str | Path, manifest: dict[str, Any], arrays: dict[str, NDArray]) -> dict[str, int]:
    """Write a file complete or not at all.

    Returns
    -------
    dict of str to int
        As `Contents.sizes`.

    Raises
    ------
    UserError
        The folder is missing or not writable, the disk is full, or the file would be refused by who reads it.
    """
    _check_readers(path, manifest, arrays)
    with atomic_output(path) as file, zipfile.ZipFile(file, "w") as container:
        return _fill(container, manifest, arrays)


def sizes_of(manifest: dict[str, Any], arrays: dict[str, NDArray]) -> dict[str, int]:
    """What `write` would return."""
    with zipfile.ZipFile(io.BytesIO(), "w") as container:
        return _fill(container, manifest, arrays)


class Contents:
    """What a file holds: its manifest at once, arrays when they are asked for, each checked against its checksum.

    The manifest is as `read_manifest` finds it to be, arrays as `ARRAYS` has them. No more is read than these allow.

    Parameters
    ----------
    path : path

    Attributes
    ----------
    path : Path
    manifest : dict
    sizes : dict of str to int
        Bytes in the file of the manifest and of each array, everything about them counted; with `END` those of all.

    Raises
    ------
    UserError
        Missing, foreign, cut short, damaged, from another version, or with a manifest that does not fit together.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        check_readable(self.path, "a transfer file", "precompute it first")
        self._arrays: dict[str, NDArray] = {}
        self._complete = False
        with self.told(), open_archive(self.path) as archive:
            members = members_of(archive)
            if "manifest.json" not in members and not _UNCOMPRESSED.issubset(members):
                raise zipfile.BadZipFile("it has no manifest.json")
            if _UNCOMPRESSED.issubset(members):
                raise UserError(
                    f"{path}: holds transfer that is not compressed, from Transfer.save; read it with "
                    "sp.load_transfer, then sp.compress and save it as .prt"
                )
            packed = members["manifest.json"]
            most = min(_LARGEST_MANIFEST, _SMALL_MANIFEST + _RATIO * packed.compress_size)
            if packed.file_size > _SMALL_MANIFEST:
                check_memory(_TAKEN * min(packed.file_size, most), f"{path}", "precompute it again with fewer shapes")
            content = with_characters(read_member(archive, packed, most))
            self.sizes = _sizes(archive)
            self._check_version(*begin_of(content))
            self.manifest = _fitting(read_manifest, content)

    def _check_version(self, form: Any, version: Any) -> None:
        if form != FORMAT:
            raise UserError(f"{self.path}: is not a transfer file of slepian-prt; precompute one")
        if isinstance(version, bool) or version != VERSION:
            newer = isinstance(version, int) and version > VERSION
            told, remedy = shorten(str(version), 20), "update slepian_prt" if newer else "precompute it again"
            raise UserError(f"{self.path}: has format version {told}, this program reads {VERSION}; {remedy}")

    def arrays(self) -> dict[str, NDArray]:
        """All arrays that the manifest has a use for, by name.

        Raises
        ------
        UserError
            Cut short or damaged, or not what the manifest and the other arrays want.
        """
        if not self._complete:
            known = known_of(self.manifest, frozenset(self.manifest["arrays"]))
            with self.told(), open_archive(self.path) as archive:
                members = members_of(archive)
                self._arrays = {row.name: array for row in ARRAYS for array in _read(archive, members, row, known)}
            self._complete = True
        return dict(self._arrays)

    def array(self, name: str) -> NDArray:
        """One array whose shape the manifest tells.

        Raises
        ------
        UserError
            Not there, cut short, damaged, or not what the manifest wants.
        """
        if name not in self._arrays:
            row = next(row for row in ARRAYS if row.name == name)
            known = known_of(self.manifest, frozenset(self.manifest["arrays"]))
            with self.told(), open_archive(self.path) as archive:
                (self._arrays[name],) = _read(archive, members_of(archive), row, known)
        return self._arrays[name]

    @contextmanager
    def told(self) -> Iterator[None]:
        """What goes wrong in reading, said in one line."""
        try:
            yield
        except UserError:  # which is a ValueError: said already
            raise
        except Misfit as error:
            reason = shorten(str(error), 200)
            raise UserError(f"{self.path}: its contents do not fit together ({reason}); precompute it again") from None
        # RuntimeError of members that a flipped bit makes encrypted, NotImplementedError of versions to come.
        except (zipfile.BadZipFile, zlib.error, RuntimeError, EOFError, struct.error, KeyError, ValueError) as error:
            told = error.args[0] if isinstance(error, KeyError) and error.args else error
            reason = shorten(" ".join(str(told).split()), 200) or type(error).__name__
            raise UserError(
                f"{self.path}: is not a transfer file, or is cut short or damaged ({reason}); precompute it again"
            ) from None
        except MemoryError:
            raise UserError(f"{self.path}: needs more memory than there is; precompute it again, coarser") from None
        except OSError as error:
            raise UserError(f"{self.path}: cannot be read ({error.strerror or error})") from None


def _read(
    archive: zipfile.ZipFile, members: Mapping[str, zipfile.ZipInfo], row: ArrayRow, known: Known
) -> Iterator[NDArray]:
    """The array of a row, if the file is to have it."""
    if not _is_expected(row, known):
        return
    array = read_array(archive, members[f"{row.name}.npy"], partial(row.expect, known))
    row.accept(known, array)
    yield array


def _is_expected(row: ArrayRow, known: Known) -> bool:
    """Whether a file has the array of a row; raises Misfit if it has to have one and has none."""
    there = row.there(known)
    if there and row.name not in known.names:
        raise Misfit(f"there is no {row.name}")
    return there is not False and row.name in known.names


def _fitting(read: Callable[[bytes], dict[str, Any]], content: bytes) -> dict[str, Any]:
    try:
        return read(content)
    except ValueError as error:
        raise Misfit(str(error)) from None


def _check_readers(path: str | Path, manifest: dict[str, Any], arrays: dict[str, NDArray]) -> None:
    """Raise UserError for what `Contents` would not read."""
    try:
        content = _text(manifest, arrays)
        if len(content) > _LARGEST_MANIFEST:
            raise ValueError(f"{len(content):,} bytes are told of its shapes and names")
        known = known_of(read_manifest(content), frozenset(arrays))
        for row in ARRAYS:
            if _is_expected(row, known):
                row.expect(known, arrays[row.name].dtype, arrays[row.name].shape)
                row.accept(known, arrays[row.name])
    except UserError:
        raise
    except ValueError as error:
        reason = shorten(str(error), 200)
        raise UserError(f"{path}: no file can hold this transfer ({reason}); change that before it is saved") from None


def _text(manifest: dict[str, Any], arrays: dict[str, NDArray]) -> bytes:
    content = {"format": FORMAT, "version": VERSION, "arrays": list(arrays), **manifest}
    text = write_json(content, indent=1)
    return (text if len(text) < _LONG_MANIFEST else write_json(content)).encode()


def _fill(container: zipfile.ZipFile, manifest: dict[str, Any], arrays: dict[str, NDArray]) -> dict[str, int]:
    content = _text(manifest, arrays)
    small = len(content) <= _SMALL_MANIFEST or len(content) <= _RATIO * len(zlib.compress(content))
    _add(container, "manifest.json", content, zipfile.ZIP_DEFLATED if small else zipfile.ZIP_STORED)
    for name, array in arrays.items():
        _add(container, f"{name}.npy", _npy(array), _compression(array))
    return _sizes(container)


def _sizes(container: zipfile.ZipFile) -> dict[str, int]:
    return {
        member.filename.removesuffix(".npy"): member.compress_size + _OF_MEMBER + 2 * len(member.filename)
        for member in container.infolist()
    }


def _add(container: zipfile.ZipFile, name: str, content: bytes, compression: int) -> None:
    information = zipfile.ZipInfo(name, _EPOCH)
    information.compress_type = compression
    container.writestr(information, content)


def _npy(array: NDArray) -> bytes:
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, np.ascontiguousarray(array), allow_pickle=False)
    return buffer.getvalue()


def _compression(array: NDArray) -> int:
    """Floats are stored as they are, but for zeros alone, and so are integers that are coded already."""
    if array.dtype.kind == "f":
        return zipfile.ZIP_DEFLATED if not array.any() else zipfile.ZIP_STORED
    content = array.tobytes()
    return zipfile.ZIP_DEFLATED if len(zlib.compress(content, 1)) < len(content) else zipfile.ZIP_STORED
