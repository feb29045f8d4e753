"""The ``.prt`` file: compressed transfer as a manifest and arrays, and back; docs/file-format.md describes it."""

from __future__ import annotations

import zlib
from dataclasses import astuple
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression import container
from slepian_prt.compression.clustering import Clusters, clusters_of_sites, frames_of
from slepian_prt.compression.codec.entropy import MODELS
from slepian_prt.compression.codec.prediction import CONTEXTS, Coded, Tuning
from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.decoder import decode_all
from slepian_prt.compression.file_size import remember_size
from slepian_prt.compression.film_packing import pack_film, unpack_film
from slepian_prt.compression.lamp_packing import pack_lamps, unpack_lamps
from slepian_prt.compression.linear_basis import LinearBasis
from slepian_prt.compression.packing import pack_radial, unpack_radial
from slepian_prt.compression.pilot import MeanTransfer
from slepian_prt.compression.prediction import Expectation
from slepian_prt.compression.stored_mesh.stored import (
    StoredMesh,
    pack_order,
    read_stored,
    sizes_of_parts,
    unpack_order,
)
from slepian_prt.compression.vertex_order import in_file_order, in_source_order
from slepian_prt.errors import UserError
from slepian_prt.scene.film import Film
from slepian_prt.scene.mesh import Mesh
from slepian_prt.scene.receivers import morton
from slepian_prt.scene.scene import Part
from slepian_prt.scene.view import View
from slepian_prt.sphere.caps import Cap
from slepian_prt.sphere.harmonics import num_coefficients
from slepian_prt.transport.effects import Effect


def save(packed: CompressedTransfer, path: str | Path, *, keep_order: bool = False) -> None:
    """Write a ``.prt`` file: complete or not at all; see `CompressedTransfer.save`.

    Raises
    ------
    UserError
        The folder is missing or not writable, or the disk is full.
    """
    remember_size(packed, container.write(path, *content_of(packed, keep_order=keep_order)))


def content_of(packed: CompressedTransfer, *, keep_order: bool = False) -> tuple[dict[str, Any], dict[str, NDArray]]:
    """The manifest and the arrays of a file."""
    stored, packed = packed.stored, in_file_order(packed)
    manifest: dict[str, Any] = {
        "bandlimit": packed.bandlimit,
        "channels": packed.channels,
        "bounces": packed.bounces,
        "basis": packed.basis,
        "coding": packed.coding,
        "step": 0.0 if packed.coded is None else packed.coded.tuning.step,
        "terms": packed.terms,
        "prior": packed.prior,
        "parts": [list(astuple(part)) for part in packed.parts],
        "name": packed.mesh.name,
        "notes": list(packed.mesh.notes),
        "expected_lost": packed.expected.lost.tolist(),
        "expected_total": packed.expected.total.tolist(),
        "effects": [effect.as_dict() for effect in packed.effects],
        "samples": packed.samples,
        "seed": packed.seed,
        "rays_traced": packed.rays_traced,
        "seconds": packed.seconds,
        "source": packed.source,
        "parameters": dict(packed.parameters),
        "view": None if packed.view is None else packed.view.as_dict(),
        "toward_view": packed.toward_view,
        "verified": packed.verified,
        "verified_vertices": packed.verified_vertices,
        "verified_left_out": packed.verified_left_out,
        "written_by": f"slepian_prt {version('slepian_prt')}",
    }
    if packed.film is not None:
        manifest["film"], mesh = pack_film(packed.film, packed.mesh)
    else:
        assert stored is not None
        manifest["mesh"], mesh = stored.entry, dict(stored.arrays)
        if keep_order:
            mesh |= pack_order(stored.order, packed.mesh)
    light: dict[str, NDArray] = {} if packed.lighting is None else {"environment/lighting": packed.lighting}
    if packed.fixed is not None:
        manifest["fixed"], lamps = pack_lamps(packed.fixed)
        light |= lamps
    if packed.path_noise is not None:
        manifest["noise"] = packed.path_noise
    return manifest, {**mesh, **light, **_transfer_arrays(packed)}


def load(path: str | Path) -> CompressedTransfer:
    """Read a ``.prt`` file.

    Raises
    ------
    UserError
        Missing, foreign, cut short, damaged, or from another version.
    """
    manifest, arrays = container.read(path)
    try:
        packed = _from_arrays(manifest, arrays)
        decode_all(packed)  # now, so that damage is found here
    except (KeyError, ValueError, IndexError, TypeError, AssertionError) as error:
        raise UserError(f"{path}: its contents do not fit together ({error!r}); precompute it again") from None
    remember_size(packed, container.member_sizes(path))
    return packed


