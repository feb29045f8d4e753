"""Many scenes into one folder: what is written, what is done again, what is collected."""

import json
import logging
import os
import pickle
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import slepian_prt as sp
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.datasets.by_workers import mapped_by
from slepian_prt.datasets.jobs import ScanSettings
from slepian_prt.datasets.precompute_set import run_set
from slepian_prt.datasets.records import NAME
from slepian_prt.transport.settings import TransportSettings
from tests.datasets.obj_as_theirs import read_icon, read_pifu, read_triangles
from tests.datasets.scans import bent_ball, write_ball, write_obj
from tests.numerics import assert_exact

SMALL = {"bandlimit": 2, "samples": 16, "clusters": 4}


@pytest.fixture
def scans(tmp_path) -> list[Path]:
    return [write_ball(tmp_path / f"{name}.obj", seed, 1) for seed, name in enumerate("abc")]


def lines(folder: Path) -> list[dict]:
    return [json.loads(line) for line in (folder / NAME).read_text().splitlines()]


def made(results) -> list[str]:
    """Names of what was done now."""
    return [result.name for result in results if not result.kept and result.failure is None]


def test_files_are_those_of_single_scenes(scans, tmp_path):
    out = tmp_path / "new" / "out"
    results = sp.precompute_set(scans, out, tolerance=0.05, **SMALL)
    assert [result.outputs for result in results] == [("a.prt",), ("b.prt",), ("c.prt",)]
    assert sorted(path.name for path in out.iterdir()) == ["a.prt", "b.prt", "c.prt", NAME]
    for scan, result, line in zip(scans, results, lines(out), strict=True):
        transfer = sp.precompute(scan, bandlimit=2, samples=16)
        packed = sp.load(out / result.outputs[0])
        single = sp.compress(transfer, clusters=4, tolerance=0.05)
        assert len(packed.mesh.positions) == result.vertices == len(transfer.vectors)
        # The kept order is the source's, vertex by vertex; both round to the tolerance.
        difference = np.linalg.norm(packed.reconstruct() - single.reconstruct())
        assert difference <= 0.1 * np.linalg.norm(transfer.vectors)
        assert result.bytes == (out / result.outputs[0]).stat().st_size
        assert line["source"] == str(scan)
        assert {"load", "plan", "transport", "compress", "write", "all"} <= set(line["seconds"])
        assert sum(line["seconds"].values()) <= 2.0 * line["seconds"]["all"] + 1e-2
        assert 0.0 < line["error"] <= 0.06
        assert line["rays"] > 0


def test_what_is_there_is_not_done_again(scans, tmp_path):
    sp.precompute_set(scans, tmp_path / "out", **SMALL)
    before = (tmp_path / "out" / NAME).read_bytes()
    results = sp.precompute_set(scans, tmp_path / "out", **SMALL)
    assert made(results) == []
    assert [result.vertices for result in results] == [42, 42, 42]
    assert (tmp_path / "out" / NAME).read_bytes() == before


@pytest.mark.parametrize("fault", ["cut", "changed", "gone", "source", "nothing"])
def test_what_is_not_whole_is_done_again(fault, scans, tmp_path):
    out = tmp_path / "out"
    sp.precompute_set(scans, out, **SMALL)
    path, content = out / "b.prt", (out / "b.prt").read_bytes()
    if fault == "cut":
        path.write_bytes(content[:-1])
    elif fault == "changed":
        path.write_bytes(content[:100] + bytes([content[100] ^ 1]) + content[101:])
    elif fault == "gone":
        path.unlink()
    elif fault == "source":
        write_ball(scans[1], 9, 1)
    assert made(sp.precompute_set(scans, out, **SMALL)) == ([] if fault == "nothing" else ["b"])
    assert made(sp.precompute_set(scans, out, **SMALL)) == []
    sp.load(path)


def test_other_settings_are_done_again(scans, tmp_path):
    sp.precompute_set(scans[:1], tmp_path / "out", **SMALL)
    for changed in ({"seed": 1}, {"tolerance": 0.1}, {"formats": ("prt", "pifu")}):
        assert made(sp.precompute_set(scans[:1], tmp_path / "out", **SMALL, **changed)) == ["a"]


