"""Direct transfer of order 2, quickly: what PIFu and ICON draw their training pictures with.

Their own code casts 1,600 rays at random from every vertex. Nine coefficients of a clamped cosine with shadows need no
more than a few directions that are evenly spread, bisection between those that disagree, and exact integrals of what
lies between (`slepian_prt.transport.occlusion`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.scene.loading import open_scene
from slepian_prt.scene.mesh import Mesh
from slepian_prt.scene.receivers import morton
from slepian_prt.scene.scene import Scene
from slepian_prt.transport.directions import direction_set
from slepian_prt.transport.estimator import receivers_per_block
from slepian_prt.transport.hemisphere import SurfacePoints
from slepian_prt.transport.occlusion import OcclusionTables
from slepian_prt.transport.visibility import VisibilityTracer, nodes_for

ORDER = 2
COEFFICIENTS = (ORDER + 1) ** 2

# Directions that every vertex looks in at first: errors of 2 to 6 % on scans and on a knot, for 28 to 43 rays.
_NODES = 20

# Vertices that the error is measured at, against so many directions, whose own error is a tenth of it.
_CHECKED, _DENSE = 128, 256

_RAYS_PER_BLOCK = 1 << 21


class OrderTwo(NamedTuple):
    """Transfer of order 2.

    Attributes
    ----------
    vectors : (V, 9) float32
        As those of `precompute`; zero at vertices that no face uses.
    error : float
        Relative RMS, measured on vertices at random.
    rays : int
        Traced for it.
    """

    vectors: NDArray[np.float32]
    error: float
    rays: int


def trace_order_two(
    mesh: Mesh, samples: int | None = None, seed: int = 0, stop: Callable[[str], None] = lambda _: None
) -> OrderTwo:
    """Direct, shadowed, diffuse transfer of the vertices of a mesh.

    Vertices inside other geometry are dark.

    Parameters
    ----------
    mesh : Mesh
    samples : int, optional
        Rays per vertex, on average. By default what 20 directions and the bisection between them take.
    seed : int
    stop : callable
        Told the name of each stage when it ends.

    Raises
    ------
    UserError
        No LLVM for Mitsuba works here.
    """
    with open_scene(mesh) as scene:
        active = np.flatnonzero(scene.receivers.active)
        points = _origins(scene)
        chosen = np.random.default_rng(seed).choice(active, min(_CHECKED, active.size), replace=False)
        scene.geometry  # noqa: B018 (built now, for the clock)
        stop("load")
        reference, tracer = _trace(scene, points, chosen, _DENSE, seed)
        changes = tracer.changes / chosen.size / tracer.directions.size**0.5
        nodes = _NODES if samples is None else nodes_for(samples, changes)
        vectors = np.zeros((len(mesh.positions), COEFFICIENTS), dtype=np.float32)
        along = active[np.argsort(morton(points.origins[active]), kind="stable")]  # neighbours share the caches
        vectors[along], main = _trace(scene, points, along, nodes, seed)
        stop("transport")
        size = float(np.linalg.norm(reference))
        error = float(np.linalg.norm(vectors[chosen] - reference)) / size if size > 0.0 else 0.0
        return OrderTwo(vectors, error, tracer.rays + main.rays)


def _origins(scene: Scene) -> SurfacePoints:
    """Straight above the vertices.

    Those of `Scene.ray_origins`, which look for contacts, changed no error of a scan and took a third of the time.
    """
    normals = scene.receivers.normals
    return SurfacePoints(normals, scene.traced_positions + scene.ray_heights[:, None] * normals)


def _trace(
    scene: Scene, points: SurfacePoints, vertices: NDArray, nodes: int, seed: int
) -> tuple[NDArray[np.float32], VisibilityTracer]:
    """(n, 9) vectors of some vertices, and what traced them."""
    directions = direction_set(nodes)
    tables = OcclusionTables(directions, ORDER)
    tracer = VisibilityTracer(scene, directions, seed, points)
    size = receivers_per_block(nodes, _RAYS_PER_BLOCK, COEFFICIENTS)
    blocks = [vertices[begin : begin + size] for begin in range(0, len(vertices), size)]
    return np.concatenate([tables.open(tracer.trace(block))[0] for block in blocks]), tracer
