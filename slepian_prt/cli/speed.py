"""How fast rays are traced: ``python -m slepian_prt.cli.speed``, a process of its own since a bad LLVM kills it."""

from __future__ import annotations

import time

import numpy as np
import trimesh

from slepian_prt.renderer import variants
from slepian_prt.scene.loading import open_scene
from slepian_prt.scene.mesh import Mesh, make_mesh
from slepian_prt.transport.device.visibility import DeviceTracer
from slepian_prt.transport.directions import direction_set
from slepian_prt.transport.visibility import VisibilityTracer


def bumpy_sphere() -> Mesh:
    """About 41,000 vertices, some in the shadow of others."""
    ball = trimesh.creation.icosphere(6)
    radius = 1 + 0.1 * np.sin(9 * ball.vertices).prod(axis=1)
    return make_mesh(ball.vertices * radius[:, None], ball.faces)


def rays_per_second(directions: int = 256, repeats: int = 3) -> float:
    """Median rate of rays such as transport traces: cosine-distributed from a surface."""
    import drjit as dr  # not before Mitsuba, which knows where LLVM is

    mesh = bumpy_sphere()
    with open_scene(mesh) as scene:
        chosen = np.arange(0, len(mesh.positions), 4)
        on_device = variants.is_on_device(scene.mi)
        tracer = (DeviceTracer if on_device else VisibilityTracer)(scene, direction_set(directions), 0)
        tracer.trace(chosen)  # compiles the kernel
        rates = []
        for _ in range(repeats):
            begin, before = time.perf_counter(), tracer.rays
            tracer.trace(chosen)
            dr.sync_thread()
            rates.append((tracer.rays - before) / (time.perf_counter() - begin))
    return float(np.median(rates))


if __name__ == "__main__":
    print(rays_per_second())
