"""Workers give the bytes that one process gives; here without Dask, whose own tests are in `tests/distributed`."""

import pickle
import zipfile
from contextlib import ExitStack
from dataclasses import replace

import numpy as np
import pytest

from slepian_prt.compression import tracing_by_workers as remote
from slepian_prt.compression.checkpoint import Journal
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.compression.stream import compress_scene
from slepian_prt.errors import UserError
from slepian_prt.transport.settings import TransportSettings
from tests.conftest import bumpy

JOB = TransportSettings(bandlimit=6, samples=256)


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("SLEPIAN_PRT_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """Blocks and pieces so small that small meshes have many."""
    monkeypatch.setattr("slepian_prt.transport.direct._RAYS_PER_BLOCK", 1 << 16)
    monkeypatch.setattr("slepian_prt.compression.blocks._PIECE", 1 << 13)


class Crew:
    """Does the tasks of a crew in this process, in an order of its own, with all that goes back and forth pickled.

    What `lost` holds is forgotten each time that it was made, and made again when it is needed.
    """

    def __init__(self, *lost) -> None:
        self._lost, self._stack, self._opened = lost, ExitStack(), {}
        self.calls: list[str] = []
        self.fetched = 0

    def share(self, value, digest=None):
        self._opened[digest] = self._stack.enter_context(pickle.loads(pickle.dumps(value)).open())
        return digest

    def release(self, shared):
        del self._opened[shared]
        if not self._opened:
            self._stack.close()

    def submit(self, function, items, shared=None, *, priority=0, key=None):
        return [Future(self, function, item, shared) for item in items]

    def results(self, futures):
        for number in np.random.default_rng(0).permutation(len(futures)).tolist():
            sent = pickle.dumps(futures[number].result())
            self.fetched += len(sent)
            yield number, pickle.loads(sent)

    def gather(self, futures):
        return [found for _, found in sorted(self.results(futures), key=lambda pair: pair[0])]


class Future:
    def __init__(self, crew, function, item, shared) -> None:
        self._crew, self._function, self._item, self._shared = crew, function, item, shared
        self._made = None

    def result(self):
        if self._made is None:
            self._crew.calls.append(self._function.__name__)
            item = pickle.loads(pickle.dumps(fill(self._item)))
            made = pickle.dumps(self._function(self._crew._opened[self._shared], item))
            if self._function.__name__ in self._crew._lost:
                return pickle.loads(made)
            self._made = made
        return pickle.loads(self._made)


def fill(item):
    if isinstance(item, Future):
        return item.result()
    if isinstance(item, list | tuple) and not hasattr(item, "_fields"):
        return type(item)(fill(each) for each in item)
    return item


def content(packed, tmp_path) -> dict[str, bytes]:
    packed.save(tmp_path / "out.prt")
    with zipfile.ZipFile(tmp_path / "out.prt") as container:
        return {name: container.read(name) for name in container.namelist() if name != "manifest.json"}


CODED = CompressionSettings(tolerance=0.05, clusters=12)


@pytest.mark.parametrize(
    "settings",
    [
        CODED,
        CompressionSettings(tolerance=0.3, clusters=3),  # so few pieces that they stay rounded between attempts
        CompressionSettings(terms=9, clusters=12),
        CompressionSettings(terms=9, clusters=12, refine=True),
        CompressionSettings(tolerance=0.05, clusters=12, group_by="bent", occlusion_classes=2),
    ],
)
def test_workers_give_the_same_bytes(settings, tmp_path):
    mesh = bumpy(4)
    alone = compress_scene(mesh, settings, JOB)
    crew = Crew()
    together = compress_scene(mesh, settings, JOB, crew=crew)
    assert crew.calls.count("_trace_block") > 4
    assert content(together, tmp_path) == content(alone, tmp_path)  # the same calls on the same machine
    assert together.rays_traced == alone.rays_traced
    assert together.expected.lost.tolist() == alone.expected.lost.tolist()
    assert together.terms == alone.terms


@pytest.mark.parametrize("lost", ["_trace_block", "_assemble_piece", "_encode_piece"])
def test_what_is_lost_is_made_again_and_comes_out_the_same(lost, tmp_path):
    mesh = bumpy(4)
    crew = Crew(lost)
    found = compress_scene(mesh, CODED, JOB, crew=crew)
    usual = Crew()
    assert content(found, tmp_path) == content(compress_scene(mesh, CODED, JOB, crew=usual), tmp_path)
    assert crew.calls.count(lost) > usual.calls.count(lost)


def test_a_block_that_was_finished_is_not_traced_again(monkeypatch):
    """Also where the worker that has it died: its journal is there."""
    added, add = [], Journal.add
    monkeypatch.setattr(
        Journal, "add", lambda journal, number, block: (added.append(number), add(journal, number, block))
    )
    crew = Crew("_trace_block")
    compress_scene(bumpy(4), CODED, JOB, crew=crew)
    assert crew.calls.count("_trace_block") > len(added)
    assert sorted(added) == list(range(len(added)))


def test_coefficients_stay_with_the_workers():
    """What comes back is the file and little else."""
    settings = CompressionSettings(tolerance=0.005, clusters=6)
    packed = compress_scene(bumpy(5), settings, JOB, crew=(crew := Crew()))
    in_the_file = packed.bytes_per_vertex * packed.vertex_count
    coefficients = 4 * packed.bases[0].count * packed.vertex_count
    assert crew.fetched < 2.0 * in_the_file
    assert crew.fetched < 0.5 * coefficients


def test_another_disk_than_the_clients(monkeypatch, tmp_path, cache):
    """A worker that cannot write to the client's journal keeps one of its own for as long as it works."""
    monkeypatch.setattr(remote.os, "access", lambda *_: False)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    kept, add = [], Journal.add
    monkeypatch.setattr(Journal, "add", lambda journal, *block: (kept.append(journal.folder), add(journal, *block)))
    compress_scene(bumpy(4), CODED, JOB, crew=Crew())
    assert len(kept) > 4
    assert all(folder.parent == tmp_path for folder in kept)
    assert not list(tmp_path.glob("slepian_prt-*"))


def test_a_pilot_that_saw_too_little_is_made_up_for(monkeypatch, tmp_path):
    monkeypatch.setattr("slepian_prt.compression.pilot.PILOT_SIZE", 1)
    settings = CompressionSettings(tolerance=0.03, clusters=12)
    crew = Crew()
    found = content(compress_scene(bumpy(4), settings, JOB, crew=crew), tmp_path)
    assert found == content(compress_scene(bumpy(4), settings, JOB), tmp_path)


def test_objects_of_mitsuba_are_refused():
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    scene = mi.load_dict({"type": "scene", "ball": {"type": "sphere"}, "floor": {"type": "rectangle"}})
    with pytest.raises(UserError, match="objects of Mitsuba cannot be sent to workers"):
        compress_scene(scene, CODED, replace(JOB, effects="direct"), crew=Crew())
