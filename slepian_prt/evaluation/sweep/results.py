"""What a sweep measured, the settings that none beats, and where more effort did not help."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

from slepian_prt.errors import UserError
from slepian_prt.evaluation.provenance import machine, versions
from slepian_prt.evaluation.sweep.axes import Setting
from slepian_prt.transport.effects import Effect


@dataclass(frozen=True)
class Point:
    """What a setting costs and gives; the fields of ``points`` in sweep.json, beside those of the setting.

    Attributes
    ----------
    setting : Setting
    error : dict of str to float
        For each environment, relative RMS error of relit radiance against the reference.
    full_error : dict of str to float
        The same of full SH, before compression.
    bytes_per_vertex : float
    transport_seconds, compress_seconds : float
        Transport below the highest bandlimit is scaled from it by the times on a sample of vertices. Compression was
        timed with the largest number of rays, which hardly matters to it.
    transport_spread : float
        Of some runs on that sample, longest less shortest over the median.
    prepare_seconds, relight_seconds : float
        Before the first light, and for each, the mean over the environments.
    """

    setting: Setting
    error: dict[str, float]
    full_error: dict[str, float]
    bytes_per_vertex: float
    transport_seconds: float
    transport_spread: float
    compress_seconds: float
    prepare_seconds: float
    relight_seconds: float

    @property
    def seconds(self) -> float:
        """From the loaded and planned scene to the file."""
        return self.transport_seconds + self.compress_seconds

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> Point:
        """The point that `as_dict` was called of."""
        setting = Setting(**{part.name: content[part.name] for part in fields(Setting)})
        return cls(setting, **{part.name: content[part.name] for part in fields(cls) if part.name != "setting"})

    def as_dict(self) -> dict[str, Any]:
        content = asdict(self)
        return {**content.pop("setting"), **content, "seconds": self.seconds}


@dataclass(frozen=True)
class Sweep:
    """Everything that a sweep measured.

    Attributes
    ----------
    source : str
    vertices : int
    environments : tuple of str
    noise : dict of str to float
        Of the reference under each environment.
    points : tuple of Point
    shared : dict of str to float
        Seconds that all settings share: loading and planning the scene, compiling kernels, references.
    effects : tuple of Effect
    command : str
    machine : dict
        What it ran on, as `provenance.machine` tells.
    """

    source: str
    vertices: int
    environments: tuple[str, ...]
    noise: dict[str, float]
    points: tuple[Point, ...]
    shared: dict[str, float]
    effects: tuple[Effect, ...]
    command: str = ""
    machine: dict[str, Any] = field(default_factory=machine)

    @classmethod
    def read(cls, path: str | Path) -> Sweep:
        """A finished sweep from its sweep.json.

        Raises
        ------
        UserError
            The file is missing, or is not that of a sweep.
        """
        try:
            content = json.loads(Path(path).read_text())
            return cls(
                content["scene"],
                int(content["vertices"]),
                tuple(content["environments"]),
                content["reference_noise"],
                tuple(Point.from_dict(point) for point in content["points"]),
                content["shared_seconds"],
                tuple(Effect(**effect) for effect in content["effects"]),
                content["command"],
                content["machine"],
            )
        except OSError as error:
            raise UserError(f"{path}: {error.strerror or error}; name the sweep.json of a finished sweep") from None
        except (ValueError, KeyError, TypeError, AttributeError):
            raise UserError(f"{path}: is not the sweep.json of a finished sweep; run the sweep again") from None

    def results(self) -> dict[str, Any]:
        """What sweep.json holds."""
        return {
            "scene": self.source,
            "vertices": self.vertices,
            "environments": list(self.environments),
            "reference_noise": self.noise,
            "points": [point.as_dict() for point in self.points],
            "pareto": {
                name: {
                    cost: [point.setting.label for point in pareto_front(self.points, name, cost)]
                    for cost in ("seconds", "bytes_per_vertex")
                }
                for name in self.environments
            },
            "shared_seconds": self.shared,
            "effects": [effect.as_dict() for effect in self.effects],
            "machine": self.machine,
            "versions": versions(),
            "command": self.command,
        }


def pareto_front(points: Sequence[Point], environment: str, cost: str) -> list[Point]:
    """The points that none beats in error without costing more, cheapest first."""
    front: list[Point] = []
    for point in sorted(points, key=lambda p: (getattr(p, cost), p.error[environment])):
        if not front or point.error[environment] < front[-1].error[environment]:
            front.append(point)
    return front


def find_setbacks(sweep: Sweep) -> list[str]:
    """Where more effort along one axis makes the error larger by more than noise explains, a sentence for each."""
    by_setting = {point.setting: point for point in sweep.points}
    sentences = []
    for axis in ("samples", "bandlimit", "bounces", "tolerance"):
        values = sorted({getattr(s, axis) for s in by_setting}, key=_effort, reverse=axis == "tolerance")
        following = dict(pairwise(values))
        for setting, point in by_setting.items():
            value = getattr(setting, axis)
            more = by_setting.get(replace(setting, **{axis: following[value]})) if value in following else None
            if more is None:
                continue
            for name in sweep.environments:
                if more.error[name] > point.error[name] * 1.02 + 0.1 * sweep.noise[name]:
                    sentences.append(
                        f"Under {name}, {axis} {value} to {following[value]} raises the error from "
                        f"{point.error[name]:.2%} to {more.error[name]:.2%} ({setting.label})."
                    )
    return sentences


def _effort(value: float | None) -> float:
    """None is as many bounces as matter."""
    return float("inf") if value is None else value