def test_what_fails_does_not_stop_the_rest(scans, tmp_path):
    """Mistakes and faults of ours are results, and are tried again."""
    out = tmp_path / "out"
    (tmp_path / "empty.obj").write_text("")
    bad = [tmp_path / "none.obj", scans[0], tmp_path / "empty.obj", *scans[1:]]
    results = sp.precompute_set(bad, out, **SMALL)
    assert [result.failure for result in results] == [
        f"{tmp_path}/none.obj: no such file; check the path",
        None,
        f"{tmp_path}/empty.obj: the file is empty; export the mesh again",
        None,
        None,
    ]
    assert [line.get("failure") for line in lines(out)] == [result.failure for result in results]
    assert not list(out.glob("none*"))
    write_ball(bad[0], 5, 1)
    results = sp.precompute_set(bad, out, **SMALL)
    assert made(results) == ["none"]
    assert [result.kept for result in results] == [False, True, False, True, True]


def test_a_fault_of_ours_is_one_line(scans, tmp_path, monkeypatch):
    def fail(*_, **__):
        raise ZeroDivisionError("by\nzero")

    monkeypatch.setattr("slepian_prt.datasets.scan.compress_scene", fail)
    (result,) = sp.precompute_set(scans[:1], tmp_path / "out", **SMALL)
    assert result.failure == "internal error, ZeroDivisionError: by zero (please report it)"


def test_an_interrupt_keeps_what_is_done(scans, tmp_path):
    def stop(result):
        if result.name == "b":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sp.precompute_set(scans, tmp_path / "out", on_result=stop, **SMALL)
    assert made(sp.precompute_set(scans, tmp_path / "out", **SMALL)) == ["c"]


@pytest.mark.slow
def test_a_killed_run_goes_on(tmp_path):
    """Killed with SIGKILL once a line is there: what has its line is kept, and all ends as if nothing had been."""
    scans = [write_ball(tmp_path / f"{number}.obj", number, 2) for number in range(6)]
    out = tmp_path / "out"
    code = f"import slepian_prt as sp; sp.precompute_set({[str(s) for s in scans]!r}, {str(out)!r}, **{SMALL!r})"
    process = subprocess.Popen([sys.executable, "-c", code])
    while process.poll() is None and not (out / NAME).is_file():
        time.sleep(0.01)
    process.kill()
    process.wait()
    there = {line["name"] for line in lines(out)}
    results = sp.precompute_set(scans, out, **SMALL)
    assert {result.name for result in results if result.kept} == there
    assert [line["name"] for line in lines(out)] == [scan.stem for scan in scans]
    assert sorted(path.name for path in out.iterdir()) == sorted([NAME, *(f"{scan.stem}.prt" for scan in scans)])


@pytest.mark.slow
def test_what_kills_the_process_comes_last(scans, tmp_path):
    """It dies at the second of three scans; the third is done when it is started again."""
    out = tmp_path / "out"
    code = (
        "import os, slepian_prt as sp, slepian_prt.datasets.scan as scan\n"
        "traced = scan.compress_scene\n"
        "scan.compress_scene = lambda path, *more: os._exit(9) if 'b.obj' in path else traced(path, *more)\n"
        f"sp.precompute_set({[str(scan) for scan in scans]!r}, {str(out)!r}, **{SMALL!r})"
    )
    for there in (["a"], ["a", "c"]):
        assert subprocess.run([sys.executable, "-c", code]).returncode == 9
        assert sorted(line["name"] for line in lines(out)) == there
    assert subprocess.run([sys.executable, "-c", code]).returncode == 9
    failed = sp.precompute_set(scans, out, **SMALL)[1]  # after the third: so that workers do not die of it for ever
    assert "b.obj: each of 3 processes that did it was killed" in failed.failure
    assert made(sp.precompute_set(scans, out, **SMALL)) == ["b"]
    assert sorted(path.name for path in out.iterdir()) == ["a.prt", "b.prt", "c.prt", NAME]


