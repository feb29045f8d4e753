"""Workers that a command shares its work among."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from slepian_prt.cli.messages import note
from slepian_prt.errors import UserError

if TYPE_CHECKING:
    from slepian_prt.distributed.crew import Crew

_SOURCES = ("workers", "scheduler", "scheduler_file")


@contextmanager
def crew_of(options: Mapping[str, Any]) -> Iterator[Crew | None]:
    """The crew that `crew_options` ask for, None if they ask for none; where its dashboard is, is said.

    Raises
    ------
    UserError
        Options that exclude each other, and as of `open_crew`.
    """
    given = {name: options[name] for name in _SOURCES if options.get(name) is not None}
    certificates = [name for name in ("tls_ca_file", "tls_cert", "tls_key") if options.get(name) is not None]
    if len(given) > 1:
        raise UserError(f"{' and '.join(f'`{name}`' for name in given)} are given; give one of them")
    if not given:
        if certificates:
            raise UserError(
                f"`{certificates[0]}` is about workers; give `scheduler`, `scheduler_file` or `workers` too"
            )
        yield None
        return
    from slepian_prt.distributed.connection import make_security
    from slepian_prt.distributed.crew import open_crew

    security = make_security(*(options.get(name) for name in ("tls_ca_file", "tls_cert", "tls_key")))
    is_done = False
    try:
        with open_crew(**given, security=security) as crew:
            if crew.address:
                note(f"dashboard: {crew.address}")
            yield crew
            is_done = True
    except KeyboardInterrupt:
        if not is_done:  # else all is written, and the workers are sent home
            raise
