"""Transfer vectors of a scene and how they came about."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.errors import UserError, check_bandlimit
from slepian_prt.lighting.environment import Environment
from slepian_prt.scene.loading import open_scene
from slepian_prt.scene.mesh import Mesh
from slepian_prt.scene.scene import Part, Scene
from slepian_prt.scene.sensors import View
from slepian_prt.sphere.harmonics import num_coefficients
from slepian_prt.transport.effects import SIMULATED, Effect, Plan, Survey, check_effects
from slepian_prt.transport.glossy import view_transfer
from slepian_prt.transport.interior import borrow
from slepian_prt.transport.interreflection import GATHER_SHARE, bounced, count_bounces, gather_operator
from slepian_prt.transport.visibility import DirectTransfer, shadowed_transfer

log = logging.getLogger(__name__)

LARGEST_BANDLIMIT = 50
LARGEST_SAMPLES = 1 << 16
LARGEST_BOUNCES = 1000

# Blocked part of the light beyond which a mesh is more likely inside out than meant.
_NEARLY_ALL = 0.97


@dataclass(frozen=True)
class Transfer:
    """How distant light becomes radiance at each vertex, before the albedo.

    Attributes
    ----------
    vectors : (V, channels, (L+1)²) float32
        Real SH coefficients of the transfer function, for unit albedo of the receiver. One channel stands for all
        three where surfaces do not tint each other's light.
    mesh : Mesh
    parts : tuple of Part
    bandlimit, samples, seed : int
    effects : tuple of Effect
    bounces : int
        Of light between surfaces.
    rays_traced : int
    seconds : dict of str to float
        Wall-clock time of each stage.
    source : str
        Path of the scene.
    environment : Environment or None
        The scene's own distant light.
    view : View or None
        The scene's camera.
    toward_view : bool
        Whether ``vectors`` hold the light that all materials send toward that camera, reflectance included.
    axes : (V, 3)
        What transport is concentrated about: the normals, or toward a view the reflection directions. Zero at
        vertices without transfer.
    """

    vectors: NDArray[np.float32]
    mesh: Mesh
    parts: tuple[Part, ...]
    bandlimit: int
    samples: int
    seed: int
    effects: tuple[Effect, ...]
    bounces: int
    rays_traced: int
    seconds: dict[str, float] = field(default_factory=dict)
    source: str = ""
    environment: Environment | None = None
    view: View | None = None
    toward_view: bool = False
    axes: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 3)))

    def __post_init__(self) -> None:
        if len(self.axes) != len(self.mesh.normals):
            object.__setattr__(self, "axes", self.mesh.normals)

    @property
    def positions(self) -> NDArray[np.float64]:
        """(V, 3) world space."""
        return self.mesh.positions

    @property
    def normals(self) -> NDArray[np.float64]:
        """(V, 3) unit normals, zero at vertices that no face uses."""
        return self.mesh.normals

    def at_bandlimit(self, bandlimit: int) -> Transfer:
        """The same transfer with fewer degrees, without the scene's own light."""
        vectors = self.vectors[:, :, : num_coefficients(bandlimit)]
        return replace(self, bandlimit=bandlimit, vectors=vectors, environment=None)


def precompute(
    scene: str | Path | Mesh,
    bandlimit: int = 10,
    samples: int = 1024,
    *,
    effects: str = "auto",
    bounces: int | None = None,
    albedo: ArrayLike | None = None,
    view: str | int | None = None,
    seed: int = 0,
    on_plan: Callable[[tuple[Effect, ...]], None] = lambda _: None,
    advance: Callable[[int, int], None] = lambda _done, _total: None,
) -> Transfer:
    """Transfer vectors of every vertex for distant light and diffuse surfaces.

    Parameters
    ----------
    scene : path of a mesh (ply, obj, stl, off, glb) or Mitsuba scene (xml), or a `Mesh`
    bandlimit : int in [0, 50]
    samples : int
        Rays per vertex over the hemisphere, on average; vertices that nothing can shadow get none.
    effects : str
        ``auto`` simulates what the scene calls for; ``direct`` shadows only; ``all``; ``none``; or some of shadows,
        interreflection, colour, with commas between.
    bounces : int, optional
        Of light between surfaces, where that is simulated. By default until the rest is less than a thousandth.
    albedo : one or three numbers in [0, 1], optional
        Of a mesh file, which says nothing about it.
    view : id or number of a camera of an .xml scene, optional
        Transfer toward that camera, of all materials but mirrors and glass; direct light only.
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
        Bandlimit, samples, bounces or effects out of range.
    """
    transport = TransportSettings(bandlimit, samples, effects, bounces, albedo, view, seed)
    with transport.opened(scene, on_plan) as planned:
        return planned.transfer(advance)


@dataclass(frozen=True)
class TransportSettings:
    """What is asked of transport; see `precompute`.

    Raises
    ------
    UserError
        A number out of range, or an unknown effect.
    """

    bandlimit: int = 10
    samples: int = 1024
    effects: str = "auto"
    bounces: int | None = None
    albedo: ArrayLike | None = None
    view: str | int | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        check_bandlimit(self.bandlimit, largest=LARGEST_BANDLIMIT)
        _check_count(self.samples, "samples", 1, LARGEST_SAMPLES)
        _check_count(self.seed, "seed", 0, None)
        if self.bounces is not None:
            _check_count(self.bounces, "bounces", 0, LARGEST_BOUNCES)
        check_effects(self.effects)

    @contextmanager
    def opened(
        self, scene: str | Path | Mesh, on_plan: Callable[[tuple[Effect, ...]], None] = lambda _: None
    ) -> Iterator[PlannedScene]:
        """The scene loaded and planned, with Mitsuba."""
        clock = Clock()
        with open_scene(scene, albedo=self.albedo, view=self.view) as opened:
            if not opened.mesh.receivers.active.any():
                raise UserError(f"{opened.path}: no face can be lit; export the mesh again")
            clock.stop("load")
            toward = opened.view if self.view is not None else None
            survey = Survey.of(opened, self.seed)
            plan = survey.plan(self.bandlimit, int(self.samples), self.effects, toward)
            on_plan(plan.effects)
            _remark_on_closed(opened.path, plan.effects)
            clock.stop("plan")
            yield PlannedScene(opened, self, survey, plan, toward, clock)


