"""What the outputs of a scan depend on, as one digest, without reading it as a scene."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import fields, is_dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from slepian_prt.scene.named_files import files_behind


def settings_digest(settings: Any) -> str:
    """Of the package's version and settings: a dataclass of plain values, arrays and other dataclasses."""
    text = json.dumps([version("slepian_prt"), _plain(settings)], sort_keys=True)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def fingerprint(source: str | Path, settings: str) -> str:
    """Of the digest of settings, and the content of a file and of all files that it names."""
    digest = hashlib.blake2b(settings.encode(), digest_size=16)
    for path in files_behind(Path(source)):
        digest.update(b"\0".join([b"", os.fsencode(path.name), digest_of(path).encode()]))
    return digest.hexdigest()


def digest_of(path: Path) -> str:
    """Of the content of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=16)).hexdigest()


def _plain(value: Any) -> Any:
    """As JSON has it; arrays by a digest of their content."""
    if is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, np.ndarray):
        return [value.shape, str(value.dtype), hashlib.blake2b(value.tobytes()).hexdigest()]
    if isinstance(value, dict):
        return {str(key): _plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    return value if value is None or isinstance(value, bool | int | float | str) else repr(value)
