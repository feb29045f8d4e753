"""Blocks that are made in one thread and finished in another, and what every estimator promises."""

import threading

import numpy as np
import pytest

from slepian_prt.transport.estimator import overlapped
from slepian_prt.transport.planned import plan_scene
from slepian_prt.transport.settings import TransportSettings
from slepian_prt.transport.transfer import compute_transfer
from tests.conftest import ROOT, bumpy
from tests.numerics import assert_exact


class Broken(Exception):
    """Raised on purpose."""


def test_results_come_in_order_from_one_other_thread():
    makers, finishers = set(), set()

    def make(number):
        makers.add(threading.current_thread())
        return number

    def finish(number):
        finishers.add(threading.current_thread())
        return number**2

    assert list(overlapped(range(50), make, finish)) == [n**2 for n in range(50)]
    assert makers == {threading.current_thread()}
    assert len(finishers) == 1
    assert not makers & finishers


def test_the_next_is_made_while_the_last_is_finished():
    """Without overlap this would wait for ever: the first is finished only when the second has been made."""
    second_is_made = threading.Event()

    def make(number):
        if number == 1:
            second_is_made.set()
        return number

    def finish(number):
        assert second_is_made.wait(60.0)
        return number

    assert list(overlapped(range(2), make, finish)) == [0, 1]


def test_few_wait():
    """However slow finishing is, no more than four results are held: three that wait and the one that is finished."""
    made, held = 0, []

    def make(number):
        nonlocal made
        made += 1
        return number

    for number in overlapped(range(20), make, lambda number: number):
        held.append(made - number)
    assert max(held) <= 4


@pytest.mark.parametrize("where", ["make", "finish"])
def test_errors_of_either_thread_are_raised(where):
    def step(number, name):
        if name == where and number == 3:
            raise Broken
        return number

    results = []
    with pytest.raises(Broken):
        results.extend(overlapped(range(20), lambda n: step(n, "make"), lambda n: step(n, "finish")))
    threads = [thread for thread in threading.enumerate() if "ThreadPoolExecutor" in thread.name]
    assert not any(thread.is_alive() for thread in threads)


def test_leaving_early_drops_what_waits():
    finished, release = [], threading.Event()

    def finish(number):
        if number > 0:
            assert release.wait(60.0)
        finished.append(number)
        return number

    blocks = overlapped(range(20), lambda number: number, finish)
    assert next(blocks) == 0
    release.set()
    blocks.close()
    assert len(finished) <= 5  # what ran; the sixteen and more that were never made are not
    assert next(blocks, None) is None


@pytest.mark.parametrize("view", [None, "front"])
def test_blocks_of_all_estimators(view):
    """Pieces hold each receiver once; blocks come in their order, and are what is estimated of any receivers."""
    scene = bumpy(3) if view is None else ROOT / "scenes" / "glossy.xml"
    with plan_scene(scene, TransportSettings(3, 16, view=view)) as planned:
        estimator = planned.estimator()
        pieces = estimator.pieces()
        count = len(planned.scene.receivers)
        assert_exact(np.sort(np.concatenate(pieces)), np.arange(count), because="integers")
        whole = estimator.estimate()
        for piece, block in zip(pieces, estimator.blocks(pieces), strict=True):
            assert_exact(block.vertices, piece, because="integers")
            assert block.vectors.shape == (piece.size, estimator.channels, 16)
            # Products of other sizes round otherwise: sums of some tens of float32 numbers below one.
            np.testing.assert_allclose(block.vectors, whole.vectors[piece], atol=1e-5)
        assert whole.rays * 2 == estimator.rays
        sizes = [size for (size,) in estimator.blocks(pieces, lambda block: (block.vertices.size,))]
        assert sizes == [piece.size for piece in pieces]
        some = np.array([5, 3, count - 1])
        np.testing.assert_allclose(estimator.estimate(some).vectors, whole.vectors[some], atol=1e-5)
        assert estimator.estimate(some[:0]).vectors.shape == (0, estimator.channels, 16)
        nothing = np.flatnonzero(~estimator.axes.any(axis=1))[:3]  # toward a view, the backs
        assert not estimator.estimate(nothing).vectors.any()
        transfer = compute_transfer(planned)
    assert_exact(transfer.axes, estimator.axes, because="a copy")
