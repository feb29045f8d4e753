"""Whatever ends the command, it leaves nothing half done, says one line, and ends its workers."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import psutil
import pytest
import trimesh

from slepian_prt.compression.files.prt_file import load
from slepian_prt.signals import interrupts_held
from tests.distributed.test_crew import wait_until

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")

PRECOMPUTE = ["precompute", "ball.ply", "-o", "out.prt", "--bandlimit", "2", "--samples", "16", "--clusters", "4"]

SPECTRUM = ["spectrum", "--bandlimit", "4", "--half-angle", "40", "--json", "x.json"]

# Each stage, by a function that is called in it.
STAGES = {
    "tracing": "slepian_prt.compression.tracing.Journal.add",
    "a thread": "slepian_prt.compression.projection.Projection.block",
    "coding": "slepian_prt.compression.stream._encode",
    "writing": "slepian_prt.files.os.fsync",
}


KEPT = "finished work is kept, and the same command goes on"


def begin(
    code: str,
    folder: Path,
    *arguments: str,
    ignored: tuple[signal.Signals, ...] = (),
    stdout: int = subprocess.PIPE,
    stderr: int = subprocess.PIPE,
) -> subprocess.Popen[str]:
    """A Python process in a session of its own, which hears of all signals but those ignored."""

    def set_signals() -> None:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):  # runners in the background hand down others
            signal.signal(number, signal.SIG_IGN if number in ignored else signal.SIG_DFL)

    return subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code), *arguments],
        cwd=folder,
        stdout=stdout,
        stderr=stderr,
        text=True,
        start_new_session=True,
        preexec_fn=set_signals,
        env={**os.environ, "SLEPIAN_PRT_CACHE": str(folder / "cache"), "PYTHONPATH": os.pathsep.join(sys.path)},
    )


def signalled_in(stage: str, number: int) -> str:
    """The command, which sends itself a signal when a stage begins, and goes on with it."""
    return f"""
        import os
        from pkgutil import resolve_name
        owner, name = {STAGES[stage]!r}.rsplit(".", 1)
        owner = resolve_name(owner)
        act = getattr(owner, name)
        def signalled(*arguments, **named):
            os.kill(os.getpid(), {int(number)})
            return act(*arguments, **named)
        setattr(owner, name, signalled)
        from slepian_prt.__main__ import main
        main()
    """


@pytest.fixture
def folder(tmp_path) -> Path:
    trimesh.creation.icosphere(2).export(tmp_path / "ball.ply")
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stage", "number", "status", "said"),
    [
        ("tracing", signal.SIGTERM, 143, "terminated; nothing was written"),
        ("a thread", signal.SIGINT, 130, "interrupted; nothing was written"),
        ("coding", signal.SIGINT, 130, f"interrupted; {KEPT}"),
        ("writing", signal.SIGHUP, 129, f"the terminal was closed; {KEPT}"),
    ],
)
def test_a_signal_ends_the_command_cleanly_in_every_stage(folder, stage, number, status, said):
    process = begin(signalled_in(stage, number), folder, *PRECOMPUTE)
    _, error = process.communicate(timeout=120)
    assert error.splitlines() == [f"slepian-prt: {said}"]
    assert process.returncode == status
    assert {path.name for path in folder.iterdir()} == {"ball.ply", "cache"}
    if stage == "writing":
        go_on_under_nohup(folder)


def go_on_under_nohup(folder: Path) -> None:
    """What was finished is there for the next run, and a closed terminal ends nothing."""
    again = begin(signalled_in("coding", signal.SIGHUP), folder, *PRECOMPUTE, ignored=(signal.SIGHUP,))
    _, error = again.communicate(timeout=120)
    assert again.returncode == 0, error
    assert "were finished before and are kept" in error
    assert load(folder / "out.prt").vertex_count == 162
    assert not list((folder / "cache").iterdir())


SIGNALLED_WHEN_WRITTEN = """
    import os, signal
    from slepian_prt import files
    replace = files._replace
    def signalled(partial, target):
        replace(partial, target)
        os.kill(os.getpid(), signal.SIGINT)
    files._replace = signalled
    from slepian_prt.__main__ import main
    main()
"""


@pytest.mark.slow
def test_what_is_in_its_place_is_not_said_to_be_unwritten(tmp_path):
    process = begin(SIGNALLED_WHEN_WRITTEN, tmp_path, *SPECTRUM)
    _, error = process.communicate(timeout=60)
    assert error == "slepian-prt: interrupted; what was written by then stays\n"
    assert process.returncode == 130
    assert os.listdir(tmp_path) == ["x.json"]


SIGNALLED_WHEN_BLOCKED = """
    import os, signal, threading
    from slepian_prt import streams
    write = streams._Patient.write
    def signalled(self, data):
        if self.fileno() == 1 and not timers:
            timers.append(threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGTERM)))
            timers[0].start()
        return write(self, data)
    timers = []
    streams._Patient.write = signalled
    from slepian_prt.__main__ import main
    main()
