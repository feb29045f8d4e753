"""What is said of scenes that are nearly dark: advice only where it can be true."""

import numpy as np
import pytest
import trimesh

from slepian_prt.transport.planned import plan_scene
from slepian_prt.transport.settings import TransportSettings
from tests.conftest import inside_out, sphere

GRAY = '<bsdf type="diffuse"/>'
SMALL_BALL = f'<shape type="sphere" id="ball"><float name="radius" value="0.3"/>{GRAY}</shape>'


def remarks(scene, caplog) -> list[str]:
    with caplog.at_level("INFO", "slepian_prt"), plan_scene(scene, TransportSettings(2, 16)):
        pass
    return [text for text in caplog.messages if "of the light is blocked" in text]


def test_a_mesh_inside_out(caplog):
    (remark,) = remarks(inside_out(sphere(3)), caplog)
    assert remark == (
        "sphere: 100 % of the light is blocked; if this is no closed room, its faces point inward: flip them"
    )


def test_a_mesh_that_is_lit(caplog):
    assert remarks(sphere(2), caplog) == []


@pytest.fixture
def scene(tmp_path):
    def write(content: str):
        path = tmp_path / "scene.xml"
        path.write_text(f'<scene version="3.0.0">{content}</scene>')
        return path

    ball = trimesh.creation.icosphere(3)
    trimesh.Trimesh(ball.vertices, ball.faces[:, ::-1]).export(tmp_path / "inward.obj")
    return write


@pytest.mark.parametrize(
    "around",
    [
        '<shape type="cube"><bsdf type="dielectric"/></shape>',
        '<shape type="sphere"><bsdf type="conductor"/></shape>',
        "".join(
            f'<shape type="rectangle"><transform name="to_world"><translate z="-1"/><rotate {turn}/></transform>'
            '<bsdf type="conductor"/></shape>'
            for turn in ('y="1" angle="0"', 'y="1" angle="90"', 'y="1" angle="180"', 'y="1" angle="270"')
            + ('x="1" angle="90"', 'x="1" angle="270"')
        ),
    ],
    ids=["glass case", "metal ball", "metal walls"],
)
def test_a_model_in_a_case_has_no_inward_faces(around, scene, caplog):
    assert remarks(scene(SMALL_BALL + around), caplog) == []


def test_a_shape_inside_out_is_named(scene, caplog):
    inward = f'<shape type="obj" id="inward"><string name="filename" value="inward.obj"/>{GRAY}</shape>'
    (remark,) = remarks(scene(inward), caplog)
    assert remark.endswith("if shape 'inward' is no closed room, its faces point inward: flip them")


def test_a_room_of_one_shape_is_named_alone(scene, caplog):
    """The ball in it sees the room, and not itself."""
    room = f'<shape type="obj" id="room"><string name="filename" value="inward.obj"/>{GRAY}</shape>'
    (remark,) = remarks(scene(room + SMALL_BALL.replace("0.3", "0.05")), caplog)
    assert "shape 'room' is no closed room" in remark
    assert "ball" not in remark.split(": ", 1)[1]


def test_settings_keep_parameters_as_they_are_written():
    settings = TransportSettings(parameters={"spp": np.int64(16), "inside": False, "size": 0.5})
    assert settings.parameters == {"spp": "16", "inside": "false", "size": "0.5"}
