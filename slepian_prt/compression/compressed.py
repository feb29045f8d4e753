"""Compressed transfer: reconstructed, relit, written to a file and read again."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression import archive
from slepian_prt.compression.bases import LinearBasis, shared_half_angle
from slepian_prt.compression.clustering import Clusters, clusters_of_sites, enclosed
from slepian_prt.compression.codec import caps as codec
from slepian_prt.compression.codec.surface import surface_of
from slepian_prt.compression.operator import Factors, TransferOperator, without_the_least
from slepian_prt.compression.packing import pack_radial, unpack_radial
from slepian_prt.compression.pilot import MeanTransfer, channel_mixing
from slepian_prt.compression.prediction import Expectation
from slepian_prt.errors import UserError
from slepian_prt.lighting.spectrum import falling_prior, light_power
from slepian_prt.scene.mesh import Mesh
from slepian_prt.scene.receivers import morton
from slepian_prt.scene.scene import Part
from slepian_prt.scene.view import View
from slepian_prt.slepian.concentration import cap_basis, scatter_radial
from slepian_prt.sphere.caps import Cap
from slepian_prt.sphere.harmonics import degrees, num_coefficients
from slepian_prt.sphere.rotation import rotate_sh, rotation_to
from slepian_prt.transport.effects import Effect

# Relit are functions that leave out no more than this part of the error of coded transfer.
_LEFT_OUT = 0.01

# The mean transfer of a cap is held by as many functions as leave out less than this part of it.
_MEAN_LEFT_OUT = 1e-5


@dataclass(frozen=True)
class Coded:
    """Coefficients as they are in the file.

    Attributes
    ----------
    tuning : codec.Tuning
    words : tuple of (n,) uint32
        Of each cap.
    """

    tuning: codec.Tuning
    words: tuple[NDArray[np.uint32], ...]


class CapCoefficients(NamedTuple):
    """One cap's coefficients as numbers.

    Attributes
    ----------
    values : (n, A) float32
        In the order of the cap's members.
    axes : (A, K channels) or None
        Rows that turn them into coefficients of the cap's basis; None if that is what they are.
    """

    values: NDArray[np.float32]
    axes: NDArray[np.float64] | None


@dataclass(frozen=True, kw_only=True)
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
    coefficients : tuple of (n_c, K_c channels) float16 or float32 arrays
        In the order of ``clusters.members``; empty if coded.
    coded : Coded or None
    mean : MeanTransfer or None
        What the coefficients are added to, told by the normal alone.
    terms : float
        Mean number of functions per vertex, the mean of ``pca`` counted as one; if coded, those that are used.
    prior : str
        Name of the light prior, if any.
    expected : Expectation
        What the pilot lets expect to be lost, in each degree; of coded coefficients, what rounding lost is in it.
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
    verified : dict of str to float
        Where a goal was set: relative RMS errors of relit radiance, measured on vertices held out, by light.
    """

    mesh: Mesh
    parts: tuple[Part, ...]
    bandlimit: int
    basis: str
    bases: tuple[LinearBasis, ...]
    clusters: Clusters
    channels: int
    coefficients: tuple[NDArray, ...] = ()
    coded: Coded | None = None
    mean: MeanTransfer | None = None
    terms: float
    prior: str = ""
    expected: Expectation
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
    verified: dict[str, float] = field(default_factory=dict)

    @property
    def coding(self) -> str:
        """coded, float16 or float32."""
        return "coded" if self.coded is not None else str(self.coefficients[0].dtype)

    @property
    def predicted_error(self) -> float:
        """Expected relative RMS error of the transfer vectors, or of radiance under white light."""
        return self.expected.relative()

    @property
    def predicted_error_under_prior(self) -> float | None:
        """The same under light of the prior, which is what a tolerance is about; None without one."""
        weights = self.bases[0].weights
        return None if weights is None else self.expected.relative(weights**2)

    def predicted_relit_error(self, lighting: NDArray | None = None) -> float:
        """Expected relative RMS error of radiance, averaged over the rotations of the light.

        Parameters
        ----------
        lighting : (3, (L+1)²), optional
            By default light that falls as 1/(l+1)².
        """
        power = falling_prior(self.bandlimit).weights ** 2 if lighting is None else light_power(lighting)
        return self.expected.relative(power)

    @cached_property
    def bytes_per_vertex(self) -> float:
        """Bytes in the file per vertex for coefficients, bases, caps and cluster indices; the mesh is not counted."""
        return archive.encoded_size(self._transfer_arrays()) / len(self.mesh.positions)

    # --- Use ---------------------------------------------------------------------------------------------------------

    def reconstruct(self, vertices: NDArray[np.integer] | None = None) -> NDArray[np.float32]:
        """Transfer vectors as the file has them: (V, (L+1)²), or (V, 3, (L+1)²) with three channels.

        Of some ``vertices`` alone, in their order, if they are given.
        """
        count, size = len(self.mesh.positions), num_coefficients(self.bandlimit)
        wanted = np.arange(count) if vertices is None else np.asarray(vertices)
        vectors = np.zeros((wanted.size, self.channels, size), dtype=np.float32)
        mixing = channel_mixing(self.channels)
        decoded = self.__dict__.get("_decoded")
        caps = self.clusters.index[wanted]
        for c in np.unique(caps[self.mesh.receivers.active[wanted]]):
            members, basis = self.clusters.members[c], self.bases[c]
            rows = np.flatnonzero((caps == c) & self.mesh.receivers.active[wanted])
            found = self.cap(int(c))[1] if decoded is None else decoded[c]
            values = found.values[np.searchsorted(members, wanted[rows])]
            if found.axes is not None:
                values = values @ found.axes.astype(np.float32)
            mixed = basis.reconstruct(values, self.channels)
            if self.mean is not None:
                mixed[:, 0] += self.mean.vectors(self._axes[wanted[rows]], int(self.clusters.kinds[c]))
            vectors[rows] = mixed if self.channels == 1 else np.einsum("dc,ndm->ncm", mixing, mixed)
        return vectors[:, 0] if self.channels == 1 else vectors

    def radiance(self, lighting: NDArray) -> NDArray[np.float32]:
        """(V, 3) outgoing radiance under lighting (3, (L+1)²), straight from the coefficients."""
        return self.operator.apply(lighting[None])[0] * self.mesh.albedo

    @cached_property
    def operator(self) -> TransferOperator:
        """What lighting is multiplied with for unit albedo; made at the first use.

        Of coded transfer, functions are left out that hold less than a hundredth of its error.
        """
        parts = [self._factors(c, found) for c, found in enumerate(self._decoded)]
        if self.coded is not None:
            prior, error = self.bases[0].weights, self.predicted_error_under_prior
            weights = np.ones(num_coefficients(self.bandlimit)) if prior is None else prior[degrees(self.bandlimit)]
            parts = without_the_least(parts, weights, _LEFT_OUT * (self.predicted_error if error is None else error))
        self.__dict__.pop("_decoded")  # as large as what was made of it
        return TransferOperator(parts, self.clusters.members)

    def _factors(self, c: int, found: CapCoefficients) -> Factors:
        """One cap's coefficients and the functions they belong to, the mean transfer among them."""
        basis, size = self.bases[c], num_coefficients(self.bandlimit)
        # One channel stands for all three; three are mixed back.
        mixing = np.ones((1, 1)) if self.channels == 1 else channel_mixing(3).astype(np.float64)
        functions = np.einsum("km,dc->kdcm", basis.synthesis, mixing).reshape(-1, self.channels * size)
        if found.axes is not None:
            functions = found.axes @ functions
        columns = [found.values]
        if basis.mean is not None:
            mean = np.einsum("dm,dc->cm", basis.mean.astype(np.float64), mixing).reshape(1, -1)
            functions = np.concatenate([functions, mean])
            columns.append(np.ones((len(found.values), 1), dtype=np.float32))
        if self.mean is not None:
            model, along = self._mean_factors(c)
            functions = np.concatenate([functions, np.einsum("km,c->kcm", model, mixing[0]).reshape(len(model), -1)])
            columns.append(along)
        values = np.concatenate(columns, axis=1)
        values[~self.mesh.receivers.active[self.clusters.members[c]]] = 0.0
        return Factors(values, functions.reshape(-1, self.channels, size))

    @cached_property
    def turned(self) -> tuple[bool, ...]:
        """Which caps are coded along their principal axes."""
        return tuple(found.axes is not None for found in self._decoded)

    def cap(self, number: int) -> tuple[NDArray[np.int64], CapCoefficients]:
        """One cap's vertices and coefficients, the others left alone."""
        members = self.clusters.members[number]
        if self.coded is None:
            return members, CapCoefficients(self.coefficients[number].astype(np.float32), None)
        surface = surface_of(self.mesh).cap(members)
        components = self.bases[number].count * self.channels
        decoded = codec.decode_cap(self.coded.words[number], components, surface, self.coded.tuning)
        return members, self._of_members(number, decoded)

    def _of_members(self, number: int, decoded: codec.DecodedCap) -> CapCoefficients:
        """From the order of coding to that of the cap's members."""
        assert self.coded is not None
        members = self.clusters.members[number]
        values = np.empty(decoded.multiples.shape, dtype=np.float32)
        places = np.searchsorted(members, surface_of(self.mesh).cap(members).order)
        values[places] = decoded.multiples * (self.coded.tuning.step / codec.PARTS)
        return CapCoefficients(values, decoded.axes)

    def knowing(self, decoded: Sequence[codec.DecodedCap]) -> CompressedTransfer:
        """The same; what was coded is known, so that it need not be decoded."""
        self.__dict__["_decoded"] = [self._of_members(c, cap) for c, cap in enumerate(decoded)]
        return self

    @cached_property
    def _decoded(self) -> list[CapCoefficients]:
        return [self.cap(c)[1] for c in range(len(self.bases))]

    @cached_property
    def _axes(self) -> NDArray[np.float64]:
        """Normals as the file has them."""
        return self.mesh.normals.astype(np.float32).astype(np.float64)

    def _mean_factors(self, c: int) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """The mean transfer of a cluster as few functions (k, (L+1)²) and coefficients (n, k) of them.

        R_n t̄ over a cap of normals lies in the span of what concentrates the kernel t̄ on it.
        """
        assert self.mean is not None
        members, kind, cap = self.clusters.members[c], int(self.clusters.kinds[c]), self._normal_caps[c]
        half_angle = shared_half_angle(cap.half_angle)
        if (kind, half_angle) not in self._mean_functions:
            basis = cap_basis(self.bandlimit, half_angle, kernel=self.mean.zonal[kind].astype(np.float64))
            left = np.cumsum(basis.eigenvalues[::-1])[::-1]
            count = max(1, int(np.sum(left > _MEAN_LEFT_OUT**2 * left[0])))
            self._mean_functions[kind, half_angle] = scatter_radial(basis.radial[:count], basis.orders[:count])
        model = rotate_sh(self._mean_functions[kind, half_angle], rotation_to(cap.center))
        along = np.empty((members.size, len(model)), dtype=np.float32)
        for begin in range(0, members.size, 8192):
            block = slice(begin, begin + 8192)
            along[block] = self.mean.vectors(self._axes[members[block]], kind) @ model.T.astype(np.float32)
        return model, along

    @cached_property
    def _mean_functions(self) -> dict[tuple[int, float], NDArray[np.float64]]:
        """Functions of the mean transfer about the pole, by kind and half-angle, as they are needed."""
        return {}

    @cached_property
    def _normal_caps(self) -> tuple[Cap, ...]:
        """Caps of the clusters' normals; those of the clusters only if normals are what was grouped."""
        if self.clusters.sites is not None:
            return self.clusters.caps
        return enclosed(self.clusters.index, len(self.clusters.caps), self._axes).caps

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
            "step": 0.0 if self.coded is None else self.coded.tuning.step,
            "terms": self.terms,
            "prior": self.prior,
            "parts": [[part.name, part.first, part.count] for part in self.parts],
            "name": self.mesh.name,
            "notes": list(self.mesh.notes),
            "expected_lost": self.expected.lost.tolist(),
            "expected_total": self.expected.total.tolist(),
            "effects": [effect.as_dict() for effect in self.effects],
            "samples": self.samples,
            "seed": self.seed,
            "rays_traced": self.rays_traced,
            "seconds": self.seconds,
            "source": self.source,
            "view": None if self.view is None else self.view.as_dict(),
            "toward_view": self.toward_view,
            "verified": self.verified,
            "written_by": f"slepian_prt {version('slepian_prt')}",
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
        arrays = _cluster_arrays(self.clusters, self.mesh, self.coded is not None)
        if self.coded is not None:
            arrays |= _coded_arrays(self.coded)
        else:
            arrays["coefficients"] = np.concatenate([values.ravel() for values in self.coefficients])
        counts = np.array([basis.count for basis in self.bases], dtype=np.uint16)
        if np.ptp(counts) or self.coded is None:
            arrays["caps/terms"] = counts
        else:
            arrays["caps/terms"] = counts[:1]
        if self.bases[0].radial is not None:
            arrays |= pack_radial(self.bases)
        for name in ("dense", "mean"):
            parts = [getattr(basis, name) for basis in self.bases]
            if parts[0] is not None:
                arrays[f"basis/{name}"] = np.concatenate([np.atleast_1d(part).ravel() for part in parts])
        if self.bases[0].weights is not None:
            arrays["basis/weights"] = self.bases[0].weights
        if self.mean is not None:
            arrays["mean/zonal"] = self.mean.zonal
        return arrays


