"""Pages of scans in a browser without a GPU: how far from Python's pictures, how soon there, how long for a light."""

from __future__ import annotations

import statistics
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.common import ROOT, data_folder, line

import slepian_prt as sp

sys.path.append(str(ROOT))  # the browser is that of the tests
from tests.browser import open_chromium
from tests.viewer.opening import Opened

SCANS = ("skull", "nefertiti")
MAPS = ("studio", "courtyard", "interior", "sunrise")
_WINDOW = {"width": 1200, "height": 800}
_PICTURE_WIDTH = 600
_OPENINGS = 5
_TOLD = ("a new light (limit 16)", "a moving picture of it", "on the screen")

# Milliseconds, medians of nine: what a light changes (functions on the processor, radiance of vertices on the GPU), and
# the picture. Reading a pixel waits for the GPU.
_STAGES = """async () => {
  const { viewer } = await slepianPrt.ready;
  const gl = viewer.renderer.getContext(), pixel = new Uint8Array(4);
  const wait = () => {
    viewer.renderer.setRenderTarget(null);
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
  };
  const size = viewer.pixels.map(pixels => Math.round(0.3 * pixels));
  const draw = () => { viewer.painter.restart(viewer._scenery(viewer._view(size))); viewer.painter.drawQuick(true); };
  const median = work => {
    const times = [];
    for (let i = 0; i < 9; i++) {
      wait();
      const begun = performance.now();
      work();
      wait();
      times.push(performance.now() - begun);
    }
    return times.sort((a, b) => a - b)[4];
  };
  viewer._resize(size);
  const picture = median(draw);
  return [median(() => { viewer._relight(); draw(); }) - picture, picture, median(() => viewer.painter.present())];
}"""


def page_pictures() -> None:
    """What a page of a scan shows beside Python's picture of the file, and how quickly."""
    with open_chromium() as browser, tempfile.TemporaryDirectory() as folder:
        for name in SCANS:
            packed = sp.compress(sp.precompute(data_folder() / "meshes" / f"{name}.ply", samples=1024), tolerance=0.05)
            maps = [sp.read_environment(data_folder() / "environments" / f"{one}.exr") for one in MAPS]
            pictures = [sp.render_picture(packed, one, width=_PICTURE_WIDTH, background="white") for one in maps]
            for functions in (16, 32):
                page = Path(folder) / f"{name}.html"
                sp.save_page(page, packed, maps, functions=functions)
                with Opened(browser, page, viewport=_WINDOW) as opened:
                    apart = [_apart(opened, one.name, wanted) for one, wanted in zip(maps, pictures, strict=True)]
                told = ", ".join(
                    f"{one} {mean:.2f} {worst:.0f}" for one, (mean, worst) in zip(MAPS, apart, strict=True)
                )
                line(f"{name}, {functions} functions: of 255, mean and 99 % (limits 1, 3)", told)
            sp.save_page(page, packed, maps[0])
            _times(name, page, browser)


def _apart(opened: Opened, light: str, wanted: np.ndarray) -> tuple[float, float]:
    height, width = wanted.shape[:2]
    drawn = opened.picture(width, height, light=light, background="#ffffff", exposure=0)
    difference = 255.0 * np.abs(drawn[..., :3] - wanted[..., :3])
    return float(difference.mean()), float(np.percentile(difference.max(axis=2), 99.0))


def _times(name: str, page: Path, browser: Any) -> None:
    firsts, stages = [], []
    for _ in range(_OPENINGS):
        with Opened(browser, page, viewport=_WINDOW) as opened:
            firsts.append(opened.tab.evaluate("slepianPrt.timings.firstLight"))
            opened.tab.wait_for_timeout(3000)
            stages.append(opened.tab.evaluate(_STAGES))
    line(f"{name}: from opening to first light, {_WINDOW['width']} x {_WINDOW['height']} (limit 1000)", _ms(firsts))
    for told, times in zip(_TOLD, zip(*stages, strict=True), strict=True):
        line(f"  {told}", _ms(times))


def _ms(times: Sequence[float]) -> str:
    return f"{statistics.median(times):.0f} ms"
