"""What a worker of a local cluster does first, as Dask's preload: it is quiet, and imports the renderer."""

from __future__ import annotations

import contextlib
import threading
from typing import Any

from slepian_prt.distributed.quiet import silence
from slepian_prt.errors import UserError


def _import_renderer() -> None:
    """While the worker connects and its client plans; what is wrong with it is told when the worker is examined."""
    with contextlib.suppress(UserError, ImportError):
        from slepian_prt.renderer.variants import imported_mitsuba

        imported_mitsuba()


def dask_setup(worker: Any) -> None:
    """Called by Dask when the worker begins."""
    silence()
    threading.Thread(target=_import_renderer, name="import of Mitsuba", daemon=True).start()
