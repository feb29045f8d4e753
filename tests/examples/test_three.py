"""The page for three.js, in a browser: the radiance that its shader makes at all vertices, and the picture."""

from __future__ import annotations

import functools
import http.server
import io
import shutil
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from slepian_prt.export.model import export_model
from slepian_prt.relighting.relight import relight
from slepian_prt.runtime.gpu_transfer import gpu_transfer
from tests.examples.conftest import EXAMPLES, Case

PAGE = EXAMPLES / "three"
THREE = PAGE / "node_modules" / "three"

pytestmark = pytest.mark.slow

# Each vertex of the first mesh becomes a point of its own in a picture of floats, drawn with the shader of the page.
READ_VERTICES = """async light => {
  const THREE = await import("three");
  const model = globalThis.model, mesh = model.meshes[0];
  if (light) model.setLight(Float64Array.from(light));
  const count = mesh.geometry.attributes.position.count, width = 64, height = Math.ceil(count / width);
  const material = mesh.material.clone();
  Object.assign(material.uniforms, model.uniforms, { exposure: { value: 1 } });
  material.vertexShader = material.vertexShader.replace(/gl_Position = .*;/, `
    vec2 pixel = vec2(gl_VertexID % ${width}, gl_VertexID / ${width}) + 0.5;
    gl_Position = vec4(2.0 * pixel / vec2(${width}, ${height}) - 1.0, 0.0, 1.0);
    gl_PointSize = 1.0;`);
  material.fragmentShader = "varying vec3 lit; void main() { gl_FragColor = vec4(lit, 1.0); }";
  const geometry = mesh.geometry.clone().setIndex(null);
  const points = new THREE.Points(geometry, material);
  points.frustumCulled = false;
  const target = new THREE.WebGLRenderTarget(width, height, { type: THREE.FloatType });
  const renderer = new THREE.WebGLRenderer();
  renderer.setRenderTarget(target);
  renderer.render(new THREE.Scene().add(points), new THREE.Camera());
  const pixels = new Float32Array(4 * width * height);
  renderer.readRenderTargetPixels(target, 0, 0, width, height, pixels);
  return Array.from({ length: 3 * count }, (_, i) => pixels[4 * Math.floor(i / 3) + i % 3]);
}"""


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_: Any) -> None:
        pass


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Iterator[tuple[str, Path]]:
    """The page on a server of its own, and the folder that it serves."""
    if not THREE.is_dir():
        pytest.skip("three is not installed: run `npm install three@0.187` in examples/three")
    folder = tmp_path_factory.mktemp("site")
    for file in PAGE.iterdir():
        if file.is_file():
            shutil.copy(file, folder)
    (folder / "node_modules").mkdir()
    (folder / "node_modules" / "three").symlink_to(THREE.resolve())
    handler = functools.partial(Quiet, directory=str(folder))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/", folder
        server.shutdown()
        thread.join()


def open_page(browser: Any, url: str) -> Any:
    page = browser.new_page(viewport={"width": 320, "height": 240})
    complaints: list[str] = []
    page.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.goto(url)
    page.wait_for_function("globalThis.model || !document.querySelector('#message').textContent.startsWith('Load')")
    assert page.evaluate("globalThis.model !== undefined"), page.text_content("#message")
    assert [text for text in complaints if "favicon" not in text and "404" not in text] == []
    return page


@pytest.mark.parametrize("attributes", ["bytes", "float", "texture"])
def test_vertices_are_relit_as_by_relight(browser, site, case: Case, attributes):
    url, folder = site
    shutil.copy(case.map, folder / "map.hdr")
    export_model(case.packed, folder / f"{attributes}.glb", attributes=attributes)
    page = open_page(browser, f"{url}?model={attributes}.glb")
    light = case.light(40.0)
    found = np.reshape(page.evaluate(READ_VERTICES, light.ravel().tolist()), (-1, 3))
    gpu = gpu_transfer(case.packed)
    expected = gpu.relight(light) * case.packed.mesh.albedo
    # Sums of 16 products of float32, and an albedo in 16 bits.
    np.testing.assert_allclose(found, expected, rtol=0, atol=5e-5 * np.abs(expected).max())
    full = relight(case.packed, light)
    assert np.sqrt(np.mean((found - full) ** 2) / np.mean(full**2)) < 2.0 * gpu.error(light)
    page.close()


def test_its_own_projection_of_a_turned_map(browser, site, case: Case):
    """From the .hdr to radiance, of a model that stands upright by a node."""
    url, folder = site
    shutil.copy(case.map, folder / "map.hdr")
    export_model(case.packed, folder / "up.glb", up="z")
    page = open_page(browser, f"{url}?model=up.glb")
    page.fill("#turn", "70")
    found = np.reshape(page.evaluate(READ_VERTICES, None), (-1, 3))
    expected = relight(case.packed, case.light(70.0), up="z")
    # Colours share eight bits of mantissa; sums over 32 rows instead of an exact rule.
    assert np.sqrt(np.mean((found - expected) ** 2) / np.mean(expected**2)) < 0.02
    with Image.open(io.BytesIO(page.screenshot())) as picture:
        pixels = np.asarray(picture.convert("RGB")).astype(int)
    drawn = np.abs(pixels - [238, 238, 238]).max(axis=2) > 8
    assert 0.05 < drawn.mean() < 0.9
    page.close()


def test_a_model_of_another_kind_is_said_to_be_one(browser, site, case: Case):
    url, folder = site
    shutil.copy(case.map, folder / "map.hdr")
    export_model(case.packed, folder / "occlusion.glb", "occlusion")
    page = browser.new_page()
    page.goto(f"{url}?model=occlusion.glb")
    page.wait_for_function("document.querySelector('#message').textContent.startsWith('this')")
    assert page.text_content("#message") == "this .glb is not one that slepian-prt export has written"
    page.close()
