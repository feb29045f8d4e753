"""What receivers send toward a camera of light that comes to them by way of other surfaces.

Paths begin with samples of the receivers' own BSDFs, seen from the camera, and are followed until they escape. What
escapes at once is left to `glossy`, but for lobes that it does not have: mirrors, and what comes from behind.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.paths.tracer import PathTracer
from slepian_prt.scene.scene import Scene
from slepian_prt.scene.view import View
from slepian_prt.sphere.harmonics import num_coefficients
from slepian_prt.transport.estimator import overlapped
from slepian_prt.transport.glossy import ReceiverBSDFs, toward_camera
from slepian_prt.transport.held_faces import PATHS, Corners, HeldFaces
from slepian_prt.transport.path_light import Ends, LightSums, PathLight
from slepian_prt.transport.path_plan import first_directions
from slepian_prt.transport.planned import PlannedScene
from slepian_prt.transport.settings import TransportSettings

_RAYS_PER_BLOCK = 1 << 19

# Additive recurrence in three dimensions (Roberts 2018), by the root of x⁴ = x + 1.
_STEPS = tuple(int(step * 2**32) for step in (0.8191725133961645, 0.6710436067037893, 0.5497004779019703))

# Bounces toward a camera, where there is no limit to them.
_MANY = 128

# From 32 bits to [0, 1), so that rounding does not reach one.
_UNIT = (1.0 - 2.0**-24) * 2.0**-32


def bounces_toward(settings: TransportSettings) -> int:
    """Bounces toward a camera that are followed at most."""
    return _MANY if settings.bounces is None else settings.bounces


def trace_view_paths(planned: PlannedScene, report: Callable[[int], None]) -> PathLight:
    """Follow paths from all receivers that face the camera of the plan.

    Parameters
    ----------
    planned : PlannedScene
    report : callable
        Given the number of vertices finished since its last call.

    Returns
    -------
    PathLight
        Whose S is nothing: no surface holds light toward other surfaces.
    """
    rays, bandlimit = ViewPaths.planned(planned), planned.settings.bandlimit
    blocks = rays.blocks()
    rows = np.concatenate([block for _, block in blocks])
    sums = LightSums(rows, len(planned.scene.receivers), 3, num_coefficients(bandlimit), 1.0)
    for count in overlapped(blocks, lambda block: rays.trace(*block), lambda ends: sums.add(ends, bandlimit)):
        report(count)
    return sums.finished()


class ViewPaths:
    """Paths from blocks of receivers, each of one part of the scene.

    Parameters
    ----------
    scene : Scene
    view : View
    samples : int
        Of each receiver's BSDF, an even number.
    bounces : int
        That are followed at most.
    seed : int
    """

    def __init__(self, scene: Scene, view: View, samples: int, bounces: int, seed: int) -> None:
        mi = scene.mi
        self._scene, self._samples, self._seed = scene, samples, seed
        outgoing, self._facing = toward_camera(scene, view)
        self._bsdfs = ReceiverBSDFs(scene, outgoing)
        materials = HeldFaces(scene).materials
        self._tracer = PathTracer(mi, scene.geometry, materials, max_depth=bounces + 1)
        self._sampler = mi.load_dict({"type": "independent"})

    @classmethod
    def planned(cls, planned: PlannedScene) -> ViewPaths:
        """As a plan with a view wants them."""
        settings, view = planned.settings, planned.plan.view
        assert view is not None
        samples = first_directions(settings.samples)
        return cls(planned.scene, view, samples, bounces_toward(settings), settings.seed + 1)

    def blocks(self) -> list[tuple[int, NDArray[np.int64]]]:
        """Numbers of parts, and some of their receivers."""
        size, facing = max(1, _RAYS_PER_BLOCK // self._samples), np.flatnonzero(self._facing)
        parts = self._bsdfs.part_of(facing)
        return [
            (int(number), own[begin : begin + size])
            for number in np.unique(parts)
            for own in (facing[parts == number],)
            for begin in range(0, own.size, size)
        ]

    def trace(self, number: int, vertices: NDArray[np.int64]) -> Ends:
        """Follow the paths of a block of receivers."""
        import drjit as dr

        mi = self._scene.mi
        ray, weight, shown = self._first(number, vertices)
        hit = self._scene.geometry.ray_intersect_preliminary(ray)
        dr.eval(weight, ray, hit, shown)  # at once: each array that is gathered from would be traced by its own
        lane: Any = dr.compress((dr.max(dr.abs(weight)) > 0.0) & ~(shown & ~hit.is_valid()))
        lanes, rays = np.array(lane, dtype=np.int64), vertices.size * self._samples
        none, colours = np.zeros(0, np.int64), np.zeros((0, 3), np.float32)
        effects, corners = np.zeros(0, np.uint32), Corners(np.zeros((0, 3), np.int32), colours)
        further = np.zeros(len(PATHS), np.int64)
        nowhere = np.zeros((0, 3))
        if lanes.size == 0:
            return Ends(
                vertices, self._samples, none, nowhere, colours, effects, none, colours, effects, corners, further, rays
            )
        seed = np.random.SeedSequence([self._seed, 1, int(vertices[0])]).generate_state(1)[0]
        self._sampler.seed(mi.UInt32(int(seed)), lanes.size)
        ends = self._tracer.follow(
            self._sampler,
            dr.gather(mi.Ray3f, ray, lane),
            hit=dr.gather(mi.PreliminaryIntersection3f, hit, lane),
            throughput=dr.gather(mi.Color3f, weight, lane),
        )
        dr.eval(ends.escaped, ends.throughput, ends.ray, ends.points)
        out = np.flatnonzero(np.array(ends.escaped))
        return Ends(
            vertices,
            self._samples,
            lanes[out],
            np.array(ends.ray.d).T[out].astype(np.float64),
            np.array(ends.throughput).T[out],
            np.ones(out.size, np.uint32),
            none,
            colours,
            effects,
            corners,
            further,
            rays + int(np.array(ends.points, dtype=np.int64).sum()),
        )

    def _first(self, number: int, vertices: NDArray[np.int64]) -> tuple[Any, Any, Any]:
        """First rays, their weights (Color3f), and whether `glossy` has what escapes along them (Bool)."""
        import drjit as dr

        mi, scene, half = self._scene.mi, self._scene, self._samples // 2
        lane = dr.arange(mi.UInt32, vertices.size * self._samples)
        place = lane // dr.opaque(mi.UInt32, self._samples)
        among = lane - place * self._samples
        second = among >= half
        among = dr.select(second, among - half, among)
        receiver = 2 * dr.gather(mi.UInt32, mi.UInt32(vertices), place) + dr.select(second, 1, 0)
        keys = np.random.SeedSequence([self._seed, 0]).generate_state(2).tolist()
        shifts = [shift for key in keys for shift in mi.sample_tea_32(receiver, dr.opaque(mi.UInt32, key))]
        u = [mi.Float(among * mi.UInt32(step) + shift) * _UNIT for step, shift in zip(_STEPS, shifts, strict=False)]
        inside = mi.UInt32((vertices - self._bsdfs.first[number]).astype(np.uint32))
        point = dr.gather(mi.SurfaceInteraction3f, self._bsdfs.points[number], dr.gather(mi.UInt32, inside, place))
        bsdf = self._bsdfs.shapes[number].bsdf()
        drawn, weight = bsdf.sample(mi.BSDFContext(), point, u[0], mi.Point2f(u[1], u[2]))
        weight = dr.select(drawn.pdf > 0.0, mi.Color3f(mi.unpolarized_spectrum(weight)), 0.0)
        above, outward = drawn.wo.z > 0.0, point.to_world(drawn.wo)
        origins = scene.ray_origins
        front, feet = (mi.Point3f(p[vertices].T.astype(np.float32)) for p in (origins.front, origins.feet))
        front, feet = dr.gather(mi.Point3f, front, place), dr.gather(mi.Point3f, feet, place)
        origin = dr.select(above, front, 2.0 * feet - front)
        shown = above & ~mi.has_flag(drawn.sampled_type, mi.BSDFFlags.Delta)
        return mi.Ray3f(origin, outward), weight, shown
