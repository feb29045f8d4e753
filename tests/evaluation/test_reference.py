"""References are of distant light alone, whatever else shines in a scene."""

import numpy as np
import pytest

from slepian_prt.evaluation.reference import render_reference, vertex_reference
from slepian_prt.lighting.environment import make_environment
from slepian_prt.scene.loading import open_scene

# A mesh keeps its own vertices, and what reflects nothing diffusely its own shape: both would go on shining.
LAMPS = {
    "mesh": '<shape type="obj" id="lamp"><string name="filename" value="lamp.obj"/><bsdf type="diffuse"/>{}</shape>',
    "sphere": '<shape type="sphere" id="lamp"><point name="center" x="0" y="1" z="0"/>'
    '<float name="radius" value="0.2"/><bsdf type="conductor"/>{}</shape>',
}
SHINES = '<emitter type="area"><rgb name="radiance" value="50"/></emitter>'


def scene_file(path, kind, emitter):
    corners = [(-0.15, 1, -0.15), (0.15, 1, -0.15), (0.15, 1, 0.15), (-0.15, 1, 0.15)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + ["f 1 2 3", "f 1 3 4"]
    (path.parent / "lamp.obj").write_text("\n".join(lines) + "\n")
    floor = (
        '<shape type="rectangle" id="floor"><transform name="to_world"><rotate x="1" angle="-90"/><scale value="3"/>'
        '</transform><bsdf type="diffuse"/></shape>'
    )
    path.write_text(f'<scene version="3.0.0">{floor}{LAMPS[kind].format(emitter)}</scene>')
    return path


@pytest.mark.parametrize("kind", LAMPS)
def test_lamps_do_not_shine_in_references(kind, tmp_path):
    light = make_environment(np.ones((8, 16, 3)))
    pictures, vertices = [], []
    for name, emitter in (("on", SHINES), ("off", "")):
        with open_scene(scene_file(tmp_path / f"{name}.xml", kind, emitter)) as scene:
            drawn = render_reference(scene, light, width=16, noise=0.02, largest_samples=64, bounces=1)
            pictures.append(drawn.picture.radiance)
            vertices.append(vertex_reference(scene, light, noise=0.02, largest_samples=64, bounces=1).radiance)
    # A lamp of 50 would be many times as bright as the sky; what is left is noise of both, 2 % of the mean each.
    for on, off in (pictures, vertices):
        assert abs(on.mean() / off.mean() - 1.0) < 0.02
