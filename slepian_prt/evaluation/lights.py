"""The environments that something is measured under: maps, or the light of the scene itself."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from slepian_prt.errors import UserError
from slepian_prt.lighting.environment import Environment
from slepian_prt.scene.loading import may_have_light
from slepian_prt.scene.scene import Scene

if TYPE_CHECKING:
    from slepian_prt.scene.loading import SceneSource


def check_lights(scene: SceneSource, environments: Sequence[Environment]) -> None:
    """Raise UserError, before the scene is opened, if there is no map and it cannot have a light of its own."""
    if not environments and not may_have_light(scene):
        raise UserError("no light: name a map with `environment` (only a Mitsuba .xml scene may have its own)")


def lights_of(scene: Scene, environments: Sequence[Environment]) -> tuple[Environment, ...]:
    """The maps, or without any the scene's own distant light.

    Raises
    ------
    UserError
        There is neither, or the scene's own light is black.
    """
    if environments:
        return tuple(environments)
    if scene.environment is None:
        raise UserError(f"{scene.path}: the scene has no distant light of its own; name a map with `environment`")
    if not scene.environment.texels.any():
        raise UserError(f"{scene.path}: the scene's own distant light is black; name a map with `environment`")
    return (scene.environment,)
