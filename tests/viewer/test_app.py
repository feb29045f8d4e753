"""The page in a browser: pointer, keys, address, dropped files, small windows, and what it says where it cannot."""

from __future__ import annotations

import numpy as np
import pytest

import slepian_prt as sp
from slepian_prt.lighting.environment import make_environment
from tests.viewer.opening import Opened
from tests.viewer.tiny import tiny, tiny_film


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """A page of a small model with two maps, and full SH beside it."""
    path = tmp_path_factory.mktemp("app") / "page.html"
    maps = [make_environment([[[0.2 * n, 0.5, 1.0]] * 8] * 4, name=name) for n, name in enumerate(["sky", "room"], 1)]
    sp.save_page(path, tiny(), maps, compare_with=tiny())
    return path


@pytest.fixture(scope="module")
def shared(browser, page):
    with Opened(browser, page) as opened:
        yield opened


@pytest.fixture
def opened(shared):
    """The page as it is at first."""
    shared.tab.evaluate("() => slepianPrt.ready.then(({ state }) => state.set(state.first))")
    yield shared
    assert shared.complaints == []


def drag(tab, by, key=None):
    if key:
        tab.keyboard.down(key)
    tab.mouse.move(120, 180)
    tab.mouse.down()
    tab.mouse.move(120 + by[0], 180 + by[1], steps=3)
    tab.mouse.up()
    if key:
        tab.keyboard.up(key)


def test_dragging_orbits_and_home_leads_back(opened):
    drag(opened.tab, (40, 10))
    assert opened.values["eye"] is not None
    assert opened.values["turn"] == 0
    opened.tab.keyboard.press("0")
    assert opened.values["eye"] is None


@pytest.mark.parametrize("key", ["Shift", "Alt"])
def test_dragging_with_a_key_turns_the_light(opened, key):
    drag(opened.tab, (50, -20), key)
    values = opened.values
    assert (values["turn"], values["tilt"], values["eye"]) == (20, -8, None)


def test_the_wheel_zooms(opened):
    opened.tab.mouse.move(120, 180)
    opened.tab.mouse.wheel(0, -200)
    opened.tab.wait_for_function("slepianPrt.ready.then(({ state }) => state.values.eye !== null)")


def test_keys(opened):
    press = opened.tab.keyboard.press
    opened.tab.focus("#canvas")
    for key in ("l", "3", ",", "w", "Shift+ArrowRight", "e", "b"):
        press(key)
    expected = {"light": 1, "mode": "difference", "functions": 15, "window": True, "turn": 5, "exposure": 0.25}
    assert {name: opened.values[name] for name in expected} == expected
    assert opened.values["background"] == "#ffffff"
    assert opened.tab.locator("#legend").is_visible()
    press("ArrowLeft")
    assert opened.values["eye"] is not None
    press("?")
    assert opened.tab.locator("#keys").is_visible()
    press("Escape")


def test_the_divider_is_a_slider(opened):
    opened.tab.keyboard.press("2")
    divider = opened.tab.get_by_role("slider", name="Where the two pictures meet")
    divider.focus()
    for key in ("ArrowRight", "Shift+ArrowRight"):
        opened.tab.keyboard.press(key)
    assert opened.values["split"] == pytest.approx(0.61)
    assert divider.get_attribute("aria-valuenow") == "61"
    box = divider.bounding_box()
    opened.tab.mouse.move(box["x"] + 14, 60)
    opened.tab.mouse.down()
    opened.tab.mouse.move(120, 60)
    opened.tab.mouse.up()
    assert opened.values["split"] == pytest.approx(0.25)


def test_a_link_shows_what_its_sender_saw(browser, page, opened):
    opened.tab.evaluate("""() => slepianPrt.ready.then(({ state }) => state.set({
        light: 1, turn: -30, tilt: 12.5, exposure: 1.5, functions: 7, mode: "split", split: 0.3, window: true,
        background: "#102030", compare: "functions", eye: [3, 2, 1], target: [0.1, 0, 0] }))""")
    opened.tab.wait_for_function("location.hash.includes('turn=-30')")
    fragment = opened.tab.evaluate("location.hash")
    assert opened.tab.evaluate("history.length") <= 2
    with Opened(browser, page, fragment) as other:
        assert other.values == opened.values
        other.tab.evaluate("location.hash = 'turn=10&functions=nonsense&light=moon'")
        other.tab.wait_for_function("slepianPrt.ready.then(({ state }) => state.values.turn === 10)")
        assert other.values["functions"] == 16
        assert "moon" in other.tab.get_by_role("alert").inner_text()


