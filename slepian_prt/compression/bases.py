"""The linear bases that transfer vectors of a cap are projected on, behind one interface.

A *candidate* is a cap's complete ordered basis with what each function is expected to carry; a truncation rule cuts
it to the *basis* that is used and stored.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.linear_basis import LinearBasis
from slepian_prt.compression.pilot import PilotStatistics
from slepian_prt.compression.prediction import by_degree
from slepian_prt.errors import check_choice
from slepian_prt.slepian.concentration import CapBasis, cap_basis, cap_moment_factors, moment_basis, scatter_radial
from slepian_prt.slepian.kernels import cosine_lobe
from slepian_prt.sphere.harmonics import degrees, num_coefficients
from slepian_prt.sphere.rotation import rotate_sh, rotation_to

# Caps share the basis of a cap at most this much wider: a few distinct problems instead of one per cap.
_ANGLE_STEP = 1.02


@dataclass(frozen=True)
class Candidate:
    """A cap's ordered basis before truncation.

    Attributes
    ----------
    energies : (K_max,)
        Expected squared coefficient of each function: by the pilot's second moment, and for ``pca`` as measured.
    total : float
        Expected squared norm of a (weighted) vector, likewise.
    cut : callable
        Gives the basis of the first K functions.
    lost : callable
        Gives the expected squared norm in each degree, (L+1,), of what the first K functions do not hold.
    """

    energies: NDArray[np.float64]
    total: float
    cut: Callable[[int], LinearBasis]
    lost: Callable[[int], NDArray[np.float64]]


class Frame(NamedTuple):
    """Where a cap's functions stand.

    Attributes
    ----------
    center : (3,)
    half_angle : float
        Of the smallest cap that holds its axes.
    spread : float
        Of the cap that, evenly filled, has axes as far from its centre on average.
    occlusion_class : int
        Which second moment is its own.
    """

    center: NDArray[np.float64]
    half_angle: float
    spread: float
    occlusion_class: int


@dataclass(frozen=True, eq=False)
class Problem:
    """What the builders of analytic bases may look at.

    Attributes
    ----------
    bandlimit : int
    frames : tuple of Frame
        One per cap.
    pilot : PilotStatistics
        Transfer of a few hundred vertices, for each occlusion class.
    weights : (L+1,) or None
        Of a light prior.
    """

    bandlimit: int
    frames: tuple[Frame, ...]
    pilot: PilotStatistics
    weights: NDArray[np.float64] | None = None
    _solved: dict[tuple[Any, ...], Any] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def scale(self) -> NDArray[np.float64]:
        """(L+1,) weights, ones if there is no prior."""
        return np.ones(self.bandlimit + 1) if self.weights is None else self.weights

    def functions(self, half_angle: float, kernel: NDArray | None = None) -> CapBasis:
        """Functions of a cap about z: Slepian functions, or concentrated for a zonal kernel under the light prior."""
        if kernel is None:
            return self._once(("plain", half_angle), lambda: cap_basis(self.bandlimit, half_angle))
        weighted = kernel * self.scale
        key = ("zonal", half_angle, weighted.tobytes())
        return self._once(key, lambda: cap_basis(self.bandlimit, half_angle, kernel=weighted))

    def adapted(self, occlusion_class: int, half_angle: float) -> CapBasis:
        """Functions of a cap about z from the pilot's second moment, under the light prior."""

        def solve() -> CapBasis:
            return moment_basis(self.bandlimit, half_angle, self.moment_factors(occlusion_class, half_angle))

        return self._once(("adapted", occlusion_class, half_angle), solve)

    def moment_factors(self, occlusion_class: int, half_angle: float) -> list[NDArray[np.float64]]:
        """Factors of the pilot's weighted second moment over a cap of that half-angle."""

        def solve() -> list[NDArray[np.float64]]:
            factors = cap_moment_factors(self.bandlimit, half_angle, self.pilot.moments[occlusion_class])
            return [factor * self.scale[m:] for m, factor in enumerate(factors)]

        return self._once(("moment", occlusion_class, half_angle), solve)

    def moment_rows(self, occlusion_class: int, half_angle: float) -> NDArray[np.float64]:
        """(r, (L+1)²): the same factors as vectors in the cap's frame, of all orders."""

        def solve() -> NDArray[np.float64]:
            l = np.arange(self.bandlimit + 1)
            rows = []
            for m, factor in enumerate(self.moment_factors(occlusion_class, half_angle)):
                for sign in (1,) if m == 0 else (1, -1):
                    block = np.zeros((len(factor), num_coefficients(self.bandlimit)))
                    block[:, l[m:] * (l[m:] + 1) + sign * m] = factor
                    rows.append(block)
            return np.concatenate(rows)

        return self._once(("rows", occlusion_class, half_angle), solve)

    def exit_radiance(self, half_angle: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Orthonormal radial coefficients and orders that span S D_t g_i, i = 1, 2, …; see `_slepian`."""
        return self._once(("exit", half_angle), lambda: self._exit_radiance(half_angle))

    def _once(self, key: tuple[Any, ...], solve: Callable[[], Any]) -> Any:
        if key not in self._solved:
            self._solved[key] = solve()
        return self._solved[key]

    def _exit_radiance(self, half_angle: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        functions = self.functions(half_angle)
        radial = functions.radial * cosine_lobe(self.bandlimit) * self.scale
        kept: list[int] = []
        done: dict[int, list[NDArray]] = {}
        for i, m in enumerate(functions.orders):
            v = radial[i]
            norm = float(np.linalg.norm(v))
            for _ in (1, 2):  # Gram-Schmidt twice is enough (Giraud et al. 2005)
                for earlier in done.get(int(m), []):
                    v = v - (earlier @ v) * earlier
            rest = float(np.linalg.norm(v))
            if rest > 1e-9 * norm and norm > 0.0:
                radial[i] = v / rest
                done.setdefault(int(m), []).append(radial[i])
                kept.append(i)
        return radial[kept], functions.orders[kept]


def shared_half_angle(half_angle: float) -> float:
    """The next larger of a geometric series of half-angles; 0 stays 0."""
    if half_angle == 0.0:
        return 0.0
    return min(math.pi, _ANGLE_STEP ** math.ceil(math.log(half_angle) / math.log(_ANGLE_STEP) - 1e-9))


# --- The bases -------------------------------------------------------------------------------------------------------


def _sh(problem: Problem, frame: Frame) -> Candidate:
    """Spherical harmonics in the order of their index."""
    in_cap_frame = rotate_sh(np.eye(num_coefficients(problem.bandlimit)), rotation_to(frame.center).T)

    def cut(k: int) -> LinearBasis:
        return LinearBasis(frame.center, problem.bandlimit, k, weights=problem.weights)

    return _predicted(problem, frame, in_cap_frame, cut, ("sh", *frame.center))


def _slepian(problem: Problem, frame: Frame) -> Candidate:
    """The paper's method: Slepian functions of the cap of normals, for exit radiance.

    B(n) ≈ Σ_{i<=K} b̄_i g_i(n) with b_lm = A_l e_lm (Lessig & Fiume, Eq. 8) is, for the transfer vector, the span of
    D_t g_i with D_t = diag(A_l). It is orthonormalised in the order of concentration, each order m by itself.
    Functions that the kernel maps into the span of earlier ones (it has no odd degree above 1) are left out.
    """
    return _radial_candidate(problem, frame, "slepian", *problem.exit_radiance(shared_half_angle(frame.half_angle)))


def _direct(problem: Problem, frame: Frame) -> Candidate:
    """What not to do: transfer vectors projected on the Slepian functions of the cap of *normals* themselves.

    Transfer fills the hemisphere about the normal, not the cap.
    """
    functions = problem.functions(shared_half_angle(frame.half_angle))
    return _radial_candidate(problem, frame, "direct", functions.radial, functions.orders)


def _incident(problem: Problem, frame: Frame) -> Candidate:
    """Slepian functions of the cap Θ + 90° that holds all transport of the cluster."""
    functions = problem.functions(shared_half_angle(min(math.pi, frame.half_angle + math.pi / 2)))
    return _radial_candidate(problem, frame, "incident", functions.radial, functions.orders)


def _transport(problem: Problem, frame: Frame) -> Candidate:
    """Eigenvectors of unoccluded transport's second moment over the cap."""
    functions = problem.functions(shared_half_angle(frame.half_angle), cosine_lobe(problem.bandlimit))
    return _radial_candidate(problem, frame, "transport", functions.radial, functions.orders)


def _adapted(problem: Problem, frame: Frame) -> Candidate:
    """Eigenvectors of the pilot's second moment over the cap: knows about shadows."""
    functions = problem.adapted(frame.occlusion_class, shared_half_angle(frame.spread))
    return _radial_candidate(problem, frame, "adapted", functions.radial, functions.orders)


class CurveStyle(NamedTuple):
    """How a curve is drawn: the colour, marker and dash of Matplotlib, any one of which tells it from the others."""

    color: str
    marker: str
    dash: str


@dataclass(frozen=True)
class BasisEntry:
    """What is known of a basis by its name; a new basis is one more entry of ``BASES``.

    Attributes
    ----------
    description : str
        Half a sentence, for help and reports.
    style : CurveStyle
    build : callable or None
        Makes the candidate of one cap; None for bases that are made from the vectors of the whole mesh.
    complete : bool
        Whether all its functions together hold any vector, so that any tolerance can be met.
    """

    description: str
    style: CurveStyle
    build: Callable[[Problem, Frame], Candidate] | None
    complete: bool = True


# Colours of Okabe & Ito, safe for colour-blind readers.
BASES = {
    "adapted": BasisEntry(
        "eigenvectors of the mean transport over the cap, learnt from a pilot of a few hundred vertices",
        CurveStyle("#D55E00", "o", "-"),
        _adapted,
    ),
    "transport": BasisEntry(
        "eigenvectors of unshadowed diffuse transport over the cap, known without looking at the scene",
        CurveStyle("#E69F00", "s", "-"),
        _transport,
    ),
    "slepian": BasisEntry(
        "the paper's Slepian functions of the cap of normals, for exit radiance",
        CurveStyle("#0072B2", "D", "--"),
        _slepian,
        complete=False,
    ),
    "incident": BasisEntry(
        "Slepian functions of the cap that holds all incident light (the cap of normals widened by 90°)",
        CurveStyle("#56B4E9", "^", "--"),
        _incident,
    ),
    "sh": BasisEntry("spherical harmonics cut at a lower degree", CurveStyle("#222222", "x", ":"), _sh),
    "direct": BasisEntry(
        "transfer projected on the Slepian functions of the cap of normals itself: what not to do",
        CurveStyle("#CC79A7", "P", ":"),
        _direct,
        complete=False,
    ),
    "pca": BasisEntry(
        "mean and principal components of each cap; has to see all vectors and to store its bases",
        CurveStyle("#009E73", "^", ":"),
        None,
    ),
    "cpca": BasisEntry(
        "pca with clusters iterated by reconstruction error (Sloan 2003)",
        CurveStyle("#009E73", "v", "-."),
        None,
    ),
}

ANALYTIC = {name: entry.build for name, entry in BASES.items() if entry.build is not None}


def candidates(name: str, problem: Problem) -> list[Candidate]:
    """One candidate per cap of the problem.

    Raises
    ------
    ValueError
        Unknown name.
    """
    check_choice(name, "basis", ANALYTIC)
    return [ANALYTIC[name](problem, frame) for frame in problem.frames]


def _radial_candidate(problem: Problem, frame: Frame, name: str, radial: NDArray, orders: NDArray) -> Candidate:
    """A candidate of orthonormal functions of one order each, about the pole, the most important first.

    Parameters
    ----------
    problem : Problem
    frame : Frame
    name : str
        Of the basis: caps of the same angles share its functions by that name.
    radial : (K_max, L+1)
        Coefficients over the degree.
    orders : (K_max,)
        Signed orders m.
    """

    def cut(k: int) -> LinearBasis:
        return LinearBasis(
            frame.center,
            problem.bandlimit,
            min(k, len(orders)),
            orders=orders[:k].astype(np.int16),
            radial=radial[:k].astype(np.float32),
            weights=problem.weights,
        )

    # Caps of one half-angle have the same functions and the same expectations.
    key = (name, frame.occlusion_class, shared_half_angle(frame.half_angle), shared_half_angle(frame.spread))
    in_cap_frame = problem._once(("in frame", *key), lambda: scatter_radial(radial, orders))
    return _predicted(problem, frame, in_cap_frame, cut, key)


def _predicted(
    problem: Problem,
    frame: Frame,
    in_cap_frame: NDArray,
    cut: Callable[[int], LinearBasis],
    key: tuple[Any, ...],
) -> Candidate:
    """A candidate of orthonormal functions, (K_max, (L+1)²) in the cap's frame, with what the pilot lets expect.

    ``key`` tells which caps have the same functions.
    """
    rows = problem.moment_rows(frame.occlusion_class, shared_half_angle(frame.spread))
    scale = problem.scale[degrees(problem.bandlimit)]

    def energies() -> NDArray[np.float64]:
        return np.asarray(np.sum((rows @ in_cap_frame.T) ** 2, axis=0))

    def lost(k: int) -> NDArray[np.float64]:
        def solve() -> NDArray[np.float64]:
            kept = in_cap_frame[:k]
            missing = rows - (rows @ kept.T) @ kept
            return by_degree(np.sum((missing / scale) ** 2, axis=0))

        return problem._once(("lost", k, *key), solve)

    found = problem._once(("energies", *key), energies)
    return Candidate(found, float(np.sum(rows**2)), cut, lost)
