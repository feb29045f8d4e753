"""Transfer by paths against Mitsuba's path tracers, receiver by receiver, and what it costs."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

import slepian_prt as sp
from slepian_prt.paths.harmonics import sum_paths
from slepian_prt.paths.tracer import PathTracer
from slepian_prt.renderer.variants import mitsuba
from slepian_prt.sphere.harmonics import degrees, real_sh

BANDLIMIT, RECEIVERS, SEEDS = 2, 400, 4
SAMPLES, REFERENCE = 512, 8192
RACE_BANDLIMIT, RACE_RECEIVERS, PATHS_PER_BLOCK = 10, 200, 1 << 20
ROWS = 96  # of the map: its bilinear interpolation is then off by less than 4e-4

RED = {"type": "rgb", "value": [0.6, 0.3, 0.1]}
DIFFUSE = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": RED}}
PLASTER = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.6}}}
GOLD = {"type": "roughconductor", "material": "Au", "alpha": 0.2}


def paths() -> None:
    """Receivers whose light comes by way of one effect after the other, then of several, against path and volpath."""
    with mitsuba() as mi:
        print("  scene              receivers   error   noise   mean z   beyond 3     mean radiance   precompute")
        scenes = {
            name: (integrator, {"type": "scene", "sky": _sky(mi), **shapes})
            for name, (integrator, shapes) in _scenes(mi).items()
        }
        biases = [_verify(mi, name, integrator, scene) for name, (integrator, scene) in scenes.items()]
        level = 1.0 - 0.99 ** (1.0 / len(biases))
        print(f"  largest bias {max(map(abs, biases)):.1f} standard errors; chance allows {norm.isf(level / 2.0):.1f}")
        print("  at equal time (L = 10): scene, error of transfer, that of plain paths of all light")
        for name in ("mirror", "metal", "glass", "thin glass"):
            _race(mi, name, scenes[name][1])


def smooth_map() -> NDArray[np.float32]:
    """(ROWS, 2 ROWS, 3) texels of a positive map of degrees 0 to 2, in Mitsuba's layout."""
    v = np.pi * np.arange(ROWS)[:, None] / (ROWS - 1)
    u = np.pi * (np.arange(2 * ROWS)[None] + 0.5) / ROWS
    directions = np.stack([np.sin(v) * np.sin(u), np.cos(v) + 0.0 * u, -np.sin(v) * np.cos(u)], axis=-1)
    values = real_sh(BANDLIMIT, directions.reshape(-1, 3)) @ np.random.default_rng(4).normal(size=(9, 3))
    return (values - values.min(axis=0) + 0.3).reshape(ROWS, 2 * ROWS, 3).astype(np.float32)


def _sky(mi: Any) -> dict[str, Any]:
    return {"type": "envmap", "bitmap": mi.Bitmap(smooth_map())}