@dataclass(frozen=True, eq=False)
class PlannedScene:
    """A scene that is loaded and planned.

    Attributes
    ----------
    scene : Scene
    settings : TransportSettings
    survey : Survey
    plan : Plan
    toward : View or None
        The camera toward which all materials are simulated.
    clock : Clock
    """

    scene: Scene
    settings: TransportSettings
    survey: Survey
    plan: Plan
    toward: View | None
    clock: Clock

    def asked(self, transport: TransportSettings) -> PlannedScene:
        """The same scene, planned for other numbers, with a clock of its own; ``albedo`` and ``view`` stay."""
        plan = self.survey.plan(transport.bandlimit, int(transport.samples), transport.effects, self.toward)
        return replace(self, settings=transport, plan=plan, clock=Clock(self.clock.seconds))

    @property
    def by_blocks(self) -> bool:
        """Whether vertices do not depend on each other, so that transfer need not be held all at once."""
        return self.toward is None and not self.plan.interreflection

    def direct(self) -> DirectTransfer:
        """The source of direct transfer."""
        return DirectTransfer(
            self.scene, int(self.settings.bandlimit), self.plan.nodes, self.plan.shadowed, self.settings.seed
        )

    def transfer(self, advance: Callable[[int, int], None] = lambda _done, _total: None) -> Transfer:
        """All vectors, in memory."""
        transport, mesh, count = self.settings, self.scene.mesh, len(self.scene.mesh.positions)
        axes, taken = mesh.normals, 0
        if self.toward is None:
            vectors, taken, rays = self._diffuse(advance)
        else:
            vectors, axes, rays = view_transfer(
                self.scene,
                self.toward,
                transport.bandlimit,
                int(transport.samples),
                transport.seed,
                shadows=self.plan.effects[0].verdict == SIMULATED,
                advance=lambda n: advance(n, count),
            )
            self.clock.stop("transport")
            mesh = replace(mesh, albedo=np.ones_like(mesh.albedo))  # the reflectance is in the vectors
        return Transfer(
            vectors=vectors,
            mesh=mesh,
            parts=self.scene.parts,
            bandlimit=int(transport.bandlimit),
            samples=int(transport.samples),
            seed=transport.seed,
            effects=self.plan.effects,
            bounces=taken,
            rays_traced=rays,
            seconds=self.clock.seconds,
            source=self.scene.path,
            environment=self.scene.environment,
            view=self.scene.view,
            toward_view=self.toward is not None,
            axes=axes,
        )

    def _diffuse(self, advance: Callable[[int, int], None]) -> tuple[NDArray[np.float32], int, int]:
        """Transfer vectors (V, channels, (L+1)²) of diffuse surfaces as planned, the bounces taken, and rays traced."""
        scene, plan, transport = self.scene, self.plan, self.settings
        mesh = scene.mesh
        total = len(mesh.positions) + (plan.shadowed.size if plan.interreflection else 0)

        def report(done: int) -> None:
            advance(done, total)

        direct, blocked, rays = shadowed_transfer(
            scene, int(transport.bandlimit), plan.nodes, plan.shadowed, transport.seed, report
        )
        borrowed = borrow(scene, np.flatnonzero((blocked >= 1.0) & mesh.receivers.active))
        borrowed.fill(direct)
        borrowed.fill(blocked)
        self.clock.stop("transport")
        if not plan.interreflection:
            return direct[:, None, :], 0, rays
        nodes = max(1, round(GATHER_SHARE * transport.samples))
        gather = gather_operator(scene, nodes, plan.shadowed, blocked, transport.seed + 1, report)
        bounces = transport.bounces
        if bounces is None:
            bounces, _ = count_bounces(gather, mesh.albedo, np.where(mesh.receivers.active, 1.0 - blocked, 0.0))
        vectors = bounced(gather, mesh.albedo, direct, plan.channels, int(bounces))
        borrowed.fill(vectors)
        self.clock.stop("interreflection")
        return vectors, int(bounces), rays + gather.rays


def _check_count(value: object, name: str, smallest: int, largest: int | None) -> None:
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    good = whole and smallest <= value and (largest is None or value <= largest)  # type: ignore[operator]
    if not good:
        allowed = "a non-negative integer" if largest is None else f"an integer in [{smallest}, {largest}]"
        raise UserError(f"{name} must be {allowed}, not {value!r}")


def _remark_on_closed(path: str, effects: tuple[Effect, ...]) -> None:
    blocked = effects[0].contribution
    if blocked is not None and blocked > _NEARLY_ALL:
        log.info(
            "%s: %.0f %% of the light is blocked; if this is no closed room, its faces point inward: flip them",
            path,
            100.0 * blocked,
        )


class Clock:
    """Seconds between calls."""

    def __init__(self, seconds: dict[str, float] | None = None) -> None:
        self.seconds: dict[str, float] = dict(seconds or {})
        self._last = time.perf_counter()

    def stop(self, stage: str) -> None:
        now = time.perf_counter()
        self.seconds[stage] = now - self._last
        self._last = now
