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
print([name for name in ours if name.split(".")[1] not in ("sphere", "slepian", "errors", "summary")])
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
