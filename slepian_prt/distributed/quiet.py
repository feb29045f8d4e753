"""Dask's own remarks, which are about its insides, kept off the standard error of ours."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

# Of Dask, and of what it stands on. Some of their children have levels of their own.
_TALKERS = ("distributed", "tornado", "bokeh", "asyncio")


def silence() -> dict[logging.Logger, int]:
    """Let no logger of Dask say anything; returns the levels that were changed."""
    children = [name for name in logging.root.manager.loggerDict if name.split(".")[0] in _TALKERS]
    loggers = [logging.getLogger(name) for name in sorted({*_TALKERS, *children})]
    before = {logger: logger.level for logger in loggers if logger.name in _TALKERS or logger.level}
    for logger in before:
        logger.setLevel(logging.CRITICAL + 1)
    return before


@contextmanager
def quiet() -> Iterator[None]:
    """Dask says nothing inside of the with-block."""
    before = silence()
    try:
        yield
    finally:
        for logger, level in before.items():
            logger.setLevel(level)


@contextmanager
def kept_environment(names: Iterable[str]) -> Iterator[None]:
    """Environment variables of these names are after the with-block as they were before."""
    before = {name: os.environ.get(name) for name in names}
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
