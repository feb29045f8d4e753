"""The shader for Godot, whose function is GLSL but for the hints of its uniforms, run in a browser: no Godot is."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from typing import Any

import numpy as np
import pytest

from slepian_prt.runtime.gpu_transfer import gpu_transfer
from tests.examples.conftest import EXAMPLES, Case

pytestmark = pytest.mark.slow

SHADER = EXAMPLES / "godot" / "relit.gdshader"

# Draws each vertex as a point into a pixel of floats of its own.
RUN = """([body, table, caps, vertices]) => {
  const gl = document.createElement("canvas").getContext("webgl2"), count = vertices.length / 16;
  gl.getExtension("EXT_color_buffer_float");
  const program = gl.createProgram();
  const sources = [`#version 300 es
    precision highp float;
    in vec4 CUSTOM0, CUSTOM1, CUSTOM2, CUSTOM3;
    out vec3 lit;
    ${body}
    void main() {
      lit = radiance(CUSTOM0, CUSTOM1, CUSTOM2, CUSTOM3);
      gl_PointSize = 1.0;
      gl_Position = vec4(2.0 * (float(gl_VertexID) + 0.5) / ${count}.0 - 1.0, 0.0, 0.0, 1.0);
    }`, `#version 300 es
    precision highp float;
    in vec3 lit;
    out vec4 color;
    void main() { color = vec4(lit, 1.0); }`];
  for (const [i, type] of [gl.VERTEX_SHADER, gl.FRAGMENT_SHADER].entries()) {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, sources[i]);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  gl.useProgram(program);
  gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ARRAY_BUFFER, Uint8Array.from(vertices), gl.STATIC_DRAW);
  for (let i = 0; i < 4; i++) {
    const place = gl.getAttribLocation(program, `CUSTOM${i}`);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, 4, gl.UNSIGNED_BYTE, false, 16, 4 * i);  // not normalised, as the file says
  }
  const texture = (width, height, data) => {
    const made = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, made);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, width, height, 0, gl.RGBA, gl.FLOAT, data);
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) {
      gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
    }
    return made;
  };
  const target = texture(count, 1, null);
  gl.bindFramebuffer(gl.FRAMEBUFFER, gl.createFramebuffer());
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, target, 0);
  texture(16, caps, Float32Array.from(table));
  gl.viewport(0, 0, count, 1);
  gl.drawArrays(gl.POINTS, 0, count);
  const pixels = new Float32Array(4 * count);
  gl.readPixels(0, 0, count, 1, gl.RGBA, gl.FLOAT, pixels);
  return Array.from(pixels);
}"""


def test_the_shader_relights_as_relight_does(browser: Any, case: Case):
    text = re.sub(r"//.*", "", SHADER.read_text())
    function = text[text.index("vec3 radiance") : text.index("void vertex")]
    (table_line,) = re.findall(r"uniform sampler2D table.*;", text)
    body = f"uniform highp sampler2D {table_line.split()[2]};\n{function}"
    gpu, light = gpu_transfer(case.packed), case.light(40.0)
    table = np.concatenate([gpu.light(light), np.ones((gpu.cap_count, 16, 1))], axis=2)
    page = browser.new_page()
    arguments = [body, table.ravel().tolist(), gpu.cap_count, gpu.vertices.ravel().tolist()]
    found = np.reshape(page.evaluate(RUN, arguments), (-1, 4))[:, :3]
    page.close()
    expected = gpu.relight(light)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5 * np.abs(expected).max())


def test_godot_parses_the_script(tmp_path):
    """What it draws is not seen: without a screen Godot has no shaders."""
    godot = os.environ.get("GODOT") or shutil.which("godot4")
    if godot is None:
        pytest.skip("no Godot 4: GODOT does not name one, and there is no godot4 (Debian has Godot 3 alone)")
    for file in ("relit.gd", "relit.gdshader"):
        shutil.copy(EXAMPLES / "godot" / file, tmp_path)
    (tmp_path / "project.godot").write_text("config_version=5\n")
    command = [godot, "--headless", "--path", str(tmp_path), "--check-only", "--script", "res://relit.gd"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
