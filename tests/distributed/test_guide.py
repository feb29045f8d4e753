"""What the guide shows of other people's tools is at least well-formed, and calls what is there."""

from __future__ import annotations

import ast
import re
import shlex
from pathlib import Path

import pytest

PAGE = (Path(__file__).parents[2] / "docs" / "guide" / "workers.md").read_text()


def shown(language: str) -> list[str]:
    """Blocks of the page in a language."""
    return re.findall(rf"^```{language}\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)


def test_workers_of_kubernetes_have_one_thread_of_dask():
    yaml = pytest.importorskip("yaml")
    (text,) = shown("yaml")
    deployment = yaml.safe_load(text)
    assert deployment["kind"] == "Deployment"
    template = deployment["spec"]["template"]
    assert template["metadata"]["labels"] == deployment["spec"]["selector"]["matchLabels"]
    (container,) = template["spec"]["containers"]
    assert container["args"][-2:] == ["--nthreads", "1"]
    assert all(isinstance(word, str) for word in container["args"])


def test_jobs_of_slurm_start_workers_with_one_thread_of_dask():
    (code,) = (block for block in shown("text") if "SLURMCluster" in block)
    tree = ast.parse(code)
    (call,) = [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "SLURMCluster"
    ]
    options = {keyword.arg: ast.literal_eval(keyword.value) for keyword in call.keywords}
    jobqueue = pytest.importorskip("dask_jobqueue")
    with jobqueue.SLURMCluster(**options, scheduler_options={"dashboard_address": "127.0.0.1:0"}) as cluster:
        script = cluster.job_script()
    assert "#SBATCH --cpus-per-task=16" in script
    assert "--nthreads 1 " in script


@pytest.mark.parametrize("command", ["dask scheduler", "dask worker"])
def test_options_of_dasks_commands_are_there(command):
    pytest.importorskip("distributed")
    from distributed.cli import dask_scheduler, dask_worker

    main = {"dask scheduler": dask_scheduler.main, "dask worker": dask_worker.main}[command]
    known = {flag for option in main.params for flag in (*option.opts, *option.secondary_opts)}
    lines = [line for block in shown("sh") for line in block.replace("\\\n", "").splitlines()]
    words = [shlex.split(line.split("#")[0]) for line in lines if command in line]
    used = {word for line in words for word in line[line.index("dask") :] if word.startswith("--")}
    assert used
    assert used <= known
