"""Choose a variant of Mitsuba that works here, and switch to it without surprising the user."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from types import ModuleType
from typing import Any

from slepian_prt.errors import UserError
from slepian_prt.machine.variables import variable_set
from slepian_prt.renderer import llvm
from slepian_prt.renderer.forks import check_not_forked
from slepian_prt.renderer.threads import size_pool_once
from slepian_prt.signals import interrupts_held

# A triangle as well: OptiX traces it by hardware, and the sphere by a program of its own.
_CUDA_PROBE = """
import mitsuba as mi, drjit as dr
mi.set_variant("cuda_ad_rgb")
for shape in ("sphere", "rectangle", "cube"):
    scene = mi.load_dict({"type": "scene", "shape": {"type": shape}})
    assert scene.ray_test(mi.Ray3f(mi.Point3f(0, 0, -3), mi.Vector3f(0, 0, 1)))[0], shape
"""

# What `cuda_failure` says where there is nothing that could work.
NO_DEVICE = "no NVIDIA device"

# Of Linux, and of Linux inside Windows.
_CUDA_DEVICES = ("/dev/nvidiactl", "/dev/dxg")


def usable_variant() -> str:
    """The variant that heavy work runs in: ``SLEPIAN_PRT_VARIANT`` if set, else CUDA if it works, else LLVM.

    Raises
    ------
    UserError
        No LLVM (or CUDA device) that works; the message says how to get one.
    """
    return _usable(os.environ.get("SLEPIAN_PRT_VARIANT", ""), "SLEPIAN_PRT_VARIANT")


@cache
def _usable(wanted: str, name: str) -> str:
    """A variant for heavy work that works here: the one wanted, or the best where that is "".

    ``name`` is what it was given as, for messages.
    """
    if not wanted:
        if cuda_works():
            return "cuda_ad_rgb"
        prepare_llvm()
        return "llvm_ad_rgb"
    if wanted.startswith("llvm_"):
        prepare_llvm()  # before Mitsuba is imported, which an LLVM that was named and does not work would kill
    known = [variant for variant in imported_mitsuba().variants() if _is_for_heavy_work(variant)]
    if wanted not in known:
        why = "traces one ray at a time" if wanted.startswith("scalar_") else "is not one that transport is traced in"
        raise UserError(f"{name} must be {' or '.join(known)}: {wanted!r} {why}")
    if wanted.startswith("cuda_") and (failure := cuda_failure()):
        raise UserError(f"{name} must be one that works here, and {wanted} does not ({failure}): use llvm_ad_rgb")
    return wanted


@cache
def cuda_failure() -> str:
    """Why OptiX cannot be used here, in a few words, tried in a child process; "" if it can."""
    if sys.platform == "darwin" or not (sys.platform == "win32" or any(map(os.path.exists, _CUDA_DEVICES))):
        return NO_DEVICE
    try:
        run = subprocess.run([sys.executable, "-c", _CUDA_PROBE], capture_output=True, text=True, timeout=300)
    except subprocess.TimeoutExpired:
        return "OptiX does not answer"
    if run.returncode == 0:
        return ""
    if run.returncode < 0:
        return f"OptiX kills the process, signal {-run.returncode}"
    said = [line.strip() for line in run.stderr.splitlines() if line.strip()]
    return said[-1][:200] if said else f"OptiX ends with exit status {run.returncode}"


def cuda_works() -> bool:
    """Whether a CUDA device is there and OptiX renders on it."""
    return not cuda_failure()


def is_on_device(mi: Any) -> bool:
    """Whether arrays of Mitsuba's variant are on a card, so that what is made of them is best made there.

    Asked for by way of the module, so that tests may have the same done on processors.
    """
    return (mi.variant() or "").startswith("cuda_")


@contextmanager
def chosen_variant(name: str | None) -> Iterator[None]:
    """Heavy work within the block runs in the variant of that name, also in processes that are started; None: any.

    Raises
    ------
    UserError
        A name that is not known, or a variant that is not for many rays in colour, or does not work here.
    """
    if name is None:
        yield
        return
    wanted, mi = _usable(name, "variant"), imported_mitsuba()
    before = mi.variant()
    _set_variant(mi, wanted)
    try:
        with variable_set("SLEPIAN_PRT_VARIANT", name):
            yield
    finally:
        if before:
            mi.set_variant(before)


def prepare_llvm() -> str:
    """Point Dr.Jit to an LLVM library that works; must come before the first use of an LLVM variant."""
    _check_working_folder()
    path, tried = llvm.find()
    if path is None:
        seen = "; ".join(f"{attempt.path} {attempt.failure}" for attempt in tried) or "no libLLVM found"
        raise UserError(f"Mitsuba has no working LLVM ({seen}): {llvm.REMEDY}")
    os.environ["DRJIT_LIBLLVM_PATH"] = path
    llvm.load_neighbours(path)
    return path


@contextmanager
def mitsuba(made_in: str | None = None) -> Iterator[Any]:
    """Mitsuba in a variant for heavy work, for the length of a with-block; the caller's variant comes back after.

    A variant that the user has set and that can trace on many rays at once is kept.

    Parameters
    ----------
    made_in : str, optional
        The variant of objects that are there already, which works in no other.

    Raises
    ------
    UserError
        No LLVM (or CUDA device) that works, or objects of a variant that cannot trace many rays, in colour, at once.
    """
    mi = imported_mitsuba()
    before = mi.variant()
    wanted = made_in or before
    if made_in and not _is_for_heavy_work(made_in):
        raise UserError(
            f"the scene was loaded in the variant {made_in}, and transport is traced in llvm_ad_rgb or cuda_ad_rgb: "
            "load it after mitsuba.set_variant('llvm_ad_rgb')"
        )
    if not wanted or not _is_for_heavy_work(wanted):
        wanted = usable_variant()
    if wanted == before:
        yield mi
        return
    _set_variant(mi, wanted)
    try:
        yield mi
    finally:
        if before:
            mi.set_variant(before)


def _is_for_heavy_work(variant: str) -> bool:
    return variant.startswith(("llvm_", "cuda_")) and variant.endswith("_rgb")


def bitmap_module() -> ModuleType:
    """Mitsuba with some variant set, enough to read and write pictures; needs no LLVM, and no threads but for EXR."""
    mi = _imported()
    if mi.variant() is None:
        _set_variant(mi, "scalar_rgb")
    return mi


def imported_mitsuba() -> ModuleType:
    """Mitsuba, whatever its variant, with LLVM found for those that need it, and no more threads than work may use.

    Raises
    ------
    UserError
        In a process that was forked after Mitsuba was imported.
    """
    check_not_forked()
    return _imported()


def _check_working_folder() -> None:
    """Raise UserError where there is none: Mitsuba asks for it when it is imported, and aborts the process."""
    try:
        os.getcwd()
    except OSError:
        raise UserError("the working folder was removed; change to one that is there") from None


def _imported() -> ModuleType:
    if "mitsuba" not in sys.modules:
        _check_working_folder()
    if "drjit" not in sys.modules and "DRJIT_LIBLLVM_PATH" not in os.environ:
        # Dr.Jit looks for LLVM once, at the first use of any LLVM variant, also one that the user sets later.
        path, _ = llvm.find()
        if path:
            os.environ["DRJIT_LIBLLVM_PATH"] = path
            llvm.load_neighbours(path)
    with interrupts_held():  # half of Dr.Jit is no module, and what meets it aborts the process
        import mitsuba

    size_pool_once()
    return mitsuba


def _set_variant(mi: Any, name: str) -> None:
    """The first use of a variant imports more of Mitsuba, which no signal may cut short."""
    with interrupts_held():
        mi.set_variant(name)
