"""The linear bases that transfer vectors of a cap are projected on, behind one interface.

A *candidate* is a cap's complete ordered basis with what each function is expected to carry; a truncation rule cuts
it to the *basis* that is used and stored.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.clusters import Clusters
from slepian_prt.errors import UserError
from slepian_prt.slepian.concentration import CapBasis, cap_basis, cap_moment_factors, scatter_radial
from slepian_prt.slepian.kernels import SecondMoment, cosine_lobe, measured_moment
from slepian_prt.sphere.caps import Cap
from slepian_prt.sphere.harmonics import num_coefficients
from slepian_prt.sphere.rotation import rotate_sh, rotation_to

# Caps share the basis of a cap at most this much wider: a few distinct problems instead of one per cap.
_ANGLE_STEP = 1.02

# Vertices whose transfer is looked at to learn the second moment of `adapted`.
PILOT_SIZE = 400


def channel_mixing(channels: int) -> NDArray[np.float32]:
    """Orthonormal rows that turn red, green and blue into channels that hardly correlate: their mean, then tints."""
    if channels == 1:
        return np.ones((1, 1), dtype=np.float32)
    rows = np.array([[1.0, 1.0, 1.0], [1.0, 0.0, -1.0], [1.0, -2.0, 1.0]])
    return (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32)


@dataclass(frozen=True)
class LinearBasis:
    """K functions of one cap: t ≈ mean + Σ_k c_k f_k with c = fᵀ (t - mean).

    The functions are orthonormal. They are kept in whichever of three forms is smallest to store.

    Attributes
    ----------
    center : (3,)
    orders : (K,) int16 or None, radial : (K, L+1) float32 or None
        Functions of one order each in the cap's frame.
    dense : (K, (L+1)²) float32, float16 or None
        Functions in the world frame. If this and ``radial`` are None, the functions are the first K harmonics.
    mean : (channels, (L+1)²) float32, float16 or None
    count, bandlimit : int
        K and L.
    """

    center: NDArray[np.float64]
    bandlimit: int
    count: int
    orders: NDArray[np.int16] | None = None
    radial: NDArray[np.float32] | None = None
    dense: NDArray | None = None
    mean: NDArray | None = None

    @cached_property
    def functions(self) -> NDArray[np.float64]:
        """(K, (L+1)²) in the world frame."""
        if self.radial is not None and self.orders is not None:
            return rotate_sh(scatter_radial(self.radial.astype(np.float64), self.orders), rotation_to(self.center))
        if self.dense is not None:
            return self.dense.astype(np.float64)
        return np.eye(self.count, num_coefficients(self.bandlimit))

    def first(self, count: int) -> LinearBasis:
        """The basis of the first ``count`` functions."""
        return replace(
            self,
            count=count,
            orders=None if self.orders is None else self.orders[:count],
            radial=None if self.radial is None else self.radial[:count],
            dense=None if self.dense is None else self.dense[:count],
        )

    def halved(self) -> LinearBasis:
        """The basis with what depends on the data, ``dense`` and ``mean``, in float16."""
        half = (None if part is None else part.astype(np.float16) for part in (self.dense, self.mean))
        dense, mean = half
        return replace(self, dense=dense, mean=mean)

    def project(self, vectors: NDArray) -> NDArray[np.float32]:
        """(n, K channels) coefficients of transfer vectors (n, channels, (L+1)²); those of one function together."""
        centred = vectors if self.mean is None else vectors - self.mean
        n, channels, size = centred.shape
        coefficients = centred.reshape(-1, size) @ self.functions.T.astype(np.float32)
        by_function = np.swapaxes(coefficients.reshape(n, channels, self.count), 1, 2)
        return by_function.reshape(n, self.count * channels).astype(np.float32)

    def reconstruct(self, coefficients: NDArray, channels: int) -> NDArray[np.float32]:
        """(n, channels, (L+1)²) transfer vectors from (n, K channels) coefficients."""
        n = len(coefficients)
        by_channel = np.swapaxes(coefficients.reshape(n, self.count, channels), 1, 2).reshape(n * channels, self.count)
        vectors = (by_channel.astype(np.float32) @ self.functions.astype(np.float32)).reshape(
            n, channels, num_coefficients(self.bandlimit)
        )
        return vectors if self.mean is None else vectors + self.mean

    def light(self, lighting: NDArray, mixing: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """What each coefficient, (K channels, 3), and the mean, (3,), make of lighting (3, (L+1)²).

        ``mixing`` (channels, 3) is the part of each channel in red, green and blue.
        """
        by_function = np.einsum("kc,dc->kdc", self.functions @ lighting.T, mixing)
        mean = np.zeros(3) if self.mean is None else np.einsum("dm,cm,dc->c", self.mean, lighting, mixing)
        return by_function.reshape(-1, 3), mean


def pack_radial(bases: tuple[LinearBasis, ...]) -> dict[str, NDArray]:
    """Arrays that hold the radial bases of all caps, each function once.

    Caps of the same shared half-angle have the same functions, and so have the orders m and -m; coefficients of
    degrees below |m| are zero. Stored are one table of functions per family of caps, the family of each cap, and for
    each function whether it repeats the one before it.
    """
    families: list[tuple[NDArray[np.int16], NDArray[np.float32]]] = []
    family = np.zeros(len(bases), dtype=np.uint16)
    for i, basis in enumerate(bases):
        if basis.orders is None or basis.radial is None:
            raise ValueError("all bases must be radial")
        mine = (basis.orders, basis.radial)
        for j, known in enumerate(families):
            k = min(len(mine[0]), len(known[0]))
            if np.array_equal(mine[0][:k], known[0][:k]) and np.array_equal(mine[1][:k], known[1][:k]):
                families[j], family[i] = (mine if len(mine[0]) > k else known), j
                break
        else:
            family[i] = len(families)
            families.append(mine)
    repeats, values = [], []
    for orders, radial in families:
        for k, (m, row) in enumerate(zip(orders, radial, strict=True)):
            repeats.append(k > 0 and np.array_equal(row, radial[k - 1]))
            if not repeats[-1]:
                values.append(row[abs(m) :])
    return {
        "radial/family": family,
        "radial/count": np.array([len(orders) for orders, _ in families], dtype=np.uint16),
        "radial/order": np.concatenate([orders for orders, _ in families]),
        "radial/repeats": np.packbits(repeats),
        "radial/values": np.concatenate(values),
    }


def unpack_radial(
    arrays: dict[str, NDArray], terms: NDArray, bandlimit: int
) -> tuple[list[NDArray[np.int16]], list[NDArray[np.float32]]]:
    """Orders and radial coefficients of each cap from what `pack_radial` made."""
    counts, orders = arrays["radial/count"].astype(np.int64), arrays["radial/order"]
    repeats = np.unpackbits(arrays["radial/repeats"], count=orders.size).astype(bool)
    radial = np.zeros((orders.size, bandlimit + 1), dtype=np.float32)
    taken = 0
    for k, m in enumerate(np.abs(orders.astype(np.int64)).tolist()):
        if repeats[k]:
            radial[k] = radial[k - 1]
        else:
            radial[k, m:] = arrays["radial/values"][taken : taken + bandlimit + 1 - m]
            taken += bandlimit + 1 - m
    starts = np.concatenate([[0], np.cumsum(counts)])[arrays["radial/family"]]
    chosen = [slice(start, start + k) for start, k in zip(starts, terms, strict=True)]
    return [orders[s] for s in chosen], [radial[s] for s in chosen]


@dataclass(frozen=True)
class Candidate:
    """A cap's ordered basis before truncation.

    Attributes
    ----------
    energies : (K_max,)
        Expected squared coefficient of each function: by the pilot's second moment, and for ``cpca`` as measured.
    total : float
        Expected squared norm of a transfer vector, likewise.
    cut : callable
        Gives the basis of the first K functions.
    """

    energies: NDArray[np.float64]
    total: float
    cut: Callable[[int], LinearBasis]


@dataclass(frozen=True, eq=False)
class Problem:
    """What the builders of bases may look at. Beyond the pilot only ``cpca`` looks at the vectors.

    ``vectors`` (V, channels, (L+1)²) are those of the transfer, ``axes`` (V, 3) what it is concentrated about.
    """

    bandlimit: int
    clusters: Clusters
    axes: NDArray[np.float64]
    vectors: NDArray[np.float32]
    seed: int = 0
    _solved: dict[tuple[str, float], Any] = field(default_factory=dict, init=False, repr=False)

    def of(self, members: NDArray) -> NDArray[np.float32]:
        """(n, channels, (L+1)²) transfer vectors of some vertices, the channels decorrelated."""
        chosen = self.vectors[members]
        channels = chosen.shape[1]
        return chosen if channels == 1 else np.einsum("dc,ncm->ndm", channel_mixing(channels), chosen)

    @cached_property
    def unoccluded(self) -> NDArray[np.float64]:
        """Zonal coefficients of diffuse transport without shadows."""
        return cosine_lobe(self.bandlimit)

    @cached_property
    def pilot_moment(self) -> SecondMoment:
        """Second moment of a stratified pilot in the vertices' own frames: every n-th vertex in cluster order."""
        lit = np.any(self.axes != 0.0, axis=1)
        in_order = np.concatenate(self.clusters.members)
        in_order = in_order[lit[in_order]]
        step = max(1, in_order.size // PILOT_SIZE)
        pilot = in_order[np.random.default_rng(self.seed).integers(step) :: step]
        to_local = np.swapaxes(rotation_to(self.axes[pilot]), -1, -2)
        seen = self.of(pilot).astype(np.float64)
        return measured_moment(rotate_sh(seen, to_local[:, None]).reshape(-1, seen.shape[2]))

    def functions(self, kind: str, half_angle: float) -> CapBasis:
        """Concentrated functions of a cap about z, solved once for all caps of that (shared) half-angle."""
        kernel = {"plain": None, "unoccluded": self.unoccluded, "pilot": self.pilot_moment}[kind]
        return self._once(kind, half_angle, lambda: cap_basis(self.bandlimit, half_angle, kernel=kernel))

    def moment_factors(self, half_angle: float) -> list[NDArray[np.float64]]:
        """Factors of the pilot's second moment over a cap of that half-angle, by which errors are predicted."""
        return self._once(
            "moment", half_angle, lambda: cap_moment_factors(self.bandlimit, half_angle, self.pilot_moment)
        )

    def exit_radiance(self, half_angle: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Orthonormal radial coefficients and orders that span D_t g_i, i = 1, 2, …; see `_slepian`."""
        return self._once("exit", half_angle, lambda: self._exit_radiance(half_angle))

    def _once(self, kind: str, half_angle: float, solve: Callable[[], Any]) -> Any:
        if (kind, half_angle) not in self._solved:
            self._solved[kind, half_angle] = solve()
        return self._solved[kind, half_angle]

    def _exit_radiance(self, half_angle: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        functions = self.functions("plain", half_angle)
        radial = functions.radial * self.unoccluded
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


def _sh(problem: Problem, cap: Cap, _members: NDArray) -> Candidate:
    """Spherical harmonics in the order of their index."""
    in_cap_frame = rotate_sh(np.eye(num_coefficients(problem.bandlimit)), rotation_to(cap.center).T)
    return _predicted(problem, cap, in_cap_frame, lambda k: LinearBasis(cap.center, problem.bandlimit, k))


def _slepian(problem: Problem, cap: Cap, _members: NDArray) -> Candidate:
    """The paper's method: Slepian functions of the cap of normals, for exit radiance.

    B(n) ≈ Σ_{i<=K} b̄_i g_i(n) with b_lm = A_l e_lm (Lessig & Fiume, Eq. 8) is, for the transfer vector, the span of
    D_t g_i with D_t = diag(A_l). It is orthonormalised in the order of concentration, each order m by itself.
    Functions that the kernel maps into the span of earlier ones (it has no odd degree above 1) are left out.
    """
    return _radial_candidate(problem, cap, *problem.exit_radiance(shared_half_angle(cap.half_angle)))


def _direct(problem: Problem, cap: Cap, _members: NDArray) -> Candidate:
    """What not to do: transfer vectors projected on the Slepian functions of the cap of *normals* themselves.

    Transfer fills the hemisphere about the normal, not the cap.
    """
    return _of_functions(problem, cap, "plain", cap.half_angle)


def _incident(problem: Problem, cap: Cap, _members: NDArray) -> Candidate:
    """Slepian functions of the cap Θ + 90° that holds all transport of the cluster."""
    return _of_functions(problem, cap, "plain", min(math.pi, cap.half_angle + math.pi / 2))


def _transport(problem: Problem, cap: Cap, _members: NDArray) -> Candidate:
    """Eigenvectors of unoccluded transport's second moment over the cap."""
    return _of_functions(problem, cap, "unoccluded", cap.half_angle)


def _adapted(problem: Problem, cap: Cap, _members: NDArray) -> Candidate:
    """Eigenvectors of the pilot's second moment over the cap: knows about shadows."""
    return _of_functions(problem, cap, "pilot", cap.half_angle)


def _cpca(problem: Problem, cap: Cap, members: NDArray) -> Candidate:
    """Mean and principal components of the cluster (Sloan et al., SIGGRAPH 2003), the clusters being the caps.

    The first of K terms is the mean, whose coefficient is one and is not stored.
    """
    size = num_coefficients(problem.bandlimit)
    vectors = problem.of(members).astype(np.float64)
    mean = vectors.mean(axis=0) if members.size else np.zeros(vectors.shape[1:])
    centred = (vectors - mean).reshape(-1, size)
    variances, components = np.linalg.eigh(centred.T @ centred / max(members.size, 1))
    variances, components = np.maximum(variances[::-1], 0.0), components[:, ::-1].T
    of_mean = float(np.sum(mean * mean))
    energies = np.concatenate([[of_mean], variances])[:size]

    def cut(k: int) -> LinearBasis:
        return LinearBasis(
            cap.center,
            problem.bandlimit,
            k - 1,
            dense=components[: k - 1].astype(np.float32),
            mean=mean.astype(np.float32),
        )

    return Candidate(energies, of_mean + float(variances.sum()), cut)


BASES: dict[str, Callable[[Problem, Cap, NDArray], Candidate]] = {
    "adapted": _adapted,
    "transport": _transport,
    "slepian": _slepian,
    "incident": _incident,
    "sh": _sh,
    "cpca": _cpca,
    "direct": _direct,
}


def candidates(name: str, problem: Problem) -> list[Candidate]:
    """One candidate per cap of the problem.

    Raises
    ------
    ValueError
        Unknown name.
    """
    if name not in BASES:
        raise UserError(f"basis must be one of {', '.join(BASES)}, not {name!r}")
    pairs = zip(problem.clusters.caps, problem.clusters.members, strict=True)
    return [BASES[name](problem, cap, members) for cap, members in pairs]


def _of_functions(problem: Problem, cap: Cap, kind: str, half_angle: float) -> Candidate:
    functions = problem.functions(kind, shared_half_angle(half_angle))
    return _radial_candidate(problem, cap, functions.radial, functions.orders)


def _radial_candidate(problem: Problem, cap: Cap, radial: NDArray, orders: NDArray) -> Candidate:
    def cut(k: int) -> LinearBasis:
        return LinearBasis(
            cap.center,
            problem.bandlimit,
            min(k, len(orders)),
            orders=orders[:k].astype(np.int16),
            radial=radial[:k].astype(np.float32),
        )

    return _predicted(problem, cap, scatter_radial(radial, orders), cut)


def _predicted(problem: Problem, cap: Cap, in_cap_frame: NDArray, cut: Callable[[int], LinearBasis]) -> Candidate:
    """A candidate of orthonormal functions, (K_max, (L+1)²) in the cap's frame, with what the pilot lets expect."""
    factors = problem.moment_factors(shared_half_angle(cap.half_angle))
    return Candidate(_energies(in_cap_frame, factors), problem.pilot_moment.energy, cut)


def _energies(in_cap_frame: NDArray, factors: list[NDArray]) -> NDArray[np.float64]:
    """fᵀ C_U f of functions given in the cap's frame, (K, (L+1)²)."""
    bandlimit = len(factors) - 1
    l = np.arange(bandlimit + 1)
    energies = np.zeros(len(in_cap_frame))
    for m, factor in enumerate(factors):
        column = l[m:] * (l[m:] + 1)
        for sign in (1,) if m == 0 else (1, -1):
            energies += np.sum((in_cap_frame[:, column + sign * m] @ factor.T) ** 2, axis=1)
    return energies
