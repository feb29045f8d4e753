"""Clients of Dask: of a cluster of ours, of the user's, or of a scheduler that is named; what fails gets one line."""

from __future__ import annotations

import asyncio
import json
import queue
import ssl
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from slepian_prt.distributed.local_cluster import local_cluster
from slepian_prt.distributed.quiet import quiet
from slepian_prt.errors import UserError, check_integer
from slepian_prt.files import check_readable

if TYPE_CHECKING:
    from distributed import Client, Security

# Seconds until a scheduler has to have answered.
_PATIENCE = 10.0


def dask_distributed() -> ModuleType:
    """Dask's distributed; UserError where it is not installed."""
    try:
        import distributed
    except ImportError as error:
        raise UserError(
            f"work on several workers needs Dask, which cannot be imported here ({error}); "
            "pip install 'slepian_prt[dask]'"
        ) from None
    return distributed


@contextmanager
def local_client(workers: int, security: Any = None) -> Iterator[Client]:
    """The client of a cluster of so many workers on this machine, which ends with the with-block."""
    dask = dask_distributed()
    count = check_integer(workers, "workers", 1)
    with quiet(), local_cluster(count, security) as cluster, dask.Client(cluster, set_as_default=False) as client:
        yield client


@contextmanager
def given_client(client: Any, security: Any = None) -> Iterator[Client]:
    """The user's own client as it is, or one for an address or a cluster of theirs.

    Raises
    ------
    UserError
        A client that is closed or asynchronous, no scheduler that answers, or something else than these.
    """
    dask = dask_distributed()
    if isinstance(client, dask.Client):
        if client.asynchronous:
            raise UserError("client is asynchronous; give one that was made with asynchronous=False")
        if client.status != "running":
            raise UserError(f"client is {client.status}; give one that is connected")
        yield client
        return
    if not isinstance(client, str) and not hasattr(client, "scheduler_address"):
        raise UserError(f"client must be a Dask client, a cluster or the address of a scheduler, not {client!r}")
    address = client if isinstance(client, str) else client.scheduler_address
    with quiet():
        own = _connect(dask, client, str(address), security)
        try:
            yield own
        finally:
            own.close(timeout=_PATIENCE)


def read_scheduler_file(path: str | Path) -> str:
    """The address in a file that ``dask scheduler --scheduler-file`` writes.

    Raises
    ------
    UserError
        No such file, or one without an address.
    """
    path = Path(path)
    remedy = "name the one that `dask scheduler` was told to write"
    try:
        content = json.loads(path.read_text())
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror or error}); {remedy}") from None
    except ValueError:
        raise UserError(f"{path}: is no scheduler file; {remedy}") from None
    address = content.get("address") if isinstance(content, dict) else None
    if not isinstance(address, str) or not address:
        raise UserError(f"{path}: holds no address of a scheduler; {remedy}")
    return address


def make_security(ca_file: str | None, cert: str | None, key: str | None) -> Security | None:
    """Certificates of all roles, for Dask; None if there are none, where Dask's own configuration decides.

    Raises
    ------
    UserError
        A file that is missing or holds no certificate, or one of them without the others.
    """
    if ca_file is None and cert is None and key is None:
        return None
    if ca_file is None or cert is None:
        raise UserError("TLS needs a certificate and its authority; give `tls_ca_file` and `tls_cert`")
    dask = dask_distributed()
    for path in filter(None, (ca_file, cert, key)):
        check_readable(path, "a .pem file")
    roles = ("client", "scheduler", "worker")
    of_roles = {f"tls_{role}_{kind}": path for role in roles for kind, path in (("cert", cert), ("key", key))}
    security = dask.Security(tls_ca_file=ca_file, require_encryption=True, **of_roles)
    try:
        security.get_connection_args("client")
    except (ssl.SSLError, OSError, ValueError) as error:
        raise UserError(
            f"{', '.join(filter(None, (ca_file, cert, key)))}: cannot be used for TLS ({_short(error)}); give .pem "
            "files that belong together"
        ) from None
    return security


def _connect(dask: ModuleType, client: Any, address: str, security: Any) -> Client:
    from distributed.comm import CommClosedError

    try:
        if isinstance(client, str):
            _ask(dask, address, security)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # versions are compared by us
            return dask.Client(client, security=security, timeout=_PATIENCE, set_as_default=False)
    except (OSError, TimeoutError, asyncio.TimeoutError) as error:
        if "ssl" in repr(error).lower() or "tls" in repr(error).lower():
            reason = f"the scheduler at {address} and we could not agree on TLS ({_short(error)})"
        elif isinstance(error, CommClosedError):
            reason = (
                f"what listens at {address} closed the connection: it is no Dask scheduler, or one with TLS (tls://)"
            )
        else:
            reason = f"no Dask scheduler answered at {address} within {_PATIENCE:.0f} s"
        raise UserError(f"{reason}; check the address, and that it is reached from here") from None
    except (TypeError, ValueError, RuntimeError) as error:
        if "ssl_context" in str(error) or "TLS" in str(error):
            raise UserError(
                f"{address} speaks TLS; give the certificates too (`tls_ca_file`, `tls_cert`, `tls_key`)"
            ) from None
        raise UserError(
            f"{address}: is no address of a Dask scheduler ({_short(error)}); give one as tcp://HOST:8786"
        ) from None


def _ask(dask: ModuleType, address: str, security: Any) -> None:
    """Raise what keeps us from a scheduler; Dask's client would wait for ever for one that accepts and is silent."""

    async def ask() -> None:
        arguments = (security or dask.Security()).get_connection_args("client")
        comm = await asyncio.wait_for(connect(address, timeout=_PATIENCE, **arguments), _PATIENCE)
        await comm.close()

    def answer() -> None:
        try:
            asyncio.run(ask())
        except Exception as error:
            answers.put(error)
        else:
            answers.put(None)

    from distributed.comm import connect

    answers: queue.SimpleQueue[Exception | None] = queue.SimpleQueue()
    threading.Thread(target=answer, daemon=True).start()  # ours may have a loop already, as in a notebook
    if fault := answers.get():
        raise fault


def _short(error: BaseException) -> str:
    return " ".join(str(error).split())[:120]
