import gc
import os
import random
import subprocess
import sys
import tracemalloc
import zipfile
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from slepian_prt.compression import checkpoint as stores
from slepian_prt.compression.files.prt_file import load
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.compression.stream import compress, compress_scene
from slepian_prt.errors import UserError
from slepian_prt.relighting.operator import transfer_operator
from slepian_prt.transport.direct import DirectTransfer
from slepian_prt.transport.settings import TransportSettings
from slepian_prt.transport.transfer import precompute
from tests.conftest import bumpy, sphere
from tests.fuzzing import journals as damaged_blocks
from tests.numerics import assert_exact, assert_rounded
from tests.variants import VARIANT


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    folder = tmp_path / "cache"
    monkeypatch.setenv("SLEPIAN_PRT_CACHE", str(folder))
    return folder


def block(rng, size: int, rays: int) -> stores.Block:
    return stores.Block(
        np.arange(size, dtype=np.int32),
        stores.BlockStatistics(*rng.random((3, size), dtype=np.float32)),
        rng.random(7 * size, dtype=np.float32),
        rays,
    )


def same(a: stores.Block, b: stores.Block) -> bool:
    return all(np.asarray(x).tobytes() == np.asarray(y).tobytes() for x, y in zip(a, b, strict=True))


class Killed(BaseException):
    pass


def killed_after(blocks: dict[int, stores.Block]) -> None:
    """Leave a journal with these blocks behind."""

    def work() -> None:
        with stores.journal("job") as journal:
            for number, content in blocks.items():
                journal.add(number, content)
            raise Killed

    with pytest.raises(Killed):
        work()


def test_blocks_of_a_job_that_was_killed_are_kept(cache, rng):
    blocks = {number: block(rng, 5 + number, 10 * number) for number in (3, 1, 7)}
    killed_after(blocks)
    with stores.journal("job") as journal:
        assert len(dict(journal)) == 3
        assert all(same(blocks[number], content) for number, content in journal)
        vertices, coefficients = journal.part(7, slice(2, 5), slice(14, 35))
        assert vertices.tolist() == [2, 3, 4]
        assert_exact(coefficients, blocks[7].coefficients[14:35], because="a copy")
    assert list(cache.iterdir()) == []  # the job is done


@pytest.mark.parametrize(
    "damage", ["cut", "longer", "coefficient", "number", "rays", "sizes", "foreign", "empty", "huge"]
)
def test_a_damaged_journal_keeps_what_is_whole(damage, cache, rng):
    killed_after({number: block(rng, 50, 8) for number in range(4)})
    path = cache / "job.blocks" / "000002.block"
    content = bytearray(path.read_bytes())
    if damage == "cut":
        content = content[:-20]
    elif damage == "longer":
        content += b"more"
    elif damage == "coefficient":
        content[-100] ^= 1
    elif damage == "number":
        content[4] ^= 1
    elif damage == "rays":
        content[24] ^= 1
    elif damage == "sizes":  # one vertex less, and as many bytes
        content[8] -= 1
        content[16] += 4
    elif damage == "huge":
        content[15] = content[23] = 255
    else:
        content = bytearray(b"something else" if damage == "foreign" else b"")
    path.write_bytes(content)
    with stores.journal("job") as journal:
        assert [number for number, _ in journal] == [0, 1, 3]
        whole = block(rng, 3, 1)
        journal.add(2, whole)
        assert same(dict(journal)[2], whole)


def test_blocks_of_another_process_are_found(cache, rng):
    with stores.journal("job") as journal:
        other = stores.Journal(journal.folder)
        assert other.find(5) is None
        made = block(rng, 6, 2)
        journal.add(5, made)
        assert same(other.find(5), made)


def test_files_of_something_else_are_left_alone(cache, rng):
    killed_after({0: block(rng, 5, 8)})
    (cache / "job.blocks" / "tmpabc").write_bytes(b"half a block")
    (cache / "job.blocks" / "other.block").write_bytes(b"x")
    with stores.journal("job") as journal:
        assert [number for number, _ in journal] == [0]


