"""Error against bytes and seconds on the scans, all methods in one run."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
from benchmarks.common import data_folder
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import slepian_prt as sp
from slepian_prt.compression.clustering import cluster_axes
from slepian_prt.evaluation.baselines import haar_transfer
from slepian_prt.lighting.emitters import emitted_environment
from slepian_prt.renderer.variants import mitsuba

MESHES = ("skull", "nefertiti")
MAPS = ("studio", "courtyard", "interior", "sunrise")
BANDLIMIT, CAPS, ROTATIONS = 10, 96, 8
SKY = {"type": "sunsky", "sun_scale": 0.0, "sun_direction": [0.75, 0.75, 0.55]}


def compression() -> None:
    """Figures asked of compression: predictions, ratios to SH and PCA, bytes at 5 % and 2 %, light priors, time."""
    data = data_folder()
    if not (data / "meshes").is_dir():
        print("SLEPIAN_PRT_DATA must name the folder of scanned meshes and maps; compression is left out")
        return
    maps = [sp.project_environment(data / "environments" / f"{name}.exr", bandlimit=BANDLIMIT) for name in MAPS]
    turns = Rotation.random(ROTATIONS, random_state=1).as_matrix()
    lights = np.array([[sp.rotate_sh(light, turn) for turn in turns] for light in maps])
    clear = sp.project_environment(_clear_sky(), bandlimit=BANDLIMIT)
    sky = np.array([[sp.rotate_sh(clear, turn) for turn in turns]])
    for name in MESHES:
        transfer = sp.precompute(data / "meshes" / f"{name}.ply", bandlimit=BANDLIMIT)
        _mesh(name, transfer, maps, lights, sky)
        _second_stage(name, data / "meshes" / f"{name}.ply")


def _clear_sky() -> sp.Environment:
    """Mitsuba's sky without its sun."""
    with mitsuba() as mi:
        return emitted_environment(mi, mi.load_dict(SKY), "sky")


class Relit:
    """Relative error of relit radiance, the mean over lights (maps, rotations, 3, (L+1)²).

    Through second moments, so that it does not take a product with every light.
    """

    def __init__(self, vectors: NDArray, lights: NDArray) -> None:
        self.vectors = vectors.astype(np.float64)
        self.lights = lights.reshape(-1, *lights.shape[2:])
        self.whole = self._under(self.vectors)

    def _under(self, vectors: NDArray) -> NDArray:
        return np.einsum("ecm,mn,ecn->e", self.lights, vectors.T @ vectors, self.lights)

    def error(self, vectors: NDArray) -> float:
        return float(np.mean(np.sqrt(self._under(vectors - self.vectors) / self.whole)))


def _relative(vectors: NDArray, reference: NDArray) -> float:
    return float(np.linalg.norm(vectors - reference) / np.linalg.norm(reference))


def _mesh(name: str, transfer: sp.Transfer, maps: list[NDArray], lights: NDArray, sky: NDArray) -> None:
    reference = transfer.vectors[:, 0]
    relit = Relit(reference, lights)
    clusters = cluster_axes(transfer.normals, CAPS)
    print(f"{name}, L = {BANDLIMIT}, {len(clusters.caps)} caps")
    print("  predicted / measured error of adapted, and measured error over that of sh:")
    print(f"  {'K':>4} {'transfer':>24} {'relit':>24} {'relit over sh':>14}")
    for terms in (4, 9, 16, 25, 36, 49, 64):
        packed = sp.compress(transfer, terms=terms, clusters=clusters)
        vectors = packed.reconstruct()[:, 0]
        foreseen = float(np.mean([packed.predicted_relit_error(light) for light in maps]))
        error, measured = _relative(vectors, reference), relit.error(vectors)
        sh = relit.error(np.where(np.arange(reference.shape[1]) < terms, reference, 0.0))
        print(
            f"  {terms:4d} {packed.predicted_error:9.4f} / {error:.4f} = {packed.predicted_error / error:4.2f}"
            f" {foreseen:9.4f} / {measured:.4f} = {foreseen / measured:4.2f} {measured / sh:14.2f}"
        )
    refined = sp.compress(transfer, terms=16, clusters=clusters, refine=True).reconstruct()[:, 0]
    pca = sp.compress(transfer, "pca", terms=16, clusters=clusters).reconstruct()[:, 0]
    print(f"  second stage over per-cap PCA at K = 16: {_relative(refined, reference) / _relative(pca, reference):.3f}")
    _bytes(transfer, clusters, maps, relit)
    _priors(transfer, clusters, maps, relit, Relit(reference, sky))


