"""Clusters as asked for: of what, and by what they are grouped."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.clustering import (
    Clusters,
    cluster_axes,
    cluster_by_occlusion,
    cluster_surface,
    clusters_of_sites,
)
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.compression.stored_mesh.stored import store_mesh
from slepian_prt.compression.stored_mesh.transfers import as_stored
from slepian_prt.scene.receivers import Receivers
from slepian_prt.transport.direct import DirectTransfer
from slepian_prt.transport.directions import SMALLEST_SET
from slepian_prt.transport.planned import PlannedScene
from slepian_prt.transport.transfer import Transfer


class Grouping(NamedTuple):
    """Receivers grouped into caps.

    Attributes
    ----------
    clusters : Clusters
    axes : (V, 3)
        What was grouped, and the axes of the vertices' own frames.
    """

    clusters: Clusters
    axes: NDArray[np.float64]


def group_transfer(settings: CompressionSettings, transfer: Transfer) -> Grouping:
    """Clusters as asked, from vectors that are there, of the mesh as a file has it."""
    transfer = as_stored(transfer, exact=settings.exact_mesh)
    first = transfer.vectors.mean(axis=1)
    open_part = first[:, 0] * np.float32(math.sqrt(4.0 * math.pi))
    axes = transfer.axes
    if settings.group_by == "bent":
        axes = bent_normals(first, axes)
    return _cluster(settings, transfer.mesh.receivers, axes, open_part)


def group_scene(settings: CompressionSettings, planned: PlannedScene) -> Grouping:
    """Clusters as asked, before transfer is there: after a quick look around if that takes one."""
    receivers = store_mesh(planned.scene.mesh, planned.scene.parts, exact=settings.exact_mesh).mesh.receivers
    axes, openness = receivers.normals, np.ones(len(receivers), dtype=np.float32)
    if settings.group_by == "bent" or settings.occlusion_classes > 1:
        quick = DirectTransfer(planned.scene, 1, SMALLEST_SET, planned.plan.shadowed, planned.settings.seed)
        survey = quick.estimate()
        openness = 1.0 - survey.blocked
        if settings.group_by == "bent":
            axes = bent_normals(survey.vectors[:, 0], axes)
    return _cluster(settings, receivers, axes, openness)


def regroup(clusters: Clusters | Grouping, transfer: Transfer) -> Grouping:
    """Clusters that were made before, on a mesh as a file has it: of sites, readers tell by its normals which is whose.

    Parameters
    ----------
    clusters : Clusters of the transfer's own axes, or Grouping
    transfer : Transfer
        Of `as_stored`.
    """
    grouping = clusters if isinstance(clusters, Grouping) else Grouping(clusters, transfer.axes)
    if grouping.clusters.sites is None:
        return grouping
    found = clusters_of_sites(grouping.clusters.sites, transfer.mesh.normals)
    same = np.array_equal(found.index, grouping.clusters.index)
    return grouping if same else Grouping(found, transfer.mesh.normals)


def bent_normals(vectors: NDArray, normals: NDArray) -> NDArray[np.float64]:
    """(V, 3) mean directions of the light that reaches each vertex, the normal where none does.

    Parameters
    ----------
    vectors : (V, >= 4)
        Transfer vectors; degree 1 holds -y, z, -x.
    normals : (V, 3)
    """
    bent = np.stack([-vectors[:, 3], -vectors[:, 1], vectors[:, 2]], axis=1).astype(np.float64)
    length = np.linalg.norm(bent, axis=1, keepdims=True)
    return np.where(
        (length > 1e-6) & np.any(normals != 0.0, axis=1)[:, None], bent / np.maximum(length, 1e-30), normals
    )


def _cluster(settings: CompressionSettings, receivers: Receivers, axes: NDArray, openness: NDArray) -> Grouping:
    if settings.group_by == "surface":
        clusters = cluster_surface(receivers, axes, settings.clusters)
    elif settings.occlusion_classes > 1:
        clusters = cluster_by_occlusion(axes, openness, settings.occlusion_classes, settings.clusters)
    else:
        clusters = cluster_axes(axes, 1 if settings.basis == "none" else settings.clusters)
        if axes is not receivers.normals:
            # Files hold normals, not other axes, from which the index could be told.
            clusters = replace(clusters, sites=None)
    return Grouping(clusters, axes)
