"""What is recorded for one kernel sees the same objects all along, and nothing keeps scenes that are done with."""

import gc
import subprocess
import sys
from threading import Barrier, Thread

import pytest

from slepian_prt.relighting.mitsuba.lobes import Material
from slepian_prt.relighting.mitsuba.recording import without_collection
from tests.relighting.mitsuba.scenes import loaded, picture


@pytest.fixture
def collecting():
    """Python collects garbage, as it does unless it is told otherwise."""
    before = gc.isenabled()
    gc.enable()
    yield
    if not before:
        gc.disable()


def test_garbage_is_collected_again_after_the_last_recording(collecting):
    both_within = Barrier(2)

    def record():
        with without_collection():
            both_within.wait()

    other = Thread(target=record)
    with without_collection():
        other.start()
        both_within.wait()
        other.join()
        assert not gc.isenabled()
    assert gc.isenabled()
    with pytest.raises(ValueError, match="x"), without_collection():
        raise ValueError("x")
    assert gc.isenabled()


def test_a_user_who_collects_nothing_stays_so(collecting):
    gc.disable()
    with without_collection():
        pass
    assert not gc.isenabled()


def test_no_garbage_is_collected_while_a_picture_is_recorded(mi, folder, monkeypatch, collecting):
    seen, held_radiance = [], Material.held_radiance
    monkeypatch.setattr(
        Material, "held_radiance", lambda *given: (seen.append(gc.isenabled()), held_radiance(*given))[1]
    )
    picture(mi, loaded(mi, folder), spp=1)
    assert seen
    assert not any(seen)
    assert gc.isenabled()


# Without the above: "invalid redefinition of function", and the process is aborted.
_DRAW = """
import gc, sys
from slepian_prt.renderer.variants import imported_mitsuba
mi = imported_mitsuba()
from tests.variants import VARIANT
mi.set_variant(VARIANT)
import drjit as dr, slepian_prt as sp
from pathlib import Path
from slepian_prt.relighting.mitsuba.lobes import Material
from tests.relighting.mitsuba.scenes import loaded
sp.register()
folder = Path(sys.argv[1])
lamp = {"type": "sphere", "center": [0, 3, 3], "emitter": {"type": "area"}}
scene = loaded(mi, folder, emitter=lamp)
gc.disable()
garbage = {"scene": mi.load_dict({"type": "scene", "lamp": lamp})}
garbage["itself"] = garbage
del garbage
gc.enable()

held_radiance = Material.held_radiance
def at_a_bad_moment(*given):
    if gc.isenabled():
        gc.collect()
    return held_radiance(*given)

Material.held_radiance = at_a_bad_moment
dr.eval(mi.render(scene, spp=1))
"""


@pytest.mark.slow
def test_garbage_with_a_scene_in_it_does_not_abort_the_process(folder):
    done = subprocess.run([sys.executable, "-c", _DRAW, str(folder)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-300:]


def number_of_next_lamp(mi) -> int:
    """In Mitsuba's registry, where each number that is free is given away again."""
    import drjit as dr

    return int(mi.UInt32(dr.reinterpret_array(mi.UInt32, mi.EmitterPtr(mi.load_dict({"type": "point"}))))[0])


def test_a_scene_is_let_go_with_its_integrator(mi, folder):
    gc.collect()
    before = number_of_next_lamp(mi)
    for hides in (True, False):
        scene = loaded(mi, folder, lamp={"type": "point", "position": [0, 3, 3]}, integrator={"hide_emitters": hides})
        picture(mi, scene, spp=1)
        del scene
        gc.collect()
        assert number_of_next_lamp(mi) == before
