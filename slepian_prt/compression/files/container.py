"""The container of ``.prt`` files: a zip archive of ``manifest.json`` and one ``.npy`` per array.

Any zip tool lists it, numpy reads its members, nothing in it is executable, and every member has a checksum. Float
arrays are stored as they are, so that they can be mapped or read in part, but for those that are all zero: these and
the others are deflated.
"""

from __future__ import annotations

import io
import json
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.files import atomic_output, check_readable

FORMAT = "slepian_prt transfer"
VERSION = 3

# What numbers and texts raise that are others than was meant.
_MISFITS = (KeyError, ValueError, AttributeError, TypeError)

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
        The folder is missing or not writable, or the disk is full.
    """
    with atomic_output(path) as file, zipfile.ZipFile(file, "w") as container:
        return _fill(container, manifest, arrays)


def sizes_of(manifest: dict[str, Any], arrays: dict[str, NDArray]) -> dict[str, int]:
    """What `write` would return."""
    with zipfile.ZipFile(io.BytesIO(), "w") as container:
        return _fill(container, manifest, arrays)


class Contents:
    """What a file holds: its manifest at once, arrays when they are asked for, each checked against its checksum.

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
        Missing, foreign, cut short, damaged, or from another version.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        check_readable(self.path, "a transfer file", "precompute it first")
        self._arrays: dict[str, NDArray] = {}
        with self._told(), zipfile.ZipFile(self.path) as container:
            if _UNCOMPRESSED.issubset(container.namelist()):
                raise UserError(
                    f"{path}: holds transfer that is not compressed, from Transfer.save; read it with "
                    "sp.load_transfer, then sp.compress and save it as .prt"
                )
            self.manifest = json.loads(container.read("manifest.json"))
            if self.manifest.get("format") != FORMAT:
                raise UserError(f"{path}: is not a transfer file of slepian-prt; precompute one")
            version = self.manifest["version"]
            if version != VERSION:
                remedy = "update slepian_prt" if version > VERSION else "precompute it again"
                raise UserError(f"{path}: has format version {version}, this program reads {VERSION}; {remedy}")
            self.sizes = _sizes(container)

    def arrays(self) -> dict[str, NDArray]:
        """All arrays, by name.

        Raises
        ------
        UserError
            Cut short or damaged.
        """
        return {name: self.array(name) for name in self._read(self.manifest["arrays"])}

    def array(self, name: str) -> NDArray:
        """One array.

        Raises
        ------
        UserError
            Not there, cut short or damaged.
        """
        self._read([name])
        return self._arrays[name]

    def _read(self, names: list[str]) -> list[str]:
        missing = [name for name in names if name not in self._arrays]
        if missing:
            with self._told(), zipfile.ZipFile(self.path) as container:
                for name in missing:
                    content = io.BytesIO(container.read(f"{name}.npy"))
                    self._arrays[name] = np.lib.format.read_array(content, allow_pickle=False)
        return names

    @contextmanager
    def _told(self) -> Iterator[None]:
        """What goes wrong in reading, said in one line."""
        try:
            yield
        except UserError:  # which is a ValueError: said already
            raise
        # RuntimeError of members that a flipped bit makes encrypted, NotImplementedError of versions to come.
        except (zipfile.BadZipFile, zlib.error, RuntimeError, *_MISFITS, EOFError) as error:
            told = error.args[0] if isinstance(error, KeyError) and error.args else error
            reason = " ".join(str(told).split()) or type(error).__name__
            raise UserError(
                f"{self.path}: is not a transfer file, or is cut short or damaged ({reason}); precompute it again"
            ) from None
        except OSError as error:
            raise UserError(f"{self.path}: cannot be read ({error.strerror or error})") from None


def _fill(container: zipfile.ZipFile, manifest: dict[str, Any], arrays: dict[str, NDArray]) -> dict[str, int]:
    content = {"format": FORMAT, "version": VERSION, "arrays": list(arrays), **manifest}
    _add(container, "manifest.json", json.dumps(content, indent=1).encode(), zipfile.ZIP_DEFLATED)
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
