"""References are of distant light alone, whatever else shines in a scene."""

import numpy as np
import pytest

from slepian_prt.evaluation.reference import render_reference, vertex_reference
from slepian_prt.lighting.environment import make_environment
from slepian_prt.scene.loading import open_scene

LAMPS = {
    "rectangle": '<shape type="rectangle" id="lamp"><transform name="to_world"><rotate x="1" angle="90"/>'
    '<translate y="2"/></transform>{}</shape>',
    "sphere": '<shape type="sphere" id="lamp"><point name="center" x="0" y="2" z="0"/>{}</shape>',
}
SHINES = '<emitter type="area"><rgb name="radiance" value="50"/></emitter>'


def scene_file(path, kind, emitter):
    lamp = LAMPS[kind].format('<bsdf type="diffuse"><rgb name="reflectance" value="0.4"/></bsdf>' + emitter)
    floor = (
        '<shape type="rectangle" id="floor"><transform name="to_world"><rotate x="1" angle="-90"/><scale value="3"/>'
        '</transform><bsdf type="diffuse"/></shape>'
    )
    path.write_text(f'<scene version="3.0.0">{floor}{lamp}</scene>')
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