def test_two_processes_do_not_share_a_journal(cache, rng):
    with stores.journal("job") as first:
        first.add(0, block(rng, 4, 0))
        with stores.journal("job") as second:
            assert list(second) == []
            second.add(1, block(rng, 4, 0))
        assert [number for number, _ in first] == [0]


def test_without_a_folder_for_it_work_goes_on(monkeypatch, tmp_path, rng):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("SLEPIAN_PRT_CACHE", str(tmp_path / "file" / "below"))
    with stores.journal("job") as journal:
        journal.add(0, block(rng, 4, 0))
        assert [number for number, _ in journal] == [0]


def test_old_journals_are_forgotten(cache):
    cache.mkdir()
    old, new, older = cache / "old.blocks", cache / "new.blocks", cache / "older.blocks"
    older.write_bytes(b"x")  # of a version that kept a single file
    for path in (old, new):
        path.mkdir()
        (path / "000001.block").write_bytes(b"x")
    for path in (old, older):
        os.utime(path, (0, 0))
    with stores.journal("job"):
        assert not old.exists()
        assert not older.exists()
        assert new.exists()


def test_a_full_disk_is_one_clear_line(monkeypatch, rng):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    with stores.journal("job") as journal:
        monkeypatch.setattr(stores.os, "replace", full)
        with pytest.raises(UserError, match=r"No space left on device.*SLEPIAN_PRT_CACHE"):
            journal.add(0, block(rng, 4, 0))
        assert [path.name for path in journal.folder.iterdir()] == ["lock"]


# --- Streaming -------------------------------------------------------------------------------------------------------

JOB = TransportSettings(bandlimit=6, samples=256)


def content(packed, tmp_path) -> dict[str, bytes]:
    packed.save(tmp_path / "out.prt")
    with zipfile.ZipFile(tmp_path / "out.prt") as container:
        return {name: container.read(name) for name in container.namelist() if name != "manifest.json"}


@pytest.mark.slow
@pytest.mark.parametrize(
    "settings",
    [
        CompressionSettings(tolerance=0.05, clusters=12),
        CompressionSettings(terms=9, clusters=12),
        CompressionSettings(terms=9, clusters=12, refine=True),
        CompressionSettings(tolerance=0.05, clusters=12, group_by="bent", occlusion_classes=2),
        CompressionSettings(tolerance=0.05, clusters=12, group_by="surface", refine=True),
        CompressionSettings(basis="none"),
        CompressionSettings(basis="pca", terms=9, clusters=12),
    ],
)
def test_streamed_is_as_good_as_in_memory(settings, tmp_path):
    mesh = bumpy(4)
    transfer = precompute(mesh, 6, 256)
    streamed = compress_scene(mesh, settings, JOB)
    options = dict(vars(settings))
    whole = compress(transfer, **options)
    reference = transfer.vectors[:, 0]
    errors = [np.linalg.norm(p.reconstruct()[:, 0] - reference) / np.linalg.norm(reference) for p in (streamed, whole)]
    assert errors[0] == pytest.approx(errors[1], rel=0.02, abs=1e-4)
    # Before transfer is there, bent normals and occlusion are only looked at with a few rays.
    rough = 0.2 if settings.group_by == "bent" else 0.02
    assert streamed.bytes_per_vertex == pytest.approx(whole.bytes_per_vertex, rel=rough)
    if settings.group_by != "bent":
        assert streamed.terms == pytest.approx(whole.terms, rel=rough)
    streamed.save(tmp_path / "streamed.prt", keep_order=True)
    read = load(tmp_path / "streamed.prt").reconstruct()
    assert_rounded(read, streamed.reconstruct(), terms=2 * 49, size=1.0)  # vectors are shorter than one


