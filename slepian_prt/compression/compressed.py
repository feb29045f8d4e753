"""Compressed transfer: made from transfer vectors, reconstructed, and written to a file."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import slepian_prt
from slepian_prt.compression import archive, codec, truncation
from slepian_prt.compression.bases import (
    BASES,
    Candidate,
    LinearBasis,
    Problem,
    candidates,
    channel_mixing,
    pack_radial,
    unpack_radial,
)
from slepian_prt.compression.clusters import Clusters, cluster_normals
from slepian_prt.errors import UserError, check_bandlimit, check_epsilon, check_terms
from slepian_prt.scene.cameras import View
from slepian_prt.scene.environments import project_environment
from slepian_prt.scene.meshes import Mesh
from slepian_prt.scene.scenes import Part
from slepian_prt.sphere.caps import Cap
from slepian_prt.sphere.harmonics import num_coefficients
from slepian_prt.transport.effects import Effect
from slepian_prt.transport.transfer import LARGEST_BANDLIMIT, Transfer

DEFAULT_CLUSTERS = 96
DEFAULT_TOLERANCE = 0.02
LARGEST_CLUSTERS = 4096
CODINGS = ("coded", "float16", "float32")

# With a given number of functions, rounding may add this part to the squared error of leaving out the others.
_ROUNDING_SHARE = 0.1
_FINEST_ROUNDING = 1e-3
_STEP_SAMPLE = 4096


@dataclass(frozen=True)
class CompressedTransfer:
    """Everything needed to relight a scene.

    Attributes
    ----------
    mesh : Mesh
    parts : tuple of Part
    bandlimit : int
    basis : str
        Name of the basis.
    bases : tuple of LinearBasis
        One per cap.
    clusters : Clusters
    channels : 1 or 3
        Of the transfer; three are stored decorrelated, see `channel_mixing`.
    coefficients : tuple of (n_c, K_c channels) arrays
        In the order of ``clusters.members``: float32 or float16, or integer multiples of ``step``.
    coding : str
        ``coded`` (rounded to multiples of ``step``, predicted and entropy-coded in the file), ``float16``, ``float32``.
    step : float
        0 unless coded.
    predicted_error : float
        Relative RMS error of the transfer vectors that the basis's own model of transport expects.
    effects : tuple of Effect
    bounces, samples, seed, rays_traced : int
    seconds : dict of str to float
    source : str
    lighting : (3, (L+1)²) or None
        Of the scene's own distant light.
    view : View or None
        The scene's camera.
    toward_view : bool
        Whether this is transfer toward that camera.
    """

    mesh: Mesh
    parts: tuple[Part, ...]
    bandlimit: int
    basis: str
    bases: tuple[LinearBasis, ...]
    clusters: Clusters
    channels: int
    coefficients: tuple[NDArray, ...]
    coding: str
    step: float
    predicted_error: float
    effects: tuple[Effect, ...]
    bounces: int
    samples: int
    seed: int
    rays_traced: int
    seconds: dict[str, float] = field(default_factory=dict)
    source: str = ""
    lighting: NDArray[np.float64] | None = None
    view: View | None = None
    toward_view: bool = False

    @property
    def terms(self) -> float:
        """Mean number of functions per vertex, the mean of ``cpca`` counted as one."""
        sizes = np.array([len(c) for c in self.coefficients])
        counts = np.array([basis.count + (basis.mean is not None) for basis in self.bases])
        return float((sizes * counts).sum() / sizes.sum())

    @cached_property
    def bytes_per_vertex(self) -> float:
        """Bytes in the file per vertex for coefficients, bases, caps and cluster indices; the mesh is not counted."""
        return archive.encoded_size(self._transfer_arrays()) / len(self.mesh.positions)

    def reconstruct(self) -> NDArray[np.float32]:
        """Transfer vectors as the file has them: (V, (L+1)²), or (V, 3, (L+1)²) with three channels."""
        count, size = len(self.mesh.positions), num_coefficients(self.bandlimit)
        vectors = np.empty((count, self.channels, size), dtype=np.float32)
        mixing = channel_mixing(self.channels)
        for members, basis, values in zip(self.clusters.members, self.bases, self._values(), strict=True):
            mixed = basis.reconstruct(values, self.channels)
            vectors[members] = mixed if self.channels == 1 else np.einsum("dc,ndm->ncm", mixing, mixed)
        vectors[~self.mesh.receivers] = 0.0
        return vectors[:, 0] if self.channels == 1 else vectors

    def radiance(self, lighting: NDArray) -> NDArray[np.float32]:
        """(V, 3) outgoing radiance under lighting (3, (L+1)²), straight from the coefficients."""
        result = np.empty((len(self.mesh.positions), 3), dtype=np.float32)
        # One channel stands for all three; three are mixed back.
        mixing = np.ones((1, 3)) if self.channels == 1 else channel_mixing(3).astype(np.float64)
        for members, basis, values in zip(self.clusters.members, self.bases, self._values(), strict=True):
            functions, mean = basis.light(lighting, mixing)
            result[members] = values @ functions.astype(np.float32) + mean
        result[~self.mesh.receivers] = 0.0
        return result * self.mesh.albedo

    def _values(self) -> Iterator[NDArray[np.float32]]:
        """Coefficients of each cap as numbers."""
        scale = np.float32(self.step if self.coding == "coded" else 1.0)
        return (stored.astype(np.float32) * scale for stored in self.coefficients)

    # --- File --------------------------------------------------------------------------------------------------------

    def save(self, path: str | Path) -> None:
        """Write a ``.prt`` file: complete or not at all.

        Raises
        ------
        UserError
            The folder is missing or not writable, or the disk is full.
        """
        manifest = {
            "bandlimit": self.bandlimit,
            "channels": self.channels,
            "bounces": self.bounces,
            "basis": self.basis,
            "coding": self.coding,
            "step": self.step,
            "parts": [[part.name, part.first, part.count] for part in self.parts],
            "name": self.mesh.name,
            "notes": list(self.mesh.notes),
            "predicted_error": self.predicted_error,
            "effects": [effect.as_dict() for effect in self.effects],
            "samples": self.samples,
            "seed": self.seed,
            "rays_traced": self.rays_traced,
            "seconds": self.seconds,
            "source": self.source,
            "view": None if self.view is None else self.view.as_dict(),
            "toward_view": self.toward_view,
            "written_by": f"slepian_prt {slepian_prt.__version__}",
        }
        mesh: dict[str, NDArray] = {
            "mesh/positions": self.mesh.positions,
            "mesh/normals": self.mesh.normals.astype(np.float32),
            "mesh/faces": self.mesh.faces,
            "mesh/albedo": self.mesh.albedo,
        }
        light = {} if self.lighting is None else {"environment/lighting": self.lighting}
        archive.write(path, manifest, {**mesh, **light, **self._transfer_arrays()})

    def _transfer_arrays(self) -> dict[str, NDArray]:
        caps = self.clusters.caps
        arrays: dict[str, NDArray] = {
            "clusters/index": self.clusters.index.astype(np.uint8 if len(caps) <= 256 else np.uint16),
            "caps/center": np.array([cap.center for cap in caps]),
            "caps/half_angle": np.array([cap.half_angle for cap in caps]),
            "caps/terms": np.array([basis.count for basis in self.bases], dtype=np.uint16),
        }
        if self.coding == "coded":
            arrays |= self._coded_arrays()
        else:
            arrays["coefficients"] = np.concatenate([values.ravel() for values in self.coefficients])
        if self.bases[0].radial is not None:
            arrays |= pack_radial(self.bases)
        for name in ("dense", "mean"):
            parts = [getattr(basis, name) for basis in self.bases]
            if parts[0] is not None:
                arrays[f"basis/{name}"] = np.concatenate([np.atleast_1d(part).ravel() for part in parts])
        return arrays

    def _coded_arrays(self) -> dict[str, NDArray]:
        order, neighbours = _surface(self.mesh, self.clusters)
        quantised = [
            values[np.searchsorted(members, along)]
            for values, members, along in zip(self.coefficients, self.clusters.members, order, strict=True)
        ]
        coded = codec.encode(quantised, neighbours)
        return {
            "coded/words": np.concatenate([cap.words for cap in coded.caps]),
            "coded/lengths": np.array([cap.words.size for cap in coded.caps], dtype=np.uint32),
            "coded/classes": np.concatenate([cap.classes for cap in coded.caps]),
            "coded/escapes": np.concatenate([cap.escapes for cap in coded.caps]),
            "coded/escape_counts": np.array([cap.escapes.size for cap in coded.caps], dtype=np.uint32),
            "coded/histograms": coded.histograms,
            "coded/shrink": coded.shrink,
        }


def _surface(mesh: Mesh, clusters: Clusters) -> tuple[list[NDArray], list[Any]]:
    """Members of each cap in the order of coding, and who neighbours whom among them."""
    order = codec.surface_order(mesh.positions, clusters.members)
    pattern = codec.adjacency(mesh.faces, len(mesh.positions))
    return order, [pattern[along][:, along] for along in order]


def _decoded(arrays: dict[str, NDArray], mesh: Mesh, clusters: Clusters, widths: NDArray) -> tuple[NDArray, ...]:
    """Multiples of the step of each cap from the ``coded/`` arrays, in the order of ``clusters.members``."""
    order, neighbours = _surface(mesh, clusters)
    words = np.split(arrays["coded/words"], np.cumsum(arrays["coded/lengths"].astype(np.int64))[:-1])
    classes = np.split(arrays["coded/classes"], np.cumsum(widths)[:-1])
    escapes = np.split(arrays["coded/escapes"], np.cumsum(arrays["coded/escape_counts"].astype(np.int64))[:-1])
    caps = tuple(codec.CodedCap(*parts) for parts in zip(words, classes, escapes, strict=True))
    quantised = codec.decode(codec.Coded(caps, arrays["coded/histograms"], arrays["coded/shrink"]), neighbours)
    return tuple(q[np.argsort(along)] for q, along in zip(quantised, order, strict=True))


def load(path: str | Path) -> CompressedTransfer:
    """Read a ``.prt`` file.

    Raises
    ------
    UserError
        Missing, foreign, cut short, damaged, or from a newer version.
    """
    manifest, arrays = archive.read(path)
    try:
        return _from_archive(manifest, arrays)
    except (KeyError, ValueError, IndexError, TypeError) as error:
        raise UserError(f"{path}: its contents do not fit together ({error!r}); precompute it again") from None


def _from_archive(manifest: dict[str, Any], arrays: dict[str, NDArray]) -> CompressedTransfer:
    bandlimit = int(manifest["bandlimit"])
    size, channels = num_coefficients(bandlimit), int(manifest["channels"])
    mesh = Mesh(
        manifest["name"],
        arrays["mesh/positions"],
        arrays["mesh/normals"].astype(np.float64),
        arrays["mesh/faces"],
        arrays["mesh/albedo"],
        tuple(manifest["notes"]),
    )
    caps = tuple(Cap(c, float(a)) for c, a in zip(arrays["caps/center"], arrays["caps/half_angle"], strict=True))
    clusters = Clusters(arrays["clusters/index"].astype(np.int32), caps)
    terms = arrays["caps/terms"].astype(np.int64)
    starts = np.cumsum(terms)[:-1]
    unknown: list[Any] = [None] * len(caps)
    orders, radial = unpack_radial(arrays, terms, bandlimit) if "radial/order" in arrays else (unknown, unknown)
    dense = np.split(arrays["basis/dense"].reshape(-1, size), starts) if "basis/dense" in arrays else unknown
    mean = list(arrays["basis/mean"].reshape(-1, channels, size)) if "basis/mean" in arrays else unknown
    bases = tuple(
        LinearBasis(cap.center, bandlimit, int(k), *parts)
        for cap, k, *parts in zip(caps, terms, orders, radial, dense, mean, strict=True)
    )
    if manifest["coding"] == "coded":
        coefficients = _decoded(arrays, mesh, clusters, terms * channels)
    else:
        sizes = np.array([len(members) for members in clusters.members])
        widths = terms * channels
        lengths = sizes * widths
        if lengths.sum() != arrays["coefficients"].size:
            raise ValueError("number of coefficients")
        pieces = np.split(arrays["coefficients"], np.cumsum(lengths)[:-1])
        coefficients = tuple(piece.reshape(n, k) for piece, n, k in zip(pieces, sizes, widths, strict=True))
    return CompressedTransfer(
        mesh,
        tuple(Part(name, first, number) for name, first, number in manifest["parts"]),
        bandlimit,
        manifest["basis"],
        bases,
        clusters,
        channels,
        coefficients,
        manifest["coding"],
        float(manifest["step"]),
        float(manifest["predicted_error"]),
        tuple(Effect(**effect) for effect in manifest["effects"]),
        int(manifest["bounces"]),
        int(manifest["samples"]),
        int(manifest["seed"]),
        int(manifest["rays_traced"]),
        dict(manifest["seconds"]),
        manifest["source"],
        arrays.get("environment/lighting"),
        None if manifest["view"] is None else View(**manifest["view"]),
        bool(manifest["toward_view"]),
    )


# --- Compression -----------------------------------------------------------------------------------------------------


def compress(
    transfer: Transfer,
    basis: str = "adapted",
    *,
    tolerance: float | None = None,
    terms: int | None = None,
    truncate: str | None = None,
    epsilon: float = 0.01,
    clusters: int | Clusters = DEFAULT_CLUSTERS,
    coding: str | None = None,
) -> CompressedTransfer:
    """Cluster, project, truncate and code transfer vectors.

    Parameters
    ----------
    transfer : Transfer
    basis : one of adapted, transport, slepian, incident, sh, cpca, direct, none
        ``none`` keeps all (L+1)² spherical harmonics.
    tolerance : float > 0
        Wanted relative error of the transfer vectors; the default rule, at 0.02. Of coefficients that are ``coded``
        the rounding step meets it (functions that round to zero cost nothing); otherwise the number of functions does,
        by prediction.
    terms : int
        Instead: this many functions in each cap.
    truncate : n_g, n_ref or count
        Instead: the Shannon number of each cap, with ``epsilon``.
    clusters : int, or Clusters made before
    coding : coded, float16 or float32
        By default ``coded`` with a tolerance, and ``float32`` with a given number of functions.

    Raises
    ------
    ValueError
        An unknown name, a number outside its range, or more than one truncation rule.
    """
    by_number = basis == "none" or terms is not None or truncate is not None
    coding = coding or ("float32" if by_number else "coded")
    wanted = clusters if isinstance(clusters, int) else 1
    check_options(basis, tolerance, terms, truncate, epsilon, wanted, coding, transfer.bandlimit)
    started = time.perf_counter()
    if basis == "none":
        basis, terms, tolerance, truncate, clusters = "sh", num_coefficients(transfer.bandlimit), None, None, 1
        label = "none"
    else:
        label = basis
    if not isinstance(clusters, Clusters):
        clusters = cluster_normals(transfer.axes, clusters)
    channels = transfer.vectors.shape[1]
    problem = Problem(transfer.bandlimit, clusters, transfer.axes, transfer.vectors, transfer.seed)
    found = candidates(basis, problem)
    sizes = np.array([len(members) for members in clusters.members])
    by_rounding = coding == "coded" and not by_number
    if by_rounding:
        counts = np.array([candidate.energies.size for candidate in found])
    else:
        counts = _terms(found, clusters, transfer.bandlimit, sizes, tolerance, terms, truncate, epsilon)
    bases = tuple(candidate.cut(int(k)) for candidate, k in zip(found, counts, strict=True))
    if coding != "float32":
        bases = tuple(b.halved() for b in bases)
    predicted, step = truncation.predicted_error(found, counts, sizes), 0.0
    if coding == "coded":
        asked = DEFAULT_TOLERANCE if tolerance is None else tolerance
        rounding = max(math.sqrt(_ROUNDING_SHARE) * predicted, _FINEST_ROUNDING)
        if by_rounding:
            rounding = math.sqrt(max(asked**2 - predicted**2, 0.01 * asked**2))
        step, rounding = _rounding_step(problem, clusters, bases, rounding, transfer.seed)
        predicted = math.hypot(predicted, rounding)
        bases, coefficients = _rounded(problem, clusters, bases, step)
    else:
        kind = np.float16 if coding == "float16" else np.float32
        coefficients = tuple(
            b.project(problem.of(members)).astype(kind) for b, members in zip(bases, clusters.members, strict=True)
        )
    own = transfer.environment
    return CompressedTransfer(
        transfer.mesh,
        transfer.parts,
        transfer.bandlimit,
        label,
        bases,
        clusters,
        channels,
        coefficients,
        coding,
        step,
        predicted,
        transfer.effects,
        transfer.bounces,
        transfer.samples,
        transfer.seed,
        transfer.rays_traced,
        {**transfer.seconds, "compress": time.perf_counter() - started},
        transfer.source,
        None if own is None else project_environment(own, transfer.bandlimit),
        transfer.view,
        transfer.toward_view,
    )


def _rounding_step(
    problem: Problem, clusters: Clusters, bases: tuple[LinearBasis, ...], error: float, seed: int
) -> tuple[float, float]:
    """The step whose rounding makes a relative error of ``error``, from a sample of the vertices, and that error."""
    rng = np.random.default_rng(seed)
    chosen = np.zeros(len(problem.vectors), dtype=bool)
    chosen[rng.permutation(len(problem.vectors))[:_STEP_SAMPLE]] = True
    energy = float(np.sum(problem.vectors[chosen].astype(np.float64) ** 2))
    if energy == 0.0:
        return 1.0, 0.0  # nothing but zeros: any step does
    sampled = [
        b.project(problem.of(members[chosen[members]])) for b, members in zip(bases, clusters.members, strict=True)
    ]
    return codec.step_for(sampled, error * error * energy), error


def _rounded(
    problem: Problem, clusters: Clusters, bases: tuple[LinearBasis, ...], step: float
) -> tuple[tuple[LinearBasis, ...], tuple[NDArray, ...]]:
    """Coefficients as multiples of the step, without those last functions of each cap that round to zero everywhere."""
    kept, values = [], []
    channels = problem.vectors.shape[1]
    for basis, members in zip(bases, clusters.members, strict=True):
        quantised = codec.quantise(basis.project(problem.of(members)), step)
        used = np.flatnonzero(quantised.any(axis=0))
        count = int(used[-1]) // channels + 1 if used.size else min(1, basis.count)
        kept.append(basis.first(count))
        values.append(np.ascontiguousarray(quantised[:, : count * channels]))
    return tuple(kept), tuple(values)


def check_options(
    basis: str,
    tolerance: float | None,
    terms: int | None,
    truncate: str | None,
    epsilon: float,
    clusters: int,
    coding: str,
    bandlimit: int,
) -> None:
    """Raise UserError, before any work, if `compress` would refuse these."""
    check_bandlimit(bandlimit, largest=LARGEST_BANDLIMIT)
    rules = {"tolerance": tolerance, "terms": terms, "truncate": truncate}
    given = [name for name, value in rules.items() if value is not None]
    if len(given) > 1:
        raise UserError(f"only one of tolerance, terms and truncate may be given, not {' and '.join(given)}")
    if basis not in (*BASES, "none"):
        raise UserError(f"basis must be one of {', '.join((*BASES, 'none'))}, not {basis!r}")
    if basis == "none" and given:
        raise UserError(f"basis none keeps all functions; leave out {given[0]}, or choose another basis")
    if terms is not None:
        check_terms(terms, num_coefficients(bandlimit))
    if truncate is not None and truncate not in truncation.TRUNCATIONS:
        raise UserError(f"truncate must be one of {', '.join(truncation.TRUNCATIONS)}, not {truncate!r}")
    if tolerance is not None and not (math.isfinite(tolerance) and tolerance > 0.0):
        raise UserError(f"tolerance must be a positive number, not {tolerance!r}")
    check_epsilon(epsilon)
    if not isinstance(clusters, int | np.integer) or not 1 <= clusters <= LARGEST_CLUSTERS:
        raise UserError(f"clusters must be an integer in [1, {LARGEST_CLUSTERS}], not {clusters!r}")
    if coding not in CODINGS:
        raise UserError(f"coding must be one of {', '.join(CODINGS)}, not {coding!r}")


def _terms(
    found: list[Candidate],
    clusters: Clusters,
    bandlimit: int,
    sizes: NDArray,
    tolerance: float | None,
    terms: int | None,
    truncate: str | None,
    epsilon: float,
) -> NDArray[np.int64]:
    if terms is not None:
        return truncation.by_terms(found, terms)
    if truncate is not None:
        return truncation.by_shannon(found, clusters.caps, bandlimit, truncate, epsilon)
    return truncation.by_tolerance(found, sizes, DEFAULT_TOLERANCE if tolerance is None else tolerance)