@pytest.mark.parametrize(("name", "content"), [("notes.txt", b"no map"), ("broken.exr", b"\x76\x2f\x31\x01\x02\0\0\0")])
def test_a_dropped_file_that_is_no_map_gets_a_sentence(opened, name, content):
    opened.drop(name, content)
    opened.tab.locator("#notices p", has_text=name).wait_for()
    assert opened.values["light"] == 0
    opened.tab.locator("#notices button").first.click()


def test_dropped_maps_have_names_of_their_own_and_no_negative_texels(browser, page):
    rows = [[1.0, 1.0, 1.0]] * 7 + [[-5.0, 1.0, 1.0]]  # far more than Python takes without being asked
    content = b"PF\n8 4\n-1.0\n" + np.array([rows] * 4, dtype="<f4").tobytes()
    with Opened(browser, page) as opened:
        for number, name in enumerate(("sky (2)", "sky (3)"), 2):
            opened.drop("sky.pfm", content)
            opened.tab.wait_for_function(
                f"slepianPrt.ready.then(({{ viewer }}) => viewer.lights.length === {number + 1})"
            )
            assert opened.tab.evaluate("slepianPrt.ready.then(({ viewer }) => viewer.lights.at(-1).name)") == name
        least = "slepianPrt.ready.then(({ viewer }) => viewer.lights.at(-1).map.data.reduce((a, b) => Math.min(a, b)))"
        assert opened.tab.evaluate(least) == 0
        assert "4 negative texels were set to zero" in opened.tab.locator("#notices").inner_text()


def test_every_control_has_a_name(opened):
    nameless = """() => [...document.querySelectorAll("button, input, select, [role=slider]")].filter(one =>
        !one.labels?.length && !one.ariaLabel && !one.textContent.trim() && one.offsetParent).map(one => one.id)"""
    assert opened.tab.evaluate(nameless) == []


def test_nothing_is_drawn_where_nothing_changes(opened):
    count = """async () => {
      const { viewer } = await slepianPrt.ready;
      viewer.redraw({ view: true });
      await new Promise(resolve => viewer.listen(({ isDone }) => isDone && resolve()));
      let drawn = 0;
      viewer.listen(() => { drawn += 1; });
      await new Promise(resolve => setTimeout(resolve, 300));
      return drawn;
    }"""
    assert opened.tab.evaluate(count) == 0


@pytest.mark.parametrize("size", [(420, 800), (320, 568), (1200, 800)])
def test_nothing_sticks_out_of_the_window(opened, size):
    width, height = size
    opened.tab.set_viewport_size({"width": width, "height": height})
    outside = """([width, height]) => [...document.querySelectorAll("#panel, #panel *")].filter(one => {
        const box = one.getBoundingClientRect();
        return box.width > 1 && (box.left < 0 || box.right > width + 0.5);
      }).map(one => one.id || one.className || one.tagName).concat(
        document.documentElement.scrollWidth > width ? ["page"] : [])"""
    assert opened.tab.evaluate(outside, list(size)) == []
    opened.tab.set_viewport_size({"width": 480, "height": 360})


def test_lost_graphics_are_told(browser, page):
    with Opened(browser, page) as opened:
        opened.tab.evaluate("""() => document.getElementById("canvas").getContext("webgl2")
            .getExtension("WEBGL_lose_context").loseContext()""")
        opened.tab.get_by_text("reload the page").wait_for()


def test_a_film_is_turned_by_dragging(browser, tmp_path):
    sp.save_page(tmp_path / "film.html", tiny_film(), make_environment([[[1.0, 1.0, 1.0]] * 8] * 4, name="white"))
    with Opened(browser, tmp_path / "film.html") as opened:
        drag(opened.tab, (50, 0))
        assert opened.values["turn"] == 20
        opened.tab.keyboard.press("4")
        assert opened.complaints == []