@pytest.mark.slow
@pytest.mark.parametrize("after", [0, 1, 3, 6])
def test_killed_at_any_block_and_resumed_gives_the_same_bytes(after, tmp_path, monkeypatch, cache, caplog):
    monkeypatch.setattr("slepian_prt.transport.direct._RAYS_PER_BLOCK", 1 << 16)
    mesh, settings = bumpy(4), CompressionSettings(tolerance=0.05, clusters=12)
    traced, blocks_of = [], DirectTransfer.blocks  # how many blocks, of the pilot and then of the rest

    def counted(source, pieces, *rest):
        traced.append(len(pieces))
        return blocks_of(source, pieces, *rest)

    monkeypatch.setattr(DirectTransfer, "blocks", counted)
    uninterrupted = compress_scene(mesh, settings, JOB)
    whole = content(uninterrupted, tmp_path)
    pilot, blocks = traced
    assert blocks > 6
    add, added = stores.Journal.add, []

    def add_some(journal, number, content):
        if len(added) == after:
            raise Killed
        added.append(number)
        add(journal, number, content)

    with monkeypatch.context() as patched:
        patched.setattr(stores.Journal, "add", add_some)
        with pytest.raises(Killed):
            compress_scene(mesh, settings, JOB)
    assert len(list(cache.iterdir())) == 1
    traced.clear()
    with caplog.at_level("INFO"):
        resumed = compress_scene(mesh, settings, JOB)
    assert content(resumed, tmp_path) == whole  # the same calls on the same machine
    assert ("were finished before and are kept" in caplog.text) == (after > 0)
    assert traced == [pilot, blocks - after]
    assert resumed.rays_traced == uninterrupted.rays_traced


@pytest.mark.parametrize("seed", range(12))
def test_blocks_that_are_not_those_of_the_plan_are_put_aside_and_done_again(seed, tmp_path, monkeypatch, cache, caplog):
    """Whatever is in the journal, also with right checksums, the file is that of an undisturbed run."""
    monkeypatch.setattr("slepian_prt.transport.direct._RAYS_PER_BLOCK", 1 << 12)
    mesh, settings, job = bumpy(3), CompressionSettings(tolerance=0.1, clusters=6), TransportSettings(4, 64)
    whole = compress_scene(mesh, settings, job)
    reference = content(whole, tmp_path)
    add, added = stores.Journal.add, []

    def add_some(journal, number, block):
        if len(added) == 3:
            raise Killed
        added.append(number)
        add(journal, number, block)

    with monkeypatch.context() as patched:
        patched.setattr(stores.Journal, "add", add_some)
        with pytest.raises(Killed):
            compress_scene(mesh, settings, job)
    (folder,) = cache.iterdir()
    before = {path: path.read_bytes() for path in folder.glob("*.block")}
    spoilt = damaged_blocks.damage(folder, random.Random(seed))
    same = spoilt.is_file() and spoilt.read_bytes() == before[spoilt]
    other_rays = spoilt.is_file() and spoilt.read_bytes()[32:-4] == before[spoilt][32:-4] and not same
    with caplog.at_level("WARNING"):
        resumed = compress_scene(mesh, settings, job)
    assert content(resumed, tmp_path) == reference
    assert resumed.rays_traced <= 2 * whole.rays_traced + 1
    if not other_rays:  # of a header whose checksum is right they may be believed, if they can be so many
        assert (f"{spoilt}: is put aside and its block done again" in caplog.text) == (not same)
        assert resumed.rays_traced == whole.rays_traced


BASES = ("transport", "slepian", "incident", "sh", "direct", "adapted", "none")


@pytest.mark.parametrize("basis", BASES)
def test_magnitudes_that_vectors_of_such_norms_cannot_have_are_not_believed(basis, monkeypatch, cache, caplog):
    """Coefficients times two, times 1e30, all 3e38: checksums are right. And good blocks of every basis are kept."""
    terms = None if basis == "none" else 6
    mesh, settings, job = bumpy(2), CompressionSettings(basis=basis, clusters=4, terms=terms), TransportSettings(4, 64)

    def trace_and_stop():
        with monkeypatch.context() as patched:
            patched.setattr(stores.Journal, "__iter__", lambda _: (_ for _ in ()).throw(Killed))
            compress_scene(mesh, settings, job)

    with pytest.raises(Killed):
        trace_and_stop()
    (folder,) = cache.iterdir()
    store = stores.Journal(folder)
    number, good = next(iter(store))
    some = np.zeros_like(good.coefficients)
    some[-1] = 3e38
    changes = {
        "it is good": good,
        "larger": good._replace(coefficients=2 * good.coefficients),
        "larger than": good._replace(coefficients=some),
        "norms": good._replace(statistics=good.statistics._replace(energy=good.statistics.energy + np.float32(3e38))),
    }
    for reason, block in changes.items():
        store.add(number, block)
        caplog.clear()
        with pytest.raises(Killed), caplog.at_level("INFO"):
            trace_and_stop()
        assert ("is put aside" in caplog.text) == (block is not good)
        assert (reason in caplog.text) == (block is not good)


