"""A planned scene as it goes to other processes: what to load, and all that the plan took time to find.

Mesh files travel as arrays, so that workers need not have the file. Mitsuba scenes travel by name, with their meshes
and textures: workers must see the same folder. What they load there is compared with what was planned.
"""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
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
    digest : bytes
        Of the geometry; empty where it travels itself.
    """

    source: Mesh | str | dict[str, Any]
    settings: TransportSettings
    plan: Plan
    robust: bool
    ray_origins: RayOrigins
    pierced: NDArray[np.integer]
    lamps_wanted: bool
    digest: bytes

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
        with open_scene(self.source, **options) as loaded:
            if self.digest and digest_geometry(loaded) != self.digest:
                raise UserError(
                    f"{loaded.path}: is not the same on all machines; put the scene and its files into a folder that "
                    "all of them share"
                )
            scene = replace(loaded, robust=self.robust)
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
    scene, digest = planned.survey.scene, b""
    sent: Mesh | str | dict[str, Any]
    if scene.loaded is None and not scene.occluders:
        sent = replace(scene.mesh)  # without what it has worked out of itself
    elif isinstance(source, str | Path):
        sent, digest = str(Path(source).resolve()), digest_geometry(scene)
    elif isinstance(source, dict) and can_be_pickled(source):
        sent, digest = source, digest_geometry(scene)
    else:
        raise UserError(
            f"{scene.path}: objects of Mitsuba cannot be sent to workers; give the path of an .xml scene, or a dict"
        )
    return PortableScene(
        sent,
        planned.settings,
        planned.plan,
        scene.is_robust,
        scene.ray_origins,
        scene.pierced,
        planned.lamps.wanted,
        digest,
    )


def digest_geometry(scene: Scene) -> bytes:
    """Of receivers and of the boxes of all shapes."""
    digest, mesh = hashlib.sha256(), scene.mesh
    for array in (mesh.positions, mesh.normals, mesh.faces, mesh.albedo, *scene.traced_bounds):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.digest()


def can_be_pickled(source: dict[str, Any]) -> bool:
    """Whether a dict of a Mitsuba scene holds nothing that is in this process alone."""
    try:
        pickle.dumps(source)
    except Exception:  # whatever the objects in it raise
        return False
    return True