def test_what_killed_processes_left_is_gone(tmp_path):
    """Half a file under another name, of outputs and of the records."""
    path, out = write_ball(tmp_path / "a.obj", 0, 1), tmp_path / "out"
    left = [
        out / ".a.prt.0123456789abcdef.part",
        out / f".{NAME}.0123456789abcdef.part",
        out / "a" / "bounce" / ".face.npy.0123456789abcdef.part",
    ]
    others = [out / ".b.prt.0123456789abcdef.part", out / "a" / ".face.npy.0123456789abcdef.part"]
    for partial in (*left, *others):
        partial.parent.mkdir(parents=True, exist_ok=True)
        partial.write_bytes(b"half")
    sp.precompute_set([path], out, formats=("prt", "pifu"), **SMALL)
    assert not any(partial.exists() for partial in left)
    assert all(partial.exists() for partial in others)


class Elsewhere:
    """A crew that does its tasks in another folder, the last first; what goes back and forth is pickled."""

    def submit(self, function, items, shared=None, *, key=None):
        return [pickle.dumps((function, item)) for item in items]

    def results(self, futures):
        for number in reversed(range(len(futures))):
            function, item = pickle.loads(futures[number])
            here = os.getcwd()
            os.chdir("/")
            try:
                made = function(None, item)
            finally:
                os.chdir(here)
            yield number, pickle.loads(pickle.dumps(made))


