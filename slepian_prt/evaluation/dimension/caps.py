"""The caps of a transfer file: dimension of the transport in each, and what the paper lets expect for its normals."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.errors import check_epsilon
from slepian_prt.machine.threads import one_blas_thread
from slepian_prt.slepian.concentration import cap_basis
from slepian_prt.slepian.shannon import concentration_count, count_above
from slepian_prt.sphere.caps import cap_area

# Concentration down to which functions count, where nothing else is said.
EPSILON = 0.01

# Normals that differ by less are one: rounding to float32 takes a hundredth of it.
_LEAST_DEGREES = 1e-3


@dataclass(frozen=True)
class CapDimension:
    """One cap of a file.

    Attributes
    ----------
    cap : int
        Its number in the file, from zero.
    vertices : int
        That receive light.
    half_angle : float
        Radians.
    expected : int or None
        Concentrations of the cap above `EPSILON`: the dimension by the paper, without shadows. None for pixels, whose
        caps are of no normals.
    dimension : float
        Of the transfer vectors of the cap, see `effective_dimension`.
    functions : int
        M.
    """

    cap: int
    vertices: int
    half_angle: float
    expected: int | None
    dimension: float
    functions: int

    @property
    def coherence(self) -> float:
        """1 - K/M."""
        return 1.0 - self.dimension / self.functions


def cap_dimensions(packed: CompressedTransfer, error: float) -> tuple[CapDimension, ...]:
    """All caps that vertices with light belong to, the largest dimension first.

    Vectors are weighted with the area of their vertices, pixels alike.

    Raises
    ------
    UserError
        An error that is none; a file that does not fit together.
    """
    # Only here: what is told without decoding starts without SciPy.
    from slepian_prt.evaluation.dimension.estimate import check_error, dimension_of_vectors
    from slepian_prt.evaluation.dimension.neighbourhoods import vertex_areas

    error = check_error(error)
    vectors, active = packed.reconstruct(), packed.mesh.receivers.active
    is_surface = packed.film is None
    areas = vertex_areas(packed.mesh) if is_surface else np.ones(len(vectors))
    found = []
    with one_blas_thread():  # matrices are small: more threads wait for each other
        for number, (cap, members) in enumerate(zip(packed.clusters.caps, packed.clusters.members, strict=True)):
            lit = members[active[members]]
            if lit.size == 0:
                continue
            found.append(
                CapDimension(
                    number,
                    int(lit.size),
                    cap.half_angle,
                    concentration_count(packed.bandlimit, cap.half_angle, EPSILON) if is_surface else None,
                    dimension_of_vectors(vectors[lit], areas[lit], error),
                    vectors.shape[-1],
                )
            )
    return tuple(sorted(found, key=lambda row: -row.dimension))


def describe_count(count: int, half_angle: float) -> str:
    """How many concentrations above `EPSILON` a cap of that half-angle, in radians, has: in words.

    A cap of one normal has no area to be concentrated on, though transport there takes a function.
    """
    degrees = math.degrees(half_angle)
    counted = {0: "no concentration", 1: "1 concentration"}.get(count, f"{count} concentrations")
    where = f"{degrees:.3g} degrees" if degrees >= _LEAST_DEGREES else "one normal"
    return f"{counted} above {EPSILON:g} in caps of {where}"


def count_concentrations(bandlimit: int, half_angle: float, epsilon: float = EPSILON) -> int:
    """As `concentration_count`, without SciPy, which takes longer to import than this.

    Concentrations are the energies over the cap of a kernel that has all degrees alike, so they are right to rounding
    of the largest instead of their own.
    """
    epsilon = check_epsilon(epsilon)
    with one_blas_thread():
        energies = cap_basis(bandlimit, half_angle, kernel=np.ones(bandlimit + 1)).eigenvalues
    return count_above(energies * cap_area(half_angle), epsilon)