"""


@pytest.mark.slow
@pytest.mark.parametrize("both", [False, True])
def test_a_command_whose_output_nobody_reads_can_be_ended(tmp_path, both):
    """Standard output, or error too, is a full pipe that is open."""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(writing, bytes(1 << 12))
    os.set_blocking(writing, True)
    streams = {"stdout": writing, **({"stderr": writing} if both else {})}
    process = begin(SIGNALLED_WHEN_BLOCKED, tmp_path, *SPECTRUM[:-2], **streams)
    try:
        _, error = process.communicate(timeout=60)
    finally:
        process.kill()
        os.close(reading), os.close(writing)
    assert process.returncode == 143
    assert error == (None if both else "slepian-prt: terminated; nothing was written\n")


HEARD = """
    import os, signal, sys, time
    from slepian_prt.signals import heard
    def send(name):
        os.kill(os.getpid(), getattr(signal, name))
    def wait():
        for _ in range(600):
            time.sleep(0.1)
    try:
        with heard():
            {body}
    except KeyboardInterrupt as ended:
        sys.exit(128 + ended.number)
"""


def outcome(body: str, folder: Path) -> int:
    """The status of a process that listens to signals while it does something."""
    process = begin(textwrap.dedent(HEARD).replace("{body}", textwrap.indent(body, 8 * " ").lstrip()), folder)
    _, error = process.communicate(timeout=60)
    assert error == ""
    return process.returncode


def while_cleaning(first: str, second: str) -> str:
    return f'try:\n    send("{first}")\n    wait()\nfinally:\n    send("{second}")\n    open("cleaned", "w")'


@pytest.mark.parametrize(
    ("first", "second", "status"),
    [
        ("SIGINT", "SIGINT", -signal.SIGINT),
        ("SIGTERM", "SIGINT", -signal.SIGINT),
        ("SIGINT", "SIGTERM", -signal.SIGTERM),
        ("SIGTERM", "SIGTERM", 143),
        ("SIGHUP", "SIGTERM", 129),
    ],
)
def test_a_second_interrupt_ends_it_at_once_and_what_comes_twice_by_itself_does_not(tmp_path, first, second, status):
    """``timeout`` and closed terminals send signals twice."""
    assert outcome(while_cleaning(first, second), tmp_path) == status
    assert (tmp_path / "cleaned").exists() == (status > 0)


def test_a_second_interrupt_while_they_are_held(tmp_path):
    body = (
        'from slepian_prt.signals import interrupts_held\nwith interrupts_held():\n    send("SIGINT")\n'
        '    open("went-on", "w")\n    send("SIGINT")\n    wait()'
    )
    assert outcome(body, tmp_path) == -signal.SIGINT
    assert (tmp_path / "went-on").exists()


@pytest.mark.parametrize(("name", "status"), [("SIGINT", 130), ("SIGTERM", 143), ("SIGHUP", 129)])
def test_signals_that_are_held_come_at_the_end(tmp_path, name, status):
    body = (
        "from slepian_prt.signals import interrupts_held\nwith interrupts_held():\n"
        f'    send("{name}")\n    open("went-on", "w")\nwait()'
    )
    assert outcome(body, tmp_path) == status
    assert (tmp_path / "went-on").exists()


def test_a_signal_is_heard_when_mitsuba_is_imported(tmp_path):
    """Within, half of Dr.Jit aborts the process, or is a fault of ours."""
    body = textwrap.dedent("""\
        class Signalling:
            def find_spec(self, name, path=None, target=None):
                if "drjit" in sys.modules and not sent:
                    sent.append(name)
                    send("SIGINT")
        sent = []
        sys.meta_path.insert(0, Signalling())
        from slepian_prt.renderer.variants import imported_mitsuba
        try:
            imported_mitsuba()
        finally:
            assert sent and "mitsuba.mitsuba_ext" in sys.modules, sent
        wait()""")
    assert outcome(body, tmp_path) == 130


@pytest.mark.parametrize("way", ["raise ValueError", "sys.exit(1)"])
def test_a_signal_that_is_held_counts_before_a_fault_that_it_caused(tmp_path, way):
    body = (
        "from slepian_prt.signals import interrupts_held\n"
        'try:\n    with interrupts_held(), interrupts_held():\n        send("SIGTERM")\n'
        f"        {way}\nexcept Exception:\n    pass"
    )
    assert outcome(body, tmp_path) == 143


def test_a_signal_in_a_finalizer_is_not_lost(tmp_path):
    """Python would print a traceback there and go on."""
    body = 'class Held:\n    def __del__(self):\n        send("SIGTERM")\n        time.sleep(1)\nHeld()\nwait()'
    assert outcome(body, tmp_path) == 143


def test_handlers_of_others_stay(tmp_path):
    """The library, and the command called as a function, set none."""
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    from slepian_prt.cli import main

    before = [signal.getsignal(number) for number in numbers]
    assert main(["spectrum", "--bandlimit", "4", "--half-angle", "40", "--json", str(tmp_path / "x.json")]) == 0
    assert [signal.getsignal(number) for number in numbers] == before
    with interrupts_held():
        assert signal.getsignal(signal.SIGTERM) is before[1]  # the system's own
    assert [signal.getsignal(number) for number in numbers] == before


# Prints, and then writes its result, as commands do.
PRINTING = """
import click, slepian_prt.cli
def work():
    click.echo("begun")
    click.echo("a remark", err=True)
    open("x.json", "w").close()
