"""A scene that is loaded and planned: what estimators are made from."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.paths.media import media_of
from slepian_prt.renderer.shape_names import shape_name
from slepian_prt.scene.loading import open_scene
from slepian_prt.scene.scene import Scene
from slepian_prt.transport.direct import DirectTransfer
from slepian_prt.transport.effects import Effect, Plan
from slepian_prt.transport.estimator import Estimator
from slepian_prt.transport.first_rays import media_around
from slepian_prt.transport.glossy import ViewTransfer
from slepian_prt.transport.interreflection import gather_operator
from slepian_prt.transport.lamps import Lamps, find_lamps
from slepian_prt.transport.settings import TransportSettings
from slepian_prt.transport.survey import Survey, SurveyedScene

if TYPE_CHECKING:
    from slepian_prt.scene.loading import SceneSource

log = logging.getLogger(__name__)

# What fills blocks of vectors, by `Plan.estimator`. A new estimator is a file of its own and a line here.
ESTIMATORS: dict[str, Callable[[Scene, TransportSettings, Plan], Estimator[Any]]] = {
    "direct": DirectTransfer.planned,
    "view": ViewTransfer.planned,
}

# Blocked part of the light beyond which a mesh is more likely inside out than meant.
_NEARLY_ALL = 0.97

# What is looked at to tell that from a model in a case: vertices, and directions from each.
_CLOSED_VERTICES, _CLOSED_NODES = 256, 64


@contextmanager
def plan_scene(
    scene: SceneSource,
    settings: TransportSettings,
    on_plan: Callable[[tuple[Effect, ...]], None] = lambda _: None,
    *,
    lamps: bool = True,
) -> Iterator[PlannedScene]:
    """Load a scene and plan its transport; usable inside the with-block, with Mitsuba.

    Parameters
    ----------
    scene : as of `precompute`
    settings : TransportSettings
    on_plan : callable
        Given the effects of the plan.
    lamps : bool
        Whether light that is not distant is wanted.

    Raises
    ------
    UserError
        As `open_scene`; no face that can be lit.
    """
    clock = Clock()
    asked = {name: getattr(settings, name) for name in ("albedo", "view", "crease_angle", "parameters")}
    with open_scene(scene, **asked) as opened:
        if not opened.receivers.active.any():
            raise UserError(f"{opened.path}: no face can be lit; export the mesh again")
        clock.stop("load")
        survey = Survey.of(opened, settings.seed, paths=settings.view is None)
        view = opened.view if settings.view is not None else None
        found = replace(find_lamps(opened, settings.seed), wanted=lamps)
        plan = survey.plan(settings.bandlimit, settings.samples, settings.effects, view)
        plan = found.add_rows(plan, settings.samples)
        on_plan(plan.effects)
        _remark_on_closed(opened, plan.shadows, settings.seed)
        clock.stop("plan")
        yield PlannedScene(settings, survey, plan, clock, found)


@dataclass(frozen=True, eq=False)
class PlannedScene:
    """A scene that is loaded and planned.

    Attributes
    ----------
    settings : TransportSettings
    survey : SurveyedScene
        A `Survey`, but for scenes that were planned by another process (`portable`).
    plan : Plan
    clock : Clock
    lamps : Lamps
    """

    settings: TransportSettings
    survey: SurveyedScene
    plan: Plan
    clock: Clock
    lamps: Lamps

    def with_settings(self, **changes: Any) -> PlannedScene:
        """The same scene, planned with other settings than ``albedo`` and ``view``, with a clock of its own."""
        assert isinstance(self.survey, Survey)
        settings = replace(self.settings, **changes)
        plan = self.survey.plan(settings.bandlimit, settings.samples, settings.effects, self.plan.view)
        plan = self.lamps.add_rows(plan, settings.samples)
        return replace(self, settings=settings, plan=plan, clock=Clock(self.clock.seconds))

    def nodes(self, samples: float) -> int:
        """As of `Survey.nodes`."""
        assert isinstance(self.survey, Survey)
        return self.survey.nodes(samples)

    @property
    def scene(self) -> Scene:
        """As it is to be traced: with the boundaries of media, if these are simulated."""
        return self.survey.scene.with_media if self._has_media else self.survey.scene

    @cached_property
    def within_media(self) -> NDArray[np.bool_]:
        """(V,) receivers in participating media that are simulated: paths bring all their light."""
        scene = self.scene
        within = np.zeros(len(scene.receivers), dtype=bool)
        if self._has_media and media_of(scene.mi, scene.geometry):
            active = np.flatnonzero(scene.receivers.active)
            medium = media_around(scene, active)
            within[active] = np.array(medium != scene.mi.MediumPtr(None))
        return within

    @property
    def _has_media(self) -> bool:
        return self.plan.paths is not None and self.plan.paths.media

    @property
    def by_blocks(self) -> bool:
        """Whether receivers do not depend on each other, so that transfer need not be held all at once."""
        return self.plan.view is None and not self.plan.interreflection and self.plan.paths is None

    def estimator(self) -> Estimator[Any]:
        """What fills blocks of transfer vectors as planned, but for light between surfaces."""
        return ESTIMATORS[self.plan.estimator](self.scene, self.settings, self.plan)


def _remark_on_closed(scene: Scene, shadows: Effect, seed: int) -> None:
    """Faces that point inward, if that can be why so much of the light is blocked."""
    if shadows.contribution is None or shadows.contribution <= _NEARLY_ALL:
        return
    if scene.loaded is None:
        subject = "this"
    elif closed := _closed_by_themselves(scene, seed):
        subject = f"shape '{closed[0]}'" if len(closed) == 1 else f"each of shapes {', '.join(map(repr, closed))}"
    else:
        return  # what stands in a case or in a room is dark on either side of its faces
    log.info(
        "%s: %.0f %% of the light is blocked; if %s is no closed room, its faces point inward: flip them",
        scene.path,
        100.0 * shadows.contribution,
        subject,
    )


def _closed_by_themselves(scene: Scene, seed: int) -> list[str]:
    """Names of the shapes that see hardly anything but the fronts of their own faces."""
    active = np.flatnonzero(scene.receivers.active)
    chosen = np.random.default_rng(seed).choice(active, min(_CLOSED_VERTICES, active.size), replace=False)
    gather = gather_operator(scene, _CLOSED_NODES, chosen, None, seed)
    shapes = enumerate(scene.loaded.shapes())
    shining = {shape_name(shape, index) for index, shape in shapes if shape.is_emitter()}  # lamps may face inward
    names = []
    for part in scene.parts:
        if part.name in shining:
            continue
        own = (gather.rows >= part.first) & (gather.rows < part.end)
        if own.any() and gather.weights[own, part.first : part.end].sum() > _NEARLY_ALL * own.sum():
            names.append(part.name)
    return names


class Clock:
    """Wall-clock time by stage.

    Attributes
    ----------
    seconds : dict of str to float
    """

    def __init__(self, seconds: dict[str, float] | None = None) -> None:
        self.seconds: dict[str, float] = dict(seconds or {})
        self._last = time.perf_counter()

    def stop(self, stage: str) -> None:
        """Give the time since the last call, or since the clock was made, to a stage."""
        now = time.perf_counter()
        self.seconds[stage] = now - self._last
        self._last = now
