"""A planned scene as it goes to other processes: what to load, and all that the plan took time to find.

Mesh files travel as arrays, so that workers need not have the file. Mitsuba scenes travel by name, with their meshes
and textures: workers must see the same folder. What they load there is compared with what was planned.
"""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.renderer.variants import chosen_variant
from slepian_prt.scene.loading import open_scene
from slepian_prt.scene.mesh import Mesh
from slepian_prt.scene.ray_origins import RayOrigins
from slepian_prt.scene.scene import Scene
from slepian_prt.transport.effects import Plan
from slepian_prt.transport.lamps import find_lamps
from slepian_prt.transport.planned import Clock, PlannedScene
from slepian_prt.transport.settings import TransportSettings
from slepian_prt.transport.survey import SurveyedScene

if TYPE_CHECKING:
    from slepian_prt.scene.loading import SceneSource

# Relative difference of geometry that is rounding.
_ALIKE = 1e-5


@dataclass(frozen=True, eq=False)
class PortableScene:
    """A planned scene that can be pickled.

    Attributes
    ----------
    source : Mesh, absolute path of an .xml, or dict of a Mitsuba scene
    settings : TransportSettings
    plan : Plan
    robust : bool
        Whether rays are traced in Embree's robust mode.
    ray_origins : RayOrigins
    pierced : (n, 2)
        As of `Scene`.
    lamps_wanted : bool
    variant : str
        Of Mitsuba.
    normals : (V, 3) or None
        Of the receivers; None where they travel themselves. Mitsuba adds those of faces up in any order, and rays
        must be turned alike everywhere.
    outline : Outline or None
        Of the geometry that is loaded there.
    """

    source: Mesh | str | dict[str, Any]
    settings: TransportSettings
    plan: Plan
    robust: bool
    ray_origins: RayOrigins
    pierced: NDArray[np.integer]
    lamps_wanted: bool
    variant: str
    normals: NDArray[np.float64] | None
    outline: Outline | None

    @contextmanager
    def open(self) -> Iterator[PlannedScene]:
        """The planned scene in this process, without a survey: what needs one cannot be done there.

        Raises
        ------
        UserError
            What `open_scene` raises; a scene that is another here than where it was planned.
        """
        is_mesh = isinstance(self.source, Mesh)
        options: dict[str, Any] = (
            {} if is_mesh else {"parameters": self.settings.parameters, "view": self.settings.view}
        )
        with chosen_variant(self.variant), open_scene(self.source, **options) as loaded:
            if self.outline is not None and not self.outline.agrees(outline_of(loaded)):
                raise UserError(
                    f"{loaded.path}: is not the same on all machines; put the scene and its files into a folder that "
                    "all of them share"
                )
            mesh = loaded.mesh if self.normals is None else replace(loaded.mesh, normals=self.normals)
            scene = replace(loaded, robust=self.robust, mesh=mesh)
            # These took most of the time of the plan.
            vars(scene).update(ray_origins=self.ray_origins, pierced=self.pierced)
            lamps = replace(find_lamps(scene, self.settings.seed), wanted=self.lamps_wanted)
            yield PlannedScene(self.settings, SurveyedScene(scene), self.plan, Clock(), lamps)


def make_portable(planned: PlannedScene, source: SceneSource) -> PortableScene:
    """The scene as it goes to other processes.

    Parameters
    ----------
    planned : PlannedScene
    source : as of `precompute`
        What it was loaded from.

    Raises
    ------
    UserError
        A scene that is in memory as objects of Mitsuba.
    """
    scene = planned.survey.scene
    sent: Mesh | str | dict[str, Any]
    if scene.loaded is None and not scene.occluders:
        sent = replace(scene.mesh)  # without what it has worked out of itself
    elif isinstance(source, str | Path):
        sent = str(Path(source).resolve())
    elif isinstance(source, dict) and can_be_pickled(source):
        sent = source
    else:
        raise UserError(
            f"{scene.path}: objects of Mitsuba cannot be sent to workers; give the path of an .xml scene, or a dict"
        )
    is_mesh = isinstance(sent, Mesh)
    return PortableScene(
        sent,
        planned.settings,
        planned.plan,
        scene.is_robust,
        scene.ray_origins,
        scene.pierced,
        planned.lamps.wanted,
        scene.mi.variant(),
        None if is_mesh else scene.mesh.normals,
        None if is_mesh else outline_of(scene),
    )


@dataclass(frozen=True)
class Outline:
    """What tells the geometry of a scene from another's, but for rounding.

    Attributes
    ----------
    shapes : tuple of tuple of int
        Of some arrays.
    norms, sums : tuple of float
        Of each its norm, and a sum in which every number has a weight of its own.
    """

    shapes: tuple[tuple[int, ...], ...]
    norms: tuple[float, ...]
    sums: tuple[float, ...]

    def agrees(self, other: Outline) -> bool:
        """Whether both may be the same scene."""
        if self.shapes != other.shapes:
            return False
        tolerances = (_ALIKE * norm for norm in self.norms)
        return all(abs(a - b) <= most for a, b, most in zip(self.sums, other.sums, tolerances, strict=True))


def outline_of(scene: Scene) -> Outline:
    """Of receivers and of the boxes of all shapes."""
    mesh = scene.mesh
    arrays: list[NDArray[Any]] = [mesh.positions, mesh.normals, mesh.faces, mesh.albedo, *scene.traced_bounds]
    flat = [np.ravel(array).astype(np.float64) for array in arrays]
    sums = tuple(float(values @ np.cos(np.arange(values.size))) for values in flat)
    return Outline(tuple(array.shape for array in arrays), tuple(float(np.linalg.norm(v)) for v in flat), sums)


def can_be_pickled(source: dict[str, Any]) -> bool:
    """Whether a dict of a Mitsuba scene holds nothing that is in this process alone."""
    try:
        pickle.dumps(source)
    except Exception:  # whatever the objects in it raise
        return False
    return True