def _cluster_arrays(clusters: Clusters, mesh: Mesh, by_site: bool) -> dict[str, NDArray]:
    """Which vertex belongs where, and the frames of the caps."""
    arrays: dict[str, NDArray] = {}
    if clusters.sites is not None:
        arrays["clusters/sites"] = clusters.sites
    else:
        # Along the surface neighbours mostly are of one cluster, which deflates well.
        along = np.argsort(morton(mesh.positions), kind="stable")
        arrays["clusters/index"] = clusters.index[along].astype(np.uint8 if len(clusters.caps) <= 256 else np.uint16)
        if clusters.kinds.any():
            arrays["clusters/kinds"] = clusters.kinds.astype(np.uint8)
    if not (by_site and clusters.sites is not None):
        arrays["caps/center"] = np.array([cap.center for cap in clusters.caps])
        arrays["caps/half_angle"] = np.array([cap.half_angle for cap in clusters.caps])
    return arrays


def _coded_arrays(coded: Coded) -> dict[str, NDArray]:
    checksums = [[words.size, zlib.crc32(words.astype("<u4").tobytes())] for words in coded.words]
    return {
        "coded/words": np.concatenate([np.zeros(0, dtype=np.uint32), *coded.words]),
        "coded/caps": np.array(checksums, dtype=np.uint32),
        "coded/shrink": coded.tuning.shrink,
        "coded/models": coded.tuning.models,
    }


