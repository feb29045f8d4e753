"""Scans of a data set: what is asked of each, and what became of it. All of it can be sent to other processes."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from slepian_prt.accuracy.goal import Goal, Light
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.files import KEPT_ORDER
from slepian_prt.transport.settings import TransportSettings

FORMATS = ("prt", "pifu", "icon")


@dataclass(frozen=True)
class ScanSettings:
    """What is asked of every scan.

    Attributes
    ----------
    formats : tuple of str
        Of ``prt``, ``pifu`` and ``icon``.
    transport : TransportSettings
    compression : CompressionSettings
    goal : Goal or None
        What rays, bandlimit and tolerance of ``prt`` are chosen for,
    light : Light or None
        and the light that it is about.
    kept_order : int
        Vertices up to which ``prt`` keeps their order.
    samples : int or None
        Rays per vertex for ``pifu`` and ``icon``, see `trace_order_two`.
    """

    formats: tuple[str, ...] = ("prt",)
    transport: TransportSettings = field(default_factory=TransportSettings)
    compression: CompressionSettings = field(default_factory=CompressionSettings)
    goal: Goal | None = None
    light: Light | None = None
    kept_order: int = KEPT_ORDER
    samples: int | None = None


@dataclass(frozen=True)
class ScanResult:
    """What became of a scan; also a line of ``results.jsonl``.

    Attributes
    ----------
    source : str
        Path of the scan.
    name : str
        Of its outputs.
    outputs : tuple of str
        Files that were written, relative to the folder; none if it failed.
    failure : str or None
        Why it failed, in one line.
    seconds : dict of str to float
        By stage, and ``all``.
    error : float or None
        Relative error: predicted of ``prt`` (measured, where there was a goal), else measured of order 2.
    bytes : int
        Of all outputs.
    vertices : int
    rays : int
    notes : tuple of str
        What the user should know, in one line each.
    kept : bool
        Whether it was there already, whole, and made of the same files with the same settings.
    fingerprint : str
        Of all that the outputs depend on.
    digests : dict of str to str
        Of the content of each output.
    """

    source: str
    name: str
    outputs: tuple[str, ...] = ()
    failure: str | None = None
    seconds: dict[str, float] = field(default_factory=dict)
    error: float | None = None
    bytes: int = 0
    vertices: int = 0
    rays: int = 0
    notes: tuple[str, ...] = ()
    kept: bool = False
    fingerprint: str = ""
    digests: dict[str, str] = field(default_factory=dict)

    def as_line(self) -> str:
        """One line of JSON: of a scan that failed what is known of it, of others all but the failure."""
        known = asdict(self)
        left_out = {"failure"} if self.failure is None else {"outputs", "error", "bytes", "vertices", "rays", "digests"}
        told = {key: value for key, value in known.items() if key not in left_out}
        line = json.dumps(told, ensure_ascii=False)
        return line if _is_text(line) else json.dumps(told)

    @classmethod
    def from_line(cls, line: str) -> ScanResult | None:
        """Of a line of JSON; None if it is none, as one that was not finished."""
        try:
            known = json.loads(line)
            names = {field.name for field in fields(cls)}
            held: dict[str, Any] = {
                key: tuple(value) if isinstance(value, list) else value for key, value in known.items() if key in names
            }
            return cls(**held)
        except (ValueError, TypeError, AttributeError):
            return None


@dataclass(frozen=True)
class ScanJob:
    """A scan to be done, wherever.

    Attributes
    ----------
    source : str
    name : str
        Of its outputs.
    folder : str
        Of all outputs.
    settings : ScanSettings
    asked : str
        Digest of the settings.
    before : ScanResult or None
        What became of it last time.
    """

    source: str
    name: str
    folder: str
    settings: ScanSettings
    asked: str
    before: ScanResult | None = None


def _is_text(line: str) -> bool:
    """Whether it can be written in UTF-8: names of files need not be."""
    try:
        line.encode()
    except UnicodeEncodeError:
        return False
    return True
