"""What the page takes of three.js: the vendored file holds what is asked for, works alone, and carries its licences."""

from __future__ import annotations

import re

import pytest

from tests.browser import VIEWER, open_chromium
from tests.conftest import ROOT

KIT = VIEWER / "vendor" / "three-kit.min.js"


def test_it_exports_what_is_asked_for_and_draws(modules):
    entry = (ROOT / "scripts" / "vendoring" / "three_kit.js").read_text()
    wanted = {name for block in re.findall(r"export \{(.*?)\}", entry, re.DOTALL) for name in re.findall(r"\w+", block)}
    found, drawn = modules.run(
        """
        const three = await import("three-kit");
        const renderer = new three.WebGLRenderer({ canvas: document.createElement("canvas") });
        const target = new three.WebGLRenderTarget(2, 2, { type: three.FloatType });
        renderer.setRenderTarget(target);
        renderer.setClearColor(new three.Color().setRGB(0.25, 0.5, 1, three.LinearSRGBColorSpace), 1);
        renderer.clear();
        const pixels = new Float32Array(16);
        renderer.readRenderTargetPixels(target, 0, 0, 2, 2, pixels);
        renderer.dispose();
        return [Object.keys(three), pixels];
        """
    )
    assert set(found) == wanted
    assert drawn.tolist() == [0.25, 0.5, 1.0, 1.0] * 4


def test_pages_carry_the_licences_and_the_versions_that_the_script_pins():
    head = KIT.read_text().partition("*/")[0]
    script = (ROOT / "scripts" / "vendor_three").read_text()
    licences = (KIT.parent / "LICENSE.three").read_text()
    assert "".join(head.removeprefix("/*!").split()) == "".join(licences.split())
    for library in ("three", "fflate"):
        version = re.search(rf"^{library}=(\S+)", script, re.MULTILINE)[1]
        assert re.search(rf"==== {library}(\.js)? {re.escape(version)},", licences)


def test_without_a_browser_tests_are_skipped_with_the_reason(monkeypatch):
    monkeypatch.setattr("tests.browser.find_chromium", lambda: None)
    with pytest.raises(pytest.skip.Exception, match="no chromium"), open_chromium():
        pass
