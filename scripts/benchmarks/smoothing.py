"""Smoothing of vectors that paths give: what is left of the error of radiance, and how far was smoothed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import trimesh
from benchmarks.common import ROOT, data_folder
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import slepian_prt as sp
from slepian_prt.paths.harmonics import sum_paths
from slepian_prt.paths.tracer import PathTracer
from slepian_prt.renderer.variants import mitsuba
from slepian_prt.transport.smoothing import calibrate_variance, smooth, surface_guides, variance_of_paths

BANDLIMIT, PATHS, REFERENCE = 9, (16, 64, 256, 1024), 4096
MAPS, TURNS = ("courtyard", "interior", "studio", "sunrise"), 4
LANES, AT_ONCE = 1 << 19, 128

GRAY = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.6}}}
GOLD = {"type": "twosided", "bsdf": {"type": "roughconductor", "material": "Au", "alpha": 0.15}}


class Estimate(NamedTuple):
    """Two halves (2, V, 3, (L+1)²) of the vectors, and mean squares of the throughput (V, 3)."""

    halves: NDArray[np.float32]
    squares: NDArray[np.float32]


def smoothing() -> None:
    """Transfer by paths of three curved surfaces with caustics, smoothed, against many more paths, under four maps."""
    lights = np.stack([light for name in MAPS for light in _lights(name)])
    print("  scene         paths   raw error   smoothed   of raw   mean gains of the bands, fine to coarse")
    with mitsuba() as mi:
        for name, (mesh, others) in _scenes(mi).items():
            scene = mi.load_dict({"type": "scene", "receivers": _mitsuba_mesh(mi, mesh), **others})
            reference = _trace(mi, scene, mesh, REFERENCE, seed=1).halves
            for paths in PATHS:
                found = _trace(mi, scene, mesh, paths, seed=1 + paths)
                raw, half = found.halves.mean(axis=0), 0.5 * (found.halves[0] - found.halves[1])
                neighbours = mesh.receivers.neighbours
                variance = calibrate_variance(variance_of_paths(found.squares, raw, paths), half, neighbours)
                smoothed = smooth(raw, variance, neighbours, surface_guides(mesh.normals))
                before, after = (_error(vectors, reference, lights) for vectors in (raw, smoothed.vectors))
                gains = " ".join(f"{gain:.2f}" for gain in smoothed.gains.mean(axis=0))
                print(
                    f"  {name:12s} {paths:6d} {before:11.4f} {after:10.4f} {after / before:8.3f}   {gains}", flush=True
                )


def _lights(name: str) -> Iterator[NDArray[np.float64]]:
    lighting = sp.project_environment(sp.read_environment(data_folder() / "environments" / f"{name}.exr"), BANDLIMIT)
    for turn in Rotation.random(TURNS, np.random.default_rng(0)).as_matrix():
        yield sp.rotate_sh(lighting, turn)


def _error(vectors: NDArray, reference: NDArray, lights: NDArray) -> float:
    """Relative RMS of radiance, averaged over lights; the noise of the reference is taken off."""
    true, noise = reference.mean(axis=0), 0.5 * (reference[0] - reference[1])
    squares = [
        np.square(np.einsum("vcm,kcm->kvc", part, lights)).sum(axis=(1, 2)) for part in (vectors - true, noise, true)
    ]
    return float(np.sqrt(np.maximum(squares[0] - squares[1], 0.0) / squares[2]).mean())


def _trace(mi: Any, scene: Any, mesh: sp.Mesh, paths: int, seed: int) -> Estimate:
    """All transport of the vertices of a mesh, by paths whose first directions are of low discrepancy."""
    tracer = PathTracer(mi, scene, [shape.bsdf() for shape in scene.shapes()])
    rng, count, each = np.random.default_rng(seed), len(mesh.positions), min(paths // 2, AT_ONCE)
    steps = np.arange(1, each + 1)[:, None] * (0.7548776662466927, 0.5698402909980532)
    halves = np.zeros((2, count, 3, (BANDLIMIT + 1) ** 2), dtype=np.float32)
    squares = np.zeros((count, 3), dtype=np.float32)
    for half in (0, 1):
        for rows in np.array_split(np.arange(count), -(-count * each // LANES)):
            for _ in range(paths // 2 // each):
                shifted = (steps + rng.random((rows.size, 1, 2))) % 1.0
                local = mi.warp.square_to_cosine_hemisphere(mi.Point2f(shifted.reshape(-1, 2).T.astype(np.float32)))
                frame = mi.Frame3f(mi.Vector3f(np.repeat(mesh.normals[rows], each, axis=0).T.astype(np.float32)))
                places = mesh.positions[rows] + 1e-4 * mesh.normals[rows]
                origin = mi.Point3f(np.repeat(places, each, axis=0).T.astype(np.float32))
                sampler = mi.load_dict({"type": "independent"})
                sampler.seed(int(rng.integers(1 << 31)), rows.size * each)
                ends = tracer.follow(sampler, mi.Ray3f(origin, frame.to_world(local)))
                sums = sum_paths(mi, BANDLIMIT, ends, each)
                halves[half, rows] += sums.vectors.reshape(rows.size, 3, -1) / (paths // 2)
                squares[rows] += sums.squares / paths
    return Estimate(halves, squares)


def _mitsuba_mesh(mi: Any, mesh: sp.Mesh) -> Any:
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(GRAY)
    made = mi.Mesh("receivers", len(mesh.positions), len(mesh.faces), properties, has_vertex_normals=True)
    parameters = mi.traverse(made)
    parameters["vertex_positions"] = mesh.positions.astype(np.float32).ravel()
    parameters["vertex_normals"] = mesh.normals.astype(np.float32).ravel()
    parameters["faces"] = mesh.faces.astype(np.uint32).ravel()
    parameters.update()
    return made


def _scenes(mi: Any) -> dict[str, tuple[sp.Mesh, dict[str, Any]]]:
    """By name, receivers, and what stands around them."""
    place = mi.ScalarTransform4f
    side = np.linspace(-1.5, 1.5, 65)
    grid = np.stack(np.meshgrid(side, [0.0], side, indexing="ij"), axis=-1).reshape(-1, 3)
    corner = (np.arange(64)[:, None] * 65 + np.arange(64)).ravel()
    faces = np.concatenate([corner[:, None] + [0, 1, 66], corner[:, None] + [0, 66, 65]])
    ball = trimesh.creation.icosphere(4, 0.45)
    knot = sp.read_mesh(ROOT / "scenes" / "knot.ply")
    knot_size = float(np.abs(knot.positions).max())
    bowl = place().translate([0, -1.0, 0]).rotate([1, 0, 0], -90)
    return {
        "glass ball": (
            sp.make_mesh(grid, faces),
            {"ball": {"type": "sphere", "center": [0, 0.55, 0], "radius": 0.5, "bsdf": {"type": "dielectric"}}},
        ),
        "metal bowl": (
            sp.make_mesh(ball.vertices, ball.faces),
            {"bowl": {"type": "cylinder", "p1": [0, 0, 1.2], "radius": 0.8, "to_world": bowl, "bsdf": GOLD},
             "floor": {"type": "disk", "to_world": bowl.scale(0.8), "bsdf": GOLD}},
        ),
        "knot, mirror": (
            sp.make_mesh(knot.positions / knot_size, knot.faces, normals=knot.normals),
            {"ball": {"type": "sphere", "center": [1.5, 0.5, 0], "radius": 0.6, "bsdf": {"type": "conductor"}}},
        ),
    }  # fmt: skip
