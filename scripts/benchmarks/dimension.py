"""Effective dimension: what it is for some models, seconds, and how far interpolation between neighbourhoods is off."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from benchmarks.common import ROOT, data_folder, line, median_seconds
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

import slepian_prt as sp
from slepian_prt.evaluation.dimension.estimate import dimension_of_vectors
from slepian_prt.evaluation.dimension.neighbourhoods import Surface

# Vertices whose own neighbourhoods are held against what is interpolated.
_HELD = 400


def dimension() -> None:
    """The knot and two scans at L = 10, and the knot at other bandlimits, radii and rays."""
    print("model      L  rays  radius    median of M        5 % at most   at least   normals alone")
    for name, path in _models():
        traced = sp.precompute(path)
        result = _row(name, traced, sp.precompute(path, effects="none"))
        decoding = _decoding_seconds(traced)
        seconds = median_seconds(lambda whole=traced: sp.effective_dimension(whole), 3)
        ratio = f"{seconds:.2f} s, {seconds / decoding:.1f}"
        line(f"{name}, {len(traced.vectors)} vertices: time, in times of reading and decoding its file", ratio)
        line(f"{name}: off from the neighbourhood of each vertex, RMS and median", _held_out(traced, result))
    knot = ROOT / "scenes" / "knot.ply"
    for bandlimit, samples, radius in ((5, 1024, 0.05), (20, 1024, 0.05), (10, 256, 0.05), (10, 4096, 0.05),
                                       (10, 1024, 0.02), (10, 1024, 0.1)):  # fmt: skip
        open_ = sp.precompute(knot, bandlimit, effects="none")
        _row("knot", sp.precompute(knot, bandlimit, samples), open_, radius)


def _models() -> Iterator[tuple[str, Path]]:
    yield "knot", ROOT / "scenes" / "knot.ply"
    for name in ("skull", "nefertiti"):
        yield name, data_folder() / "meshes" / f"{name}.ply"


def _decoding_seconds(traced: sp.Transfer) -> float:
    """To read a file and have its vectors."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.prt"
        sp.compress(traced).save(path)
        return median_seconds(lambda: sp.load(path).reconstruct(), 3)


def _row(name: str, traced: sp.Transfer, open_: sp.Transfer, radius: float = 0.05) -> sp.EffectiveDimension:
    result, alone = (sp.effective_dimension(transfer, 0.05, radius) for transfer in (traced, open_))
    low, middle, high = (math.ceil(result.quantile(part)) for part in (0.05, 0.5, 0.95))
    coherence = 1.0 - middle / result.functions
    ours = f"{traced.bandlimit:>2}  {traced.samples:>4}  {100 * radius:>4g} %   {middle:>3} of {result.functions}, "
    line(f"{name:<9} {ours}{coherence:.3f}   {low:>5} {high:>10}", f"{math.ceil(alone.quantile(0.5)):>4}")
    return result


def _held_out(traced: sp.Transfer, result: sp.EffectiveDimension) -> str:
    surface = Surface(traced.mesh, result.radius)
    chosen = np.random.default_rng(1).choice(np.flatnonzero(traced.mesh.receivers.active), _HELD, replace=False)
    with threadpool_limits(1, "blas"):
        own: NDArray = np.array([_own(surface, traced, int(vertex), result.error) for vertex in chosen])
    off = result.dimension[chosen] / own - 1.0
    return f"{np.sqrt(np.mean(off**2)):.1%} {np.median(np.abs(off)):.1%}"


def _own(surface: Surface, traced: sp.Transfer, vertex: int, error: float) -> float:
    about = surface.about(vertex)
    return dimension_of_vectors(traced.vectors[about.members], about.areas, error)
