"""What workers have: the same results come of the same versions, and the same bytes of the same processors."""

from __future__ import annotations

import asyncio
import hashlib
import importlib.metadata
import platform
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from slepian_prt.errors import UserError
from slepian_prt.machine.cores import allowed_cores, usable_cores

if TYPE_CHECKING:
    from distributed import Client

# What numbers come from.
PACKAGES = ("slepian_prt", "mitsuba", "drjit", "numpy", "scipy")

# Units of x86 that BLAS and LLVM make other instructions for, in another order of sums.
_VECTOR_UNITS = ("avx", "avx2", "fma", "avx512f")


@dataclass(frozen=True)
class Equipment:
    """What a process computes with.

    Attributes
    ----------
    source : str
        A digest of the package's own files, which differ also under one version.
    renderer : str
        What Mitsuba compiles for, such as ``LLVM 19``; empty if that does not work here.
    failure : str
        Why it does not.
    processor : str
        Kind of processor, as far as sums of floats depend on it.
    cores : tuple of int
        Those that this process may use.
    machine : str
        What it is called.
    """

    source: str
    renderer: str
    failure: str
    processor: str
    cores: tuple[int, ...]
    machine: str


def package_versions() -> dict[str, str]:
    """Versions here of Python and of the packages that numbers come from."""
    return {"Python": platform.python_version(), **{name: importlib.metadata.version(name) for name in PACKAGES}}


def look_around(variant: str) -> Equipment:
    """What this process has for that variant of Mitsuba."""
    renderer, failure = "", ""
    try:
        renderer = _renderer(variant)
    except UserError as error:
        failure = str(error)
    return Equipment(_source_digest(), renderer, failure, _processor(), _cores(), platform.node())


async def look_around_aside(variant: str) -> Equipment:
    """As `look_around`, in another thread than the one that answers the scheduler."""
    return await asyncio.get_running_loop().run_in_executor(None, look_around, variant)


async def examine(client: Client, addresses: Iterable[str], variant: str) -> dict[str, Equipment | str]:
    """What each worker has, or a sentence about what is wrong with it.

    Versions are asked for first and by the standard library alone: a worker without the package, or with another
    one, could not even read a question of ours.
    """
    addresses = list(addresses)
    own = package_versions()
    asked: list[Any] = [client.run(platform.python_version, workers=addresses, on_error="return")]
    asked += [client.run(importlib.metadata.version, name, workers=addresses, on_error="return") for name in PACKAGES]
    answers = dict(zip(own, await asyncio.gather(*asked), strict=True))
    found: dict[str, Equipment | str] = {}
    for address in addresses:
        theirs = {name: answer.get(address) for name, answer in answers.items()}
        if any(isinstance(version, OSError) or version is None for version in theirs.values()):
            continue  # it is gone already
        if difference := _difference(own, theirs):
            found[address] = difference
    left = [address for address in addresses if address not in found]
    here = look_around(variant)
    there = await client.run(look_around_aside, variant, workers=left, on_error="return") if left else {}
    for address, equipment in there.items():
        if isinstance(equipment, Equipment):
            found[address] = _fault(here, equipment) or equipment
        elif not isinstance(equipment, OSError):
            found[address] = f"cannot say what it has ({type(equipment).__name__}: {equipment})"
    return found


def sharing_of(equipments: Iterable[Equipment]) -> Counter[tuple[str, tuple[int, ...]]]:
    """How many of these workers there are for the same cores of the same machine."""
    return Counter((each.machine, each.cores) for each in equipments)


def _difference(own: Mapping[str, str], theirs: Mapping[str, Any]) -> str:
    for name, version in own.items():
        other = theirs[name]
        if isinstance(other, Exception):
            return f"has no {name}, and here is {version}; install the same there"
        if name == "Python":  # its third number does not matter
            version, other = (".".join(text.split(".")[:2]) for text in (version, other))
        if other != version:
            return f"has {name} {other}, and here is {version}; install the same version there"
    return ""


def _fault(here: Equipment, there: Equipment) -> str:
    if there.failure:
        return there.failure
    if there.source != here.source:
        return "has other files of slepian_prt, under the same version; install the same there"
    if there.renderer != here.renderer:
        return f"has {there.renderer}, and here is {here.renderer}; install the same there"
    return ""


@cache
def _source_digest() -> str:
    digest = hashlib.sha256()
    folder = Path(__file__).parents[1]
    for path in sorted(folder.rglob("*.py")):
        digest.update(str(path.relative_to(folder)).encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _renderer(variant: str) -> str:
    from slepian_prt.renderer.variants import cuda_failure, imported_mitsuba, prepare_llvm

    if variant.startswith("cuda"):
        if cuda_failure():
            raise UserError("has no CUDA device that Mitsuba works with; use another variant, or workers that have one")
        imported_mitsuba()
        import drjit

        return f"CUDA {drjit.detail.cuda_version()[0]}"
    prepare_llvm()
    imported_mitsuba()
    import drjit

    return f"LLVM {drjit.detail.llvm_version()[0]}"


@cache
def _processor() -> str:
    from threadpoolctl import threadpool_info

    kernels = sorted(
        {info.get("architecture") or info["internal_api"] for info in threadpool_info() if info["user_api"] == "blas"}
    )
    return " ".join([platform.machine(), *kernels, *_vector_units()])


def _vector_units() -> list[str]:
    try:
        text = Path("/proc/cpuinfo").read_text()
    except OSError:
        return []
    flags = re.search(r"^flags\s*:(.*)$", text, re.MULTILINE)
    return [unit for unit in _VECTOR_UNITS if flags and unit in flags[1].split()]


def _cores() -> tuple[int, ...]:
    """The cores that this process may run on, as many of them as its control group's quota is worth."""
    return allowed_cores()[: usable_cores()]
