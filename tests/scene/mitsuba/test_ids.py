"""Mitsuba's objects keep their ids in scenes of ours."""

from slepian_prt.renderer.variants import mitsuba
from slepian_prt.scene.mitsuba.ids import load_keeping_ids


def test_ids_are_kept():
    with mitsuba() as mi:
        named, other = (mi.load_dict({"type": "sphere"}) for _ in range(2))
        named.set_id("ball")
        before = other.id()
        scene = load_keeping_ids(mi, {"type": "scene", "first": named, "second": other})
        assert (named.id(), other.id()) == ("ball", before)
        assert len(scene.shapes()) == 2
