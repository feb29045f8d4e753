import contextlib
import io
import json
import re
import zipfile
from dataclasses import replace
from pathlib import Path

import DracoPy
import numpy as np
import pytest

from slepian_prt import files
from slepian_prt.compression.files import container as container_file
from slepian_prt.compression.files.prt_file import load
from slepian_prt.compression.stream import compress
from slepian_prt.errors import UserError
from slepian_prt.relighting.relight import relight
from slepian_prt.transport.transfer import precompute
from tests.conftest import bumpy, sphere
from tests.numerics import assert_exact, assert_rounded


@pytest.fixture(scope="module", params=["float32", "coded"])
def packed(request):
    return compress(precompute(bumpy(3), bandlimit=4, samples=64), tolerance=0.05, clusters=8, coding=request.param)


@pytest.fixture(scope="module")
def content(packed, tmp_path_factory):
    path = tmp_path_factory.mktemp("prt") / "bumpy.prt"
    packed.save(path)
    return path.read_bytes()


@pytest.mark.parametrize("basis", ["adapted", "transport", "slepian", "incident", "sh", "cpca", "direct", "none"])
@pytest.mark.parametrize("coding", ["float32", "float16", "coded"])
def test_what_is_read_is_what_was_written(basis, coding, tmp_path):
    transfer = precompute(bumpy(2), bandlimit=4, samples=64)
    options = {} if basis == "none" else {"tolerance": 0.1}
    before = compress(transfer, basis, clusters=6, coding=coding, **options)
    before.save(tmp_path / "file.prt")
    after = load(tmp_path / "file.prt")
    order = before.stored.order
    assert_rounded(after.reconstruct(), before.reconstruct()[order], terms=2 * 25, size=1.0)  # shorter than one
    assert_exact(after.mesh.positions, before.mesh.positions[order], because="a copy")
    assert_exact(after.mesh.normals, before.mesh.normals[order], because="a copy")
    for name in ("basis", "bandlimit", "terms", "predicted_error", "effects", "rays_traced", "seconds", "parts"):
        assert getattr(after, name) == getattr(before, name)
    assert after.bytes_per_vertex == before.bytes_per_vertex
    light = np.random.default_rng(0).normal(size=(3, 25))
    assert_rounded(
        relight(after, light), relight(before, light)[order], terms=3 * 25, size=float(np.linalg.norm(light))
    )


def test_bytes_per_vertex_is_what_the_file_spends(packed, content):
    with zipfile.ZipFile(io.BytesIO(content)) as container:
        others = [i for i in container.infolist() if i.filename.startswith(("mesh/", "manifest"))]
    # A member takes a local header of 30 bytes, an entry of 46 in the directory, and its name in both.
    mesh = sum(i.compress_size + 76 + 2 * len(i.filename) for i in others)
    assert packed.bytes_per_vertex == pytest.approx((len(content) - mesh) / len(packed.mesh.positions), rel=1e-12)


def test_same_content_same_bytes(packed, content, tmp_path):
    packed.save(tmp_path / "again.prt")
    assert (tmp_path / "again.prt").read_bytes() == content


def test_readable_by_others(content):
    with zipfile.ZipFile(io.BytesIO(content)) as container:
        assert json.loads(container.read("manifest.json"))["format"] == container_file.FORMAT
        draco = np.load(io.BytesIO(container.read("mesh/draco.npy")), allow_pickle=False)
    assert DracoPy.decode(draco.tobytes()).points.shape == (642, 3)


@pytest.mark.parametrize("part", [0.0, 0.1, 0.5, 0.9, 0.999])
def test_cut_short(part, content, tmp_path):
    path = tmp_path / "cut.prt"
    path.write_bytes(content[: int(part * len(content))])
    with pytest.raises(UserError, match=r"cut\.prt: is not a transfer file, or is cut short or damaged"):
        load(path)


def test_flipped_bytes_never_decode_silently(content, tmp_path, packed):
    """A changed byte is either refused, or in a field that changes nothing of what is read."""
    rng = np.random.default_rng(5)
    order = packed.stored.order
    reference, positions = packed.reconstruct()[order], packed.mesh.positions[order]
    path = tmp_path / "flipped.prt"
    refused = 0
    for position in rng.integers(0, len(content), 150):
        spoiled = bytearray(content)
        spoiled[position] ^= 1 << rng.integers(8)
        path.write_bytes(spoiled)
        with contextlib.suppress(UserError):
            refused += 1
            read = load(path)
            refused -= 1
            assert_rounded(read.reconstruct(), reference, terms=2 * 25, size=1.0)
            assert_exact(read.mesh.positions, positions, because="a copy")
    assert refused >= 130


@pytest.mark.parametrize("foreign", [b"PK\x03\x04 something", b"\x89PNG\r\n", b"ply\nformat ascii 1.0\n"])
def test_foreign_files(foreign, tmp_path):
    path = tmp_path / "foreign.prt"
    path.write_bytes(foreign)
    with pytest.raises(UserError, match="not a transfer file"):
        load(path)


