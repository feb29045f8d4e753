"""Imports point one way, and nothing heavy is imported before it is needed."""

import subprocess
import sys

import pytest


def run(code: str) -> str:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()


@pytest.mark.parametrize("layer", ["sphere", "slepian"])
def test_mathematics_imports_no_renderer(layer):
    code = f"""
import importlib, pkgutil, sys
import slepian_prt.{layer} as package
for module in pkgutil.iter_modules(package.__path__):
    importlib.import_module(f"slepian_prt.{layer}.{{module.name}}")
import slepian_prt
slepian_prt.cap_basis(3, 0.5).functions
print([name for name in sys.modules if name.split(".")[0] in ("mitsuba", "drjit", "trimesh")])
ours = [name for name in sys.modules if name.startswith("slepian_prt.")]
print([name for name in ours if name.split(".")[1] not in ("sphere", "slepian", "errors", "arrays", "summary")])
"""
    assert run(code).splitlines() == ["[]", "[]"]


def test_import_sets_no_variant_and_loads_nothing():
    assert run("import sys, slepian_prt; print('mitsuba' in sys.modules, 'numpy' in sys.modules)") == "False False"


def test_every_public_name_exists():
    import slepian_prt

    for name in slepian_prt.__all__:
        assert getattr(slepian_prt, name) is not None
    assert set(slepian_prt.__all__) <= set(dir(slepian_prt))
    with pytest.raises(AttributeError, match="no_such_name"):
        slepian_prt.no_such_name  # noqa: B018


def test_the_users_variant_comes_back():
    code = """
import slepian_prt as sp
from slepian_prt.renderer.variants import mitsuba
import mitsuba as mi
mi.set_variant("scalar_rgb")
with mitsuba() as inside:
    print(inside.variant())
print(mi.variant())
"""
    inside, after = run(code).splitlines()
    assert inside.startswith(("llvm", "cuda"))
    assert after == "scalar_rgb"


def loaded_by(*command: str) -> set[str]:
    """Modules that are imported when a command of the command line has run."""
    code = f"""
import contextlib, io, sys
from slepian_prt.cli import main
with contextlib.redirect_stdout(io.StringIO()):
    assert main({list(command)!r}) == 0
print(*sys.modules)
"""
    return set(run(code).split())


# What takes longer to import than all that a command does without it; each is imported by what needs it.
HEAVY = {
    "mitsuba",
    "drjit",
    "trimesh",
    "matplotlib",
    "rich.console",
    "PIL",
    "jinja2",
    "networkx",
    "pandas",
}


@pytest.fixture(scope="module")
def transfer_file(tmp_path_factory):
    """A small transfer file, and a map."""
    import numpy as np

    import slepian_prt as sp
    from slepian_prt.renderer.variants import bitmap_module
    from tests.conftest import bumpy

    folder = tmp_path_factory.mktemp("lazy")
    sp.compress(sp.precompute(bumpy(2), bandlimit=2, samples=16), tolerance=0.2).save(folder / "bumpy.prt")
    bitmap_module().Bitmap(np.ones((16, 32, 3), dtype=np.float32)).write(str(folder / "sky.exr"))
    return folder


def test_help_loads_no_numpy():
    assert not loaded_by("--help") & (HEAVY | {"numpy", "scipy"})


def test_what_is_told_of_a_file_needs_no_renderer_and_no_scipy(transfer_file):
    assert not loaded_by("info", str(transfer_file / "bumpy.prt")) & (HEAVY | {"scipy"})


def test_numbers_are_relit_without_a_renderer(transfer_file):
    arguments = [str(transfer_file / "bumpy.prt"), "--environment", str(transfer_file / "sky.exr")]
    loaded = loaded_by("relight", *arguments, "-o", str(transfer_file / "relit.npz"))
    assert not loaded & HEAVY
    assert (transfer_file / "relit.npz").is_file()


def test_the_version_is_that_of_the_installation():
    from importlib.metadata import version

    import slepian_prt

    assert slepian_prt.__version__ == version("slepian_prt")
