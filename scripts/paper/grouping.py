"""Neighbourhoods by normals against neighbourhoods on the surface, the two mappings of Lessig & Fiume (Sec. 4)."""

from __future__ import annotations

import numpy as np
from paper.models import models

import slepian_prt as sp
from slepian_prt.compression.clustering import spread
from slepian_prt.compression.grouping import Grouping, group_transfer
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.evaluation.metrics import relative_rms

BANDLIMIT, TERMS, TOLERANCES = 10, 16, (0.05, 0.02)
BASES = ("slepian", "adapted", "pca")
CODED = ("adapted", "pca")
GROUPINGS = (("normal", 96), ("surface", 96), ("surface", 384))


def grouping() -> None:
    """Caps of normals and geodesic cells: how wide they are, errors at equal K, and bytes at equal tolerance."""
    errors = " | ".join(f"`{basis}`, K = {TERMS}" for basis in BASES)
    sizes = " | ".join(f"bytes of `{basis}` at 5 %, 2 %" for basis in CODED)
    print(f"| model | grouped by | cells | mean half-angle | {errors} | {sizes} |")
    print("| --- " * (4 + len(BASES) + len(CODED)) + "|")
    for model in models("skull", "nefertiti"):
        transfer = sp.precompute(model.mesh, BANDLIMIT, 1024)
        for group_by, count in GROUPINGS:
            groups = group_transfer(CompressionSettings(group_by=group_by, clusters=count), transfer)
            found = " | ".join(f"{_error(transfer, groups, basis):.1%}" for basis in BASES)
            coded = " | ".join(_sizes(transfer, groups, basis) for basis in CODED)
            name, angle = model.name.split(",")[0], np.degrees(_mean_half_angle(groups))
            print(
                f"| {name} | {group_by} | {len(groups.clusters.caps)} | {angle:.0f}° | {found} | {coded} |", flush=True
            )


def _sizes(transfer: sp.Transfer, groups: Grouping, basis: str) -> str:
    packed = (sp.compress(transfer, basis, tolerance=tolerance, clusters=groups) for tolerance in TOLERANCES)
    return ", ".join(f"{each.bytes_per_vertex:.2f}" for each in packed)


def _error(transfer: sp.Transfer, groups: Grouping, basis: str) -> float:
    packed = sp.compress(transfer, basis, terms=TERMS, coding="float16", clusters=groups)
    return relative_rms(packed.reconstruct(), transfer.vectors)


def _mean_half_angle(groups: Grouping) -> float:
    """Of evenly filled caps as wide as each cell's normals, the mean over vertices."""
    clusters = groups.clusters
    widths = [
        spread(cap.center, groups.axes[chosen]) for cap, chosen in zip(clusters.caps, clusters.members, strict=True)
    ]
    return float(np.average(widths, weights=clusters.sizes))
