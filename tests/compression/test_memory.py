"""What does not fit in memory is told before work begins, and refused only where it clearly does not."""

import logging

import numpy as np
import pytest

import slepian_prt as sp
from slepian_prt.accuracy.goal import Goal, Light
from slepian_prt.accuracy.run import precompute_within
from slepian_prt.compression.from_scene import precompute_compressed
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.errors import UserError
from slepian_prt.examples import example
from slepian_prt.machine.memory import check_estimate, describe_size, held_memory, memory_limited
from slepian_prt.transport import transfer as transfer_module
from slepian_prt.transport.settings import TransportSettings


def told_of(caplog, need: float, least: float | None = None) -> list[str]:
    """Warnings of work that needs so many bytes where 1 GiB is allowed."""
    caplog.clear()
    with memory_limited(1 << 30), caplog.at_level(logging.WARNING):
        check_estimate(need, "this", "wait", least)
    return caplog.messages


def test_what_may_fit_is_told_and_what_clearly_does_not_is_refused(caplog):
    gib = 1 << 30
    assert told_of(caplog, 0.79 * gib) == []
    told = "this needs about {} of memory, `max_memory` allows 1.0 GiB; "
    told += "if that is too little, raise `max_memory`, or wait"
    for need, least in ((0.81 * gib, None), (1.24 * gib, None), (7 * gib, 0.9 * gib)):
        assert told_of(caplog, need, least) == [told.format(describe_size(need))]
    for need, least in ((1.26 * gib, None), (1.1 * gib, 1.01 * gib)):
        with pytest.raises(UserError, match=r"this needs about .* allows 1\.0 GiB; raise `max_memory`, or wait"):
            told_of(caplog, need, least)


def refuse_to_trace(*_args, **_named):
    raise AssertionError("traced")


@pytest.mark.slow
def test_vectors_that_cannot_be_coded_are_refused_before_they_are_traced(monkeypatch):
    """They themselves fit: with interreflection they are held all at once."""
    monkeypatch.setattr(transfer_module, "merge_equal_channels", refuse_to_trace)
    monkeypatch.setattr("slepian_prt.compression.stream.compute_transfer", refuse_to_trace)
    told = "compressing 33301 vertices at bandlimit 50 needs about .*; raise `max_memory`, or raise `tolerance`, lower"
    with memory_limited(1 << 30), pytest.raises(UserError, match=told):
        precompute_compressed(example("knot"), bandlimit=50, samples=1024, albedo=0.5)


@pytest.mark.slow
def test_the_search_for_a_goal_is_told_of_before_its_pilot(monkeypatch, caplog):
    monkeypatch.setattr("slepian_prt.accuracy.run.draw_vertices", refuse_to_trace)
    given = example("knot"), Goal(error=0.1), Light(spectrum="falling"), CompressionSettings(), TransportSettings()
    told = "the search for a goal, of 33301 vertices, needs about .*; {}raise `max_memory`, or lower `bandlimit`"
    with memory_limited(100 << 20), pytest.raises(UserError, match=told.format("")):
        precompute_within(*given)
    with memory_limited(1 << 30), pytest.raises(AssertionError, match="traced"):
        precompute_within(*given)
    assert any("if that is too little" in message and "the search" in message for message in caplog.messages)


def test_vectors_that_are_there_are_looked_at_before_they_are_compressed(monkeypatch):
    mesh = sp.make_mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    transfer = sp.precompute(mesh, 2, 16)
    monkeypatch.setattr("slepian_prt.compression.stream.as_stored", refuse_to_trace)
    with memory_limited(held_memory() // 2), pytest.raises(UserError, match="compressing 3 vertices at bandlimit 2"):
        sp.compress(transfer)


def test_many_lights_at_once_are_refused_where_their_radiance_does_not_fit(monkeypatch):
    mesh = sp.make_mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    transfer = sp.precompute(mesh, 1, 16)
    monkeypatch.setattr("slepian_prt.relighting.relight._LARGE", 3 * 4 * 3 * 5)
    monkeypatch.setattr("slepian_prt.relighting.relight._apply_vectors", refuse_to_trace)
    told = "relighting 3 receivers under 5 lights at once needs about .*, or relight under fewer at a time"
    with memory_limited(held_memory() // 2), pytest.raises(UserError, match=told):
        sp.relight(transfer, np.ones((5, 3, 4)))


def test_a_capture_that_does_not_fit_is_refused_before_its_paths(monkeypatch):
    monkeypatch.setattr("slepian_prt.transport.capturing.capture.add_passes", refuse_to_trace)
    told = "capturing 230400 pixels at bandlimit 50 needs about .*; raise `max_memory`, or lower `bandlimit` or make"
    with memory_limited(2 << 30), pytest.raises(UserError, match=told):
        sp.capture(example("glossy"), bandlimit=50)
