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
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.files import atomic_output, check_readable

FORMAT = "slepian_prt transfer"
VERSION = 3

# A fixed time stamp: the same content gives the same bytes.
_EPOCH = (1980, 1, 1, 0, 0, 0)


# What a member takes beside its content and, twice, its name; and what the whole takes beside its members.
_OF_MEMBER = 30 + 46
END = 22


def write(path: str | Path, manifest: dict[str, Any], arrays: dict[str, NDArray]) -> dict[str, int]:
    """Write a file complete or not at all.

    Returns
    -------
    dict of str to int
        As `member_sizes`.

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


def member_sizes(path: str | Path) -> dict[str, int]:
    """Bytes in a file of the manifest and of each array, by name, everything about them counted; without reading them.

    Of a file that can be `read`; their sum and `END` are the bytes of the file.
    """
    with zipfile.ZipFile(path) as container:
        return _sizes(container)


def read(path: str | Path) -> tuple[dict[str, Any], dict[str, NDArray]]:
    """Manifest and arrays of a file, every checksum verified.

    Raises
    ------
    UserError
        Missing, foreign, cut short, damaged, or from another version.
    """
    path = Path(path)
    check_readable(path, "a transfer file", "precompute it first")
    try:
        with zipfile.ZipFile(path) as container:
            manifest = json.loads(container.read("manifest.json"))
            if manifest.get("format") != FORMAT:
                raise UserError(f"{path}: is not a transfer file of slepian-prt; precompute one")
            if manifest["version"] != VERSION:
                remedy = "update slepian_prt" if manifest["version"] > VERSION else "precompute it again"
                raise UserError(
                    f"{path}: has format version {manifest['version']}, this program reads {VERSION}; {remedy}"
                )
            arrays = {}
            for name in manifest["arrays"]:
                with container.open(f"{name}.npy") as member:
                    arrays[name] = np.lib.format.read_array(io.BytesIO(member.read()), allow_pickle=False)
    except UserError:
        raise
    except (zipfile.BadZipFile, zlib.error, KeyError, ValueError, EOFError, AttributeError, TypeError) as error:
        reason = " ".join(str(error).split()).strip("'\"") or type(error).__name__
        raise UserError(
            f"{path}: is not a transfer file, or is cut short or damaged ({reason}); precompute it again"
        ) from None
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror or error})") from None
    return manifest, arrays


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
    return zipfile.ZIP_STORED if array.dtype.kind == "f" and array.any() else zipfile.ZIP_DEFLATED
