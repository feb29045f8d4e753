"""Means over passes: means and variances, and what is left when a process is killed."""

import mmap
from contextlib import contextmanager

import numpy as np
import pytest

from slepian_prt.errors import UserError
from slepian_prt.transport.capturing.pixel_means import BlockMeans, kept_means
from tests.numerics import assert_exact, assert_rounded

PIXELS, PER_BLOCK, BANDLIMIT = 10, 4, 2


class Killed(BaseException):
    pass


class Killing:
    """A table that cannot be written to."""

    def __getitem__(self, _rows):
        raise Killed


@contextmanager
def killed():
    """A with-block that does not end."""
    with pytest.raises(Killed):
        yield


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("SLEPIAN_PRT_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def some_pass(rng, count):
    vectors = rng.normal(size=(count, 3, 9)).astype(np.float32)
    background, moments = rng.random((2, count, 3), dtype=np.float32)
    return BlockMeans(vectors, background, moments, rng.random(count, dtype=np.float32))


def add(held, block, means):
    """Of a copy, as the arrays are used up."""
    held.add(block, BlockMeans(*(array.copy() for array in means)))


def test_means_and_variances(rng):
    passes = [[some_pass(rng, n) for n in (4, 4, 2)] for _ in range(5)]
    with kept_means("job", PIXELS, PER_BLOCK, BANDLIMIT) as held:
        assert held.blocks == 3
        for one in passes:
            for block, part in enumerate(one):
                add(held, block, part)
        for block in range(3):
            means, variance = held.means(block)
            vectors = np.stack([one[block].vectors for one in passes]).astype(np.float64)
            assert_rounded(means.vectors, vectors.mean(axis=0), 8, 4.0)
            background = np.mean([one[block].background for one in passes], axis=0)
            assert_rounded(means.background, background, 8)
            assert_rounded(means.moments, np.mean([one[block].moments for one in passes], axis=0), 8)
            assert_rounded(means.rays, np.mean([one[block].rays for one in passes], axis=0), 8)
            spread = vectors.var(axis=0, ddof=1) / len(passes)
            wanted = np.stack([spread[:, :, l * l : (l + 1) ** 2].mean(axis=2) for l in range(3)], axis=2)
            assert_rounded(variance, wanted, 64, 4.0)


def test_one_pass_tells_no_variance(rng):
    with kept_means("job", PIXELS, PER_BLOCK, BANDLIMIT) as held:
        add(held, 2, some_pass(rng, 2))
        assert_exact(held.pixels(2), [8, 9], "the last block is shorter")
        assert not held.means(2)[1].any()


def test_what_was_finished_is_there_for_the_same_job(rng, cache):
    first, second = some_pass(rng, 4), some_pass(rng, 4)
    with killed(), kept_means("job", PIXELS, PER_BLOCK, BANDLIMIT) as held:
        add(held, 0, first)
        add(held, 1, first)
        add(held, 0, second)
        raise Killed
    with kept_means("another", PIXELS, PER_BLOCK, BANDLIMIT) as held:
        assert [held.passes(block) for block in range(3)] == [0, 0, 0]
    with kept_means("job", PIXELS, PER_BLOCK, BANDLIMIT) as held:
        assert [held.passes(block) for block in range(3)] == [2, 1, 0]
        assert_rounded(held.means(0)[0].vectors, (first.vectors + second.vectors) / 2.0, 4, 4.0)
        assert_exact(held.means(1)[0].vectors, first.vectors, "one pass is its own mean")
    assert list(cache.iterdir()) == []


def test_killed_while_a_block_is_written(rng):
    """Half of a pass has been written: the passes before it are whole, and it is not counted."""
    first, second = some_pass(rng, 4), some_pass(rng, 4)
    with killed(), kept_means("job", PIXELS, PER_BLOCK, BANDLIMIT) as held, pytest.MonkeyPatch.context() as patch:
        add(held, 0, first)
        patch.setattr(held, "_others", Killing())
        add(held, 0, second)
    with kept_means("job", PIXELS, PER_BLOCK, BANDLIMIT) as held:
        assert held.passes(0) == 1
        assert_exact(held.means(0)[0].vectors, first.vectors, "one pass is its own mean")


@pytest.mark.parametrize("damage", ["passes", "number", "background", "head", "shorter", "other", "copied"])
def test_blocks_that_are_damaged_are_traced_again(damage, rng, cache, caplog):
    """What the file holds is believed only with the checksum that belongs to it."""
    first = some_pass(rng, 4)
    with killed(), kept_means("job", PIXELS, PER_BLOCK, BANDLIMIT) as held:
        add(held, 0, first)
        add(held, 1, first)
        sizes = [held._heads.nbytes, held._vectors.nbytes]
        raise Killed
    (path,) = cache.iterdir()
    page, content = mmap.ALLOCATIONGRANULARITY, bytearray(path.read_bytes())
    if damage == "passes":
        content[0:4] = b"\xff\xff\xff\xff"
    elif damage == "number":
        content[page + 7] ^= 64
    elif damage == "background":
        content[3 * page + 1] ^= 1
    elif damage == "head":
        content[8] ^= 1
    elif damage == "copied":  # of another block, as it was
        content[0:12] = content[12:24]
        content[page : page + 4] = b"more"
    elif damage == "shorter":
        content = content[:page]
    else:
        content[:] = rng.integers(0, 256, len(content), dtype=np.uint8).tobytes()
    assert max(sizes) < page
    path.write_bytes(content)
    with caplog.at_level("WARNING"), kept_means("job", PIXELS, PER_BLOCK, BANDLIMIT) as held:
        whole = [] if damage in ("shorter", "other") else [1]
        assert [held.passes(block) for block in range(3)] == [0, 1 if whole else 0, 0]
        add(held, 0, first)
        assert_exact(held.means(0)[0].vectors, first.vectors, "one pass is its own mean")
    assert "are damaged and are traced again" in caplog.text


def test_two_processes_do_not_share_their_means(rng):
    with (
        kept_means("job", PIXELS, PER_BLOCK, BANDLIMIT) as one,
        kept_means("job", PIXELS, PER_BLOCK, BANDLIMIT) as other,
    ):
        add(one, 0, some_pass(rng, 4))
        assert other.passes(0) == 0


def test_means_that_do_not_fit_are_refused_and_take_no_space(cache):
    width = 1 << 40  # pixels: no disk is as large
    with (
        pytest.raises(UserError, match=r"cannot be written .* GB; free some space"),
        kept_means("a", width, width, 0),
    ):
        pass
    (left,) = cache.iterdir()
    assert left.stat().st_blocks == 0
