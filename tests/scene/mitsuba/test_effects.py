"""Rows of the plan about materials: one for each effect, which names what it is about and says what happens to it."""

import pytest
import trimesh

from slepian_prt.renderer.variants import mitsuba
from slepian_prt.scene.left_out import LeftOut
from slepian_prt.scene.loading import open_scene
from slepian_prt.scene.mitsuba.effects import ShapeOutcome, effects_left_out

MATERIALS = {
    "Wood": {"type": "twosided", "nested": {"type": "roughplastic"}},
    "Chrome": {"type": "conductor"},
    "Gold": {"type": "twosided", "nested": {"type": "roughconductor", "material": "Au"}},
    "Glass": {"type": "dielectric"},
    "Pane": {"type": "thindielectric"},
    "Leaf": {"type": "mask", "nested": {"type": "twosided", "nested": {"type": "diffuse"}}},
    "Petal": {"type": "principledthin", "diff_trans": 1.0},
    "Cloth": {"type": "bumpmap", "texture": {"type": "checkerboard"}, "nested": {"type": "diffuse"}},
    "Tile": {
        "type": "normalmap",
        "normalmap": {"type": "checkerboard"},
        "nested": {"type": "twosided", "nested": {"type": "diffuse"}},
    },
    "Wall": {"type": "diffuse"},
}
UNLIT = "its material has no diffuse part; it casts shadows only"


@pytest.fixture(scope="module")
def mi():
    with mitsuba() as module:
        yield module


def outcome(mi, name, bsdf, sides=1, reason="", **options):
    called = "" if isinstance(bsdf, dict) else bsdf.id()
    shape = mi.load_dict({"type": "sphere", "id": name, "bsdf": bsdf, **options.pop("shape", {})})
    if called:
        bsdf.set_id(called)  # Mitsuba calls it by its key in the dict
    return ShapeOutcome(shape, name, options.pop("area", 1.0), sides, reason, **options)


def with_id(mi, name):
    return mi.load_dict({**MATERIALS[name], "id": name})


def rows(mi, *outcomes, view=False):
    return {row.name: row for row in effects_left_out(mi, outcomes, view=view)}


def test_a_living_room_fits_a_screen(mi):
    bsdfs = {name: with_id(mi, name) for name in MATERIALS}
    unlit = ("Chrome", "Gold", "Glass", "Pane")
    shapes = []
    for number in range(65):
        name = list(MATERIALS)[number % 10]
        shapes.append(outcome(mi, f"s{number}", bsdfs[name], 0 if name in unlit else 1, UNLIT if name in unlit else ""))
    found = rows(mi, *shapes)
    toward = list(rows(mi, *shapes, view=True))
    assert toward[-2:] == [
        "light onto other surfaces by reflection of materials 'Wood', 'Chrome', 'Gold' and 3 more (41 shapes)",
        "light onto other surfaces through materials 'Glass', 'Pane', 'Leaf' and 1 more (26 shapes)",
    ]
    assert list(found) == [
        "glossy reflection of materials 'Wood', 'Gold', 'Petal' (rough metal, thin surface, 20 shapes)",
        "mirror reflection of materials 'Chrome', 'Glass', 'Pane' (metal, glass, thin glass, 21 shapes)",
        "transmission through materials 'Glass', 'Pane', 'Petal' (glass, thin glass, thin surface, 20 shapes)",
        "opacity of material 'Leaf' (6 shapes)",
        "bump map of material 'Cloth' (6 shapes)",
        "normal map of material 'Tile' (6 shapes)",
    ]
    assert [row.verdict for row in found.values()] == ["gathered"] * 6
    assert list(found.values())[3].share == pytest.approx(6 / 65)


def test_hair_is_no_hole(mi):
    """Mitsuba's hair BSDF claims a null lobe, which it does not have."""
    hair = mi.load_dict({"type": "hair", "id": "Fur"})
    assert list(rows(mi, outcome(mi, "fur", hair, 0, UNLIT), outcome(mi, "floor", MATERIALS["Wall"]))) == [
        "glossy reflection of material 'Fur' (shape 'fur')",
        "transmission through material 'Fur' (shape 'fur')",
    ]


def test_a_plain_scene_has_no_rows(mi):
    assert not rows(mi, outcome(mi, "a", MATERIALS["Wall"]), outcome(mi, "b", MATERIALS["Wall"], sides=2))


def test_nothing_is_said_about_other_surfaces_where_there_are_none(mi):
    assert list(rows(mi, outcome(mi, "ball", MATERIALS["Wood"]))) == [
        "glossy reflection of material 'bsdf' (shape 'ball')"
    ]