def test_other_settings_do_not_take_the_blocks(monkeypatch, cache):
    monkeypatch.setattr(stores.Journal, "__iter__", lambda _: (_ for _ in ()).throw(Killed))
    settings = CompressionSettings(tolerance=0.05, clusters=6)
    others = [
        (settings, JOB),
        (CompressionSettings(tolerance=0.2, clusters=6), JOB),
        (CompressionSettings(tolerance=0.05, clusters=7), JOB),
        (settings, TransportSettings(6, 256, seed=1)),
        (settings, TransportSettings(6, 300)),
        (settings, TransportSettings(5, 256)),
    ]
    for number, (how, transport) in enumerate(others):
        with pytest.raises(Killed):
            compress_scene(bumpy(3), how, transport)
        assert len(list(cache.iterdir())) == number + 1


def test_hard_edges_do_not_take_the_blocks_of_smooth_ones(monkeypatch, cache, tmp_path):
    monkeypatch.setattr(stores.Journal, "__iter__", lambda _: (_ for _ in ()).throw(Killed))
    mesh, path = bumpy(3), tmp_path / "bumpy.off"
    trimesh.Trimesh(mesh.positions, mesh.faces, process=False).export(path)
    for angle, journals in ((None, 1), (180.0, 1), (25.0, 2), (24.0, 3), (25.0, 3)):
        with pytest.raises(Killed):
            compress_scene(path, CompressionSettings(clusters=6), replace(JOB, crease_angle=angle))
        assert len(list(cache.iterdir())) == journals


@pytest.mark.slow
def test_a_pilot_that_saw_too_little_is_made_up_for(monkeypatch):
    """The second moment of one vertex foresees far too few functions; the tolerance is kept all the same."""
    monkeypatch.setattr("slepian_prt.compression.pilot.PILOT_SIZE", 1)
    mesh = bumpy(4)
    reference = precompute(mesh, 6, 256).vectors[:, 0]
    for packed in (
        compress_scene(mesh, CompressionSettings(tolerance=0.03, clusters=12), JOB),
        compress(precompute(mesh, 6, 256), tolerance=0.03, clusters=12),
    ):
        assert np.linalg.norm(packed.reconstruct()[:, 0] - reference) <= 0.0301 * np.linalg.norm(reference)


def test_vertices_inside_other_geometry_borrow(tmp_path):
    """A box that stands in a floor: what is streamed is what is computed at once."""
    floor = trimesh.creation.box((4, 4, 0.2)).subdivide_loop(4)
    box = trimesh.creation.box((1, 1, 2)).subdivide_loop(3)
    path = tmp_path / "scene.ply"
    trimesh.util.concatenate([floor, box]).export(path)
    reference = precompute(path, 4, 256).vectors[:, 0]
    packed = compress_scene(path, CompressionSettings(tolerance=1e-3, clusters=12), TransportSettings(4, 256))
    assert np.linalg.norm(packed.reconstruct()[:, 0] - reference) <= 1.01e-3 * np.linalg.norm(reference)


@pytest.mark.slow
def test_a_process_that_is_killed(tmp_path, cache):
    """As it happens to users: SIGKILL, then the same command."""
    mesh = bumpy(5)
    trimesh.Trimesh(mesh.positions, mesh.faces, process=False).export(tmp_path / "bumpy.ply")
    command = [
        sys.executable, "-m", "slepian_prt", "precompute", "bumpy.ply", "-o", "out.prt", "--bandlimit", "8",
        "--tolerance", "0.1", "--clusters", "12",
    ]  # fmt: skip
    code = (
        "import os, signal, sys; from slepian_prt.compression import checkpoint; add = checkpoint.Journal.add\n"
        "def kill(*a):\n    add(*a); os.kill(os.getpid(), signal.SIGKILL)\n"
        "checkpoint.Journal.add = kill; sys.argv = sys.argv[1:]; from slepian_prt.__main__ import main; main()"
    )
    killed = subprocess.run([sys.executable, "-c", code, *command[2:]], cwd=tmp_path, capture_output=True, check=False)
    assert killed.returncode == -9
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bumpy.ply", "cache"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert "1 of " in done.stderr
    assert "were finished before and are kept" in done.stderr
    assert load(tmp_path / "out.prt").predicted_error <= 0.1
    assert list(cache.iterdir()) == []