slepian_prt.cli.main = work
from slepian_prt.__main__ import main
main()
"""


@pytest.mark.parametrize("gone", ["pipe", "terminal", "closed"])
def test_what_nobody_reads_ends_no_work(tmp_path, gone):
    """Standard streams whose reader has gone."""
    run = {"cwd": tmp_path, "check": False, "timeout": 60}
    if gone == "closed":
        done = subprocess.run(["sh", "-c", f"exec {sys.executable} -c '{PRINTING}' >&- 2>&- <&-"], **run)
    else:
        reading, writing = os.pipe() if gone == "pipe" else os.openpty()
        os.close(reading)
        done = subprocess.run([sys.executable, "-c", PRINTING], stdout=writing, stderr=writing, **run)
        os.close(writing)
    assert done.returncode == 0
    assert os.listdir(tmp_path) == ["x.json"]


@pytest.mark.slow
def test_a_full_disk_below_standard_output_is_told_when_all_is_done(tmp_path):
    code = "from slepian_prt.__main__ import main; main()"
    with open("/dev/full", "wb") as full:
        process = begin(code, tmp_path, *SPECTRUM, stdout=full.fileno())
    _, error = process.communicate(timeout=60)
    (line,) = error.splitlines()
    assert "standard output: cannot be written (No space left on device)" in line
    assert process.returncode == 2
    assert os.listdir(tmp_path) == ["x.json"]


@pytest.mark.slow
@pytest.mark.parametrize(("number", "group"), [(signal.SIGHUP, False), (signal.SIGTERM, True)])
def test_workers_end_with_the_command(tmp_path, number, group):
    """Also where all processes of the command get the signal, as of a terminal that is closed or a batch system."""
    pytest.importorskip("distributed")
    code = """
        import os, sys
        from slepian_prt.distributed.crew import open_crew
        from slepian_prt.signals import heard
        from tests.distributed import tasks
        try:
            with heard(), open_crew(workers=2) as crew:
                workers = crew.client.run(os.getpid).values()
                for number, _ in crew.results(crew.submit(tasks.wait, [0.0] + [30.0] * 4)):
                    if number == 0:
                        print(*workers, flush=True)
        except KeyboardInterrupt as ended:
            sys.exit(128 + ended.number)
    """
    command = begin(code, tmp_path)
    assert command.stdout is not None
    workers = [int(word) for word in command.stdout.readline().split()]
    assert len(workers) == 2
    children = psutil.Process(command.pid).children(recursive=True)
    (os.killpg if group else os.kill)(command.pid, number)
    _, error = command.communicate(timeout=60)  # what workers do takes half a minute, and is not waited for
    assert (command.returncode, error) == (128 + number, "")
    assert wait_until(lambda: not any(child.is_running() for child in children), 10.0)


@pytest.mark.parametrize("command", ["bitmap_module", "prepare_llvm"])
def test_a_working_folder_that_was_removed_is_a_line(tmp_path, command):
    """Mitsuba would abort the process when it is imported, and LLVM be taken for one that does not work."""
    code = f"""
        import os
        os.mkdir("gone"), os.chdir("gone"), os.rmdir("../gone")
        from slepian_prt.errors import UserError
        from slepian_prt.renderer.variants import {command}
        try:
            {command}()
        except UserError as error:
            print(error)
    """
    process = begin(code, tmp_path)
    assert process.communicate(timeout=60) == ("the working folder was removed; change to one that is there\n", "")
    assert process.returncode == 0


def test_workers_hear_of_no_signal_from_their_first_moment():
    """One that ends while it starts would be a fault of Dask's, and not the end of the command."""
    pytest.importorskip("distributed")
    from slepian_prt.distributed.local_cluster import _unheard_by_children

    code = "import signal; print(*sorted(map(int, signal.pthread_sigmask(signal.SIG_BLOCK, ()))))"
    with _unheard_by_children():
        blocked = subprocess.check_output([sys.executable, "-S", "-c", code], text=True).split()
    assert {int(signal.SIGINT), int(signal.SIGTERM), int(signal.SIGHUP)} <= set(map(int, blocked))
    assert signal.SIGTERM not in signal.pthread_sigmask(signal.SIG_BLOCK, ())