def test_scans_are_done_by_workers(scans, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    settings = ScanSettings(
        transport=TransportSettings(bandlimit=2, samples=16), compression=CompressionSettings(clusters=4)
    )
    told = []
    results = run_set(["a.obj", "b.obj", "c.obj"], "out", settings, told.append, mapped_by(Elsewhere()))
    assert [result.name for result in results] == ["a", "b", "c"]
    assert [result.source for result in told] == ["c.obj", "b.obj", "a.obj"]
    assert [line["name"] for line in lines(tmp_path / "out")] == ["a", "b", "c"]
    assert all((tmp_path / "out" / f"{name}.prt").is_file() for name in "abc")
    again = run_set(["a.obj", "b.obj", "c.obj"], "out", settings)
    assert made(again) == []


def test_notes_are_those_of_the_scan(scans, tmp_path):
    """What its reader and its mesh have to say, without its name; the log says it too."""
    flat = bent_ball(0, 1)
    path = write_obj(tmp_path / "flat.obj", flat.vertices, [*(flat.faces + 1).tolist(), [1, 1, 2]], "l 1 2")
    messages: list[str] = []
    log, handler = logging.getLogger("slepian_prt"), logging.Handler()
    handler.emit = lambda record: messages.append(record.getMessage())
    log.addHandler(handler)
    try:
        results = sp.precompute_set([scans[0], path], tmp_path / "out", **SMALL)
    finally:
        log.removeHandler(handler)
    assert results[0].notes == ()
    assert set(results[1].notes) == {"1 faces of zero area left out", "1 points and lines left out"}
    assert f"{path}: 1 faces of zero area left out" in messages


def test_scans_of_one_name(tmp_path):
    """Of one run by their folders; of another run they are refused, unless the first is gone."""
    scans = [write_ball(tmp_path / folder / "mesh.obj", seed, 1) for seed, folder in enumerate(("one", "two"))]
    results = sp.precompute_set(scans, tmp_path / "out", **SMALL)
    assert [result.outputs for result in results] == [("one-mesh.prt",), ("two-mesh.prt",)]
    sp.precompute_set(scans[:1], tmp_path / "single", **SMALL)
    with pytest.raises(sp.UserError, match=r"single: mesh there is of .*one/mesh.obj; choose another folder for .*two"):
        sp.precompute_set(scans[1:], tmp_path / "single", **SMALL)
    moved = scans[0].rename(tmp_path / "mesh.obj")
    assert made(sp.precompute_set([moved], tmp_path / "single", **SMALL)) == []


def test_scans_with_one_folder_of_pifu(tmp_path):
    scans = [write_ball(tmp_path / name, 0, 1) for name in ("x_100k.obj", "x_OBJ.obj")]
    with pytest.raises(sp.UserError, match="would both be in the folder x_OBJ of PIFu; rename one"):
        sp.precompute_set(scans, tmp_path / "out", formats="pifu")
    assert made(sp.precompute_set(scans, tmp_path / "out", formats="icon")) == ["x_100k", "x_OBJ"]


def test_a_file_where_a_folder_has_to_be(scans, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "a").write_text("")
    results = sp.precompute_set(scans[:2], tmp_path / "out", formats="icon")
    assert "out/a/prt: cannot be made" in (results[0].failure or "")
    assert results[1].failure is None


@pytest.mark.skipif(sys.platform != "linux", reason="names of files are text there")
@pytest.mark.parametrize("name", ["\u2028\x85".encode(), "ü\n".encode()])
def test_names_that_look_like_ends_of_lines(name, tmp_path):
    scan = write_ball(tmp_path / os.fsdecode(name + b".obj"), 0, 1)
    assert len(made(sp.precompute_set([scan], tmp_path / "out", **SMALL))) == 1
    assert made(sp.precompute_set([scan], tmp_path / "out", **SMALL)) == []
    assert (tmp_path / "out" / NAME).read_bytes().count(b"\n") == 1


@pytest.mark.skipif(sys.platform != "linux", reason="names of files are text there")
def test_a_name_that_is_no_text(scans, tmp_path):
    """Mitsuba takes none such; the others are done, and the records can be read."""
    odd = tmp_path / os.fsdecode(b"\xff.obj")
    odd.write_bytes(scans[0].read_bytes())
    for done in (["a"], []):
        results = sp.precompute_set([odd, scans[0]], tmp_path / "out", **SMALL)
        assert results[0].failure is not None
        assert made(results) == done
    assert len(lines(tmp_path / "out")) == 2


def test_training_formats(tmp_path):
    """All faces of the file with its transfer, at whatever corner: as dark there as a dense reference says."""
    ball = bent_ball(3, 3)
    faces = (ball.faces + 1).tolist()
    path = write_obj(tmp_path / "scan_100k.obj", ball.vertices, [*faces[:5], [9, 9, 8], *faces[5:]])
    (result,) = sp.precompute_set([path], tmp_path / "out", formats=("icon", "prt", "pifu"), bandlimit=2, clusters=4)
    assert set(result.outputs) == {
        "scan_100k.prt",
        "scan_OBJ/bounce/bounce0.txt",
        "scan_OBJ/bounce/face.npy",
        "scan_100k/prt/bounce.npy",
        "scan_100k/prt/face.npy",
    }
    table, corners = read_pifu(tmp_path / "out" / "scan_OBJ")
    other, same = read_icon(tmp_path / "out" / "scan_100k")
    assert_exact(corners, same, "the same numbers")
    np.testing.assert_allclose(table, other, rtol=0.0, atol=0.5e-8 + 1e-15)
    positions, triangles = read_triangles(path)
    dense = sp.precompute(path, bandlimit=2, samples=1024, effects="direct")
    assert_exact(dense.positions, positions, "the reader keeps vertices of a file without seams")
    expected = dense.vectors[triangles, 0] * np.pi * [1, -1, 1, -1, 1, -1, 1, -1, 1]
    assert np.linalg.norm(table[corners] - expected) <= 0.06 * np.linalg.norm(expected)


def test_other_formats_than_obj_are_refused_before_they_are_traced(tmp_path):
    bent_ball(0, 1).export(tmp_path / "ball.ply")
    (result,) = sp.precompute_set([tmp_path / "ball.ply"], tmp_path / "out", formats=("prt", "pifu"), **SMALL)
    assert "PIFu and ICON read OBJ files only" in (result.failure or "")
    assert not list((tmp_path / "out").glob("*.prt"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"scenes": []}, "no scene is given"),
        ({"formats": ("prt", "obj")}, "`formats` must be some of prt, pifu, icon, not 'obj'"),
        ({"formats": ()}, "`formats` must be some of"),
        ({"tolerence": 0.1}, "'tolerence' is no setting"),
        ({"tolerance": 2.0}, "tolerance must be"),
        ({"folder": ""}, "name of the output folder is empty"),
        ({"tolerance": 0.1, "terms": 3}, "only one of"),
    ],
)
def test_mistakes(arguments, message, scans, tmp_path):
    with pytest.raises(sp.UserError, match=message):
        sp.precompute_set(**{"scenes": scans, "folder": tmp_path / "out", **arguments})
    assert not (tmp_path / "out").exists()
