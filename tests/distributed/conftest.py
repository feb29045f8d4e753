"""A cluster of other people's, in threads."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from typing import Any

import pytest


@pytest.fixture
def cluster() -> Iterator[Any]:
    """One worker of somebody's cluster, in our process."""
    with threaded_cluster() as made:
        yield made


def threaded_cluster(**options: Any) -> Any:
    """A cluster whose scheduler and only worker are threads of ours, which begins and ends quickly."""
    distributed = pytest.importorskip("distributed")
    return distributed.LocalCluster(
        n_workers=1,
        processes=False,
        memory_limit=0,
        dashboard_address="127.0.0.1:0",
        silence_logs=logging.CRITICAL + 1,
        **{"threads_per_worker": 1, "protocol": "tcp", "host": "127.0.0.1", **options},
    )
