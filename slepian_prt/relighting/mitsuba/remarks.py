"""What integrators say in Mitsuba's log, and how it is heard where that is not shown."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

_PREFIX = "slepian_prt: "


def log_warning(mi: Any, text: str) -> None:
    """A sentence in Mitsuba's log, bare: `mi.Log` puts the file, line and function of ours before it that called it."""
    level, logger, line = mi.LogLevel.Warn, mi.logger(), f"{_PREFIX}{text}"
    if level >= logger.error_level():  # the user wants warnings to be errors
        mi.Log(level, line)
    elif level >= logger.log_level():
        for number in range(logger.appender_count()):
            logger.appender(number).append(level, line)


@contextmanager
def heard_remarks(mi: Any) -> Iterator[list[str]]:
    """What integrators of ours say within the block, in a list; neither that nor Mitsuba's warnings are shown."""
    remarks: list[str] = []

    class Listener(mi.Appender):
        def append(self, _level: Any, text: str) -> None:
            if text.startswith(_PREFIX):
                remarks.append(text.removeprefix(_PREFIX))

        def log_progress(self, *_: Any) -> None:
            pass

    logger = mi.logger()
    levels = logger.log_level(), logger.error_level()
    shown = [logger.appender(number) for number in range(logger.appender_count())]
    try:
        logger.clear_appenders()
        logger.add_appender(Listener())
        logger.set_error_level(mi.LogLevel.Error)
        logger.set_log_level(mi.LogLevel.Warn)
        yield remarks
    finally:
        logger.clear_appenders()
        for appender in shown:
            logger.add_appender(appender)
        logger.set_log_level(levels[0])
        logger.set_error_level(levels[1])
