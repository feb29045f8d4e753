import pickle
from pathlib import Path

import numpy as np
import pytest

from slepian_prt.errors import UserError
from slepian_prt.scene.mesh_files import read_mesh
from slepian_prt.transport.planned import plan_scene
from slepian_prt.transport.portable import make_portable
from slepian_prt.transport.settings import TransportSettings
from tests.conftest import bumpy
from tests.numerics import assert_exact

SETTINGS = TransportSettings(bandlimit=4, samples=64, effects="direct")

SCENE = """<scene version="3.0.0">
  <shape type="obj"><string name="filename" value="model.obj"/></shape>
  <shape type="rectangle" id="floor"><transform name="to_world"><scale value="3"/>
    <rotate x="1" angle="-90"/><translate y="-1.5"/></transform></shape>
</scene>"""


def write_obj(path: Path, scale: float) -> None:
    mesh = bumpy(2)
    vertices = "".join("v {:.7f} {:.7f} {:.7f}\n".format(*(scale * p)) for p in mesh.positions)
    path.write_text(vertices + "".join("f {} {} {}\n".format(*(face + 1)) for face in mesh.faces))


@pytest.fixture
def scene(tmp_path):
    write_obj(tmp_path / "model.obj", 1.0)
    (tmp_path / "scene.xml").write_text(SCENE)
    return tmp_path / "scene.xml"


def sent(source, settings=SETTINGS):
    """What other processes are sent, and all vectors as they are here."""
    with plan_scene(source, settings) as planned:
        return pickle.dumps(make_portable(planned, source)), planned.estimator().estimate().vectors


def vectors_there(content: bytes):
    with pickle.loads(content).open() as planned:
        return planned.estimator().estimate().vectors


@pytest.mark.parametrize("name", ["model.obj", "scene.xml"])
def test_other_processes_trace_the_same(name, scene):
    content, here = sent(scene.parent / name)
    assert np.ptp(here) > 0.0
    assert_exact(vectors_there(content), here, because="the same rays on the same machine")


def test_a_mesh_travels_itself(scene):
    path = scene.parent / "model.obj"
    content, here = sent(path)
    path.unlink()
    assert_exact(vectors_there(content), here, because="the same rays on the same machine")


def test_what_a_mesh_has_worked_out_of_itself_stays(scene):
    mesh = read_mesh(scene.parent / "model.obj")
    content, _ = sent(mesh)
    assert "receivers" in vars(mesh)
    assert "receivers" not in vars(pickle.loads(content).source)


def test_a_scene_that_is_another_there_is_refused(scene):
    content, _ = sent(scene)
    write_obj(scene.parent / "model.obj", 1.01)
    with pytest.raises(UserError, match=r"scene\.xml: is not the same on all machines"):
        vectors_there(content)


def test_a_scene_that_is_not_there_is_named(scene):
    content, _ = sent(scene)
    scene.unlink()
    with pytest.raises(UserError, match=r"scene\.xml: no such file"):
        vectors_there(content)


def test_a_dict_travels_if_it_holds_no_objects():
    mi = pytest.importorskip("mitsuba")
    plain = {"type": "scene", "ball": {"type": "sphere"}, "floor": {"type": "rectangle"}}
    content, here = sent(plain)
    assert_exact(vectors_there(content), here, because="the same rays on the same machine")
    mi.set_variant("llvm_ad_rgb")
    with pytest.raises(UserError, match="cannot be sent to workers"):
        sent({**plain, "ball": mi.load_dict({"type": "sphere"})})
