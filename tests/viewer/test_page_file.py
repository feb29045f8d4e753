"""The one file of a page: complete, in need of nothing else, and with words for browsers that cannot show it."""

from __future__ import annotations

import json
import re

import pytest

from slepian_prt.errors import UserError
from slepian_prt.viewer import page_file
from slepian_prt.viewer.page_file import check_page_name, make_page, write_page
from slepian_prt.viewer.pages import PageWish, page_content
from slepian_prt.viewer.payload import make_payload
from tests.browser import VIEWER
from tests.viewer.page_reader import blocks, read_payload
from tests.viewer.tiny import tiny


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """A page of a small model."""
    path = tmp_path_factory.mktemp("page") / "small.html"
    write_page(path, "small & <tiny>", make_payload(page_content(tiny(), PageWish())))
    return path


def opened(browser, page, script: str = "", **options):
    """The page in a browser, which has run a script before, and what it asked any network or disk for."""
    tab, asked = browser.new_page(**options), []
    tab.on("request", lambda request: asked.append(request.url))
    if script:
        tab.add_init_script(script)
    tab.goto(page.as_uri())
    return tab, asked


def test_it_carries_the_payload_and_all_modules(page):
    found = blocks(page)
    assert read_payload(found["payload"])["title"] == "bumpy"
    modules = json.loads(found["modules"])
    names = {f"#{path.stem}" for path in (VIEWER / "page").glob("*.js")} - {"#bootstrap"}
    assert set(modules) == {*names, "three-kit"}
    assert modules["#payload"] == (VIEWER / "page" / "payload.js").read_text()


def test_it_names_nothing_that_would_have_to_be_fetched(page):
    text = re.sub(r"<!--.*?-->", "", page.read_text(), flags=re.DOTALL)
    assert not re.search(r"""\b(src|href|action)\s*=\s*["'](?!#|data:)""", text)
    assert "@import" not in text
    assert not re.search(r"url\(\s*[\"']?https?:", text)


def test_the_licence_of_three_can_be_read_in_it(page):
    comments = " ".join(re.findall(r"<!--(.*?)-->", page.read_text(), re.DOTALL))
    for line in (VIEWER / "vendor" / "LICENSE.three").read_text().splitlines():
        assert line.strip() in comments


def test_titles_are_escaped(page):
    assert "<title>small &amp; &lt;tiny&gt;</title>" in page.read_text()


def test_the_same_content_makes_the_same_page():
    assert make_page("a", b"payload") == make_page("a", b"payload")


def test_it_opens_from_a_disk_and_fetches_nothing(browser, page):
    tab, asked = opened(browser, page)
    tab.wait_for_function("document.getElementById('message').hidden", timeout=20000)
    assert [url for url in asked if not url.startswith("blob:")] == [page.as_uri()]
    tab.close()


@pytest.mark.parametrize(("script", "lacking"), [
    ("delete globalThis.DecompressionStream", "to unpack gzip by itself"),
    ("HTMLScriptElement.supports = undefined", "import maps"),
    ("HTMLCanvasElement.prototype.getContext = () => null", "WebGL 2, which may be turned off"),
])  # fmt: skip
def test_browsers_that_cannot_show_it_say_what_they_lack(browser, page, script, lacking):
    tab, _ = opened(browser, page, script)
    said = tab.locator("#message")
    assert said.is_visible()
    assert said.inner_text() == (f"This page needs {lacking}. Open it in a current Firefox, Chrome, Edge or Safari.")
    tab.close()


def test_without_scripts_there_is_a_sentence(browser, page):
    tab, _ = opened(browser, page, java_script_enabled=False)
    assert tab.locator("#message").is_visible()
    assert tab.locator("#message").inner_text().startswith("This page needs JavaScript")
    tab.close()


def test_a_damaged_page_says_so(browser, page, tmp_path):
    text = page.read_text()
    begin = text.index('id="modules"') + 200
    broken = tmp_path / "broken.html"
    broken.write_text(text[:begin] + "AAAA" + text[begin + 4 :])
    tab, _ = opened(browser, broken)
    tab.wait_for_function("document.getElementById('message').textContent.startsWith('This page could not be opened')")
    tab.close()


def test_a_page_that_is_too_large_is_refused_and_nothing_is_written(tmp_path, monkeypatch):
    monkeypatch.setattr(page_file, "LARGEST_PAGE", 100_000)
    with pytest.raises(UserError, match=r"the page would have \d+ MB, .* than \d+; take `functions=8`"):
        write_page(tmp_path / "large.html", "large", b"payload")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["page", "page.png", "page.html.gz"])
def test_other_names_are_no_pages(name):
    with pytest.raises(UserError, match=r"pages are written as \.html; name the file so"):
        check_page_name(name)


def test_names_of_pages():
    check_page_name("a.html")
    check_page_name("A.HTM")
