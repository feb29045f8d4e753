"""Transfer that is kept uncompressed is the same when it is read back."""

import json
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

import slepian_prt as sp
from slepian_prt.lighting.emitters import SkyEnvironment
from slepian_prt.lighting.environment import make_environment
from slepian_prt.scene.left_out import LeftOut
from slepian_prt.scene.mesh import Mesh
from slepian_prt.transport.transfer import Transfer
from tests.conftest import bumpy
from tests.numerics import assert_exact

PANE = """<shape type="rectangle" id="floor"><bsdf type="diffuse"/></shape><shape type="sphere" id="ball">
<transform name="to_world"><scale value="0.3"/><translate z="0.5"/></transform><bsdf type="diffuse"/></shape>"""
EYE = '<sensor type="perspective" id="eye"><transform name="to_world"><translate z="9"/></transform></sensor>'


def assert_same(read: Transfer, kept: Transfer) -> None:
    """Every attribute, arrays with their types."""
    for one, other, names in (
        (read, kept, [field.name for field in fields(Transfer)]),
        (read.mesh, kept.mesh, [field.name for field in fields(Mesh)]),
    ):
        for name in names:
            mine, theirs = getattr(one, name), getattr(other, name)
            if isinstance(theirs, np.ndarray):
                assert mine.dtype == theirs.dtype
                assert_exact(mine, theirs, "copied")
            elif name not in ("mesh", "environment"):
                assert mine == theirs, name


def traced(tmp_path: Path, light: str = "", more: str = "", **options) -> Transfer:
    scene = f'<scene version="3.0.0">{PANE}{light}{more}</scene>'
    (tmp_path / "scene.xml").write_text(scene)
    return sp.precompute(tmp_path / "scene.xml", 3, 16, **options)


def test_a_mesh(tmp_path):
    left_out = (LeftOut("transmission", 0.25, "none is"), LeftOut("gloss"))
    mesh = replace(bumpy(2), known_albedo=True, notes=("a", "b"), not_simulated=left_out)
    mesh = replace(mesh, albedo=np.full((162, 3), 0.5, dtype=np.float32))
    kept = sp.precompute(mesh, 4, 64)
    assert kept.bounces > 0
    kept.save(tmp_path / "kept.npz")
    assert_same(sp.load_transfer(tmp_path / "kept.npz"), kept)
    assert [p.name for p in tmp_path.iterdir()] == ["kept.npz"]


def test_three_channels_and_a_camera(tmp_path):
    box = PANE.replace('type="diffuse"/>', 'type="diffuse"><rgb name="reflectance" value="0.9, 0.5, 0.1"/></bsdf>')
    (tmp_path / "scene.xml").write_text(f'<scene version="3.0.0">{EYE}{box}</scene>')
    for options in ({"effects": "all"}, {"view": "eye"}):
        kept = sp.precompute(tmp_path / "scene.xml", 2, 16, **options)
        kept.save(tmp_path / "kept.npz")
        read = sp.load_transfer(tmp_path / "kept.npz")
        assert_same(read, kept)
        assert read.view is not None
        assert read.toward_view == ("view" in options) == (read.axes is not read.mesh.normals)
    assert kept.parts


@pytest.mark.parametrize("light", ['<emitter type="constant"/>', '<emitter type="sunsky"/>'])
def test_the_light_of_a_scene(light, tmp_path):
    kept = traced(tmp_path, light)
    assert isinstance(kept.environment, SkyEnvironment) == ("sunsky" in light)
    kept.save(tmp_path / "kept.npz")
    read = sp.load_transfer(tmp_path / "kept.npz")
    assert_same(read, kept)
    assert repr(read.environment) == repr(kept.environment)
    mine, theirs = (sp.project_environment(transfer.environment, 3) for transfer in (read, kept))
    assert_exact(mine, theirs, "the same sums of the same numbers on one machine")


def test_the_lamps_of_a_scene(tmp_path):
    lamps = """<emitter type="point" id="bulb"><point name="position" x="0" y="0" z="2"/></emitter>
    <emitter type="directional" id="sun"><vector name="direction" x="0" y="0" z="-1"/></emitter>"""
    kept = traced(tmp_path, lamps)
    kept.save(tmp_path / "kept.npz")
    read = sp.load_transfer(tmp_path / "kept.npz")
    assert_same(replace(read, fixed=None), replace(kept, fixed=None))
    assert read.fixed is not None
    assert kept.fixed is not None
    assert (read.fixed.names, read.fixed.kinds) == (("bulb", "sun"), ("point", "directional"))
    for name in ("emitted", "direct", "bounced", "directions"):
        assert_exact(getattr(read.fixed, name), getattr(kept.fixed, name), "copied")
    with np.load(tmp_path / "kept.npz") as file:
        arrays = dict(file)
    np.savez(tmp_path / "less.npz", **{**arrays, "fixed_direct": arrays["fixed_direct"][:1]})
    with pytest.raises(sp.UserError, match="fixed_direct of shape"):
        sp.load_transfer(tmp_path / "less.npz")


def test_it_compresses_to_the_same_file(tmp_path):
    kept = sp.precompute(bumpy(2), 4, 64)
    kept.save(tmp_path / "kept.npz")
    for name, transfer in (("one", kept), ("other", sp.load_transfer(str(tmp_path / "kept.npz")))):
        packed = sp.compress(transfer, clusters=4)
        replace(packed, seconds={}).save(tmp_path / f"{name}.prt")
    assert (tmp_path / "one.prt").read_bytes() == (tmp_path / "other.prt").read_bytes()  # one machine


