"""What workers must have."""

from __future__ import annotations

import dataclasses
import logging

import pytest

from slepian_prt.distributed import admission, examination, held
from slepian_prt.distributed.crew import open_crew
from slepian_prt.distributed.examination import look_around, package_versions, sharing_of
from slepian_prt.errors import UserError
from tests.distributed.test_crew import wait_until

HERE = look_around("llvm_ad_rgb")


def test_this_process_has_what_it_has():
    assert HERE.renderer.startswith("LLVM ")
    assert not HERE.failure
    assert len(HERE.source) == 16
    assert HERE.cores
    assert set(package_versions()) == {"Python", "slepian_prt", "mitsuba", "drjit", "numpy", "scipy"}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"renderer": "LLVM 1"}, "has LLVM 1, and here is LLVM"),
        ({"source": "0"}, "has other files of slepian_prt, under the same version"),
        ({"renderer": "", "failure": "Mitsuba has no working LLVM"}, "Mitsuba has no working LLVM"),
    ],
)
def test_a_worker_with_something_else_is_refused(cluster, monkeypatch, change, words):
    async def other(variant: str) -> examination.Equipment:
        return dataclasses.replace(HERE, **change)

    monkeypatch.setattr(examination, "look_around_aside", other)
    address = next(iter(cluster.scheduler.workers))
    with pytest.raises(UserError, match=f"^the worker {address} {words}"), open_crew(client=cluster):
        pass


def test_a_worker_without_the_package_is_refused(cluster, monkeypatch):
    own = {**package_versions(), "no-such-package": "1"}
    monkeypatch.setattr(examination, "PACKAGES", (*examination.PACKAGES, "no-such-package"))
    for module in (admission, examination):
        monkeypatch.setattr(module, "package_versions", lambda: own)
    words = "has no no-such-package, and here is 1; install the same there"
    with pytest.raises(UserError, match=words), open_crew(client=cluster):
        pass


def test_other_processors_are_noted_once(cluster, monkeypatch, caplog):
    caplog.set_level(logging.INFO, "slepian_prt")
    other = dataclasses.replace(HERE, processor="riscv64")
    monkeypatch.setattr(admission, "look_around", lambda variant: other)
    with open_crew(client=cluster) as crew:
        cluster.scale(2)
        assert wait_until(lambda: crew.count == 2)
    assert [record.message for record in caplog.records] == [
        f"processors differ ({', '.join(sorted([HERE.processor, 'riscv64']))}): results are equal to rounding, not to "
        "the bit"
    ]


def test_cores_are_shared_by_workers_that_may_use_the_same():
    def on(machine: str, *cores: int) -> examination.Equipment:
        return dataclasses.replace(HERE, machine=machine, cores=cores)

    workers = [on("x", 0, 1, 2, 3), on("x", 0, 1, 2, 3), on("y", 0, 1), on("z", 0), on("z", 1)]
    assert sharing_of(workers) == {("x", (0, 1, 2, 3)): 2, ("y", (0, 1)): 1, ("z", (0,)): 1, ("z", (1,)): 1}


def test_workers_that_join_one_by_one_share_the_cores_and_one_that_stands_in_changes_nothing(cluster, monkeypatch):
    async def four_cores(variant: str) -> examination.Equipment:
        return dataclasses.replace(HERE, cores=(0, 1, 2, 3))

    given: list[int] = []
    monkeypatch.setattr(examination, "look_around_aside", four_cores)
    monkeypatch.setattr(admission, "use_threads", given.append)
    with open_crew(client=cluster) as crew:
        assert given == [4]
        cluster.scale(2)
        assert wait_until(lambda: given == [4, 2, 2])
        assert wait_until(lambda: crew.count == 2)
        cluster.scale(1)
        assert wait_until(lambda: crew.count == 1)
        cluster.scale(2)
        assert wait_until(lambda: crew.count == 2)
        assert given == [4, 2, 2, 2]
        cluster.scale(3)
        assert wait_until(lambda: given == [4, 2, 2, 2, 1, 1, 1])


def test_a_task_that_runs_keeps_its_threads(monkeypatch):
    """Those that others ask for meanwhile are of the next one."""
    drjit = pytest.importorskip("drjit")
    before = drjit.thread_count()
    monkeypatch.setattr(held, "_threads", [before])

    def more(_: object, count: int) -> int:
        held.use_threads(count)
        return drjit.thread_count()

    assert held.call(more, None, before + 1) == before
    assert held.call(more, None, before) == before + 1
    assert held.call(more, None, before) == before
