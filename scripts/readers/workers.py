"""Readers in processes of their own, which may crash, hang, print and take too much memory."""

from __future__ import annotations

import json
import os
import resource
import select
import subprocess
import sys
import tempfile
import traceback
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from readers.measures import Measures, measure
from readers.others import PYTHON_READERS

from slepian_prt.errors import UserError

_SCRIPTS = Path(__file__).parent.parent


@dataclass(frozen=True)
class Answer:
    """What a reader made of a file.

    Attributes
    ----------
    measures : Measures or None
        None if it read nothing.
    refusal : str
        Why it read nothing, in its words.
    fault : str
        What no reader should do: a crash, a hang, something printed.
    """

    measures: Measures | None = None
    refusal: str = ""
    fault: str = ""


class Worker:
    """A reader: ``ours``, ``trimesh``, ``assimp`` or ``three``.

    Parameters
    ----------
    name : str
    seconds : float
        That it may take for a file.
    gigabytes : float
        That it may take of memory.
    node_modules : Path or None
        Where three is.
    """

    def __init__(self, name: str, seconds: float, gigabytes: float, node_modules: Path | None = None) -> None:
        self.name, self._seconds, self._gigabytes = name, seconds, gigabytes
        self._command = [sys.executable, str(_SCRIPTS / "compare_readers.py"), "--serve", name]
        if name == "three":
            assert node_modules is not None
            self._command = ["node", str(_SCRIPTS / "readers" / "three.mjs"), str(node_modules.parent / "package.json")]
        self._process: subprocess.Popen[bytes] | None = None
        self._folder = tempfile.TemporaryDirectory()

    def ask(self, path: Path) -> Answer:
        """Let it read a file."""
        out, printed = Path(self._folder.name, "triangles"), Path(self._folder.name, "printed")
        process = self._start(printed)
        assert process.stdin is not None
        process.stdin.write(json.dumps({"path": str(path), "out": str(out)}).encode() + b"\n")
        process.stdin.flush()
        line = self._wait(process)
        said = printed.read_text(errors="replace").strip()
        printed.write_text("")
        if not line:
            died = process.poll() is not None
            self._end()
            return Answer(fault=f"died with status {process.returncode}" if died else f"hangs ({self._seconds:g} s)")
        answer = json.loads(line)
        fault = answer.get("fault", "") or (f"prints: {said.splitlines()[-1][:200]}" if said else "")
        if "triangles" not in answer:
            return Answer(refusal=answer.get("refused", ""), fault=fault)
        triangles = np.fromfile(out).reshape(-1, 3, 3)
        out.unlink()
        return Answer(measure(triangles), fault=fault)

    def stop(self) -> None:
        self._end()
        self._folder.cleanup()

    def _end(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None

    def _start(self, printed: Path) -> subprocess.Popen[bytes]:
        if self._process is None or self._process.poll() is not None:
            printed.touch()
            with printed.open("ab") as errors:
                self._process = subprocess.Popen(
                    self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, preexec_fn=self._limit
                )
        return self._process

    def _limit(self) -> None:
        if self.name != "three":  # node reserves far more addresses than it uses
            limit = int(self._gigabytes * 1e9)
            resource.setrlimit(resource.RLIMIT_AS, (limit, limit))

    def _wait(self, process: subprocess.Popen[bytes]) -> bytes:
        """A line of its answer; empty if there is none in time."""
        assert process.stdout is not None
        line = b""
        while not line.endswith(b"\n"):
            if not select.select([process.stdout], [], [], self._seconds)[0]:
                return b""
            more = os.read(process.stdout.fileno(), 1 << 16)
            if not more:
                process.wait()
                return b""
            line += more
        return line


def serve(name: str) -> None:
    """Be a worker: answer each line of standard input with one."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what libraries print is noted, and does not get between the answers
    read = PYTHON_READERS[name]
    for line in sys.stdin:
        asked = json.loads(line)
        answer: dict[str, Any]
        try:
            triangles = read(Path(asked["path"]))
            np.ascontiguousarray(triangles, dtype=np.float64).tofile(asked["out"])
            answer = {"triangles": len(triangles)}
        except UserError as error:
            answer = {"refused": str(error)}
            if "\n" in str(error):
                answer["fault"] = "refuses in more than one line"
        except BaseException as error:
            words = " ".join(f"{type(error).__name__}: {error}".split())[:200]
            place = traceback.extract_tb(error.__traceback__)[-1]
            answer = {"refused": words}
            if name == "ours":
                answer["fault"] = f"{words} ({Path(place.filename).name}, line {place.lineno})"
        sys.stdout.flush()
        sys.stderr.flush()
        answers.write(json.dumps(answer) + "\n")
        answers.flush()
