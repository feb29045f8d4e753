"""What work is refused for its memory."""

import pytest

from slepian_prt.errors import UserError
from slepian_prt.machine.memory import allowed_memory, available_memory, check_memory, memory_limited


def test_this_machine_has_some():
    available = available_memory()
    assert available is None or 1 << 20 < available < 1 << 50


def test_work_that_needs_more_than_is_allowed_is_refused():
    with memory_limited(3 << 30):
        check_memory(3 << 30, "this", "wait")
        with pytest.raises(UserError, match=r"this needs about 3\.5 GiB of memory, 3\.0 are left; wait"):
            check_memory(7 << 29, "this", "wait")


def test_the_limit_ends_with_the_block():
    before = allowed_memory()
    with memory_limited(1):
        assert allowed_memory() == 1
    assert allowed_memory() == pytest.approx(before, rel=0.5)
