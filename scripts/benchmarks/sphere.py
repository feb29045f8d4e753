"""Sphere mathematics beside scipy and pyshtools."""

from __future__ import annotations

import math

import numpy as np
from benchmarks.common import PEAK_MEMORY, in_child, line, median_seconds

import slepian_prt as sp


def sphere() -> None:
    """Harmonics against scipy; cap bases against pyshtools; a high bandlimit in time and memory; rotation."""
    import pyshtools
    from scipy.special import sph_harm_y_all

    rng = np.random.default_rng(0)
    d = rng.normal(size=(100_000, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    theta, phi = np.arccos(d[:, 2]), np.arctan2(d[:, 1], d[:, 0])
    ours = median_seconds(lambda: sp.real_sh(20, d))
    theirs = median_seconds(lambda: sph_harm_y_all(20, 20, theta, phi), 3)
    line("real_sh, L = 20, 100k directions: times faster than scipy sph_harm_y_all", f"{theirs / ours:.1f}")
    size = 441 * 100_000
    source = np.ones(size)
    copy = median_seconds(lambda: source.copy())
    line("real_sh, L = 20, 100k directions: time of a copy of the result", f"{copy / ours:.2f} of ours")
    ours = median_seconds(lambda: sp.cap_basis(200, math.radians(20)), 3)
    theirs = median_seconds(lambda: pyshtools.spectralanalysis.SHReturnTapers(math.radians(20), 200), 1)
    line("cap_basis, L = 200, 20°, all 40,401 functions: part of pyshtools' time", f"{ours / theirs:.2f}")
    code = (
        "import math, time, slepian_prt as sp; t = time.perf_counter();"
        "n = len(sp.cap_basis(500, math.radians(20), threshold=1e-3)); t = time.perf_counter() - t;"
        f"print(n, f'{{t:.1f}} s', {PEAK_MEMORY})"
    )
    line("cap_basis, L = 500, 20°, λ > 1e-3: functions, time, peak memory of the process", in_child(code))
    f = rng.normal(size=201**2)
    turn = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    sp.rotate_sh(f, turn)
    line("rotate_sh, L = 200, one vector", f"{1e3 * median_seconds(lambda: sp.rotate_sh(f, turn)):.1f} ms")
    many = rng.normal(size=(10_000, 121))
    turns = np.tile(turn, (10_000, 1, 1))
    seconds = median_seconds(lambda: sp.rotate_sh(many, turns))
    line("rotate_sh, L = 10, vectors per second, each by its own rotation", f"{10_000 / seconds:,.0f}")
