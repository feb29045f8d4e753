"""The browser, one for a session, and pages of it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from tests.browser import Modules, open_chromium


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Playwright's headless Chromium; tests without one are skipped."""
    with open_chromium() as chromium:
        yield chromium


@pytest.fixture(scope="session")
def modules(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Modules:
    """A page to run the viewer's modules in."""
    return Modules(browser, tmp_path_factory.mktemp("modules"))
