"""Transfer as graphics hardware takes it: 16 bytes per vertex, say, and few functions for each of at most 255 caps.

A vertex has K - 1 coefficients in one byte each and the number of its cap in another. What the light makes of the K
functions of each cap, the mean and K - 1 principal axes, is worked out when the light changes; a vertex shader
multiplies it with the bytes. docs/runtime-format.md has all that a shader needs to know.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.decoder import forget
from slepian_prt.compression.prediction import Expectation
from slepian_prt.errors import UserError, check_integer, check_transfer
from slepian_prt.lighting.fitting import one_light
from slepian_prt.lighting.spectrum import expected_power, falling_prior
from slepian_prt.machine.threads import one_blas_thread
from slepian_prt.relighting.factors import all_factors
from slepian_prt.runtime.energies import DegreeEnergies
from slepian_prt.runtime.groups import Group, group_caps
from slepian_prt.runtime.local_axes import LocalAxes, cluster_counts, split_by_axes, variance_left
from slepian_prt.runtime.rounding import LARGEST, round_functions, to_bytes
from slepian_prt.sphere.harmonics import degrees, num_coefficients
from slepian_prt.summary import Summarised

if TYPE_CHECKING:
    from slepian_prt.transport.transfer import Transfer

LARGEST_FUNCTIONS = 128
LARGEST_CAPS = 255

# A cap whose functions are fewer receivers than this saves nothing.
_RECEIVERS_PER_FUNCTION = 2

# What part of the squares of coefficients rounding to a byte loses, where they range over six standard deviations.
_BYTE_ROUNDING = (6.0 / LARGEST) ** 2 / 12.0

# Rounding of functions adds this part to the squared error that is left, or to that of 0.001 of a transfer vector.
_ROUNDING_PART = 0.02
_LEAST_LEFT = 1e-6

# A full-SH transfer is grouped like this before.
_CAPS_OF_VECTORS = 96


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class GpuTransfer(Summarised):
    """Transfer ready to be uploaded.

    The transfer vector of receiver v, of cap c = ``vertices[v, K - 1]``, is

        functions[c, 0] + Σ_k (vertices[v, k - 1] / 255 - zeros[c, k - 1]) functions[c, k],    k = 1 … K - 1,

    and its radiance for unit albedo that vector times the light, colour by colour.

    Attributes
    ----------
    bandlimit : int
    vertices : (V, K) uint8
        In each row the K - 1 coefficients, those of functions that carry most first, and the number of a cap.
    functions : (C, K, channels, (L+1)²) float32
        World space, all of them numbers of float16; the first is the mean. With one channel it is that of all colours.
    zeros : (C, K - 1) float32
        What part of 255 stands for a coefficient of zero, to leave out functions.
    expected : Expectation
        What this step loses of the transfer vectors of the file, and these, in each degree.
    of_file : Expectation
        What the file itself was expected to lose.
    """

    bandlimit: int
    vertices: NDArray[np.uint8]
    functions: NDArray[np.float32]
    zeros: NDArray[np.float32]
    expected: Expectation
    of_file: Expectation

    @property
    def channels(self) -> int:
        """1, or 3 of transfer in colours."""
        return self.functions.shape[2]

    @property
    def function_count(self) -> int:
        """K, the bytes of a vertex."""
        return self.functions.shape[1]

    @property
    def cap_count(self) -> int:
        """C, the dark one among them, if any."""
        return len(self.functions)

    def error(self, lighting: NDArray | None = None) -> float:
        """Relative RMS error of radiance that this step adds, averaged over the rotations of the light.

        Parameters
        ----------
        lighting : (3, (L+1)²), optional
            By default light that falls as 1/(l+1)².
        """
        return self.expected.relative(expected_power(lighting, self.bandlimit))

    def relit_error(self, lighting: NDArray | None = None) -> float:
        """The same together with what the file lost, which has nothing to do with it."""
        return math.hypot(self.error(lighting), self.of_file.relative(expected_power(lighting, self.bandlimit)))

    def light(self, lighting: NDArray) -> NDArray[np.float32]:
        """What a light makes of the functions: the table that shaders read, anew for each light.

        Parameters
        ----------
        lighting : (3, n²)
            Of another bandlimit it is cut, or zero in the degrees that it has not, with a remark.

        Returns
        -------
        (C, K, 3) float32
            Radiance of receiver v is table[c, 0] + Σ_k vertices[v, k - 1] / 255 table[c, k].
        """
        light = one_light(lighting, self.bandlimit).astype(np.float32)
        table = np.einsum(
            "ckdm,dm->ckd",
            np.broadcast_to(self.functions, (*self.functions.shape[:2], *light.shape)),
            light,
            optimize=True,
        )
        table[:, 0] -= np.einsum("ck,ckd->cd", self.zeros, table[:, 1:])
        return np.asarray(table, dtype=np.float32)

    def relight(self, lighting: NDArray) -> NDArray[np.float32]:
        """(V, 3) radiance for unit albedo under lighting (3, (L+1)²), as a shader has it."""
        table, radiance = self.light(lighting), np.empty((len(self.vertices), 3), dtype=np.float32)
        caps = self.vertices[:, -1]
        for c in np.unique(caps):
            own = np.flatnonzero(caps == c)
            coefficients = self.vertices[own, :-1].astype(np.float32) / np.float32(LARGEST)
            radiance[own] = table[c, 0] + coefficients @ table[c, 1:]
        return radiance

    def _summary(self) -> dict[str, object]:
        return {
            "vertices": len(self.vertices),
            "bytes_per_vertex": self.function_count,
            "bandlimit": self.bandlimit,
            "channels": self.channels,
            "functions": self.function_count,
            "caps": self.cap_count,
            "error": self.error(),
            "relit_error": self.relit_error(),
        }


def gpu_transfer(
    transfer: CompressedTransfer | Transfer, functions: int = 16, *, bits: int = 8, caps: int | None = None
) -> GpuTransfer:
    """Transfer in so many bytes per vertex, for graphics hardware.

    The caps of a file are split further, each vertex going where principal axes fit it best, until there are ``caps``.
    Everything is done on coefficients; no transfer vectors are formed.

    Parameters
    ----------
    transfer : CompressedTransfer, or Transfer (full SH)
    functions : int, a multiple of 8 up to 128
        K: of each cap the mean and K - 1 principal axes, for K bytes per vertex. Hardware likes 8, 16, 24 and 32.
    bits : int in [2, 8]
        Of a coefficient, which takes a byte all the same: fewer make it compress better.
    caps : int in [1, 255], optional
        At most so many. By default up to 255, as long as the functions of a channel are not more numbers than vertices
        have bytes, but no fewer than the file has.

    Returns
    -------
    GpuTransfer

    Raises
    ------
    UserError
        Numbers that are not as above.

    References
    ----------
    Sloan, Hall, Hart and Snyder, "Clustered Principal Components for Precomputed Radiance Transfer", SIGGRAPH 2003.
    """
    check_transfer(transfer)
    count = check_integer(functions, "functions", 8, LARGEST_FUNCTIONS)
    if count % 8:
        raise UserError(f"functions must be a multiple of 8 from 8 to {LARGEST_FUNCTIONS}, not {count}")
    bits = check_integer(bits, "bits", 2, 8)
    packed = as_compressed(transfer)
    if caps is None:
        affordable = packed.vertex_count // num_coefficients(packed.bandlimit)
        caps = min(LARGEST_CAPS, max(affordable, packed.cap_count))
    caps = check_integer(caps, "caps", 1, LARGEST_CAPS)
    prior = packed.prior_weights
    by_degree = falling_prior(packed.bandlimit).weights if prior is None else prior
    weights = by_degree[degrees(packed.bandlimit)].astype(np.float64)
    active = packed.mesh.receivers.active
    parts = all_factors(packed)
    forget(packed)
    # Threads of BLAS that wait for each other make many small problems slow.
    with one_blas_thread():
        groups = group_caps(parts, packed.clusters.members, active, weights, caps)
        clusters = [cluster for group in _split(groups, caps, count - 1) for cluster in group]
        return _assemble(packed, clusters, _Wanted(count, bits, weights))


class _Wanted(NamedTuple):
    """K, bits of a coefficient, and ((L+1)²,) the weights that functions are orthonormal under."""

    functions: int
    bits: int
    weights: NDArray[np.float64]


def as_compressed(transfer: CompressedTransfer | Transfer) -> CompressedTransfer:
    """The same transfer in caps; of full SH nothing is lost."""
    if isinstance(transfer, CompressedTransfer):
        return transfer
    from slepian_prt.compression.stream import compress  # only for vectors: what files hold needs no encoder

    clusters = min(_CAPS_OF_VECTORS, len(transfer.mesh.positions))
    return compress(transfer, "none", clusters=clusters, coding="float32")


def _split(groups: Sequence[Group], caps: int, count: int) -> list[list[Group]]:
    """Each group in clusters that are near planes of ``count`` dimensions, ``caps`` of them altogether."""
    left = np.array([variance_left(group.values, count, _BYTE_ROUNDING) for group in groups])
    sizes = np.array([len(group.members) for group in groups])
    counts = cluster_counts(left, sizes, caps, _RECEIVERS_PER_FUNCTION * (count + 1))
    rng = np.random.default_rng(0)
    split = []
    for group, clusters in zip(groups, counts.tolist(), strict=True):
        labels = split_by_axes(group.values, clusters, count, rng)
        chosen = [labels == label for label in np.unique(labels)]
        split.append([Group(group.members[own], group.values[own], group.functions) for own in chosen])
    return split


def _assemble(packed: CompressedTransfer, clusters: Sequence[Group], wanted: _Wanted) -> GpuTransfer:
    """Bytes and functions of all clusters, each a cap, and what they lose."""
    active = packed.mesh.receivers.active
    dark = int(not active.all())  # one more cap, whose functions are all zero
    shape = len(clusters) + dark, wanted.functions
    functions = np.zeros((*shape, packed.channels, wanted.weights.size), dtype=np.float32)
    zeros = np.zeros((shape[0], wanted.functions - 1), dtype=np.float32)
    vertices = np.zeros((packed.vertex_count, wanted.functions), dtype=np.uint8)
    vertices[~active, -1] = len(clusters)
    lost, total = DegreeEnergies(packed.bandlimit), DegreeEnergies(packed.bandlimit)
    for cluster in clusters:
        total.add(cluster.values, cluster.functions)
    planes = [LocalAxes.of(cluster.values, wanted.functions - 1) for cluster in clusters]
    left = sum(float(plane.residuals(own.values).sum()) for plane, own in zip(planes, clusters, strict=True))
    whole = sum(float(np.vdot(own.values, own.values)) for own in clusters)
    step = _function_step(max(left, _LEAST_LEFT * whole), packed, wanted.weights)
    for c, (plane, cluster) in enumerate(zip(planes, clusters, strict=True)):
        coefficients, own_zeros, scales = to_bytes((cluster.values - plane.mean) @ plane.axes, wanted.bits)
        exact = np.concatenate([plane.mean[None], (plane.axes * scales).T]).astype(np.float64)
        rounded = round_functions(exact @ cluster.functions, step)
        used = len(scales)
        vertices[cluster.members, :used] = coefficients
        vertices[cluster.members, -1] = c
        functions[c, : used + 1] = rounded.reshape(used + 1, packed.channels, -1)
        zeros[c, :used] = own_zeros
        along = np.ones((len(cluster.values), used + 1), dtype=np.float32)
        along[:, 1:] = coefficients / np.float32(LARGEST) - own_zeros
        # What is left along the functions of the cluster, and what rounding turned out of them.
        repeated = np.tile(wanted.weights, packed.channels)
        inside = (rounded * repeated) @ (cluster.functions * repeated).T
        rest = cluster.values - along @ inside.astype(np.float32)
        outside = inside @ cluster.functions - rounded
        lost.add(np.concatenate([rest, along], axis=1), np.concatenate([cluster.functions, outside]))
    return GpuTransfer(
        bandlimit=packed.bandlimit,
        vertices=vertices,
        functions=functions,
        zeros=zeros,
        expected=Expectation(lost.sums, total.sums),
        of_file=packed.expected,
    )


def _function_step(left: float, packed: CompressedTransfer, weights: NDArray[np.float64]) -> float:
    """What functions may be rounded to, for a small part of the squared error that is left (weighted)."""
    # Half of what the rounding of K functions makes is that of the mean: coefficients are small against their range.
    per_unit = 2.0 * packed.vertex_count * packed.channels * float(weights @ weights) / 12.0
    return math.sqrt(_ROUNDING_PART * left / per_unit)
