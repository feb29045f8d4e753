"""Workers of this machine end with the command, whatever ends it, and nothing of Dask's is heard."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import psutil
import pytest

from slepian_prt.distributed.local_cluster import _forget_stale
from slepian_prt.distributed.quiet import kept_environment
from tests.distributed.test_crew import wait_until


def begin_long_work(folder: Path) -> subprocess.Popen[str]:
    """In a session of its own, and with a folder for temporary files."""
    return subprocess.Popen(
        [sys.executable, "-m", "tests.distributed.long_work"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={**os.environ, "TMPDIR": str(folder)},
    )


@pytest.mark.slow
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_workers_end_at_once_with_the_command(how, tmp_path):
    """A terminal sends an interrupt to all processes of a command, the others come to one."""
    command = begin_long_work(tmp_path)
    assert command.stdout is not None
    workers = [int(word) for word in command.stdout.readline().split()]
    assert len(workers) == 2
    assert [path.name[:20] for path in tmp_path.iterdir()] == ["slepian-prt-workers-"]
    if how == signal.SIGINT:
        os.killpg(command.pid, how)
    else:
        command.send_signal(how)
    _, heard = command.communicate(timeout=25)  # what workers do takes half a minute
    assert command.returncode == -how
    assert wait_until(lambda: not any(psutil.pid_exists(process) for process in workers), 5.0)
    if how == signal.SIGINT:
        assert heard.splitlines()[-1] == "KeyboardInterrupt"
        assert heard.count("Traceback") == 1
        assert not list(tmp_path.iterdir())
    else:
        assert heard == ""


@pytest.mark.slow
def test_an_interrupt_while_workers_start_is_heard_of_once(tmp_path):
    command = begin_long_work(tmp_path)
    assert wait_until(lambda: any(tmp_path.iterdir()))
    os.killpg(command.pid, signal.SIGINT)
    _, heard = command.communicate(timeout=20)
    assert command.returncode == -signal.SIGINT
    assert heard.count("Traceback") == heard.count("KeyboardInterrupt") == 1
    assert not list(tmp_path.iterdir())


def test_folders_of_processes_that_were_killed_are_removed(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    names = [f"slepian-prt-workers-{number}-x" for number in (ended.pid, os.getpid())] + ["slepian-prt-workers-y-x"]
    for name in names:
        (tmp_path / name / "deep").mkdir(parents=True)
    _forget_stale()
    assert {path.name for path in Path(tmp_path).iterdir()} == set(names[1:])


def test_the_environment_is_as_before(monkeypatch):
    monkeypatch.setenv("CHANGED", "1")
    monkeypatch.setenv("REMOVED", "1")
    monkeypatch.delenv("ADDED", raising=False)
    monkeypatch.setenv("OTHER", "1")
    with kept_environment(["CHANGED", "REMOVED", "ADDED"]):
        os.environ.update(CHANGED="2", ADDED="2", OTHER="2")
        del os.environ["REMOVED"]
    assert [os.environ.get(name) for name in ("CHANGED", "REMOVED", "ADDED", "OTHER")] == ["1", "1", None, "2"]
