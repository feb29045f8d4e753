"""The integrator of a transfer in memory, for pictures that are not drawn from scene files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import PurePath
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.lighting.fitting import one_light
from slepian_prt.relighting.mitsuba.held_files import HeldFile, named_in_memory
from slepian_prt.relighting.mitsuba.integrator import NAME, register


def scene_integrator(
    mi: Any,
    packed: CompressedTransfer,
    *,
    lighting: ArrayLike | None = None,
    lamps: Mapping[str, Any] | None = None,
    albedo: str = "auto",
    fixed_lights: float = 1.0,
    hide_emitters: bool = False,
    max_depth: int = -1,
) -> Any:
    """A Mitsuba integrator `slepian_prt` that draws a transfer in memory.

    Parameters
    ----------
    mi : Mitsuba, in the ``llvm_*`` or ``cuda_*`` variant of the scene
    packed : CompressedTransfer
    lighting : (3, n²), optional
        Distant light in the world of the file that held surfaces are lit by, in place of the scene's own emitter.
    lamps : mapping of str to Mitsuba emitter, optional
        The scene's lamps by the names that the file has for them, as of `lamp_places`; by default they are found.
    albedo, fixed_lights, hide_emitters, max_depth
        As of the integrator.

    Raises
    ------
    UserError
        Lighting of another shape, or a parameter that the integrator refuses.
    """
    coefficients = None
    if lighting is not None:
        coefficients = one_light(lighting, packed.bandlimit).astype(np.float64)
    register()
    properties = mi.Properties(NAME)
    properties["albedo"] = albedo
    properties["fixed_lights"] = float(fixed_lights)
    properties["hide_emitters"] = bool(hide_emitters)
    properties["max_depth"] = int(max_depth)
    name = PurePath(packed.source or packed.mesh.name or "the transfer").name
    with named_in_memory(HeldFile(name, packed, coefficients, lamps)) as key:
        properties["transfer"] = key
        return mi.PluginManager.instance().create_object(properties)
