"""Options that share work among workers."""

from __future__ import annotations

from typing import Any

import click
import pytest

from slepian_prt.cli.options import crew_options
from slepian_prt.cli.workers import crew_of
from slepian_prt.errors import UserError
from tests.distributed import tasks
from tests.distributed.conftest import threaded_cluster


@click.command()
@crew_options
def count(**options: Any) -> None:
    """How many workers there are."""
    with crew_of(options) as crew:
        click.echo("none" if crew is None else f"{crew.count}, {crew.gather(crew.submit(tasks.wait, [0.0]))}")


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[str, str]:
    count.main([str(argument) for argument in arguments], standalone_mode=False)
    return tuple(capsys.readouterr())  # type: ignore[return-value]


def test_without_any_there_is_no_crew(capsys):
    assert run(capsys) == ("none\n", "")


def test_a_scheduler_by_its_address(capsys):
    with threaded_cluster() as cluster:
        assert run(capsys, "--scheduler", cluster.scheduler_address) == ("1, [0.0]\n", "")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--workers", 2, "--scheduler", "tcp://a:1"), "`workers` and `scheduler` are given; give one of them"),
        (("--scheduler", "tcp://a:1", "--scheduler-file", "b"), "`scheduler` and `scheduler_file` are given"),
        (("--workers", 0), "workers must be a positive integer, not 0"),
        (("--scheduler-file", "/no/such/file"), "/no/such/file: cannot be read"),
        (("--tls-key", "a.pem"), "`tls_key` is about workers; give `scheduler`, `scheduler_file` or `workers` too"),
        (("--workers", 1, "--tls-cert", "a.pem"), "give `tls_ca_file` and `tls_cert`"),
        (("--scheduler", ""), "is no address of a Dask scheduler"),
    ],
)
def test_each_mistake_gets_its_line(capsys, arguments, words):
    with pytest.raises(UserError, match=words) as raised:
        run(capsys, *arguments)
    assert "\n" not in str(raised.value)