def _bytes(transfer: sp.Transfer, clusters: object, maps: list[NDArray], relit: Relit) -> None:
    """Bytes per vertex at a relit error, interpolated between settings on logarithmic scales."""
    reference = transfer.vectors[:, 0]
    prior = sp.measured_prior(maps, BANDLIMIT, "maps")
    curves: dict[str, list[tuple[float, float, float]]] = {}

    def add(method: str, packed: object) -> None:
        seconds = getattr(packed, "seconds", {}).get("compress", float("nan"))
        curves.setdefault(method, []).append(
            (relit.error(packed.reconstruct()[:, 0]), packed.bytes_per_vertex, seconds)
        )  # type: ignore[attr-defined]

    for tolerance in (0.2, 0.14, 0.1, 0.07, 0.05, 0.035, 0.025):
        add("adapted, coded", sp.compress(transfer, tolerance=tolerance, clusters=clusters))
        add("  without second stage", sp.compress(transfer, tolerance=tolerance, clusters=clusters, refine=False))
        add("  prior of the maps", sp.compress(transfer, tolerance=tolerance, clusters=clusters, light_prior=prior))
        add("cpca, coded", sp.compress(transfer, "cpca", tolerance=tolerance, clusters=clusters))
    for terms in (3, 4, 6, 9, 13, 18, 25, 36):
        add("cpca, float16", sp.compress(transfer, "cpca", terms=terms, clusters=clusters, coding="float16"))
    for terms in (9, 16, 25, 36, 49, 64, 81, 100, 121):
        add("sh, float16", sp.compress(transfer, "sh", terms=terms, clusters=1, coding="float16"))
        add("haar", haar_transfer(transfer.vectors, terms, transfer.mesh.albedo))
    wanted = (0.05, 0.02)
    at = {method: [_at(points, error, 1) for error in wanted] for method, points in curves.items()}
    print(f"  {'bytes per vertex at a relit error of':36} {'5 %':>7} {'2 %':>7}   seconds")
    for method, found in at.items():
        print(f"  {method:36} {found[0]:7.2f} {found[1]:7.2f}   {np.median([p[2] for p in curves[method]]):.1f}")
    for method in ("cpca, float16", "sh, float16"):
        ratios = [b / a for a, b in zip(at["adapted, coded"], at[method], strict=True)]
        print(f"  {method} takes {ratios[0]:.1f} and {ratios[1]:.1f} times as many as adapted, coded")
    cut = np.where(np.arange(reference.shape[1]) < 36, reference, 0.0)
    print(f"  leaving out degrees above 5, as d3dx does, is an error of {relit.error(cut):.3f} by itself")


def _at(points: list[tuple[float, float, float]], error: float, column: int) -> float:
    ordered = np.array(sorted(points))
    if not ordered[0, 0] <= error <= ordered[-1, 0]:
        return float("nan")
    return float(np.exp(np.interp(np.log(error), np.log(ordered[:, 0]), np.log(ordered[:, column]))))


def _priors(transfer: sp.Transfer, clusters: object, maps: list[NDArray], relit: Relit, sky: Relit) -> None:
    """Relit error with a light prior over that without, at equal K."""
    priors = {"of the maps": sp.measured_prior(maps, BANDLIMIT, "maps"), "1/(l+1)": sp.falling_prior(BANDLIMIT)}
    print("  relit error with a light prior over that without:")
    for terms in (4, 9, 16):
        plain = sp.compress(transfer, terms=terms, clusters=clusters).reconstruct()[:, 0]
        row = []
        for name, prior in priors.items():
            vectors = sp.compress(transfer, terms=terms, clusters=clusters, light_prior=prior).reconstruct()[:, 0]
            row.append(
                f"{name}: {relit.error(vectors) / relit.error(plain):.3f} under the maps, "
                f"{sky.error(vectors) / sky.error(plain):.3f} under a clear sky"
            )
        print(f"    K = {terms:2d}  " + "; ".join(row))


def _second_stage(name: str, path: Path) -> None:
    """Seconds of the second stage beside per-cap PCA of full vectors, at L = 20."""
    transfer = sp.precompute(path, bandlimit=20)
    clusters = cluster_axes(transfer.normals, CAPS)
    seconds: dict[bool, list[float]] = {True: [], False: []}
    errors = {}
    for _ in range(3):
        for ours in (True, False):
            begin = time.perf_counter()
            packed = sp.compress(
                transfer, "adapted" if ours else "pca", terms=16, clusters=clusters, refine=ours or None
            )
            seconds[ours].append(time.perf_counter() - begin)
            errors[ours] = _relative(packed.reconstruct()[:, 0], transfer.vectors[:, 0])
    mine, peers = (float(np.median(seconds[ours])) for ours in (True, False))
    print(
        f"  {name}, L = 20, K = 16: second stage {mine:.1f} s, per-cap PCA {peers:.1f} s, ratio {mine / peers:.2f}; "
        f"error ratio {errors[True] / errors[False]:.3f}"
    )