def _verify(mi: Any, name: str, integrator: str, scene: dict[str, Any]) -> float:
    """Print a line of the table; returns by how many standard errors the mean radiance is off."""
    lighting = sp.project_environment(smooth_map(), bandlimit=BANDLIMIT)
    runs, seconds = [], []
    for seed in range(SEEDS):
        begin = time.perf_counter()
        transfer = sp.precompute(scene, BANDLIMIT, SAMPLES, seed=seed, effects="all")  # nothing may be left out
        seconds.append(time.perf_counter() - begin)
        vectors = np.broadcast_to(transfer.vectors, (len(transfer.vectors), 3, transfer.vectors.shape[2]))
        runs.append(np.einsum("vcm,cm->vc", vectors, lighting))
    inner = _inner(transfer)
    chosen = np.sort(np.random.default_rng(1).choice(inner, min(RECEIVERS, inner.size), replace=False))
    ours = np.stack(runs)[:, chosen]
    reference = np.stack(list(_reference(mi, scene, integrator, transfer, chosen)))
    means = ours.mean(axis=0), reference.mean(axis=0)
    variance = ours.var(axis=0, ddof=1) / SEEDS, reference.var(axis=0, ddof=1) / len(reference)
    # Four runs tell a variance badly; receivers of the same scene have much the same relative noise.
    pooled = np.sqrt(np.mean(variance[0]) / np.mean(means[1] ** 2)) * means[1], np.sqrt(variance[1])
    lit = means[1] > 0.02 * means[1].mean()
    difference, noise = means[0] - means[1], np.hypot(*pooled)
    z = (difference / np.maximum(noise, 1e-9))[lit]
    error = math.sqrt(np.mean(difference**2) / np.mean(means[1] ** 2))
    expected = math.sqrt(np.mean(noise**2) / np.mean(means[1] ** 2))
    ratio = means[0].mean() / means[1].mean()
    spread = [np.std(values.mean(axis=(1, 2)), ddof=1) / math.sqrt(len(values)) for values in (ours, reference)]
    resolution = math.hypot(*spread) / means[1].mean()
    print(
        f"  {name:18s} {chosen.size:9d}   {error:5.3f}   {expected:5.3f}   {z.mean():6.2f}   {np.mean(abs(z) > 3):8.1%}"
        f"   {ratio:.4f} ± {resolution:.4f}   {np.median(seconds):8.1f} s",
        flush=True,
    )
    return float((ratio - 1.0) / resolution)


def _race(mi: Any, name: str, scene: dict[str, Any]) -> None:
    """Print the error of transfer, and that of paths of all light that take as long."""
    sp.precompute(scene, RACE_BANDLIMIT, 16)  # kernels
    begin = time.perf_counter()
    transfer = sp.precompute(scene, RACE_BANDLIMIT, SAMPLES)
    seconds = time.perf_counter() - begin
    chosen = np.random.default_rng(2).choice(_inner(transfer), RACE_RECEIVERS, replace=False)
    plain = _PlainPaths(mi, scene, transfer)
    everywhere = np.flatnonzero(transfer.mesh.receivers.active)
    plain.trace(everywhere, 16, seed=1)  # kernels
    begin = time.perf_counter()
    plain.trace(everywhere, 64, seed=1)
    count = max(4, round(64 * seconds / (time.perf_counter() - begin)))
    truth = np.mean([plain.trace(chosen, 1 << 14, seed=seed) for seed in range(10, 14)], axis=0)
    weights = 1.0 / (degrees(RACE_BANDLIMIT) + 1.0)

    def error(vectors: NDArray) -> float:
        return float(np.linalg.norm((vectors - truth) * weights) / np.linalg.norm(truth * weights))

    theirs = error(plain.trace(chosen, count, seed=3))
    print(f"  {name:12s} {error(transfer.vectors[chosen]):.4f}   {theirs:.4f} of {count} paths", flush=True)


