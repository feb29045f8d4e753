"""Scenes that would hang, fill memory or end the process in Mitsuba's parser and readers: one line before that."""

import os

import pytest

from slepian_prt.errors import UserError
from slepian_prt.machine import memory
from slepian_prt.machine.memory import memory_limited
from slepian_prt.scene.loading import open_scene
from slepian_prt.scene.mitsuba.inspection import inspect_xml
from tests.fuzzing import maps, scenes

WALL = '<shape type="rectangle"><bsdf type="diffuse"/></shape>'
LAUGHS = '<!DOCTYPE a [<!ENTITY b "cc"><!ENTITY d "&b;&b;&b;&b;&b;&b;&b;&b;">]>'
SECRET = '<!DOCTYPE a [<!ENTITY b SYSTEM "file:///etc/passwd">]>'
NESTED = "<bsdf type='twosided'>" * 200 + "</bsdf>" * 200
CHAIN = "".join(f'<default name="a{k}" value="{f"$a{k + 1}" * 10 if k < 9 else "x"}"/>' for k in range(9, -1, -1))


def write(folder, body, head="", name="a.xml"):
    (folder / name).write_text(f'{head}<scene version="3.0.0">\n{body}</scene>')
    return folder / name


BAD = {
    "entities": (WALL, LAUGHS, "line 1: a scene has no document type"),
    "external entity": (WALL, SECRET, "line 1: a scene has no document type"),
    "nested": (NESTED, "", "line 2: elements stand more than 100 deep"),
    "multiplied": (CHAIN, "", "make a value of"),
    "itself": ('<include filename="a.xml"/>', "", "include each other in a circle"),
    "a ring": ('<include filename="ring.xml"/>', "", "include each other in a circle"),
    "a bush": ('<include filename="bush0.xml"/>', "", "over 1000 files"),
    "by a parameter": ('<default name="f" value="a"/><include filename="$f.xml"/>', "", "each other in a circle"),
    "malformed": ("<shape", "", "line 2: its XML is malformed"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_mitsuba_would_follow_for_ever_is_refused(name, tmp_path):
    body, head, message = BAD[name]
    path = write(tmp_path, body, head)
    write(tmp_path, '<include filename="a.xml"/>', name="ring.xml")
    for k in range(8):
        write(tmp_path, f'<include filename="bush{k + 1}.xml"/>' * 10, name=f"bush{k}.xml")
    write(tmp_path, "", name="bush8.xml")
    with pytest.raises(UserError, match=message) as told:
        inspect_xml(path, {})
    assert str(told.value).isprintable()


NAMES = (
    '<include filename="{}"/>', '<shape type="ply"><string name="filename" value="{}"/></shape>',
    '<bsdf type="diffuse"><spectrum name="reflectance" filename="{}"/></bsdf>',
    '<path value="below"/><texture type="bitmap"><string name="filename" value="{}"/></texture>',
    '<default name="f" value="{}"/><include filename="$f"/>',
)  # fmt: skip


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
@pytest.mark.parametrize("body", NAMES)
@pytest.mark.parametrize("file", ["/dev/zero", "pipe", "below/../pipe"])
def test_pipes_and_devices_are_not_read(body, file, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "below").mkdir()
    with pytest.raises(UserError, match=f"{file}: is a pipe or a device"):
        inspect_xml(write(tmp_path, body.format(file)), {})


@pytest.mark.parametrize("name", scenes.seeds())
def test_scenes_that_are_meant_to_be_looked_at_pass(name, tmp_path):
    for other, content in scenes.seeds().items():
        (tmp_path / other).write_bytes(content)
    inspect_xml(tmp_path / name, {})


@pytest.mark.parametrize(
    "content",
    [
        "<!-- ---- walls ---- é -->".encode("latin-1") + b'<scene version="3.0.0"><path value="none"/></scene>',
        '<?xml version="1.0" encoding="iso-8859-1"?><scene><string value="é"/></scene>'.encode("latin-1"),
        '<?xml version="1.0"?><scene><string value="é"/><include filename="none.xml"/></scene>'.encode(),
        '<scene><string value="é"/></scene>'.encode("utf-16"),
    ],
)
def test_comments_and_encodings_as_people_have_them_pass(content, tmp_path):
    (tmp_path / "a.xml").write_bytes(content)
    inspect_xml(tmp_path / "a.xml", {})


def test_text_in_an_unknown_encoding(tmp_path):
    (tmp_path / "a.xml").write_bytes('<scene version="3.0.0"><shape type="cube" id="é"/></scene>'.encode("latin-1"))
    with pytest.raises(UserError, match="line 1: its text is not UTF-8"):
        inspect_xml(tmp_path / "a.xml", {})


def test_scenes_larger_than_memory_are_not_parsed(tmp_path, monkeypatch):
    monkeypatch.setattr(memory, "_LEAST", 1)
    path = write(tmp_path, "<!--" + "x" * 10_000 + "-->" + WALL)
    inspect_xml(path, {})
    with memory_limited(10_000), pytest.raises(UserError, match="of memory"):
        inspect_xml(path, {})


def envmap(folder, content):
    (folder / "map.hdr").write_bytes(content)
    light = '<emitter type="envmap"><string name="filename" value="map.hdr"/></emitter>'
    return write(folder, WALL + light)


def test_pictures_that_end_mitsuba_are_not_given_to_it(tmp_path):
    """Without the look at its size the process dies of a segmentation fault."""
    whole = maps.seeds()["plain.hdr"]
    with open_scene(envmap(tmp_path, whole)) as scene:
        assert scene.environment is not None
    with (
        pytest.raises(UserError, match=r"line 2: .*map.hdr: is 0 x 0 texels"),
        open_scene(envmap(tmp_path, whole.replace(b"-Y 8 +X 16", b"-Y 0 +X 0"))),
    ):
        pass
    with (
        pytest.raises(UserError, match=r"map.hdr: says it is 99999"),
        open_scene(envmap(tmp_path, whole.replace(b"-Y 8 +X 16", b"-Y 99999 +X 999999"))),
    ):
        pass


def test_dicts_that_hold_themselves():
    scene = {"type": "scene"}
    scene["again"] = scene
    with pytest.raises(UserError, match="holds itself"), open_scene(scene):
        pass
