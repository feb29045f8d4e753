"""The comparison of conventions sees what differs, and says in a line what it cannot have."""

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

SCRIPTS = Path(__file__).parents[2] / "scripts"


@pytest.fixture
def own_code(monkeypatch):
    monkeypatch.syspath_prepend(str(SCRIPTS))
    from conventions import own_code

    return own_code


def test_their_own_code_agrees(own_code, tmp_path):
    pytest.importorskip("pyshtools")
    assert own_code.shtools(own_code.Workshop(tmp_path, None)) < 1e-12


def test_a_wrong_sign_is_seen(own_code):
    import slepian_prt as sp

    def without_phase(coefficients):
        return np.abs(sp.real_sh(2, own_code.DIRECTIONS)) @ coefficients.T

    assert own_code._each("google", 2, without_phase) > 0.5


def test_what_cannot_be_had_is_said_in_a_line(own_code, tmp_path):
    workshop = own_code.Workshop(tmp_path, None)
    with pytest.raises(own_code.Missing, match="no-such-program"):
        workshop.run("no-such-program")
    with pytest.raises(own_code.Missing, match=r"failed \(.*why\)$"):
        workshop.run(sys.executable, "-c", "import sys; sys.exit('this is\\nwhy')")


def test_checkouts_that_are_there_are_taken(own_code, tmp_path):
    (tmp_path / "sources" / "PIFu").mkdir(parents=True)
    workshop = own_code.Workshop(tmp_path, tmp_path / "sources")
    assert workshop.checkout("PIFu") == tmp_path / "sources" / "PIFu"


def test_each_row_runs_code_of_its_own(own_code):
    """Of what is brought here, the first thing that each asks for: no two are the same code under two names."""
    asked = []

    def ask(*what):
        asked.append(what)
        raise own_code.Missing(what)

    bare = SimpleNamespace(checkout=ask, package=ask, run=ask, folder=Path("nowhere"))
    for name, (compare, _) in own_code.TOOLS.items():
        if name != "shtools":  # which is installed, or not compared
            with pytest.raises(own_code.Missing):
                compare(bare)
    assert len(set(asked)) == len(own_code.TOOLS) - 1