class _PlainPaths:
    """All of transport by paths from the receivers, first directions spread by an additive recurrence."""

    def __init__(self, mi: Any, scene: dict[str, Any], transfer: sp.Transfer) -> None:
        loaded = mi.load_dict(scene)
        self._mi, self._tracer = mi, PathTracer(mi, loaded, [shape.bsdf() for shape in loaded.shapes()])
        size = float(np.linalg.norm(np.ptp(transfer.positions, axis=0)))
        self._normals, self._origins = transfer.normals, transfer.positions + 1e-4 * size * transfer.normals

    def trace(self, receivers: NDArray[np.int64], count: int, seed: int) -> NDArray[np.float32]:
        """(n, 3, M) transfer vectors."""
        step = max(1, PATHS_PER_BLOCK // count)
        blocks = [receivers[begin : begin + step] for begin in range(0, receivers.size, step)]
        return np.concatenate([self._block(block, count, [seed, i]) for i, block in enumerate(blocks)])

    def _block(self, receivers: NDArray[np.int64], count: int, seed: list[int]) -> NDArray[np.float32]:
        import drjit as dr

        mi, shifts = self._mi, np.random.default_rng(seed).random((2, receivers.size)).astype(np.float32)
        lane = dr.arange(mi.UInt32, receivers.size * count)
        receiver = lane // count
        along = mi.Float(lane - receiver * count) * mi.Point2f(0.7548776662, 0.5698402909)
        u = along + dr.gather(mi.Point2f, mi.Point2f(shifts), receiver)
        normal = dr.gather(mi.Normal3f, mi.Normal3f(self._normals[receivers].T.astype(np.float32)), receiver)
        origin = dr.gather(mi.Point3f, mi.Point3f(self._origins[receivers].T.astype(np.float32)), receiver)
        outward = mi.Frame3f(normal).to_world(mi.warp.square_to_cosine_hemisphere(u - dr.floor(u)))
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(int(np.random.default_rng(seed).integers(1 << 31)), dr.width(lane))
        ends = self._tracer.follow(sampler, mi.Ray3f(origin, outward))
        return sum_paths(mi, RACE_BANDLIMIT, ends, count).vectors / count


def _inner(transfer: sp.Transfer) -> NDArray[np.int64]:
    """Receivers off the borders of their shapes: rays of the reference slip out where walls meet there."""
    corners = transfer.mesh.faces
    edges = np.sort(np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]), axis=1)
    unique, uses = np.unique(edges, axis=0, return_counts=True)
    inner = transfer.mesh.receivers.active.copy()
    inner[unique[uses == 1].ravel()] = False
    return np.flatnonzero(inner)


def _reference(
    mi: Any, scene: dict[str, Any], integrator: str, transfer: sp.Transfer, chosen: NDArray[np.int64], runs: int = 16
) -> Iterator[NDArray[np.float64]]:
    """Radiance of unit albedo by Mitsuba's own integrator, (n, 3) in each of some independent runs."""
    import drjit as dr

    loaded, follow = mi.load_dict(scene), mi.load_dict({"type": integrator, "max_depth": -1})
    samples = REFERENCE // runs
    size = float(np.linalg.norm(np.ptp(transfer.positions, axis=0)))
    normals = transfer.normals[chosen]
    origins = transfer.positions[chosen] + 1e-4 * size * normals
    for seed in range(runs):
        sampler = mi.load_dict({"type": "independent", "sample_count": samples})
        sampler.seed(1000 + seed, chosen.size * samples)
        receiver = dr.arange(mi.UInt32, chosen.size * samples) // samples
        normal = dr.gather(mi.Normal3f, mi.Normal3f(normals.T.astype(np.float32)), receiver)
        origin = dr.gather(mi.Point3f, mi.Point3f(origins.T.astype(np.float32)), receiver)
        outward = mi.Frame3f(normal).to_world(mi.warp.square_to_cosine_hemisphere(sampler.next_2d()))
        radiance, valid, _ = follow.sample(loaded, sampler, mi.RayDifferential3f(origin, outward))
        found = dr.select(valid, mi.Color3f(radiance), 0.0)
        yield np.stack([np.array(dr.block_sum(channel, samples)) for channel in found], axis=1) / samples


