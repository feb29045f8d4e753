"""The script for Blender, in Blender without its window: colours of vertices, also when the world is turned."""

from __future__ import annotations

import shutil
import subprocess

import numpy as np
import pytest

from slepian_prt.export.model import export_model
from slepian_prt.relighting.relight import relight
from tests.examples.conftest import EXAMPLES, Case, radiance_hdr, texels_of

pytestmark = pytest.mark.slow

SCRIPT = EXAMPLES / "blender" / "relight.py"

# After the script has run: what the vertices have, the world turned, and what they have then.
READ = """
import bpy, math, numpy as np
def colors():
    mesh = next(one for one in bpy.data.objects if "Radiance" in getattr(one.data, "attributes", {})).data
    values = np.empty(4 * len(mesh.vertices), dtype=np.float32)
    mesh.attributes["Radiance"].data.foreach_get("color", values)
    return values.reshape(-1, 4)[:, :3]
before = colors()
mapping = next(node for node in bpy.context.scene.world.node_tree.nodes if node.type == "MAPPING")
mapping.inputs["Rotation"].default_value[2] = math.radians(100.0)
bpy.context.view_layer.update()
np.savez("read.npz", before=before, after=colors())
"""


@pytest.mark.parametrize("attributes", ["float", "bytes"])
def test_colours_follow_the_world(tmp_path, case: Case, attributes):
    blender = shutil.which("blender")
    if blender is None:
        pytest.skip("no blender: install it (Debian: apt-get install blender python3-numpy)")
    export_model(case.packed, tmp_path / "model.glb", attributes=attributes)
    # Rows of Blender's maps are centred, those of Mitsuba's stand on the poles: both of the same light.
    rows = (np.arange(len(case.texels)) + 0.5) / len(case.texels)
    (tmp_path / "map.hdr").write_bytes(radiance_hdr(texels_of(rows)))
    (tmp_path / "read.py").write_text(READ)
    command = [blender, "--background", "--factory-startup", "--python-exit-code", "1", "--python", str(SCRIPT)]
    command += ["--python", str(tmp_path / "read.py"), "--", "model.glb", "map.hdr", "30"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    read = np.load(tmp_path / "read.npz")
    for name, degrees in (("before", 30.0), ("after", 100.0)):
        # u is 1/2 - atan2(y, x)/2π in Blender and atan2(x, -z)/2π here; Mapping turns what is looked up.
        expected = relight(case.packed, case.light(90.0 - degrees))
        found = read[name]
        assert np.sqrt(np.mean((found - np.maximum(expected, 0.0)) ** 2) / np.mean(expected**2)) < 0.02, name
