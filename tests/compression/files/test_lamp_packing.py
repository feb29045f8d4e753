"""Light of lamps in files, against a reader of its own and the bound that the format states."""

from dataclasses import replace

import numpy as np
import pytest

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.files import container
from slepian_prt.compression.files.lamp_packing import pack_lamps, unpack_lamps
from slepian_prt.compression.files.prt_file import load
from slepian_prt.compression.stream import compress
from slepian_prt.errors import UserError
from slepian_prt.lighting.fixed_lights import FixedLights
from slepian_prt.transport.transfer import precompute
from tests import format_reader
from tests.conftest import sphere
from tests.fuzzing.prt_files import pack
from tests.numerics import assert_exact

BOUND = 2.0**-11 + 1e-5
VERTICES = 162


def lamps() -> FixedLights:
    """A gray one, one of one colour, a pure red one, one of many, one that is nearly gray, and a dark one."""
    rng = np.random.default_rng(5)
    shape = np.exp(rng.uniform(-12.0, 3.0, size=(VERTICES, 1)))
    shape[::3] = 0.0
    nearly = shape * [1.0, 1.001, 1.0]
    nearly[1] *= [1.0, 1.02, 0.98]
    many = np.exp(rng.uniform(-12.0, 3.0, size=(VERTICES, 3)))
    colours = [shape * [1.0, 1.0, 1.0], shape * [0.2, 7.0, 1e-6], shape * [3e5, 0.0, 0.0], many, nearly, 0.0 * many]
    direct = np.array(colours, dtype=np.float32)
    return FixedLights(
        ("gray", "tinted", "red", "many", "nearly gray", "inside a box"),
        ("area", "point", "spot", "directional", "area", "projector"),
        rng.uniform(0.0, 9.0, size=(6, 3)),
        direct,
        direct[::-1].copy(),
        np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0], [0.6, 0.0, -0.8], [0, 0, 0], [0, 0, 0]]),
    )


@pytest.fixture(scope="module")
def packed() -> CompressedTransfer:
    return compress(precompute(sphere(2), bandlimit=2, samples=16), clusters=4)


def test_what_is_read_is_within_the_bound(packed, tmp_path):
    kept = lamps()
    replace(packed, fixed=kept).save(tmp_path / "lit.prt")
    read = load(tmp_path / "lit.prt").fixed
    assert read is not None
    assert (read.names, read.kinds) == (kept.names, kept.kinds)
    assert_exact(read.emitted, kept.emitted, "JSON keeps the digits of doubles")
    assert_exact(read.directions, kept.directions, "JSON keeps the digits of doubles")
    file = format_reader.read(tmp_path / "lit.prt")
    for table in ("direct", "bounced"):
        mine, theirs = getattr(read, table), getattr(kept, table)[:, packed.stored.order]
        assert mine.dtype == np.float32
        np.testing.assert_allclose(mine, theirs, rtol=BOUND, atol=0.0)
        np.testing.assert_allclose(mine, format_reader.light_of_lamps(file, table), rtol=1e-7)


def test_rows_and_bytes(packed, tmp_path):
    """One row where channels are alike, none where it is dark, at most two bytes for each number."""
    entries, arrays = pack_lamps(lamps())
    assert [entry["direct_rows"] for entry in entries] == [1, 1, 1, 3, 3, 0]
    assert [entry["bounced_rows"] for entry in entries] == [0, 3, 3, 1, 1, 1]
    assert arrays["fixed/direct"].shape == (2, 9, VERTICES)
    replace(packed, fixed=lamps()).save(tmp_path / "lit.prt")
    packed.save(tmp_path / "plain.prt")
    more = (tmp_path / "lit.prt").stat().st_size - (tmp_path / "plain.prt").stat().st_size
    assert more < 2 * 2 * 9 * VERTICES + 2000
    assert load(tmp_path / "lit.prt").bytes_per_vertex == packed.bytes_per_vertex


def test_files_without_lamps(packed, tmp_path):
    packed.save(tmp_path / "plain.prt")
    contents = container.Contents(tmp_path / "plain.prt")
    manifest, arrays = contents.manifest, contents.arrays()
    assert "fixed" not in manifest
    assert not [name for name in arrays if name.startswith("fixed")]
    assert load(tmp_path / "plain.prt").fixed is None


def test_lamps_that_do_not_fit(packed, tmp_path):
    replace(packed, fixed=lamps()).save(tmp_path / "lit.prt")
    contents = container.Contents(tmp_path / "lit.prt")
    manifest, arrays = contents.manifest, contents.arrays()
    for name in ("fixed/direct", "fixed/bounced_scale"):
        (tmp_path / "cut.prt").write_bytes(pack(manifest, {**arrays, name: arrays[name][:-1]}))
        with pytest.raises(UserError, match="contents do not fit together"):
            load(tmp_path / "cut.prt")
        less = {key: value for key, value in arrays.items() if key != name}
        (tmp_path / "less.prt").write_bytes(pack({**manifest, "arrays": list(less)}, less))
        with pytest.raises(UserError, match="contents do not fit together"):
            load(tmp_path / "less.prt")


def test_no_lamps_are_none():
    assert unpack_lamps([], {}, 9) is None
    assert unpack_lamps(None, {}, 9) is None
