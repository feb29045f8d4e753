"""Pages of the browser."""

from __future__ import annotations

from typing import Any

import pytest

from tests.browser import Modules


@pytest.fixture(scope="session")
def modules(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Modules:
    """A page to run the viewer's modules in."""
    return Modules(browser, tmp_path_factory.mktemp("modules"))