@pytest.mark.slow
def test_peak_memory_does_not_grow_with_the_mesh(monkeypatch):
    """Beyond the mesh: of vertices that are four times as many, coefficients are held, their vectors are not.

    Counted in bytes of living arrays: what the process takes from the system depends on when its threads give back.
    """
    # Blocks and pieces are small, so that even these meshes have many.
    monkeypatch.setattr("slepian_prt.transport.estimator.NUMBERS_PER_BLOCK", 1 << 19)
    monkeypatch.setattr("slepian_prt.compression.blocks._PIECE", 1 << 17)
    monkeypatch.setattr("slepian_prt.compression.encoder._SAMPLE_COEFFICIENTS", 1 << 17)
    peaks, counts = [], []
    tracemalloc.start()
    try:
        for subdivisions in (5, 5, 6):  # tables and imports are the first one's alone
            mesh = bumpy(subdivisions)
            gc.collect()  # what was left of the run before
            tracemalloc.reset_peak()
            held = tracemalloc.get_traced_memory()[0]
            compress_scene(mesh, CompressionSettings(tolerance=0.1, clusters=24), TransportSettings(20, 64))
            peaks.append(tracemalloc.get_traced_memory()[1] - held)
            counts.append(len(mesh.positions))
    finally:
        tracemalloc.stop()
    vectors = 441 * 4 * (counts[2] - counts[1])
    # The mesh in all its forms, with where its rays start and what the file has of it, takes some 640 bytes per vertex.
    assert peaks[2] - peaks[1] < 0.5 * vectors, [peak / 1e6 for peak in peaks]


def test_convex_streams_without_a_ray():
    packed = compress_scene(sphere(4), CompressionSettings(tolerance=0.05, clusters=12), JOB)
    assert packed.rays_traced == 0


@pytest.mark.slow
@pytest.mark.parametrize("group_by", ["normal", "bent", "surface"])
@pytest.mark.parametrize("classes", [1, 3])
def test_relighting_is_reconstruction_times_light_however_grouped(group_by, classes, rng):
    if group_by == "surface" and classes > 1:
        pytest.skip("patches have no classes")
    settings = CompressionSettings(tolerance=0.05, clusters=8, group_by=group_by, occlusion_classes=classes)
    packed = compress_scene(bumpy(4), settings, JOB)
    lights = rng.normal(size=(20, 3, 49))
    expected = np.einsum("vm,bcm->bvc", packed.reconstruct()[:, 0], lights)
    difference = transfer_operator(packed).apply(lights) - expected
    # What is left out when relighting is at most a hundredth of the error under white light; a fifth for chance.
    assert np.linalg.norm(difference) <= 1.2 * 0.01 * packed.predicted_error * np.linalg.norm(expected)


def test_blocks_of_another_size_or_mode_are_not_taken(monkeypatch, cache):
    """Work that was killed before an update that cuts other blocks, or that traces rays otherwise."""
    monkeypatch.setattr(stores.Journal, "__iter__", lambda _: (_ for _ in ()).throw(Killed))
    patches = [("slepian_prt.transport.direct._RAYS_PER_BLOCK", 1 << 16)]
    if VARIANT.startswith("cuda_"):  # where there is one mode
        patches = [("slepian_prt.transport.direct._ON_DEVICE", 1 << 16)]
    else:
        patches.append(("slepian_prt.scene.scene.too_many_slip", lambda _: True))
    for number, patch in enumerate((None, *patches)):
        with monkeypatch.context() as patched:
            if patch:
                patched.setattr(*patch)
            with pytest.raises(Killed):
                compress_scene(bumpy(3), CompressionSettings(tolerance=0.05, clusters=6), JOB)
        assert len(list(cache.iterdir())) == number + 1
