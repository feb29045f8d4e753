"""The settings of a sweep: every combination of the values of its axes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.errors import UserError
from slepian_prt.transport.settings import TransportSettings


@dataclass(frozen=True)
class Axes:
    """What is varied; every combination is a setting.

    Attributes
    ----------
    samples, bandlimits, clusters : tuple of int
    bases : tuple of str
    tolerances : tuple of float
    bounces : tuple of int or None
        Of light between surfaces; None until what is left is negligible.
    """

    samples: tuple[int, ...] = (64, 256, 1024)
    bandlimits: tuple[int, ...] = (5, 10)
    clusters: tuple[int, ...] = (96,)
    bases: tuple[str, ...] = ("adapted",)
    tolerances: tuple[float, ...] = (0.2, 0.05, 0.02)
    bounces: tuple[int | None, ...] = (None,)

    def check(self) -> None:
        """
        Raises
        ------
        UserError
            An axis without values, or a value out of range.
        """
        for name, values in vars(self).items():
            if not values:
                raise UserError(f"{name} has no values to sweep over")
            if len(set(values)) < len(values):
                raise UserError(f"{name} has a value twice: {', '.join(map(str, values))}")
        for samples, bandlimit, bounces in product(self.samples, self.bandlimits, self.bounces):
            TransportSettings(bandlimit, samples, bounces=bounces)
        for setting in self.settings():
            CompressionSettings(basis=setting.basis, tolerance=setting.tolerance, clusters=setting.clusters).check(
                setting.bandlimit
            )

    def settings(self) -> Iterator[Setting]:
        """All combinations, those that share most next to each other."""
        for samples, bounces in product(self.samples, self.bounces):
            for bandlimit, clusters, basis in product(self.bandlimits, self.clusters, self.bases):
                for tolerance in sorted(self.tolerances):
                    yield Setting(samples, bandlimit, clusters, basis, tolerance, bounces)


@dataclass(frozen=True)
class Setting:
    """One combination; see `Axes`."""

    samples: int
    bandlimit: int
    clusters: int
    basis: str
    tolerance: float
    bounces: int | None = None

    @property
    def label(self) -> str:
        """All of it, for readers."""
        bounces = "" if self.bounces is None else f"{self.bounces} bounces, "
        compression = f"{self.clusters} caps, {self.basis}, {self.tolerance:g}"
        return f"{self.samples} rays, {bounces}L = {self.bandlimit}, {compression}"