def test_numpy_alone_reads_it(tmp_path):
    kept = sp.precompute(bumpy(1), 2, 16)
    kept.save(tmp_path / "kept.npz")
    with np.load(tmp_path / "kept.npz") as file:
        assert set(file.files) == {"about", "vectors", "positions", "normals", "faces", "albedo"}
        assert_exact(file["vectors"], kept.vectors, "copied")
        assert json.loads(str(file["about"]))["bandlimit"] == 2


def test_mistakes_in_names(tmp_path):
    kept = replace(sp.precompute(bumpy(1), 1, 16), environment=make_environment(np.ones((3, 6, 3))))
    for name, message in (
        ("kept.prt", "kept as .npz"),
        ("kept", "kept as .npz"),
        ("none/kept.npz", "does not exist"),
        ("", "is a folder"),
    ):
        with pytest.raises(sp.UserError, match=message):
            kept.save(tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_what_is_not_such_a_file(tmp_path):
    kept = sp.precompute(bumpy(1), 1, 16)
    kept.save(tmp_path / "kept.npz")
    content = (tmp_path / "kept.npz").read_bytes()
    with np.load(tmp_path / "kept.npz") as file:
        arrays = dict(file)
    about = json.loads(str(arrays["about"]))
    np.savez(tmp_path / "foreign.npz", a=np.ones(3))
    np.save(tmp_path / "array.npy", np.ones(3))
    np.savez(tmp_path / "future.npz", **{**arrays, "about": np.array(json.dumps({**about, "version": 2}))})
    np.savez(tmp_path / "shorter.npz", **{**arrays, "vectors": arrays["vectors"][:-1]})
    np.savez(tmp_path / "astray.npz", **{**arrays, "faces": arrays["faces"] + 1})
    np.savez(tmp_path / "pickled.npz", **{**arrays, "albedo": np.array([None])})
    sp.compress(kept, clusters=2).save(tmp_path / "packed.prt")
    middle = len(content) // 2
    for name, broken in {
        "empty.npz": b"",
        "text.npz": b"hello",
        "cut.npz": content[:middle],
        "changed.npz": content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :],
    }.items():
        (tmp_path / name).write_bytes(broken)
    for path in sorted(tmp_path.iterdir()):
        if path.name != "kept.npz":
            with pytest.raises(sp.UserError, match=r"no file of Transfer\.save|format version 2") as refused:
                sp.load_transfer(path)
            assert "\n" not in str(refused.value)
    for name, message in (("none.npz", "no such file"), ("", "is a folder")):
        with pytest.raises(sp.UserError, match=message):
            sp.load_transfer(tmp_path / name)


CHANGES = {
    "none": {"parts": []},
    "fewer": {"parts": [["a", 0, 10, 1]]},
    "more": {"parts": [["a", 0, 1 << 30, 1]]},
    "split": {"parts": [["a", 0, 20, 1], ["b", 20, 22, 1]]},
    "bounces": {"bounces": 10**30},
    "noise": {"noise": -1.0},
    "view": {"view": {"name": "v", "to_world": np.zeros((4, 4)).tolist(), "fov": 40.0, "width": 8, "height": 8,
                      "near": 0.1, "far": 5.0}},
    "behind": {"view": {"name": "v", "to_world": np.eye(4).tolist(), "fov": 40.0, "width": 8, "height": 8,
                        "near": 5.0, "far": 0.1}},
}  # fmt: skip


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """The arrays of a file, and what is told of them."""
    path = tmp_path_factory.mktemp("small") / "kept.npz"
    sp.precompute(bumpy(1), 1, 16).save(path)
    with np.load(path) as file:
        arrays = dict(file)
    return arrays, json.loads(str(arrays["about"]))


@pytest.mark.parametrize("name", CHANGES)
def test_what_is_told_does_not_fit_the_arrays_or_cannot_be(name, small, tmp_path):
    arrays, about = small
    np.savez(tmp_path / "a.npz", **{**arrays, "about": np.array(json.dumps(about | CHANGES[name]))})
    with pytest.raises(sp.UserError, match="cut short or damaged"):
        sp.load_transfer(tmp_path / "a.npz")


def test_lamps_and_films_that_cannot_be(small, tmp_path):
    arrays, about = small
    count = len(arrays["positions"])
    lamps = {f"fixed_{name}": np.ones((1, count, 3)) for name in ("direct", "bounced")}
    lamps |= {"fixed_emitted": np.ones((1, 3)), "fixed_directions": np.full((1, 3), 1e18)}
    told = about | {"fixed": {"names": ["a"], "kinds": ["point"]}}
    np.savez(tmp_path / "a.npz", **{**arrays, **lamps, "about": np.array(json.dumps(told))})
    with pytest.raises(sp.UserError, match="fixed_directions outside"):
        sp.load_transfer(tmp_path / "a.npz")
    film = {"name": "f", "width": count, "height": 1, "crop": [0, 0], "size": [0, 0]}
    np.savez(tmp_path / "a.npz", **{**arrays, "about": np.array(json.dumps(about | {"film": film}))})
    with pytest.raises(sp.UserError, match="size"):
        sp.load_transfer(tmp_path / "a.npz")


def test_backs_that_are_not_their_fronts_turned_round(small, tmp_path):
    arrays, about = small
    half = len(arrays["positions"]) // 2
    np.savez(tmp_path / "a.npz", **{**arrays, "about": np.array(json.dumps(about | {"parts": [["a", 0, half, 2]]}))})
    with pytest.raises(sp.UserError, match="back must be"):
        sp.compress(sp.load_transfer(tmp_path / "a.npz"), clusters=2)
