"""The `client` that functions of the library take."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from slepian_prt.distributed.crew import Crew


@contextmanager
def given_crew(client: Any) -> Iterator[Crew | None]:
    """The workers of a client, as of `open_crew`; a crew itself; None without one, and nothing of Dask is imported."""
    if client is None:
        yield None
        return
    from slepian_prt.distributed.crew import Crew, open_crew

    if isinstance(client, Crew):
        yield client
        return

    with open_crew(client=client) as crew:
        yield crew
