"""What work is refused for its memory."""

from pathlib import Path

import pytest

from slepian_prt.errors import UserError
from slepian_prt.machine.memory import (
    MAX_MEMORY,
    allowed_memory,
    available_memory,
    check_memory,
    memory_limited,
    parse_size,
)


def test_this_machine_has_some():
    available = available_memory()
    assert available is None or 1 << 20 < available < 1 << 50


def test_work_that_needs_more_than_is_allowed_is_refused():
    with memory_limited(3 << 30):
        check_memory(3 << 30, "this", "wait")
        told = r"^this needs about 3\.5 GiB of memory, `max_memory` allows 3\.0 GiB; raise `max_memory`, or wait$"
        with pytest.raises(UserError, match=told):
            check_memory(7 << 29, "this", "wait")


def test_who_gave_no_limit_is_not_told_to_raise_one(monkeypatch):
    monkeypatch.delenv(MAX_MEMORY, raising=False)
    monkeypatch.setattr("slepian_prt.machine.memory.available_memory", lambda: 1 << 30)
    with pytest.raises(UserError, match=r"there are .*; wait$"):
        check_memory(1 << 50, "this", "wait")


def test_the_limit_ends_with_the_block():
    before = allowed_memory()
    with memory_limited(1 << 20):
        assert allowed_memory() == 1 << 20
    assert allowed_memory() == pytest.approx(before, rel=0.5)


@pytest.mark.parametrize(
    ("text", "size"),
    [("2G", 2 << 30), ("1.5g", 3 << 29), ("500 MiB", 500 << 20), ("1048576", 1 << 20), ("1TB", 1 << 40)],
)
def test_sizes_are_read(text, size):
    assert parse_size(text, "it") == size


@pytest.mark.parametrize("text", ["", "G", "2X", "-1G", "nan", "1", "1e9", "2G 3"])
def test_what_is_no_size_is_refused(text):
    with pytest.raises(UserError, match="it must be a size of 1M at least"):
        parse_size(text, "it")


def write(root: Path, **files: str) -> Path:
    """A folder that stands for /, with files whose names have __ for slashes."""
    for name, text in files.items():
        path = root / name.replace("__", "/")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return root


MEMINFO = "MemTotal: 64000000 kB\nMemAvailable: 32000000 kB\n"


def test_a_group_inside_another_of_version_2_counts_with_the_one_around_it(tmp_path):
    files = {
        "proc__self__cgroup": "0::/outer/inner\n",
        "proc__meminfo": MEMINFO,
        "sys__fs__cgroup__cgroup.controllers": "",
    }
    outer, inner = "sys__fs__cgroup__outer__memory", "sys__fs__cgroup__outer__inner__memory"
    files |= {
        f"{inner}.max": "max\n",
        f"{inner}.current": "9",
        f"{outer}.max": str(3 << 30),
        f"{outer}.current": str(1 << 30),
    }
    root = write(tmp_path, **files, **{f"{outer}.stat": f"anon 5\ninactive_file {1 << 20}\n"})
    assert available_memory(root) == (2 << 30) + (1 << 20)


def test_a_group_of_version_1_is_found_by_its_name(tmp_path):
    files = {"proc__self__cgroup": "4:memory:/a/b\n0::/\n", "proc__meminfo": MEMINFO}
    folder = "sys__fs__cgroup__memory__a__b__memory."
    files |= {
        f"{folder}limit_in_bytes": str(1 << 30),
        f"{folder}usage_in_bytes": str(1 << 28),
        f"{folder}stat": "cache 1\n",
    }
    root = write(tmp_path, **files, **{"sys__fs__cgroup__memory__memory.limit_in_bytes": "9223372036854771712"})
    assert available_memory(root) == (1 << 30) - (1 << 28)


def test_in_a_container_the_outermost_folder_that_is_there_is_ours(tmp_path):
    files = {"proc__self__cgroup": "4:memory:/docker/0123\n", "proc__meminfo": MEMINFO}
    files |= {"sys__fs__cgroup__memory__memory.limit_in_bytes": str(1 << 30)}
    root = write(tmp_path, **files, **{"sys__fs__cgroup__memory__memory.usage_in_bytes": "0"})
    assert available_memory(root) == 1 << 30


def test_a_system_without_proc_does_not_tell(tmp_path):
    assert available_memory(tmp_path) is None
