"""The effective dimension of light transport over neighbourhoods of a surface (Lessig & Fiume, EGSR 2010)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.errors import UserError, check_real, check_transfer
from slepian_prt.evaluation.dimension.neighbourhoods import Neighbourhood, Surface
from slepian_prt.machine.threads import one_blas_thread, thread_count
from slepian_prt.sphere.harmonics import num_coefficients
from slepian_prt.summary import Summarised
from slepian_prt.transport.checks import check_finite, check_vectors
from slepian_prt.transport.transfer import Transfer

# Vectors are float32; what they leave below this part of their size is rounding.
SMALLEST_ERROR = 1e-5

# Neighbourhoods are taken about vertices so far apart, in radii, and what is between them is interpolated from those
# no further away than the second number times that. Half of all vertices are then within 1.6 % of what their own
# neighbourhood has, 9 % RMS on scans, where what hangs together changes at once (`scripts/benchmark dimension`).
_SPACING = 1.0 / 4.0
_BLEND = 1.5

# Neighbourhoods that wait for threads: each holds its vertices meanwhile.
_AT_ONCE = 64
_THREADS = 4

_ROWS = 1 << 13


@dataclass(frozen=True, repr=False)
class EffectiveDimension(Summarised):
    """How many functions light transport takes around each vertex.

    Attributes
    ----------
    dimension : (V,)
        K, not rounded, at least 1; zero where no light arrives. Interpolated between neighbourhoods: rounded up it is
        near the smallest number of functions of the neighbourhood of each vertex, but need not be that.
    functions : int
        M = (L+1)², of how many.
    error : float
        What the K functions leave, relative, RMS over the neighbourhood.
    radius : float
        Of the neighbourhoods, in units of the model.
    neighbourhood : float
        The same as a part of the model's size.
    areas : (V,)
        Of the surface about each vertex. Zero on the backs of what has two sides, so that it counts once, by its front,
        the side that its normals point to: backs of walls and floors are seen by no one, and nothing shadows them.
    members : int
        Vertices that a neighbourhood has, the median.
    """

    dimension: NDArray[np.float64]
    functions: int
    error: float
    radius: float
    neighbourhood: float
    areas: NDArray[np.float64] = field(repr=False)
    members: int

    @property
    def coherence(self) -> NDArray[np.float64]:
        """(V,) 1 - K/M: near one where few functions do, one where no light arrives."""
        return 1.0 - self.dimension / self.functions

    def quantile(self, part: float) -> float:
        """The dimension that this part of the lit surface, by area, is at or below.

        Parameters
        ----------
        part : float in [0, 1]
            0.5 gives the median.

        Raises
        ------
        UserError
            A part out of that range.
        """
        part = check_real(part, "part", "[0, 1]", lambda x: 0.0 <= x <= 1.0)
        lit = (self.dimension > 0.0) & (self.areas > 0.0)
        if not lit.any():
            return 0.0
        order = np.argsort(self.dimension[lit])
        reached = np.cumsum(self.areas[lit][order])
        place = int(np.searchsorted(reached, part * reached[-1]))
        return float(self.dimension[lit][order][min(place, order.size - 1)])

    def _summary(self) -> dict[str, object]:
        middle = self.quantile(0.5)
        lit: dict[str, object] = {
            "median": f"{middle:.3g} of {self.functions}",
            "coherence": 1.0 - middle / self.functions,
        }
        return {
            "vertices": self.dimension.size,
            **(lit if middle > 0.0 else {"median": "none, no light arrives anywhere"}),
            "error": self.error,
            "radius": self.radius,
        }


def effective_dimension(
    transfer: Transfer | CompressedTransfer,
    error: float = 0.05,
    neighbourhood: float = 0.05,
    *,
    advance: Callable[[int, int], None] = lambda _done, _total: None,
) -> EffectiveDimension:
    """How many functions are enough for the light transport around each vertex of a model.

    Over a neighbourhood U' of the surface the best K functions are the first K right singular vectors of the
    transfer vectors there, weighted with the area that each stands for, so that the density of the mesh does not
    matter; no mean is taken off. K is the smallest number that leaves a relative error of at most ``error`` under
    white light: √(Σ_(i>K) σ_i² / Σ_i σ_i²). For transport that is a zonal kernel about normals that fill a cap, σ_i²
    are the eigenvalues of ``cap_basis(L, Θ, kernel=t)``. Between K and K - 1 the error is taken to be linear,
    which makes the dimension change smoothly along the surface.

    The paper's K/M, small where transport is coherent, is ``dimension / functions``.

    Parameters
    ----------
    transfer : Transfer or CompressedTransfer
        Of a mesh or scene; what is compressed is decoded. Of three channels each gives vectors of its own.
    error : float in [1e-5, 1)
    neighbourhood : float in (0, 1]
        Radius of the neighbourhoods as a part of the model's size, the diagonal of its bounding box. A neighbourhood
        is what of the surface is within that radius of a vertex, in a straight line, and hangs together with it there.
    advance : callable
        Given (vertices finished since the last call, vertices in all), of those that some face uses.

    Returns
    -------
    EffectiveDimension

    Raises
    ------
    UserError
        Pixels of a camera instead of a surface, or no transfer at all; vectors that are not finite; a number out of its
        range.
    """
    check_transfer(transfer)
    error, neighbourhood = check_error(error), check_neighbourhood(neighbourhood)
    if transfer.film is not None:
        raise UserError(
            f"these are the pixels of camera '{transfer.film.name}', which are no surface to have neighbourhoods on; "
            "precompute the scene instead"
        )
    mesh = transfer.mesh
    if isinstance(transfer, Transfer):
        check_vectors(transfer)
        vectors = transfer.vectors
    else:
        check_finite(vectors := transfer.reconstruct())
    active = mesh.receivers.active
    used = mesh.positions[active]
    radius = neighbourhood * float(np.linalg.norm(np.ptp(used, axis=0)))
    surface = Surface(mesh, radius)
    with one_blas_thread():  # matrices are small: more threads wait for each other
        dimension, counts = _over_surface(surface, vectors, error, advance)
    functions = num_coefficients(transfer.bandlimit)
    areas = surface.areas.copy()
    for part in transfer.parts:
        if part.sides == 2:
            areas[part.first + part.count : part.end] = 0.0
    return EffectiveDimension(dimension, functions, error, radius, neighbourhood, areas, int(np.median(counts)))


def _over_surface(
    surface: Surface, vectors: NDArray, error: float, advance: Callable[[int, int], None]
) -> tuple[NDArray[np.float64], list[int]]:
    """The dimension of each vertex (V,), and how many vertices the neighbourhoods have that it was computed from."""
    total, weight = np.zeros(len(surface.areas)), np.zeros(len(surface.areas))
    counts, reach = [], _BLEND * _SPACING * surface.radius

    def dimension(about: Neighbourhood) -> float:
        return dimension_of_vectors(vectors[about.members], about.areas, error)

    wanted = _covering(surface, advance)
    with ThreadPoolExecutor(min(thread_count(), _THREADS)) as threads:
        while batch := list(islice(wanted, _AT_ONCE)):
            for about, found in zip(batch, threads.map(dimension, batch), strict=True):
                counts.append(about.members.size)
                if found == 0.0:  # no light arrives there, which is no low dimension to go over into
                    continue
                blend = np.maximum(1.0 - (about.distances / reach) ** 2, 0.0) ** 2
                total[about.members] += blend * found
                weight[about.members] += blend
    total[~vectors.any(axis=tuple(range(1, vectors.ndim)))] = 0.0
    return total / np.maximum(weight, 1e-300), counts


def _covering(surface: Surface, advance: Callable[[int, int], None]) -> Iterator[Neighbourhood]:
    """Neighbourhoods of vertices that are no closer to each other than the spacing, but of all vertices to one."""
    done, spacing = np.zeros(len(surface.areas), dtype=bool), _SPACING * surface.radius
    order = list(surface.spread_order())
    for vertex in order:
        if not done[vertex]:
            about = surface.about(vertex)
            near = about.members[about.distances <= spacing]
            advance(int(np.count_nonzero(~done[near])), len(order))
            done[near] = True
            yield about


def dimension_of_vectors(vectors: NDArray, weights: NDArray, error: float) -> float:
    """The dimension of the best linear space for some transfer vectors, see `dimension_of_energies`.

    Parameters
    ----------
    vectors : (n, (L+1)²) or (n, channels, (L+1)²)
    weights : (n,)
        Not negative: what each counts, as the area that it stands for.
    error : float
    """
    rows = vectors if vectors.ndim == 3 else vectors[:, None]
    seen = np.flatnonzero(weights > 0.0)
    rows, roots = rows[seen], np.sqrt(weights[seen])[:, None, None]
    size = rows.shape[0] * rows.shape[1]
    if size <= rows.shape[2]:
        few = (rows * roots).reshape(size, rows.shape[2])
        moment = few @ few.T
    else:
        moment = np.zeros((rows.shape[2], rows.shape[2]))
        for begin in range(0, len(rows), _ROWS):
            some = (rows[begin : begin + _ROWS] * roots[begin : begin + _ROWS]).reshape(-1, rows.shape[2])
            moment += some.T @ some
    return dimension_of_energies(np.linalg.eigvalsh(moment)[::-1], error)


def dimension_of_energies(energies: NDArray, error: float) -> float:
    """The effective dimension where the best functions carry these energies, largest first.

    With r(K) = √(Σ_(i>K) E_i / Σ_i E_i) it is the K with r(K) = error, where r is linear between whole numbers, and at
    least 1: rounded up, the smallest number of functions that leave no more than that. Zero without energy. Were ln r
    linear, the K of what has a finite rank would be set by how small the noise is that is left beyond.

    Parameters
    ----------
    energies : (n,)
        Squared singular values or eigenvalues; those below zero are rounding.
    error : float
    """
    left = np.append(np.cumsum(np.maximum(energies, 0.0)[::-1])[::-1], 0.0)
    if not left[0] > 0.0:
        return 0.0
    errors = np.sqrt(left / left[0])
    count = int(np.argmax(errors <= error))
    above, below = float(errors[count - 1]), float(errors[count])
    return max(1.0, count - 1.0 + (above - error) / (above - below))


def check_error(error: float) -> float:
    """Return it as a float; raise UserError outside of [1e-5, 1)."""
    return check_real(error, "error", f"[{SMALLEST_ERROR:g}, 1)", lambda x: SMALLEST_ERROR <= x < 1.0)


def check_neighbourhood(neighbourhood: float) -> float:
    """Return it as a float; raise UserError outside of (0, 1]."""
    return check_real(neighbourhood, "neighbourhood", "(0, 1], a part of the model's size", lambda x: 0.0 < x <= 1.0)