def _scenes(mi: Any) -> dict[str, tuple[str, dict[str, Any]]]:
    """By name, the integrator that is right for a scene, and its shapes."""
    place = mi.ScalarTransform4f

    def floor(bsdf: Any = PLASTER) -> dict[str, Any]:
        return {"type": "rectangle", "to_world": place().rotate([1, 0, 0], -90).scale(2), "bsdf": bsdf}

    def ball(bsdf: Any, **others: Any) -> dict[str, Any]:
        return {"type": "sphere", "center": [0, 0.6, 0], "radius": 0.5, "bsdf": bsdf, **others}

    def sheet(bsdf: Any) -> dict[str, Any]:
        lying = place().translate([0, 0.7, 0]).rotate([1, 0, 0], -90).scale(0.8)
        return {"type": "rectangle", "to_world": lying, "bsdf": bsdf}

    def wall(x: float, bsdf: Any) -> dict[str, Any]:
        standing = place().translate([x, 1.0, 0]).rotate([0, 1, 0], 90 if x < 0 else -90).scale([2, 1, 1])
        return {"type": "rectangle", "to_world": standing, "bsdf": bsdf}

    fog = {"type": "homogeneous", "sigma_t": 1.5, "albedo": {"type": "rgb", "value": [0.9, 0.8, 0.7]}}
    marble = {"type": "homogeneous", "sigma_t": 12.0, "albedo": {"type": "rgb", "value": [0.95, 0.9, 0.85]}}
    mask = {"type": "mask", "opacity": 0.4, "bsdf": DIFFUSE}
    leaf = {"type": "principledthin", "base_color": RED, "diff_trans": 1.0}
    coat = {"type": "roughplastic", "diffuse_reflectance": RED, "alpha": 0.1}
    box = {"type": "cube", "to_world": place().translate([0, 0.7, 0]).scale(0.6), "bsdf": {"type": "null"}}
    bowl = place().translate([0, 0.02, 0]).rotate([1, 0, 0], -90)
    room = {"floor": floor(), "left": wall(-2, DIFFUSE), "right": wall(2, PLASTER)}
    inside = place().translate([0.0, 0.3, 0.9]).rotate([0, 1, 0], 30).scale(0.3)
    return {
        "diffuse": ("path", {"floor": floor(), "ball": ball(DIFFUSE)}),
        "mirror": ("path", {"floor": floor(), "ball": ball({"type": "conductor"})}),
        "metal": ("path", {"floor": floor(), "ball": ball(GOLD)}),
        "coat": ("path", {"floor": floor(), "ball": ball(coat)}),
        "glass": ("path", {"floor": floor(), "ball": ball({"type": "dielectric"})}),
        "rough glass": ("path", {"floor": floor(), "ball": ball({"type": "roughdielectric", "alpha": 0.2})}),
        "thin glass": ("path", {"floor": floor(), "sheet": sheet({"type": "thindielectric"})}),
        "opacity": ("path", {"floor": floor(), "sheet": sheet(mask)}),
        "leaf": ("path", {"floor": floor(), "sheet": sheet(leaf)}),
        "fog": ("volpath", {"floor": floor(), "box": {**box, "interior": fog}}),
        "glass and mirror": (
            "path",
            {**room, "ball": ball({"type": "dielectric"}),
             "block": {"type": "cube", "to_world": inside, "bsdf": {"type": "conductor"}}},
        ),
        "marble": (
            "volpath",
            {"floor": floor(), "ball": ball({"type": "roughdielectric", "alpha": 0.1}, interior=marble)},
        ),
        "curtain": ("path", {**room, "curtain": {**sheet(mask), "to_world": place().translate([0, 1, 0]).scale(0.8)}}),
        "metal bowl": (
            "path",
            {"floor": floor(), "bowl": {"type": "cylinder", "p0": [0, 0, 0], "p1": [0, 0, 0.6], "radius": 0.7,
                                        "to_world": bowl, "bsdf": {"type": "twosided", "bsdf": GOLD}}},
        ),
        "window": (
            "path",
            {**room, "back": {**wall(2, PLASTER), "to_world": place().translate([0, 1, -2]).scale([2, 1, 1])},
             "ceiling": {**floor(), "to_world": place().translate([0, 2, 0]).rotate([1, 0, 0], 90).scale(2)},
             "pane": {"type": "rectangle", "to_world": place().translate([0, 1, 2]).scale([2, 1, 1]),
                      "bsdf": {"type": "thindielectric"}},
             "ball": ball(GOLD)},
        ),
    }  # fmt: skip
