"""What glossy transfer for all views would take: transfer matrices (Sloan et al. 2002), compressed by the same caps."""

from __future__ import annotations

import numpy as np
from benchmarks.common import data_folder
from numpy.typing import NDArray

from slepian_prt.compression.clustering import cluster_axes
from slepian_prt.scene.loading import open_scene
from slepian_prt.scene.scene import Scene
from slepian_prt.sphere.harmonics import degrees, real_sh
from slepian_prt.sphere.quadrature import spherical_fibonacci

BANDLIMIT, CAPS, SEED = 10, 24, 1
VERTICES, DIRECTIONS, VIEWS = 1500, 2048, 40
ROUGHNESS = (1.0, 0.7, 0.5, 0.3, 0.2, 0.1)
ERRORS = (0.1, 0.05, 0.02)


def all_views() -> None:
    """Functions per vertex that hold transfer toward all views, by roughness, beside those of diffuse transfer."""
    data = data_folder()
    if not (data / "meshes").is_dir():
        print("SLEPIAN_PRT_DATA must name the folder of scanned meshes and maps; all views are left out")
        return
    with open_scene(data / "meshes" / "skull.ply") as scene:
        vertices = _in_one_cap(scene)
        directions = spherical_fibonacci(DIRECTIONS)
        visible = _visible(scene, vertices, directions)
        normals = scene.receivers.normals[vertices]
    light = real_sh(BANDLIMIT, directions) / (degrees(BANDLIMIT) + 1.0) * (4.0 * np.pi / DIRECTIONS)
    cosine = np.maximum(normals @ directions.T, 0.0) * visible
    print(f"  {len(vertices)} vertices of one of {CAPS} caps of skull; L = {BANDLIMIT}, light of the prior 1/(l+1)")
    print(f"  {'':22s} functions of the vertices for {', '.join(f'{e:.0%}' for e in ERRORS)}; of the views for 5 %")
    counts = _counts((cosine @ light / np.pi).astype(np.float32))
    print(f"  {'diffuse':22s} {counts}")
    axis = normals.mean(axis=0) / np.linalg.norm(normals.mean(axis=0))
    views = spherical_fibonacci(4 * VIEWS)
    views = views[np.argsort(-views @ axis)[:VIEWS]]  # within 60° of the axis
    for roughness in ROUGHNESS:
        vectors = np.empty((len(vertices), VIEWS, light.shape[1]), dtype=np.float32)
        for row, (normal, lit) in enumerate(zip(normals, cosine, strict=True)):
            vectors[row] = (ggx(roughness, normal, views, directions) * lit) @ light
        unfolded = _counts(vectors.transpose(1, 0, 2).reshape(VIEWS, -1), (0.05,))
        print(f"  {f'rough metal, α = {roughness:g}':22s} {_counts(vectors.reshape(len(vertices), -1))}; {unfolded}")


def ggx(roughness: float, normal: NDArray, views: NDArray, directions: NDArray) -> NDArray[np.float64]:
    """(views, directions) values of a GGX metal that absorbs nothing (Walter et al. 2007, Eqs. 20, 33, 34)."""
    half = views[:, None] + directions[None]
    half /= np.maximum(np.linalg.norm(half, axis=2, keepdims=True), 1e-9)
    h, v, l = half @ normal, (views @ normal)[:, None], (directions @ normal)[None]
    squared = roughness * roughness
    distribution = squared / (np.pi * (h * h * (squared - 1.0) + 1.0) ** 2)

    def masked(c: NDArray) -> NDArray:
        c = np.maximum(c, 1e-6)
        return 2.0 / (1.0 + np.sqrt(1.0 + squared * (1.0 - c * c) / (c * c)))

    values = distribution * masked(v) * masked(l) / (4.0 * np.maximum(v, 1e-3) * np.maximum(l, 1e-3))
    return np.where((v > 0.0) & (l > 0.0), values, 0.0)


def _in_one_cap(scene: Scene) -> NDArray[np.int64]:
    """The vertices of the cap that is most like the mean one: of median size."""
    clusters = cluster_axes(scene.receivers.normals, CAPS)
    chosen = np.flatnonzero(clusters.index == np.argsort(clusters.sizes)[CAPS // 2])
    return np.random.default_rng(SEED).permutation(chosen)[:VERTICES]


def _visible(scene: Scene, vertices: NDArray, directions: NDArray) -> NDArray[np.bool_]:
    """(vertices, directions) whether nothing is in the way."""
    mi = scene.mi
    origin = np.repeat(scene.ray_origins.front[vertices], len(directions), axis=0).T.astype(np.float32)
    toward = np.tile(directions, (len(vertices), 1)).T.astype(np.float32)
    blocked = scene.geometry.ray_test(mi.Ray3f(mi.Point3f(origin), mi.Vector3f(toward)))
    return ~np.array(blocked).reshape(len(vertices), len(directions))


def _counts(rows: NDArray, errors: tuple[float, ...] = ERRORS) -> str:
    """How many functions, of the rows' own, leave no more than each error."""
    energy = np.linalg.eigvalsh((rows @ rows.T).astype(np.float64))[::-1].clip(0.0)
    left = np.sqrt(np.maximum(1.0 - np.cumsum(energy) / energy.sum(), 0.0))
    return ", ".join(str(int(np.argmax(left <= error)) + 1) for error in errors)