def load(path: str | Path) -> CompressedTransfer:
    """Read a ``.prt`` file.

    Raises
    ------
    UserError
        Missing, foreign, cut short, damaged, or from another version.
    """
    manifest, arrays = archive.read(path)
    try:
        packed = _from_archive(manifest, arrays)
        packed._decoded  # noqa: B018 - now, so that damage is found here
    except (KeyError, ValueError, IndexError, TypeError, AssertionError) as error:
        raise UserError(f"{path}: its contents do not fit together ({error!r}); precompute it again") from None
    return packed


def _from_archive(manifest: dict[str, Any], arrays: dict[str, NDArray]) -> CompressedTransfer:
    bandlimit, channels = int(manifest["bandlimit"]), int(manifest["channels"])
    mesh = Mesh(
        manifest["name"],
        arrays["mesh/positions"],
        arrays["mesh/normals"].astype(np.float64),
        arrays["mesh/faces"],
        arrays["mesh/albedo"],
        tuple(manifest["notes"]),
    )
    clusters = _clusters(arrays, mesh)
    terms = np.broadcast_to(arrays["caps/terms"].astype(np.int64), len(clusters.caps))
    bases = _bases(arrays, clusters, terms, bandlimit, channels, manifest["coding"] == "coded")
    coded: Coded | None = None
    coefficients: tuple[NDArray, ...] = ()
    if manifest["coding"] == "coded":
        coded = _coded(arrays, float(manifest["step"]), len(bases))
    else:
        lengths = clusters.sizes * terms * channels
        if lengths.sum() != arrays["coefficients"].size:
            raise ValueError("number of coefficients")
        pieces = np.split(arrays["coefficients"], np.cumsum(lengths)[:-1])
        coefficients = tuple(
            piece.reshape(n, k) for piece, n, k in zip(pieces, clusters.sizes, terms * channels, strict=True)
        )
    return CompressedTransfer(
        mesh=mesh,
        parts=tuple(Part(name, first, number) for name, first, number in manifest["parts"]),
        bandlimit=bandlimit,
        basis=manifest["basis"],
        bases=bases,
        clusters=clusters,
        channels=channels,
        coefficients=coefficients,
        coded=coded,
        mean=MeanTransfer(arrays["mean/zonal"]) if "mean/zonal" in arrays else None,
        terms=float(manifest["terms"]),
        prior=manifest["prior"],
        expected=Expectation(np.array(manifest["expected_lost"]), np.array(manifest["expected_total"])),
        effects=tuple(Effect(**effect) for effect in manifest["effects"]),
        bounces=int(manifest["bounces"]),
        samples=int(manifest["samples"]),
        seed=int(manifest["seed"]),
        rays_traced=int(manifest["rays_traced"]),
        seconds=dict(manifest["seconds"]),
        source=manifest["source"],
        lighting=arrays.get("environment/lighting"),
        view=None if manifest["view"] is None else View(**manifest["view"]),
        toward_view=bool(manifest["toward_view"]),
        verified=dict(manifest.get("verified", {})),
    )


