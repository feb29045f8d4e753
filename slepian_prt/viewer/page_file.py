"""One HTML file that needs nothing else: no network, no server, no build.

Pages from ``file://`` may not fetch, so that all is inline: the payload and the modules as gzip in base64. A small
script inflates the modules with the browser's own `DecompressionStream`, gives each a ``blob:`` URL, adds an import map
(they import each other by names such as ``#harmonics``) and starts ``#main``.
"""

from __future__ import annotations

import base64
import gzip
import json
from pathlib import Path

import jinja2
from markupsafe import Markup

from slepian_prt.errors import UserError
from slepian_prt.files import atomic_output

# What a page may be; browsers take long over more.
LARGEST_PAGE = 32_000_000

# Names that the bundle of three.js goes by.
_KIT = "three-kit"


def make_page(title: str, payload: bytes) -> bytes:
    """The page.

    Parameters
    ----------
    title : str
    payload : bytes
        As of `make_payload`.
    """
    folder = Path(__file__).parent
    sources = {f"#{one.stem}": one.read_text() for one in _scripts(folder / "page")}
    kit = (folder / "vendor" / f"{_KIT}.min.js").read_text()
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("slepian_prt", "viewer/page"), autoescape=True, keep_trailing_newline=True
    )
    page = environment.get_template("page.html").render(
        title=title,
        style=Markup((folder / "page" / "style.css").read_text()),
        bootstrap=Markup((folder / "page" / "bootstrap.js").read_text()),
        licence=Markup((folder / "vendor" / "LICENSE.three").read_text()),
        modules=Markup(_packed(json.dumps({**sources, _KIT: kit}, ensure_ascii=False).encode())),
        payload=Markup(_packed(payload)),
    )
    return page.encode()


def check_page_name(path: str | Path) -> None:
    """Raise UserError unless browsers know such a file for a page."""
    if Path(path).suffix.lower() not in (".html", ".htm"):
        raise UserError(f"{path}: pages are written as .html; name the file so")


def write_page(path: str | Path, title: str, payload: bytes) -> int:
    """Write the page, complete or not at all; how many bytes it has.

    Raises
    ------
    UserError
        More than `LARGEST_PAGE`; a folder that cannot be written to.
    """
    page = make_page(title, payload)
    if len(page) > LARGEST_PAGE:
        raise UserError(
            f"{path}: the page would have {len(page) / 1e6:.0f} MB, and browsers take long over more than "
            f"{LARGEST_PAGE / 1e6:.0f}; take `functions=8`, or two pages instead of `compare_with`"
        )
    with atomic_output(path) as file:
        file.write(page)
    return len(page)


def _scripts(folder: Path) -> list[Path]:
    """The modules of a page."""
    return [one for one in sorted(folder.glob("*.js")) if one.name != "bootstrap.js"]


def _packed(content: bytes) -> str:
    """Base64 of gzip, always the same."""
    return base64.b64encode(gzip.compress(content, 9, mtime=0)).decode()
