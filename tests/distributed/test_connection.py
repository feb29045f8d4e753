"""Ways to a scheduler, and what is said where there is none."""

from __future__ import annotations

import json
import logging
import shutil
import socket
import subprocess
import sys

import pytest

from slepian_prt.distributed import connection
from slepian_prt.distributed.connection import make_security, read_scheduler_file
from slepian_prt.distributed.crew import open_crew
from slepian_prt.errors import UserError
from tests.distributed import tasks
from tests.distributed.conftest import threaded_cluster


@pytest.fixture
def impatient(monkeypatch):
    monkeypatch.setattr(connection, "_PATIENCE", 0.5)


@pytest.fixture
def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def test_no_scheduler_there(impatient, free_port):
    address = f"tcp://127.0.0.1:{free_port}"
    words = f"^no Dask scheduler answered at {address}.*check the address"
    with pytest.raises(UserError, match=words), open_crew(scheduler=address):
        pass


def test_something_else_there(impatient):
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        address = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        with pytest.raises(UserError, match=f"^no Dask scheduler answered at {address}"), open_crew(scheduler=address):
            pass


@pytest.mark.parametrize(
    "address", ["http://127.0.0.1:8786", "tcp://127.0.0.1", "tcp://127.0.0.1:none", "", "skull.ply"]
)
def test_what_is_no_address(impatient, address):
    with pytest.raises(UserError) as raised, open_crew(scheduler=address):
        pass
    assert "\n" not in str(raised.value)
    assert "address" in str(raised.value)


@pytest.mark.parametrize(
    ("content", "words"),
    [("not json", "is no scheduler file"), ("[1]", "holds no address"), ('{"address": 3}', "holds no address")],
)
def test_what_is_no_scheduler_file(tmp_path, content, words):
    path = tmp_path / "scheduler.json"
    with pytest.raises(UserError, match="cannot be read"):
        read_scheduler_file(path)
    path.write_text(content)
    with pytest.raises(UserError, match=words):
        read_scheduler_file(path)


def test_the_file_that_a_scheduler_wrote(cluster, tmp_path):
    path = tmp_path / "scheduler.json"
    path.write_text(json.dumps(cluster.scheduler.identity()))
    with open_crew(scheduler_file=path) as crew:
        assert crew.gather(crew.submit(tasks.wait, [0.0])) == [0.0]


def test_what_is_no_client(cluster):
    import distributed

    with distributed.Client(cluster) as client:
        pass
    with pytest.raises(UserError, match="client is closed; give one that is connected"), open_crew(client=client):
        pass
    words = "must be a Dask client, a cluster or the address of a scheduler, not 3"
    with pytest.raises(UserError, match=words), open_crew(client=3):
        pass


@pytest.mark.parametrize("workers", [0, -1, 1.5, True, "two"])
def test_what_is_no_number_of_workers(workers):
    with pytest.raises(UserError, match="workers must be a positive integer"), open_crew(workers):
        pass


def test_dask_is_not_installed(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(UserError, match=r"needs Dask.*pip install 'slepian_prt\[dask\]'"), open_crew(2):
        pass


def test_nothing_of_dask_is_imported_before_it_is_needed():
    code = "import sys, slepian_prt.distributed.crew, slepian_prt.cli.workers; print('distributed' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "False\n"


@pytest.fixture(scope="module")
def certificates(tmp_path_factory) -> dict[str, str]:
    """Self-signed, each with its key in its file; two of them."""
    if not shutil.which("openssl"):
        pytest.skip("no openssl to make certificates with")
    folder = tmp_path_factory.mktemp("certificates")
    made = {}
    for name in ("ours", "others"):
        made[name] = str(folder / f"{name}.pem")
        command = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
        parts = [folder / f"{name}.{part}" for part in ("crt", "key")]
        command += ["-days", "2", "-subj", f"/CN={name}", "-out", str(parts[0]), "-keyout", str(parts[1])]
        subprocess.run(command, check=True, capture_output=True)
        (folder / f"{name}.pem").write_text("".join(part.read_text() for part in parts))
    return made


def test_tls(certificates, impatient):
    ours, others = (make_security(path, path, None) for path in certificates.values())
    with threaded_cluster(security=ours, protocol="tls") as cluster:
        address = cluster.scheduler_address
        assert address.startswith("tls://")
        with open_crew(scheduler=address, security=ours) as crew:
            assert crew.gather(crew.submit(tasks.wait, [0.0])) == [0.0]
        with pytest.raises(UserError, match="speaks TLS; give the certificates too"), open_crew(scheduler=address):
            pass
        plain = address.replace("tls://", "tcp://")
        with pytest.raises(UserError, match=f"{plain} closed the connection.*tls://"), open_crew(scheduler=plain):
            pass
        with (
            pytest.raises(UserError, match=f"{address} and we could not agree"),
            open_crew(scheduler=address, security=others),
        ):
            pass


def test_what_are_no_certificates(certificates, tmp_path):
    assert make_security(None, None, None) is None
    with pytest.raises(UserError, match="give `tls_ca_file` and `tls_cert`"):
        make_security(None, certificates["ours"], None)
    with pytest.raises(UserError, match="no such file"):
        make_security(certificates["ours"], str(tmp_path / "none.pem"), None)
    text = tmp_path / "text.pem"
    text.write_text("no certificate")
    with pytest.raises(UserError, match="cannot be used for TLS"):
        make_security(certificates["ours"], str(text), None)
    with pytest.raises(UserError, match="cannot be used for TLS"):
        make_security(certificates["ours"], certificates["ours"], certificates["others"])


def test_dask_says_nothing_and_its_loggers_are_as_before(cluster, impatient, free_port, capfd):
    loggers = [
        logging.getLogger(name) for name in ("distributed", "distributed.client", "tornado.application", "asyncio")
    ]
    before = [logger.level for logger in loggers]
    with open_crew(client=cluster) as crew:
        crew.gather(crew.submit(tasks.wait, [0.0]))
        logging.getLogger("distributed.core").warning("Event loop was unresponsive")
    with pytest.raises(UserError), open_crew(scheduler=f"tcp://127.0.0.1:{free_port}"):
        pass
    assert capfd.readouterr() == ("", "")
    assert [logger.level for logger in loggers] == before