def _clusters(arrays: dict[str, NDArray], mesh: Mesh) -> Clusters:
    caps: tuple[Cap, ...] = ()
    if "caps/center" in arrays:
        pairs = zip(arrays["caps/center"], arrays["caps/half_angle"], strict=True)
        caps = tuple(Cap(center, float(half_angle)) for center, half_angle in pairs)
    if "clusters/sites" in arrays:
        found = clusters_of_sites(arrays["clusters/sites"], mesh.normals)
        return Clusters(found.index, caps or found.caps, sites=found.sites)
    index = np.empty(len(mesh.positions), dtype=np.int32)
    index[np.argsort(morton(mesh.positions), kind="stable")] = arrays["clusters/index"]
    if index.max() >= len(caps):
        raise ValueError("index of a cluster")
    return Clusters(index, caps, arrays.get("clusters/kinds", np.zeros(0)).astype(np.int32))


def _bases(
    arrays: dict[str, NDArray], clusters: Clusters, terms: NDArray, bandlimit: int, channels: int, coded: bool
) -> tuple[LinearBasis, ...]:
    size = num_coefficients(bandlimit)
    starts = np.cumsum(terms)[:-1]
    unknown: list[Any] = [None] * len(terms)
    orders, radial = unpack_radial(arrays, terms, bandlimit) if "radial/order" in arrays else (unknown, unknown)
    dense = np.split(arrays["basis/dense"].reshape(-1, size), starts) if "basis/dense" in arrays else unknown
    mean = list(arrays["basis/mean"].reshape(-1, channels, size)) if "basis/mean" in arrays else unknown
    weights = arrays.get("basis/weights")
    frames = frames_of(clusters) if coded else np.array([cap.center for cap in clusters.caps])
    return tuple(
        LinearBasis(frame, bandlimit, int(k), m, r, d, t, weights)
        for frame, k, m, r, d, t in zip(frames, terms, orders, radial, dense, mean, strict=True)
    )


def frames_of(clusters: Clusters) -> NDArray[np.float64]:
    """(n, 3) axes of the frames that coded bases stand in: the sites, which files hold, or else the caps' centres."""
    if clusters.sites is None:
        return np.array([cap.center for cap in clusters.caps])
    sites = clusters.sites.astype(np.float64)
    return np.asarray(sites / np.linalg.norm(sites, axis=1, keepdims=True))


def _coded(arrays: dict[str, NDArray], step: float, caps: int) -> Coded:
    lengths = arrays["coded/caps"][:, 0].astype(np.int64)
    words = np.split(arrays["coded/words"], np.cumsum(lengths)[:-1])
    if lengths.sum() != arrays["coded/words"].size or len(words) != caps:
        raise ValueError("number of words")
    for part, checksum in zip(words, arrays["coded/caps"][:, 1].tolist(), strict=True):
        if zlib.crc32(part.astype("<u4").tobytes()) != checksum:
            raise ValueError("checksum of a cap")
    models = arrays["coded/models"]
    if models.shape != (codec.CONTEXTS,) or models.max() >= codec.MODELS:
        raise ValueError("entropy models")
    return Coded(codec.Tuning(step, arrays["coded/shrink"], models), tuple(words))
