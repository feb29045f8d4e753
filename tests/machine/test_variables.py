"""Variables come back as they were."""

import os

import pytest

from slepian_prt.machine.variables import variable_set

NAME = "SLEPIAN_PRT_TEST_OF_VARIABLES"


@pytest.mark.parametrize("before", [None, "", "old"])
def test_what_was_there_comes_back(before, monkeypatch):
    if before is None:
        monkeypatch.delenv(NAME, raising=False)
    else:
        monkeypatch.setenv(NAME, before)
    with variable_set(NAME, "new"):
        assert os.environ[NAME] == "new"
        with pytest.raises(KeyError), variable_set(NAME, "inner"):
            raise KeyError(os.environ[NAME])
        assert os.environ[NAME] == "new"
    assert os.environ.get(NAME) == before
