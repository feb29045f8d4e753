"""Compressed transfer of a scene with one call."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import TYPE_CHECKING, Any

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.compression.stream import compress_scene
from slepian_prt.distributed.given import given_crew
from slepian_prt.errors import UserError
from slepian_prt.transport.effects import Effect
from slepian_prt.transport.settings import TransportSettings

if TYPE_CHECKING:
    from slepian_prt.scene.loading import SceneSource


def precompute_compressed(
    scene: SceneSource,
    *,
    client: Any = None,
    on_plan: Callable[[tuple[Effect, ...]], None] = lambda _: None,
    advance: Callable[[int, int], None] = lambda _done, _total: None,
    report: Callable[[str], None] = lambda _: None,
    **settings: Any,
) -> CompressedTransfer:
    """Transfer of a scene, compressed as it is traced: its vectors are never held all at once, if they need not be.

    What the command ``precompute`` does. Work that is killed goes on from the blocks of vertices that were finished
    when it is started again with the same arguments.

    Parameters
    ----------
    scene : as of `precompute`
    client : distributed.Client, cluster, or address of a scheduler, optional
        Dask's workers that trace and code; the result is the same with any number of them, and without.
    on_plan, advance : as of `precompute`
    report : callable
        Told what is being done.
    **settings
        As of `precompute` and `compress`: ``bandlimit``, ``samples``, ``tolerance``, ….

    Raises
    ------
    UserError
        As these, an unknown setting, and what is wrong with the workers.
    """
    transport, compression = settings_of_both(settings)
    with given_crew(client) as crew:
        return compress_scene(scene, compression, transport, on_plan=on_plan, advance=advance, report=report, crew=crew)


def settings_of_both(settings: Mapping[str, Any]) -> tuple[TransportSettings, CompressionSettings]:
    """Settings by name, as those of transport and of compression.

    Raises
    ------
    UserError
        One that neither has; numbers out of range.
    """
    kinds = (TransportSettings, CompressionSettings)
    transport, compression = ({field.name for field in fields(kind)} for kind in kinds)
    unknown = sorted(set(settings) - transport - compression)
    if unknown:
        raise UserError(f"{unknown[0]!r} is no setting of precompute or compress")
    return (
        TransportSettings(**{name: value for name, value in settings.items() if name in transport}),
        CompressionSettings(**{name: value for name, value in settings.items() if name in compression}),
    )
