"""Pages of whole models: how large, made in what time, read by a browser in what time."""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

from benchmarks.common import DRAGONS, ROOT, data_folder, line, median_seconds

import slepian_prt as sp
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.compression.stream import compress_scene
from slepian_prt.transport.settings import TransportSettings
from slepian_prt.viewer.page_file import write_page
from slepian_prt.viewer.pages import PageWish, page_content
from slepian_prt.viewer.payload import make_payload

sys.path.append(str(ROOT))  # the browser is that of the tests
from tests.browser import Modules, open_chromium

_RUNS = 5
_SAMPLES = 512

_READ = """
  const { readPayload } = await import("#payload");
  const times = [];
  for (let i = 0; i <= runs; i++) {
    const begun = performance.now();
    await readPayload(packed);
    times.push(performance.now() - begun);
  }
  return [times[0], times.slice(1).sort((a, b) => a - b)[Math.floor(runs / 2)]];
"""


def page_files() -> None:
    """Bytes of pages of the knot and of scans with one map, seconds to make them, and for a browser to read them."""
    meshes = {name: data_folder() / "meshes" / f"{name}.ply" for name in ("skull", "nefertiti")}
    dragon = DRAGONS / "dragon_vrip.ply"
    with open_chromium() as browser, tempfile.TemporaryDirectory() as folder:
        modules = Modules(browser, Path(folder))
        for name, mesh in {"knot": sp.example("knot"), **meshes}.items():
            _page(name, mesh, 10, "(limit 3)", modules, Path(folder))
        if dragon.is_file():
            _page("dragon", dragon, 20, "(limit 16)", modules, Path(folder))
        else:
            line("dragon", "not here, left out; scripts/fetch_dragons fetches it")


def _page(name: str, mesh: str | Path, bandlimit: int, limit: str, modules: Modules, folder: Path) -> None:
    packed = compress_scene(str(mesh), CompressionSettings(), TransportSettings(bandlimit, _SAMPLES))
    packed.save(folder / "file.prt")
    wish = PageWish((data_folder() / "environments" / "studio.exr",))
    begun = time.perf_counter()
    payload = make_payload(page_content(sp.load(folder / "file.prt"), wish))
    size = write_page(folder / "page.html", name, payload)
    seconds = time.perf_counter() - begun
    again = median_seconds(lambda: write_page(folder / "page.html", name, payload), 3)
    text = (folder / "page.html").read_text()
    begin = text.index(">", text.index('id="payload"')) + 1
    first, read = modules.run(_READ, packed=text[begin : text.index("</script>", begin)], runs=_RUNS)
    line(f"{name}, {packed.vertex_count:,} vertices, L = {bandlimit}", f"{size / 1e6:.2f} MB   {limit}")
    line("  made from the file; packed", f"{seconds:.1f} s; {again:.1f} s")
    line("  read by a browser, at first and again", f"{first:.0f} ms, {read:.0f} ms")
