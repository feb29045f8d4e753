"""Options that share work among workers."""

from __future__ import annotations

from typing import Any

import click
import numpy as np
import pytest

from slepian_prt.cli import main
from slepian_prt.cli.options import crew_options
from slepian_prt.cli.workers import crew_of
from slepian_prt.errors import UserError
from tests.distributed import tasks
from tests.distributed.conftest import threaded_cluster

SCENE = """<scene version="3.0.0"><sensor type="perspective"><transform name="to_world">
<lookat origin="0, -4, 2" target="0, 0, .5" up="0, 0, 1"/></transform><film type="hdrfilm">
<integer name="width" value="32"/><integer name="height" value="24"/></film></sensor>
<shape type="rectangle"><transform name="to_world"><scale value="1.5"/></transform></shape>
<shape type="sphere"><point name="center" x="0" y="0" z=".5"/><float name="radius" value=".4"/></shape></scene>"""


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


@pytest.mark.slow
def test_commands_by_the_workers_of_a_scheduler(crew, tmp_path, capsys, monkeypatch):
    """capture, sweep and compare, small, by workers that are there."""
    monkeypatch.setenv("SLEPIAN_PRT_CACHE", str(tmp_path / "cache"))
    (tmp_path / "scene.xml").write_text(SCENE)
    sky, address = tmp_path / "sky.pfm", crew.client.scheduler.address
    write_pfm(sky, np.linspace(0.5, 1.5, 16 * 32 * 3, dtype=np.float32).reshape(16, 32, 3))
    small = ["--samples", "16", "--bandlimit", "2", "--scheduler", address]
    light = ["--environment", str(sky), "--noise", "0.1"]
    scene, out = str(tmp_path / "scene.xml"), str(tmp_path / "out")
    assert main(["capture", scene, "-o", str(tmp_path / "picture.prt"), *small]) == 0
    assert "16 paths of each" in capsys.readouterr().out
    assert main(["sweep", scene, "-o", out, *small, *light, "--clusters", "4", "--tolerance", "0.2"]) == 0
    assert capsys.readouterr().out.strip().endswith("sweep.html: 1 settings")
    assert main(["compare", scene, "-o", out, *small, *light, "--basis", "sh", "--width", "32"]) == 0
    assert "methods, 1 environment" in capsys.readouterr().out


def write_pfm(path, texels):
    path.write_bytes(b"PF\n%d %d\n-1.0\n" % (texels.shape[1], texels.shape[0]) + texels[::-1].tobytes())
