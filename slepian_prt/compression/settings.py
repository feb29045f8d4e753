"""What is asked of compression."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slepian_prt.arrays import real_numbers
from slepian_prt.compression import truncation
from slepian_prt.compression.bases import BASES
from slepian_prt.compression.prediction import Expectation
from slepian_prt.errors import UserError, check_bandlimit, check_choice, check_epsilon, check_integer
from slepian_prt.lighting.spectrum import LightPrior
from slepian_prt.sphere.harmonics import num_coefficients
from slepian_prt.transport.settings import LARGEST_BANDLIMIT

CODINGS = ("coded", "float16", "float32")
GROUPINGS = ("normal", "bent", "surface")

DEFAULT_CLUSTERS = 96
DEFAULT_TOLERANCE = 0.02
LARGEST_CLUSTERS = 4096
LARGEST_CLASSES = 16


@dataclass(frozen=True)
class CompressionSettings:
    """How to compress.

    Attributes
    ----------
    basis : one of adapted, transport, slepian, incident, sh, direct, pca, cpca, none
        ``none`` keeps all (L+1)² spherical harmonics; ``pca`` and ``cpca`` look at all vectors.
    tolerance : float in (0, 1), optional
        Wanted relative error, of the transfer vectors or, with a light prior, of radiance under such light. The default
        rule, at 0.02. Of coefficients that are ``coded`` the rounding step meets it (functions that round to zero cost
        next to nothing); otherwise the number of functions does, by prediction.
    terms : int, optional
        Instead: this many functions in each cap.
    truncate : n_g, n_ref or count, optional
        Instead: the Shannon number of each cap, with ``epsilon``.
    epsilon : float in (0, 1), optional
        Concentration down to which ``truncate`` counts; 0.01 by default.
    clusters : int
    group_by : normal, bent or surface
        What is grouped into caps: normals, bent normals (the mean direction of the light that is not blocked), or
        neighbourhoods on the surface (geodesic patches).
    occlusion_classes : int
        Parts of equally many vertices, from occluded to open, that are grouped and learnt from separately.
    light_prior : LightPrior, optional
        Of light that errors count under.
    refine : bool, optional
        Second stage: principal axes inside the coefficients of each cap. By default where it makes the file smaller.
    coding : coded, float16 or float32, optional
        By default ``coded`` with a tolerance, and ``float32`` with a given number of functions.
    exact_mesh : bool
        Whether positions and albedo of the mesh are kept to the bit, and its normals in float32.
    """

    basis: str = "adapted"
    tolerance: float | None = None
    terms: int | None = None
    truncate: str | None = None
    epsilon: float | None = None
    clusters: int = DEFAULT_CLUSTERS
    group_by: str = "normal"
    occlusion_classes: int = 1
    light_prior: LightPrior | None = None
    refine: bool | None = None
    coding: str | None = None
    exact_mesh: bool = False

    @property
    def by_number(self) -> bool:
        """Whether the number of functions is given."""
        return self.basis == "none" or self.terms is not None or self.truncate is not None

    @property
    def resolved_coding(self) -> str:
        """The coding, default resolved."""
        return self.coding or ("float32" if self.by_number else "coded")

    @property
    def resolved_tolerance(self) -> float:
        """The tolerance, default resolved."""
        return DEFAULT_TOLERANCE if self.tolerance is None else self.tolerance

    @property
    def needs_all_vectors(self) -> bool:
        """Whether bases are made from the vectors of the whole mesh."""
        return self.basis in BASES and BASES[self.basis].build is None

    def expected_error(self, expected: Expectation) -> float:
        """Of what the tolerance is about."""
        return expected.relative(None if self.light_prior is None else self.light_prior.weights**2)

    def check(self, bandlimit: int) -> None:
        """Raise UserError, before any work, on what cannot be done."""
        check_bandlimit(bandlimit, largest=LARGEST_BANDLIMIT)
        rules = {"tolerance": self.tolerance, "terms": self.terms, "truncate": self.truncate}
        given = [name for name, value in rules.items() if value is not None]
        if len(given) > 1:
            raise UserError(f"only one of `tolerance`, `terms` and `truncate` may be given, not {' and '.join(given)}")
        check_choice(self.basis, "basis", (*BASES, "none"))
        if self.basis == "none" and given:
            raise UserError(f"basis none keeps all functions; leave out `{given[0]}`, or choose another basis")
        if self.terms is not None:
            check_integer(self.terms, "terms", 1, num_coefficients(bandlimit))
        if self.truncate is not None:
            check_choice(self.truncate, "truncate", truncation.TRUNCATIONS)
            if self.needs_all_vectors:
                raise UserError(f"`truncate` counts functions of a cap, which {self.basis} does not have; use `terms`")
        number = isinstance(self.tolerance, int | float | np.number) and not isinstance(self.tolerance, bool)
        if self.tolerance is not None and not (number and 0.0 < self.tolerance < 1.0):
            raise UserError(f"tolerance must be a number in (0, 1), not {self.tolerance!r}")
        if self.epsilon is not None:
            check_epsilon(self.epsilon)
            if self.truncate is None:
                raise UserError("`epsilon` says where `truncate` stops counting; give `truncate` too, or leave it out")
        check_integer(self.clusters, "clusters", 1, LARGEST_CLUSTERS)
        check_integer(self.occlusion_classes, "occlusion_classes", 1, LARGEST_CLASSES)
        check_choice(self.group_by, "group_by", GROUPINGS)
        if self.group_by == "bent" and bandlimit < 1:
            raise UserError(
                "bent normals are the first degree of transfer; use `bandlimit` 1 or more, or group by normal"
            )
        if self.group_by == "surface" and self.occlusion_classes > 1:
            raise UserError("`occlusion_classes` divide caps of axes; leave them out, or group by normal or bent")
        check_choice(self.resolved_coding, "coding", CODINGS)
        if self.light_prior is not None:
            if not isinstance(self.light_prior, LightPrior):
                raise UserError(f"light_prior must come from falling_prior or measured_prior, not {self.light_prior!r}")
            if self.needs_all_vectors or self.basis == "none":
                raise UserError(f"`light_prior` has no effect on basis {self.basis}; leave it out")
            weights = real_numbers(self.light_prior.weights, "weights of `light_prior`")
            if not np.all((weights > 0.0) & (weights <= 1.0)):
                raise UserError("weights of `light_prior` must lie in (0, 1]; make it with falling_prior")
            if weights.shape != (bandlimit + 1,):
                raise UserError(f"light_prior must be made for bandlimit {bandlimit}, not {weights.size - 1}")
        if self.refine and (self.needs_all_vectors or self.basis == "none"):
            raise UserError(f"`refine` has no effect on basis {self.basis}; leave it out")
