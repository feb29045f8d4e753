"""Transfer vectors of a scene and how they came about."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError, check_bandlimit
from slepian_prt.scene.meshes import Mesh
from slepian_prt.scene.scenes import Part, open_scene
from slepian_prt.transport.effects import Effect, plan_effects
from slepian_prt.transport.visibility import shadowed_transfer

log = logging.getLogger(__name__)

LARGEST_BANDLIMIT = 50
LARGEST_SAMPLES = 1 << 20

# Blocked part of the light beyond which a mesh is more likely inside out than meant.
_NEARLY_ALL = 0.97


@dataclass(frozen=True)
class Transfer:
    """How distant light becomes radiance at each vertex, before the albedo.

    Attributes
    ----------
    vectors : (V, channels, (L+1)²) float32
        Real SH coefficients of the transfer function, for unit albedo.
    mesh : Mesh
    parts : tuple of Part
    bandlimit, samples, seed : int
    effects : tuple of Effect
    rays_traced : int
    seconds : dict of str to float
        Wall-clock time of each stage.
    source : str
        Path of the scene.
    """

    vectors: NDArray[np.float32]
    mesh: Mesh
    parts: tuple[Part, ...]
    bandlimit: int
    samples: int
    seed: int
    effects: tuple[Effect, ...]
    rays_traced: int
    seconds: dict[str, float] = field(default_factory=dict)
    source: str = ""

    @property
    def positions(self) -> NDArray[np.float64]:
        """(V, 3) world space."""
        return self.mesh.positions

    @property
    def normals(self) -> NDArray[np.float64]:
        """(V, 3) unit normals, zero at vertices that no face uses."""
        return self.mesh.normals


def precompute(
    scene: str | Path | Mesh,
    bandlimit: int = 10,
    samples: int = 1024,
    *,
    seed: int = 0,
    on_plan: Callable[[tuple[Effect, ...]], None] = lambda _: None,
    advance: Callable[[int, int], None] = lambda _done, _total: None,
) -> Transfer:
    """Transfer vectors of every vertex for direct, shadowed, diffuse light.

    Parameters
    ----------
    scene : path of a mesh (ply, obj, stl, off, glb) or Mitsuba scene (xml), or a `Mesh`
    bandlimit : int in [0, 50]
    samples : int
        Rays per vertex over the hemisphere; vertices that nothing can shadow get none.
    seed : int
        The same seed gives the same bits.
    on_plan : callable
        Given the effects plan before the heavy work begins.
    advance : callable
        Given (vertices finished since the last call, vertices in all).

    Raises
    ------
    UserError
        The scene cannot be used, or no LLVM for Mitsuba works here.
    ValueError
        Bandlimit or samples out of range.
    """
    bandlimit = check_bandlimit(bandlimit, largest=LARGEST_BANDLIMIT)
    if not isinstance(samples, int | np.integer) or not 1 <= samples <= LARGEST_SAMPLES:
        raise UserError(f"samples must be an integer in [1, {LARGEST_SAMPLES}], not {samples!r}")
    if not isinstance(seed, int | np.integer) or seed < 0:
        raise UserError(f"seed must be a non-negative integer, not {seed!r}")
    started = time.perf_counter()
    with open_scene(scene) as (mi, opened):
        if not opened.mesh.receivers.any():
            raise UserError(f"{opened.path}: no face can be lit; export the mesh again")
        loaded = time.perf_counter()
        effects = plan_effects(mi, opened, seed)
        on_plan(effects)
        if effects[0].contribution is not None and effects[0].contribution > _NEARLY_ALL:
            log.info(
                "%s: %.0f %% of the light is blocked; if this is no closed room, its faces point inward: flip them",
                opened.path,
                100.0 * effects[0].contribution,
            )
        planned = time.perf_counter()
        total = len(opened.mesh.positions)
        vectors, rays = shadowed_transfer(mi, opened, bandlimit, int(samples), seed, lambda done: advance(done, total))
        traced = time.perf_counter()
        seconds = {"load": loaded - started, "plan": planned - loaded, "transport": traced - planned}
        return Transfer(
            vectors[:, None, :],
            opened.mesh,
            opened.parts,
            bandlimit,
            int(samples),
            seed,
            effects,
            rays,
            seconds,
            opened.path,
        )
