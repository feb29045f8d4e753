"""Transport that would not fit in memory is refused before it is traced."""

import pytest

import slepian_prt as sp
from slepian_prt.errors import UserError
from slepian_prt.examples import example
from slepian_prt.machine.memory import memory_limited
from slepian_prt.transport.memory import part_of_blocks
from tests.numerics import assert_rounded


@pytest.mark.slow
def test_what_does_not_fit_names_what_to_change():
    told = r"transfer of 33301 vertices at bandlimit 50, held all at once, needs about .* `max_memory` allows 300 MiB; "
    with memory_limited(300 << 20), pytest.raises(UserError, match=told + "raise `max_memory`, or lower `bandlimit`"):
        sp.precompute(example("knot"), 50, 1024)


def test_blocks_are_smaller_where_little_is_allowed():
    parts = []
    for size in (2 << 30, 1 << 30, 600 << 20, 300 << 20, 1 << 20):
        with memory_limited(size):
            parts.append(part_of_blocks())
    assert parts == [1, 1, 2, 4, 32]


@pytest.mark.slow
def test_smaller_blocks_give_the_same_vectors(monkeypatch):
    mesh = example("cornell")
    whole = sp.precompute(mesh, 3, 16, effects="direct").vectors
    monkeypatch.setattr("slepian_prt.transport.estimator.part_of_blocks", lambda: 32)
    parts = sp.precompute(mesh, 3, 16, effects="direct").vectors
    assert_rounded(parts, whole, terms=256, size=1.0)