def _transfer_arrays(packed: CompressedTransfer) -> dict[str, NDArray]:
    arrays = _cluster_arrays(packed.clusters, packed.mesh, packed.coded is not None)
    if packed.coded is not None:
        arrays |= _coded_arrays(packed.coded)
    else:
        arrays["coefficients"] = np.concatenate([values.ravel() for values in packed.coefficients])
    counts = np.array([basis.count for basis in packed.bases], dtype=np.uint16)
    if np.ptp(counts) or packed.coded is None:
        arrays["caps/terms"] = counts
    else:
        arrays["caps/terms"] = counts[:1]
    if packed.bases[0].radial is not None:
        arrays |= pack_radial(packed.bases)
    for name in ("dense", "mean"):
        parts = [getattr(basis, name) for basis in packed.bases]
        if parts[0] is not None:
            arrays[f"basis/{name}"] = np.concatenate([np.atleast_1d(part).ravel() for part in parts])
    if packed.bases[0].weights is not None:
        arrays["basis/weights"] = packed.bases[0].weights
    if packed.mean is not None:
        arrays["mean/zonal"] = packed.mean.zonal
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
        if clusters.occlusion_classes.any():
            arrays["clusters/kinds"] = clusters.occlusion_classes.astype(np.uint8)
    if not (by_site and clusters.sites is not None):
        arrays["caps/center"] = np.array([cap.center for cap in clusters.caps])
        arrays["caps/half_angle"] = np.array([cap.half_angle for cap in clusters.caps])
    return arrays


def _coded_arrays(coded: Coded) -> dict[str, NDArray]:
    checksums = [[words.size, zlib.crc32(words.astype("<u4").tobytes())] for words in coded.words]
    return {
        "coded/words": np.concatenate([np.zeros(0, dtype=np.uint32), *coded.words]),
        "coded/caps": np.array(checksums, dtype=np.uint32),
        "coded/shrink": coded.tuning.gains,
        "coded/models": coded.tuning.models,
    }


def _from_arrays(manifest: dict[str, Any], arrays: dict[str, NDArray]) -> CompressedTransfer:
    bandlimit, channels = int(manifest["bandlimit"]), int(manifest["channels"])
    film, mesh, stored = _film_and_mesh(manifest, arrays)
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
    packed = CompressedTransfer(
        mesh=mesh,
        stored=stored,
        parts=tuple(Part(*part) for part in manifest["parts"]),
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
        path_noise=manifest.get("noise"),
        seconds=dict(manifest["seconds"]),
        source=manifest["source"],
        parameters=dict(manifest.get("parameters", {})),
        lighting=arrays.get("environment/lighting"),
        view=None if manifest["view"] is None else View(**manifest["view"]),
        toward_view=bool(manifest["toward_view"]),
        fixed=unpack_lamps(manifest.get("fixed"), arrays, len(mesh.positions)),
        film=film,
        verified=dict(manifest.get("verified", {})),
        verified_vertices=int(manifest.get("verified_vertices", 0)),
        verified_left_out=dict(manifest.get("verified_left_out", {})),
    )
    if "mesh/order" not in arrays:
        return packed
    return in_source_order(packed, unpack_order(arrays["mesh/order"]))


def _film_and_mesh(manifest: dict[str, Any], arrays: dict[str, NDArray]) -> tuple[Film | None, Mesh, StoredMesh | None]:
    name, notes = manifest["name"], tuple(manifest["notes"])
    if "film" in manifest:
        return *unpack_film(manifest["film"], arrays, name, notes), None
    stored = read_stored(manifest["mesh"], arrays, name, notes)
    if sizes_of_parts(stored.entry) != [(part[2], part[3]) for part in manifest["parts"]]:
        raise ValueError("parts of the mesh")
    return None, stored.mesh, stored


def _clusters(arrays: dict[str, NDArray], mesh: Mesh) -> Clusters:
    caps: tuple[Cap, ...] = ()
    if "caps/center" in arrays:
        pairs = zip(arrays["caps/center"], arrays["caps/half_angle"], strict=True)
        caps = tuple(Cap(center, float(half_angle)) for center, half_angle in pairs)
    if "clusters/sites" in arrays:
        found = clusters_of_sites(arrays["clusters/sites"], mesh.normals)
        return Clusters.of_one_class(found.index, caps or found.caps, found.sites)
    index = np.empty(len(mesh.positions), dtype=np.int32)
    index[np.argsort(morton(mesh.positions), kind="stable")] = arrays["clusters/index"]
    if index.max() >= len(caps):
        raise ValueError("index of a cluster")
    if "clusters/kinds" not in arrays:
        return Clusters.of_one_class(index, caps)
    if len(arrays["clusters/kinds"]) != len(caps):
        raise ValueError("classes of clusters")
    return Clusters(index, caps, arrays["clusters/kinds"].astype(np.int32))


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


def _coded(arrays: dict[str, NDArray], step: float, caps: int) -> Coded:
    lengths = arrays["coded/caps"][:, 0].astype(np.int64)
    words = np.split(arrays["coded/words"], np.cumsum(lengths)[:-1])
    if lengths.sum() != arrays["coded/words"].size or len(words) != caps:
        raise ValueError("number of words")
    for part, checksum in zip(words, arrays["coded/caps"][:, 1].tolist(), strict=True):
        if zlib.crc32(part.astype("<u4").tobytes()) != checksum:
            raise ValueError("checksum of a cap")
    models = arrays["coded/models"]
    if models.shape != (CONTEXTS,) or models.max() >= MODELS:
        raise ValueError("entropy models")
    return Coded(Tuning(step, arrays["coded/shrink"], models), tuple(words))
