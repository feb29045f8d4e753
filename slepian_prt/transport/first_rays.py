"""The first rays of paths from receivers, and which of them go on."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.paths.media import media_of, medium_at
from slepian_prt.scene.receivers import morton
from slepian_prt.scene.scene import Scene
from slepian_prt.sphere.rotation import rotation_to
from slepian_prt.transport.held_faces import PATHS, HeldFaces
from slepian_prt.transport.hemisphere import upload_frames, upload_origins

_RAYS_PER_BLOCK = 1 << 19

# Additive recurrence in two dimensions (Roberts 2018), by the root of x³ = x + 1.
_STEPS = tuple(int(step * 2**32) for step in (0.7548776662466927, 0.5698402909980532))

# From 32 bits to [0, 1), so that rounding does not reach one.
_UNIT = (1.0 - 2.0**-24) * 2.0**-32


class GoingOn(NamedTuple):
    """Those of the first rays of a block of receivers that meet something to go on from, k of them.

    Attributes
    ----------
    lanes : (k,)
        Samples of a receiver times the place of the receiver in the block, plus the number of the direction; ascending.
    effects : (k,)
        By what they go on: places in `PATHS`, from 1 on.
    ray : Ray3f
    hit : PreliminaryIntersection3f
    medium : MediumPtr or None
        That the rays begin in; None if there is none anywhere.
    first_known : Bool
        Whether what diffuse surfaces reflect along these rays is known: not from within media.
    """

    lanes: NDArray[np.int64]
    effects: NDArray[np.uint32]
    ray: Any
    hit: Any
    medium: Any
    first_known: Any


class FirstRays:
    """Rays by the cosine from receivers: low-discrepancy sets with a shift for each receiver and half.

    Parameters
    ----------
    scene : Scene
    geometry : Mitsuba scene
        To trace in.
    held : HeldFaces
    samples : int
        Rays of each receiver, an even number; those of the second half come last.
    effects : iterable of str
        Those of `PATHS` by which paths go on from what they meet first.
    seed : int
    """

    def __init__(
        self, scene: Scene, geometry: Any, held: HeldFaces, samples: int, effects: Iterable[str], seed: int
    ) -> None:
        mi, wanted = scene.mi, set(effects)
        self._scene, self._geometry, self._held = scene, geometry, held
        self._samples, self._seed = samples, seed
        self._wanted = mi.Bool([False, *(effect in wanted for effect in PATHS)])
        self._has_media = "media" in wanted and bool(media_of(mi, geometry))
        self._sampler = mi.load_dict({"type": "independent"})

    def blocks(self, vertices: NDArray[np.int64]) -> list[NDArray[np.int64]]:
        """The receivers in blocks whose rays fit in memory; neighbours in space together."""
        order = vertices[np.argsort(morton(self._scene.traced_positions[vertices]), kind="stable")]
        size = max(1, _RAYS_PER_BLOCK // self._samples)
        return [order[begin : begin + size] for begin in range(0, order.size, size)]

    def trace(self, vertices: NDArray[np.int64]) -> GoingOn:
        """Trace a block of receivers; of those within media all rays go on."""
        import drjit as dr

        mi = self._scene.mi
        place, ray = self._rays(vertices)
        hit = self._geometry.ray_intersect_preliminary(ray)
        effect = self._held.first_met(ray, hit)
        medium, within = None, mi.Bool(False)
        if self._has_media:
            medium = dr.gather(mi.MediumPtr, media_around(self._scene, vertices), place)
            within = mi.Bool(medium != mi.MediumPtr(None))
            effect = dr.select(within, 1 + PATHS.index("media"), effect)
        dr.eval(place, ray, hit, effect, within)  # at once: each array that is gathered from would be traced by its own
        lane: Any = dr.compress(dr.gather(mi.Bool, self._wanted, effect))
        lanes = np.array(lane, dtype=np.int64)
        if lanes.size and medium is not None:
            medium, within = dr.gather(mi.MediumPtr, medium, lane), dr.gather(mi.Bool, within, lane)
        return GoingOn(
            lanes,
            np.array(effect)[lanes],
            dr.gather(mi.Ray3f, ray, lane),
            dr.gather(mi.PreliminaryIntersection3f, hit, lane),
            medium,
            ~within,
        )

    def sampler(self, vertices: NDArray[np.int64], lanes: int) -> Any:
        """The sampler, seeded for paths of a block."""
        seed = np.random.SeedSequence([self._seed, 1, int(vertices[0])]).generate_state(1)[0]
        self._sampler.seed(self._scene.mi.UInt32(int(seed)), lanes)
        return self._sampler

    def _rays(self, vertices: NDArray[np.int64]) -> tuple[Any, Any]:
        """Places among the receivers, and rays, those of one receiver side by side."""
        import drjit as dr

        mi, scene, half = self._scene.mi, self._scene, self._samples // 2
        lane = dr.arange(mi.UInt32, vertices.size * self._samples)
        place = lane // dr.opaque(mi.UInt32, self._samples)
        among = lane - place * self._samples
        second = among >= half
        among = dr.select(second, among - half, among)
        # By the receiver and the half, whatever block it is in, the same shifts.
        number = 2 * dr.gather(mi.UInt32, mi.UInt32(vertices), place) + dr.select(second, 1, 0)
        key = int(np.random.SeedSequence([self._seed, 0]).generate_state(1)[0])
        shifts = mi.sample_tea_32(number, dr.opaque(mi.UInt32, key))
        u = [mi.Float(among * mi.UInt32(step) + shift) * _UNIT for step, shift in zip(_STEPS, shifts, strict=True)]
        frames = rotation_to(scene.receivers.normals[vertices])
        outward = upload_frames(mi, frames)(place, mi.warp.square_to_cosine_hemisphere(mi.Point2f(u[0], u[1])))
        return place, mi.Ray3f(upload_origins(mi, scene.ray_origins, vertices)(place, outward), outward)


def media_around(scene: Scene, vertices: NDArray[np.int64]) -> Any:
    """MediumPtr, what medium the rays of receivers start in; null for none."""
    import drjit as dr

    mi = scene.mi
    medium = medium_at(mi, scene.geometry, mi.Point3f(scene.ray_origins.front[vertices].T.astype(np.float32)))
    dr.eval(medium)  # by itself: OptiX traces one scene in a kernel, and what follows may be traced in another
    return medium
