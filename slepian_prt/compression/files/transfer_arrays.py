"""Coefficients, bases and caps as arrays of a file."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.clustering import Clusters, clusters_of_sites, frames_of
from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.files.coded_packing import pack_coded, unpack_coded
from slepian_prt.compression.files.radial_packing import pack_radial, unpack_radial
from slepian_prt.compression.linear_basis import LinearBasis
from slepian_prt.compression.pilot import MeanTransfer
from slepian_prt.scene.mesh import Mesh
from slepian_prt.scene.receivers import morton
from slepian_prt.sphere.caps import Cap
from slepian_prt.sphere.harmonics import num_coefficients


def pack_transfer(packed: CompressedTransfer) -> dict[str, NDArray]:
    """Arrays that hold coefficients, bases and caps."""
    arrays = _cluster_arrays(packed.clusters, packed.mesh, packed.coded is not None)
    if packed.coded is not None:
        arrays |= pack_coded(packed.coded)
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


def unpack_transfer(manifest: dict[str, Any], arrays: dict[str, NDArray], mesh: Mesh) -> dict[str, Any]:
    """Fields of a `CompressedTransfer` from what `pack_transfer` packed.

    Raises
    ------
    ValueError
        Another number of coefficients than the vertices of the caps have, or a checksum that is another.
    """
    bandlimit, channels, is_coded = manifest["bandlimit"], manifest["channels"], manifest["coding"] == "coded"
    clusters = _clusters(arrays, mesh)
    terms = np.broadcast_to(arrays["caps/terms"].astype(np.int64), len(clusters.caps))
    fields = {
        "clusters": clusters,
        "bases": _bases(arrays, clusters, terms, bandlimit, channels, is_coded),
        "mean": MeanTransfer(arrays["mean/zonal"]) if "mean/zonal" in arrays else None,
    }
    if is_coded:
        return {**fields, "coded": unpack_coded(arrays, manifest["step"], len(terms)), "coefficients": ()}
    return {**fields, "coded": None, "coefficients": _plain(arrays["coefficients"], clusters.sizes, terms * channels)}


def _plain(values: NDArray, sizes: NDArray[np.int64], widths: NDArray[np.int64]) -> tuple[NDArray, ...]:
    lengths = sizes * widths
    if lengths.sum() != values.size:
        raise ValueError("number of coefficients")
    pieces = np.split(values, np.cumsum(lengths)[:-1])
    return tuple(piece.reshape(n, k) for piece, n, k in zip(pieces, sizes, widths, strict=True))


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
    if "clusters/kinds" not in arrays:
        return Clusters.of_one_class(index, caps)
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
