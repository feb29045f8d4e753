"""Processes that are forked from one that uses Mitsuba."""

import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")

CODE = """
import os, sys
import numpy as np
import slepian_prt as sp
from slepian_prt.renderer.variants import mitsuba
packed = sp.load({path!r})
light = np.ones((3, (packed.bandlimit + 1) ** 2))
if {used}:
    with mitsuba():
        pass
sys.stdout.flush()
if os.fork() == 0:
    print(np.isfinite(sp.relight(packed, light)).all())
    print(np.isfinite(sp.project_environment({sky!r}, 2)).all())
    try:
        with mitsuba():
            print("works")
    except sp.UserError as error:
        print(error)
    sys.stdout.flush()
    os._exit(0)
os.wait()
"""


@pytest.mark.slow
@pytest.mark.parametrize("used", [True, False])
def test_relighting_goes_on_and_what_needs_mitsuba_says_how_to(used, tmp_path):
    import slepian_prt as sp
    from slepian_prt.examples import example

    mesh = sp.make_mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    path = tmp_path / "triangle.prt"
    sp.compress(sp.precompute(mesh, 2, 16), clusters=1).save(path)
    code = CODE.format(path=str(path), used=used, sky=str(example("sky")))
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=100)
    relit, projected, mitsuba = run.stdout.splitlines()
    assert (relit, projected, run.stderr) == ("True", "True", "")
    assert ("spawn" in mitsuba) if used else (mitsuba == "works")
