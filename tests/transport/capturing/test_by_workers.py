"""Captures by two workers, against the same in one process."""

import numpy as np
import pytest

from slepian_prt.errors import UserError
from slepian_prt.transport.capturing.capture import capture
from slepian_prt.transport.capturing.passes import TracerHere
from tests.numerics import assert_rounded
from tests.transport.capturing.scenes import llvm_mitsuba

SCENE = """<scene version="3.0.0">
<sensor type="perspective"><transform name="to_world"><lookat origin="0, -4, 2" target="0, 0, .5" up="0, 0, 1"/>
</transform><film type="hdrfilm"><integer name="width" value="14"/><integer name="height" value="12"/>
<rfilter type="box"/></film></sensor>
<emitter type="point"><point name="position" x="1" y="-1" z="2"/><rgb name="intensity" value="3, 2, 1"/></emitter>
<shape type="rectangle"><transform name="to_world"><scale value="1.5"/></transform>
<bsdf type="diffuse"><rgb name="reflectance" value=".8, .5, .2"/></bsdf></shape>
<shape type="sphere"><point name="center" x="0" y="0" z=".5"/><float name="radius" value=".4"/>
<bsdf type="{}"/></shape>
</scene>"""

# Products of a path's throughput, which kernels round by themselves, and the sum of so many paths.
TERMS = 1 << 10


@pytest.fixture(autouse=True)
def small_blocks(tmp_path, monkeypatch):
    """Four of them, and nothing kept between tests."""
    monkeypatch.setenv("SLEPIAN_PRT_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("slepian_prt.transport.capturing.passes.LANES", 50 * 16)
    llvm_mitsuba()


@pytest.fixture
def scene(tmp_path):
    (tmp_path / "box.xml").write_text(SCENE.format("conductor"))
    return tmp_path / "box.xml"


@pytest.mark.slow
def test_blocks_and_lamps(crew, scene):
    told = []
    options = {"samples": 64, "bandlimit": 2}
    here = capture(scene, **options)
    there = capture(scene, **options, client=crew.client, advance=lambda *done: told.append(done))
    assert np.ptp(here.vectors) > 0.0
    assert_rounded(there.vectors, here.vectors, TERMS)
    assert_rounded(there.film.background, here.film.background, TERMS)
    assert_rounded(there.fixed.direct, here.fixed.direct, TERMS)
    assert there.rays_traced == here.rays_traced
    assert sum(done for done, _ in told) == told[0][1]


@pytest.mark.slow
def test_what_was_finished_here_is_kept(crew, scene, monkeypatch):
    whole = capture(scene, samples=64, bandlimit=2)
    blocks = TracerHere.blocks

    def stopping(self, items):
        for number, means in enumerate(blocks(self, items)):
            if number == 3:
                raise KeyboardInterrupt
            yield means

    with monkeypatch.context() as patch:
        patch.setattr(TracerHere, "blocks", stopping)
        with pytest.raises(KeyboardInterrupt):
            capture(scene, samples=64, bandlimit=2)
    told = []
    again = capture(scene, samples=64, bandlimit=2, client=crew.client, advance=lambda *done: told.append(done))
    assert told[0][0] > len(whole.vectors) / 4
    assert_rounded(again.vectors, whole.vectors, TERMS)


def test_a_scene_in_memory_is_refused(crew, scene):
    import mitsuba

    with pytest.raises(UserError, match="objects of Mitsuba cannot be sent to workers; give the path of an"):
        capture(mitsuba.load_file(str(scene)), samples=16, bandlimit=1, client=crew.client)
