"""The value that is open stays so as long as a task uses it."""

from __future__ import annotations

from slepian_prt.distributed import held
from slepian_prt.distributed.crew import open_crew
from tests.distributed import tasks
from tests.distributed.conftest import threaded_cluster
from tests.distributed.tasks import Table
from tests.distributed.test_crew import wait_until


def test_another_thread_of_dask_closes_no_value_that_is_in_use():
    with threaded_cluster(threads_per_worker=2) as cluster, open_crew(client=cluster) as crew:
        shared = crew.share(Table(3))
        futures = crew.submit(tasks.closed_meanwhile, [0.3], shared)
        assert wait_until(lambda: bool(held._open))
        crew.release(shared)
        assert crew.gather(futures) == [0]
        assert wait_until(lambda: not held._open)


def test_another_worker_of_the_process_closes_no_value_that_is_in_use(cluster):
    cluster.scale(2)
    with open_crew(client=cluster) as crew:
        assert wait_until(lambda: crew.count == 2)
        tables = [crew.share(Table(number)) for number in range(2)]
        futures = [future for table in tables for future in crew.submit(tasks.closed_meanwhile, [0.05] * 4, table)]
        assert crew.gather(futures) == [0] * 8