def test_materials_without_a_name_of_their_own_are_told_by_their_shapes(mi):
    """Ids that several materials have, as from a dict, are no names; the largest come first."""
    shapes = [outcome(mi, f"s{k}", MATERIALS["Chrome"], 0, UNLIT, area=1.0 + k) for k in range(5)]
    assert {shape.shape.bsdf().id() for shape in shapes} == {"bsdf"}
    found = rows(mi, *shapes, outcome(mi, "t", with_id(mi, "Glass"), 0, UNLIT))
    assert "mirror reflection of material 'Glass' and shapes 's4', 's3' and 3 more (metal, glass, 6 shapes)" in found


def test_transfer_toward_a_camera_holds_gloss_and_gathers_nothing(mi):
    found = rows(mi, outcome(mi, "a", with_id(mi, "Wood")), outcome(mi, "b", with_id(mi, "Cloth")), view=True)
    assert "bump map of material 'Cloth' (shape 'b')" in found
    assert not any("glossy" in name for name in found)
    assert {row.verdict for row in found.values()} == {"not simulated"}


def test_shapes_that_receive_no_light_are_told_by_reason(mi, tmp_path):
    reason = "it has no vertices; it casts shadows only"
    control = "\n".join(f"{x} 0 0 0.1" for x in range(5))
    path = tmp_path / "curve.txt"
    path.write_text(control)
    curve = mi.load_dict({"type": "bsplinecurve", "filename": str(path), "bsdf": MATERIALS["Wall"]})
    found = rows(
        mi,
        ShapeOutcome(curve, "hair", 0.0, 0, reason),
        ShapeOutcome(curve, "beard", 0.0, 0, reason),
        outcome(mi, "closed", MATERIALS["Wall"], 1, "nobody sees its back"),
    )
    (row,) = found.values()
    assert row.name == "light received by 2 curves ('hair', 'beard')"
    assert row.reason.startswith(reason)
    assert row.verdict == "gathered"


def test_media_are_named_and_their_bounds_are_not(mi):
    fog = outcome(mi, "fog", {"type": "null"}, 0, UNLIT, shape={"interior": {"type": "homogeneous"}})
    empty = (
        {"type": "null"},
        {**MATERIALS["Leaf"], "opacity": 0.0},
        {"type": "dielectric", "int_ior": 1.0, "ext_ior": 1.0},
    )
    bounds = [outcome(mi, f"bound {k}", bsdf, 0, "all light passes it") for k, bsdf in enumerate(empty)]
    shapes = (fog, *bounds, outcome(mi, "a", MATERIALS["Wall"]))
    assert not rows(mi, *shapes)  # the pilot of paths decides
    found = rows(mi, *shapes, view=True)
    assert list(found) == ["participating media inside shape 'fog' (homogeneous)"]
    assert found.popitem()[1].verdict == "not simulated"


def test_what_vertices_lose_of_textures(mi):
    """The RMS over the surfaces that lose 5 % or more."""
    shapes = [
        outcome(mi, "a", with_id(mi, "Wall"), area=3.0, texture_lost=0.2),
        outcome(mi, "b", MATERIALS["Wall"], area=1.0, texture_lost=0.4),
        outcome(mi, "c", MATERIALS["Wall"], area=9.0, texture_lost=0.04),
    ]
    found = rows(mi, *shapes)
    (row,) = found.values()
    assert row.name == "texture between vertices of material 'Wall' and shape 'b' (2 shapes)"
    assert row.share == pytest.approx(((3 * 0.2**2 + 0.4**2) / 4) ** 0.5)
    assert row.verdict == "gathered"
    assert not rows(mi, shapes[2])


def test_rows_of_older_files_are_not_simulated():
    assert LeftOut("gloss", 0.5, "why").verdict == "not simulated"


def test_leaning_normals_are_told_with_their_part(mi):
    """Of the shapes that have them, by area; of smooth meshes nothing."""
    bsdf = MATERIALS["Wall"]
    found = rows(
        mi,
        outcome(mi, "box", bsdf, area=3.0, leaning=0.1),
        outcome(mi, "room", bsdf, area=1.0, leaning=0.3),
        outcome(mi, "ball", bsdf, area=9.0, leaning=0.01),
    )
    (row,) = found.values()
    assert row.name == "leaning normals of shapes 'box', 'room'"
    assert row.share == pytest.approx(0.15)
    assert "face_normals" in row.reason


def test_boxes_with_one_normal_at_each_corner(tmp_path):
    """As Mitsuba makes them of files without normals; with hard edges they lean nowhere."""
    trimesh.creation.box().export(tmp_path / "box.ply")
    named = '<string name="filename" value="box.ply"/>'
    for flat in ("false", "true"):
        flag = f'<boolean name="face_normals" value="{flat}"/>'
        (tmp_path / "scene.xml").write_text(
            f'<scene version="3.0.0"><shape type="ply" id="box">{named}{flag}<bsdf type="diffuse"/></shape></scene>'
        )
        with open_scene(tmp_path / "scene.xml") as scene:
            names = [row.name for row in scene.not_simulated]
        assert ("leaning normals of shape 'box'" in names) == (flat == "false")
