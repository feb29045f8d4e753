"""Choose a variant of Mitsuba that works here, and switch to it without surprising the user."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from types import ModuleType
from typing import Any

from slepian_prt.errors import UserError
from slepian_prt.renderer import llvm

_CUDA_PROBE = """
import mitsuba as mi, drjit as dr
mi.set_variant("cuda_ad_rgb")
scene = mi.load_dict({"type": "scene", "shape": {"type": "sphere"}})
assert scene.ray_test(mi.Ray3f(mi.Point3f(0, 0, -3), mi.Vector3f(0, 0, 1)))[0]
"""


@cache
def usable_variant() -> str:
    """The variant that heavy work runs in: ``SLEPIAN_PRT_VARIANT`` if set, else CUDA if it works, else LLVM.

    Raises
    ------
    UserError
        No LLVM (or CUDA device) that works; the message says how to get one.
    """
    wanted = os.environ.get("SLEPIAN_PRT_VARIANT", "")
    if wanted:
        known = [name for name in imported_mitsuba().variants() if re.fullmatch("(llvm|cuda)_.*_rgb", name)]
        if wanted not in known:
            raise UserError(f"SLEPIAN_PRT_VARIANT must be one of {', '.join(known)}, not {wanted!r}")
        if wanted.startswith("llvm"):
            prepare_llvm()
        return wanted
    if cuda_works():
        return "cuda_ad_rgb"
    prepare_llvm()
    return "llvm_ad_rgb"


@cache
def cuda_works() -> bool:
    """Whether a CUDA device is there and OptiX renders on it, tried in a child process."""
    if not os.path.exists("/dev/nvidiactl") and sys.platform != "win32":
        return False
    run = subprocess.run([sys.executable, "-c", _CUDA_PROBE], capture_output=True, timeout=300)
    return run.returncode == 0


def prepare_llvm() -> str:
    """Point Dr.Jit to an LLVM library that works; must come before the first use of an LLVM variant."""
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
    mi.set_variant(wanted)
    try:
        yield mi
    finally:
        if before:
            mi.set_variant(before)


def _is_for_heavy_work(variant: str) -> bool:
    return variant.startswith(("llvm_", "cuda_")) and variant.endswith("_rgb")


def bitmap_module() -> ModuleType:
    """Mitsuba with some variant set, enough to read and write pictures; needs no LLVM."""
    mi = imported_mitsuba()
    if mi.variant() is None:
        mi.set_variant("scalar_rgb")
    return mi


def imported_mitsuba() -> ModuleType:
    """Mitsuba, whatever its variant, with LLVM found for those that need it."""
    if "drjit" not in sys.modules and "DRJIT_LIBLLVM_PATH" not in os.environ:
        # Dr.Jit looks for LLVM once, at the first use of any LLVM variant, also one that the user sets later.
        path, _ = llvm.find()
        if path:
            os.environ["DRJIT_LIBLLVM_PATH"] = path
            llvm.load_neighbours(path)
    import mitsuba

    return mitsuba
