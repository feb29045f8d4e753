"""A headless Chromium for tests of the viewer, and our modules run in it as the viewer's page runs them."""

from __future__ import annotations

import base64
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import slepian_prt

VIEWER = Path(slepian_prt.__file__).parent / "viewer"

# What distributions call it.
_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")

# WebGL2 drawn by the processor: there need be no GPU, and every machine draws the same.
_SOFTWARE_WEBGL = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")

# Blob URLs for the sources of modules, and a map from their names: nothing is fetched, as in a page opened from a disk.
_INSTALL = """sources => {
  const imports = {};
  for (const [name, source] of Object.entries(sources)) {
    imports[name] = URL.createObjectURL(new Blob([source], { type: "text/javascript" }));
  }
  const map = document.createElement("script");
  map.type = "importmap";
  map.textContent = JSON.stringify({ imports });
  document.head.append(map);
}"""

# Arrays travel as their bytes: as JSON they would lose NaN and their kind, and be slow.
_CALL = """async ([body, packed]) => {
  const kinds = { int8: Int8Array, uint8: Uint8Array, int16: Int16Array, uint16: Uint16Array, int32: Int32Array,
                  uint32: Uint32Array, float32: Float32Array, float64: Float64Array };
  const unpack = value => {
    if (Array.isArray(value)) return value.map(unpack);
    if (value === null || typeof value !== "object") return value;
    if (!("$kind" in value)) return Object.fromEntries(Object.entries(value).map(([k, v]) => [k, unpack(v)]));
    return new kinds[value.$kind](Uint8Array.fromBase64(value.$bytes).buffer);
  };
  const pack = value => {
    if (ArrayBuffer.isView(value)) {
      const kind = Object.keys(kinds).find(k => value instanceof kinds[k]) ?? "uint8";
      return { $kind: kind, $bytes: new Uint8Array(value.buffer, value.byteOffset, value.byteLength).toBase64() };
    }
    if (Array.isArray(value)) return value.map(pack);
    if (value === null || typeof value !== "object") return value;
    return Object.fromEntries(Object.entries(value).map(([k, v]) => [k, pack(v)]));
  };
  const names = Object.keys(packed);
  const run = new (async () => {}).constructor(...names, body);
  return pack((await run(...names.map(name => unpack(packed[name])))) ?? null);
}"""


def find_chromium() -> str | None:
    """The browser to test with: that of ``SLEPIAN_PRT_CHROMIUM``, or the first on the path."""
    given = os.environ.get("SLEPIAN_PRT_CHROMIUM")
    return given or next((found for name in _NAMES if (found := shutil.which(name))), None)


@contextmanager
def open_chromium() -> Iterator[Any]:
    """A browser of Playwright's; skips the test where there is none."""
    path = find_chromium()
    if path is None:
        pytest.skip("no chromium: install it (Debian: apt-get install chromium), or set SLEPIAN_PRT_CHROMIUM to one")
    playwright = pytest.importorskip("playwright.sync_api", reason="no playwright: scripts/setup --dev installs it")
    sandbox = ["--no-sandbox"] if getattr(os, "geteuid", lambda: 1)() == 0 else []  # which root cannot have
    with playwright.sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=path, args=[*sandbox, *_SOFTWARE_WEBGL])
        yield chromium
        chromium.close()


def module_sources() -> dict[str, str]:
    """The modules of the viewer, by the names that they import each other by."""
    sources = {f"#{path.stem}": path.read_text() for path in sorted((VIEWER / "page").glob("*.js"))}
    return sources | {"three-kit": (VIEWER / "vendor" / "three-kit.min.js").read_text()}


class Modules:
    """An empty page, opened from a disk, that knows the viewer's modules.

    Attributes
    ----------
    page : Playwright's page
    complaints : list of str
        Warnings and errors that the page wrote on its console, and errors that nothing caught.
    """

    def __init__(self, browser: Any, folder: Path) -> None:
        empty = folder / "empty.html"
        empty.write_text("<!DOCTYPE html><title>Modules</title>")
        self.page = browser.new_page()
        self.complaints: list[str] = []
        self.page.on("console", self._listen)
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.goto(empty.as_uri())
        self.page.evaluate(_INSTALL, module_sources())

    def run(self, body: str, **values: Any) -> Any:
        """What the body of an asynchronous JavaScript function returns.

        Parameters
        ----------
        body : str
            Imports what it needs: ``const { rotateSh } = await import("#harmonics"); return rotateSh(c, 3, r);``
        values
            Its variables. Arrays become flat typed arrays of their type (of the eight that JavaScript and NumPy
            share) and bytes a Uint8Array, also within lists and mappings; typed arrays come back as flat arrays.

        Raises
        ------
        playwright.sync_api.Error
            What the body throws.
        """
        return unpack(self.page.evaluate(_CALL, [body, {name: _pack(value) for name, value in values.items()}]))

    def error(self, body: str, **values: Any) -> str:
        """The message of the error that a body throws; fails where it throws none."""
        caught = f"try {{ await (async () => {{ {body} }})(); }} catch (error) {{ return error.message; }} return null;"
        message = self.run(caught, **values)
        assert message is not None, "nothing was thrown"
        return message

    def _listen(self, message: Any) -> None:
        if message.type in ("warning", "error"):
            self.complaints.append(message.text)


def _pack(value: Any) -> Any:
    if isinstance(value, bytes):
        value = np.frombuffer(value, np.uint8)
    if isinstance(value, np.ndarray):
        data = np.ascontiguousarray(value)
        return {"$kind": str(data.dtype), "$bytes": base64.b64encode(data).decode("ascii")}
    if isinstance(value, dict):
        return {name: _pack(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [_pack(part) for part in value]
    return value.item() if isinstance(value, np.generic) else value


def unpack(value: Any) -> Any:
    if isinstance(value, list):
        return [unpack(part) for part in value]
    if not isinstance(value, dict):
        return value
    if "$kind" in value:
        return np.frombuffer(base64.b64decode(value["$bytes"]), value["$kind"])
    return {name: unpack(part) for name, part in value.items()}
