"""What a comparison found: errors, bytes and seconds of each method, and pictures under each environment."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.evaluation.ladder import StageError
from slepian_prt.evaluation.provenance import versions
from slepian_prt.evaluation.reference import ReferencePicture, ReferenceVertices
from slepian_prt.lighting.environment import Environment
from slepian_prt.relighting.drawing.pictures import Finish, Picture
from slepian_prt.transport.transfer import Transfer


@dataclass(frozen=True)
class MethodResult:
    """What one method with one setting costs and loses; the fields of ``methods`` in results.json.

    Attributes
    ----------
    basis, coding : str
    terms : float
        Mean number of functions.
    bytes_per_vertex : float
    transfer_error : float
        Relative RMS error of the transfer vectors.
    predicted_error : float or None
        The same as compression foresaw it, of methods that do.
    relit_error : dict of str to float
        For each environment, relative RMS error of radiance at the vertices against full SH.
    predicted_relit_error : dict of str to float
        The same as compression foresaw it, averaged over the rotations of the map.
    image_error : dict of str to float
        For each environment, relative RMS error of the picture against the path-traced reference.
    seam_across, seam_within : float or None
        Jumps of the error along edges between caps and within them, see `metrics.seam`; means over the environments.
    compress_seconds, relight_seconds : float
    """

    basis: str
    coding: str
    terms: float
    bytes_per_vertex: float
    transfer_error: float
    predicted_error: float | None
    relit_error: dict[str, float]
    predicted_relit_error: dict[str, float]
    image_error: dict[str, float]
    seam_across: float | None
    seam_within: float | None
    compress_seconds: float
    relight_seconds: float


@dataclass(frozen=True, eq=False)
class View:
    """One environment: its light, the references under it, and pictures from one camera.

    Attributes
    ----------
    environment : Environment
    lighting : (3, (L+1)²)
    radiance : (V, 3)
        Of full SH.
    reference : ReferencePicture
        Path-traced, without what transfer knows no light of.
    vertices : ReferenceVertices
    interpolated, full : Picture
        Of ``vertices``, and of full SH.
    backdrop : (H, W, 3) or None
        Radiance of the environment as the camera sees it, where that is the background.
    compressed : dict of str to Picture
        Of each method.
    """

    environment: Environment
    lighting: NDArray[np.float64]
    radiance: NDArray[np.float32]
    reference: ReferencePicture
    vertices: ReferenceVertices
    interpolated: Picture
    full: Picture
    backdrop: NDArray[np.float32] | None = None
    compressed: dict[str, Picture] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Comparison:
    """Everything that the report shows.

    Attributes
    ----------
    transfer : Transfer
    grouping : CompressionSettings
        Of which only the grouping counts.
    clusters : int
        Number of caps.
    half_angles : (float, float)
        Of the narrowest and the widest cap, radians.
    methods : tuple of MethodResult
    ladder : tuple of StageError
    views : tuple of View
        One for each environment.
    pictured_terms : int
        Number of functions of the compressed pictures.
    negative : dict of str to float
        For each environment, the part of the vertices that full SH makes negative.
    finish : Finish
        Background and exposure of the pictures.
    seconds : float
        That the whole comparison took.
    compressed : CompressedTransfer or None
        By the first method, as exactly as it was coded; None if that is not of our own kind.
    """

    transfer: Transfer
    grouping: CompressionSettings
    clusters: int
    half_angles: tuple[float, float]
    methods: tuple[MethodResult, ...]
    ladder: tuple[StageError, ...]
    views: tuple[View, ...]
    pictured_terms: int
    negative: dict[str, float]
    finish: Finish
    seconds: float
    compressed: CompressedTransfer | None

    def results(self) -> dict[str, Any]:
        """What results.json holds; its names are stable."""
        return {
            "scene": self.transfer.source,
            "vertices": len(self.transfer.positions),
            "bandlimit": self.transfer.bandlimit,
            "samples": self.transfer.samples,
            "seed": self.transfer.seed,
            "clusters": self.clusters,
            "group_by": self.grouping.group_by,
            "occlusion_classes": self.grouping.occlusion_classes,
            "environments": [view.environment.name for view in self.views],
            "methods": [asdict(method) for method in self.methods],
            "ladder": [asdict(error) for error in self.ladder],
            "references": {
                view.environment.name: {
                    "noise": view.reference.noise,
                    "samples_per_pixel": view.reference.samples,
                    "seconds": view.reference.seconds,
                }
                for view in self.views
            },
            "bounces": self.transfer.bounces,
            "toward_camera": self.transfer.toward_view,
            "effects": [effect.as_dict() for effect in self.transfer.effects],
            "rays_traced": self.transfer.rays_traced,
            "seconds": {**self.transfer.seconds, "total": self.seconds},
            "versions": versions(),
        }
