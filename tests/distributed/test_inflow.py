"""Tasks whose results are gone with their workers before anybody fetched them."""

from __future__ import annotations

from slepian_prt.distributed import held
from slepian_prt.distributed.crew import open_crew
from tests.distributed import tasks
from tests.distributed.tasks import Table
from tests.distributed.test_crew import wait_until


def test_a_finished_result_that_dies_with_its_worker_is_made_again(cluster):
    """While that goes on Dask calls it lost."""
    cluster.scale(2)
    with open_crew(client=cluster) as crew:
        assert wait_until(lambda: crew.count == 2)
        (future,) = crew.submit(tasks.wait, [0.3])
        assert wait_until(future.done)
        (holder,) = crew.client.who_has([future])[future.key]
        cluster.sync(cluster.scheduler.remove_worker, holder, stimulus_id="a-death")
        assert wait_until(lambda: future.status == "lost")
        assert crew.gather([future]) == [0.3]


def test_a_task_is_done_again_with_one_before_it_whose_future_is_gone(cluster):
    """All workers die, and with them the value and the first result: the first fails for want of the value."""
    with open_crew(client=cluster) as crew:
        found = crew.submit(tasks.look_up, [0], crew.share(Table(3)))
        assert wait_until(found[0].done)
        cluster.scale(0)
        assert wait_until(lambda: crew.count == 0)
        held._close("")
        held._values.clear()
        sums = crew.submit(tasks.add, [found])
        del found
        cluster.scale(1)
        assert crew.gather(sums) == [3]
