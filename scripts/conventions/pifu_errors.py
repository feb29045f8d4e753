"""How far transfer of PIFu's own program is off, and ours, on meshes that occlude themselves."""

from __future__ import annotations

import time

import numpy as np
import trimesh
from conventions.own_code import Missing, Workshop, prt_util

import slepian_prt as sp

REFERENCE_RAYS = 65536


def compare_transfer(workshop: Workshop) -> None:
    """Relative RMS errors of order 2, over all vertices."""
    try:
        workshop.package("rtree")
        module = prt_util(workshop)
    except Missing as missing:
        print(f"PIFu's transfer: not compared: {missing}")
        return
    ball = trimesh.creation.icosphere(3)
    above = trimesh.creation.icosphere(2, 0.5)
    above.apply_translation([0.0, 1.7, 0.0])
    mesh = trimesh.util.concatenate([ball, above])
    path = workshop.folder / "occluder.ply"
    mesh.export(path)
    reference = sp.precompute(path, bandlimit=2, samples=REFERENCE_RAYS, effects="direct", seed=1).vectors[:, 0]
    print(f"transfer of order 2 on a ball under an occluder, {len(reference)} vertices, against {REFERENCE_RAYS} rays:")
    for rays in (256, 1024, 1600):
        begin = time.perf_counter()
        ours = sp.precompute(path, bandlimit=2, samples=rays, effects="direct").vectors[:, 0]
        _say(f"ours, {rays} rays", ours, reference, begin)
    for side in (16, 40):
        np.random.seed(0)  # noqa: NPY002 - which theirs draws from
        begin = time.perf_counter()
        theirs = module.computePRT(str(path), side, 2)[0]
        _say(
            f"PIFu, n = {side}: {side * side} rays",
            sp.convert_sh(theirs, source="pifu", quantity="transfer"),
            reference,
            begin,
        )


def _say(what: str, vectors: np.ndarray, reference: np.ndarray, begin: float) -> None:
    error = np.linalg.norm(vectors - reference) / np.linalg.norm(reference)
    print(f"  {what:26} {error:.4f}   {time.perf_counter() - begin:.1f} s")
