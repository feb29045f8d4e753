"""Pages of the viewer opened in a browser, and the pictures that they draw."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.browser import unpack

# Bytes of a finished picture, from the top, of the state that is set before.
_TAKE = """async ([width, height, values]) => {
  const { viewer, state } = await slepianPrt.ready;
  const { light, ...others } = values;
  const chosen = light === undefined ? {} : { light: viewer.lights.findIndex(one => one.name === light) };
  state.set({ ...others, ...chosen });
  const { data } = await viewer.takePicture({ width, height });
  return { $kind: "uint8", $bytes: new Uint8Array(data).toBase64() };
}"""


class Opened:
    """A page that has drawn its first picture.

    Attributes
    ----------
    tab : Playwright's page
    complaints : list of str
        What it wrote on its console as a warning or an error, and errors that nothing caught.
    """

    def __init__(self, browser: Any, path: Path, fragment: str = "", **options: Any) -> None:
        self.tab = browser.new_page(**{"viewport": {"width": 480, "height": 360}} | options)
        self.complaints: list[str] = []
        self.tab.on("console", self._listen)
        self.tab.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.tab.goto(path.as_uri() + fragment)
        self.tab.wait_for_function("globalThis.slepianPrt !== undefined")
        self.tab.evaluate("() => slepianPrt.ready.then(() => null)")

    def __enter__(self) -> Opened:
        return self

    def __exit__(self, *_: object) -> None:
        self.tab.close()

    @property
    def values(self) -> dict[str, Any]:
        """What is chosen now."""
        values: dict[str, Any] = self.tab.evaluate("() => slepianPrt.ready.then(({ state }) => state.values)")
        return values

    def picture(self, width: int, height: int, **values: Any) -> NDArray[np.float64]:
        """(H, W, 4) in [0, 1] of what is chosen; ``light`` goes by its name."""
        bytes_ = unpack(self.tab.evaluate(_TAKE, [width, height, values]))
        return np.asarray(bytes_.reshape(height, width, 4) / 255.0)

    def drop(self, name: str, content: bytes) -> None:
        """Drop a file on the page."""
        script = """([name, content]) => {
          const data = new DataTransfer();
          data.items.add(new File([Uint8Array.from(content)], name));
          const options = { dataTransfer: data, bubbles: true, cancelable: true };
          for (const kind of ["dragover", "drop"]) document.body.dispatchEvent(new DragEvent(kind, options));
        }"""
        self.tab.evaluate(script, [name, list(content)])

    def _listen(self, message: Any) -> None:
        if message.type in ("warning", "error"):
            self.complaints.append(message.text)