def test_foreign_zip_and_newer_version(tmp_path):
    path = tmp_path / "other.prt"
    with zipfile.ZipFile(path, "w") as container:
        container.writestr("manifest.json", json.dumps({"format": "other"}))
    with pytest.raises(UserError, match="not a transfer file of slepian-prt"):
        load(path)
    with zipfile.ZipFile(path, "w") as container:
        container.writestr("manifest.json", json.dumps({"format": container_file.FORMAT, "version": 99}))
    with pytest.raises(UserError, match=r"format version 99.*update"):
        load(path)
    with zipfile.ZipFile(path, "w") as container:
        container.writestr(
            "manifest.json",
            json.dumps({"format": container_file.FORMAT, "version": container_file.VERSION, "arrays": []}),
        )
    with pytest.raises(UserError, match="do not fit together"):
        load(path)


@pytest.mark.parametrize("name", ["full.npz", "full.prt"])
def test_transfer_that_is_not_compressed(name, tmp_path):
    """What it is and what to do, whatever it is called."""
    precompute(sphere(1), 2, 16).save(tmp_path / "full.npz")
    (tmp_path / "full.npz").rename(tmp_path / name)
    with pytest.raises(UserError) as told:
        load(tmp_path / name)
    assert str(told.value) == (
        f"{tmp_path / name}: holds transfer that is not compressed, from Transfer.save; read it with "
        "sp.load_transfer, then sp.compress and save it as .prt"
    )


def test_missing_file(tmp_path):
    with pytest.raises(UserError, match="no such file"):
        load(tmp_path / "nothing.prt")


class Interrupted(BaseException):
    pass


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError(28, "No space left on device"), Interrupted])
def test_nothing_is_left_of_a_write_that_fails(error, tmp_path):
    path = tmp_path / "out.prt"
    path.write_bytes(b"the old one")

    def fail() -> None:
        with files.atomic_output(path) as file:
            file.write(b"half")
            raise error

    with pytest.raises((UserError, KeyboardInterrupt, Interrupted)):
        fail()
    assert path.read_bytes() == b"the old one"
    assert list(tmp_path.iterdir()) == [path]


def test_folder_that_is_missing_or_in_the_way(tmp_path):
    for check in (files.check_writable, lambda path: files.atomic_output(path).__enter__()):
        with pytest.raises(UserError, match=r"choose another|create it"):
            check(tmp_path / "missing" / "out.prt")
        with pytest.raises(UserError, match="is a folder"):
            check(tmp_path)


@pytest.mark.slow
def test_many_functions_of_high_degree_come_back(tmp_path):
    """More than 2^15 numbers in the tables of radial functions."""
    transfer = precompute(sphere(3), 20, 16)
    packed = compress(transfer, "transport", terms=441, clusters=64, coding="float16")
    packed.save(tmp_path / "high.prt")
    vectors = packed.reconstruct()[packed.stored.order]
    assert_rounded(load(tmp_path / "high.prt").reconstruct(), vectors, terms=2 * 441, size=1.0)


@pytest.mark.parametrize(("version", "remedy"), [(2, "precompute it again"), (99, "update slepian_prt")])
def test_files_of_other_versions_are_told_of_in_one_sentence(version, remedy, tmp_path):
    manifest = {"format": container_file.FORMAT, "version": version, "arrays": []}
    with zipfile.ZipFile(tmp_path / "other.prt", "w") as file:
        file.writestr("manifest.json", json.dumps(manifest))
    with pytest.raises(UserError) as told:
        load(tmp_path / "other.prt")
    expected = f"has format version {version}, this program reads {container_file.VERSION}; {remedy}"
    assert str(told.value) == f"{tmp_path / 'other.prt'}: {expected}"


def test_the_same_work_gives_the_same_file_where_builds_are_reproducible(tmp_path, monkeypatch):
    """By the convention of reproducible-builds.org; else files say how long the work took."""
    packed = compress(precompute(sphere(2), 4, 16), clusters=4)
    slower = replace(packed, seconds={"transport": 9.0})
    packed.save(tmp_path / "a.prt")
    assert load(tmp_path / "a.prt").seconds == packed.seconds
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")
    for name, each in (("b.prt", packed), ("c.prt", slower)):
        each.save(tmp_path / name)
    assert (tmp_path / "b.prt").read_bytes() == (tmp_path / "c.prt").read_bytes()
    assert load(tmp_path / "b.prt").seconds == {}


@pytest.mark.parametrize("kind", ["empty", "other zip", "device"])
def test_what_is_no_transfer_file_is_told_as_what_it_is(kind, tmp_path):
    path = Path("/dev/null") if kind == "device" else tmp_path / "a.prt"
    if kind == "empty":
        path.write_bytes(b"")
    if kind == "other zip":
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("a.txt", "a")
    told = {
        "empty": "(the file is empty)",
        "other zip": "(it has no manifest.json)",
        "device": "; name a transfer file",
    }
    with pytest.raises(UserError, match=re.escape(told[kind])):
        load(path)
