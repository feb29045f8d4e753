"""What a page computes when its light changes, in Debian's Chromium without a GPU."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
import OpenEXR
from benchmarks.common import ROOT, data_folder, line

sys.path.append(str(ROOT))  # the browser is that of the tests
from tests.browser import Modules, open_chromium

_RUNS = 9

# The median of several runs, the first not counted: browsers compile what they have seen often.
_TIMED = """
  const times = [];
  for (let i = 0; i <= runs; i++) {
    const begun = performance.now();
    await work();
    times.push(performance.now() - begun);
  }
  return times.slice(1).sort((a, b) => a - b)[Math.floor(runs / 2)];
"""

_PROJECT = """
  const { projectTexels } = await import("#projection");
  const data = Float32Array.from({ length: 6 * height * height }, Math.random);
  const work = () => projectTexels({ width: 2 * height, height, data }, bandlimit);
"""

_ROTATE = """
  const { rotateSh } = await import("#harmonics");
  const light = new Float64Array(3 * (bandlimit + 1) ** 2).fill(1), turn = [0.6, 0, 0.8, 0, 1, 0, -0.8, 0, 0.6];
  const work = () => { for (let i = 0; i < 100; i++) rotateSh(light, bandlimit, turn); };
"""

_MODEL = """
  const size = (bandlimit + 1) ** 2, random = length => Float32Array.from({ length }, Math.random);
  const model = { functions, caps: 255, channels: 1, table: random(255 * functions * size),
                  zeros: random(255 * (functions - 1)), bytes: new Uint8Array(functions * vertices) };
  const light = random(3 * size);
  const { lightFunctions } = await import("#light");
"""

_LIT = "const work = () => lightFunctions(model, light);"

_NEGATIVE = """
  const { negativeFraction } = await import("#radiance"), lit = lightFunctions(model, light);
  const work = () => negativeFraction(model, lit);
"""

_READ = 'const { readMap } = await import("#maps"); const work = () => readMap("map.exr", bytes.slice().buffer);'

# A timer every millisecond: how late it came at most.
_LATEST = """
  const { readMap } = await import("#maps"), { projectTexels } = await import("#projection");
  let last = performance.now(), latest = 0;
  const timer = setInterval(() => {
    latest = Math.max(latest, performance.now() - last);
    last = performance.now();
  }, 1);
  const begun = last, map = await readMap("map.exr", bytes.slice().buffer), read = performance.now();
  await projectTexels(map, bandlimit);
  await new Promise(resolve => { setTimeout(resolve, 20); });
  clearInterval(timer);
  return [read - begun, performance.now() - 20 - read, latest];
"""


def pages() -> None:
    """Maps read and projected, lights rotated, functions of caps lit, in a page."""
    with open_chromium() as browser, tempfile.TemporaryDirectory() as folder:
        modules = Modules(browser, Path(folder))

        def timed(what: str, body: str, limit: str, **values: object) -> None:
            milliseconds = modules.run(body + _TIMED, runs=_RUNS, **values)
            line(what, f"{milliseconds:8.2f} ms   {limit}")

        for bandlimit in (10, 20):
            timed(
                f"map of 1024 x 512 projected at L = {bandlimit}",
                _PROJECT,
                "(limit 300)",
                height=512,
                bandlimit=bandlimit,
            )
        timed("100 lights rotated at L = 10", _ROTATE, "", bandlimit=10)
        for functions in (16, 32):
            sizes = {"functions": functions, "bandlimit": 10, "vertices": 437_645}
            timed(f"255 caps of {functions} functions lit at L = 10", _MODEL + _LIT, "(a frame: 16)", **sizes)
            timed(f"negative among 437,645 vertices, {functions} functions", _MODEL + _NEGATIVE, "", **sizes)
        timed(
            "studio.exr (1024 x 512, DWAA) read and checked",
            _READ,
            "",
            bytes=(data_folder() / "environments" / "studio.exr").read_bytes(),
        )
        read, projected, latest = modules.run(_LATEST, bytes=_large_map(Path(folder)), bandlimit=10)
        line("map of 4096 x 2048 (half, ZIP) read and checked", f"{read:8.2f} ms")
        line("projected at L = 10", f"{projected:8.2f} ms")
        line("how long the page did not answer meanwhile, at most", f"{latest:8.2f} ms")


def _large_map(folder: Path) -> bytes:
    rows, columns = np.mgrid[:2048, :4096] / 300.0
    texels = np.exp(np.sin(rows) + np.cos(columns)).astype(np.float16)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, dict.fromkeys("RGB", texels)) as file:
        file.write(str(folder / "large.exr"))
    return (folder / "large.exr").read_bytes()
