"""Which variant of Mitsuba heavy work runs in, chosen by name, by the environment or by what works."""

import os
import subprocess
from types import SimpleNamespace

import click
import pytest
from click.testing import CliRunner

from slepian_prt.cli import machine, main
from slepian_prt.cli.backend import variant_option
from slepian_prt.cli.commands import COMMANDS, cli
from slepian_prt.errors import UserError
from slepian_prt.renderer import variants
from slepian_prt.renderer.variants import chosen_variant, cuda_failure, imported_mitsuba, mitsuba, usable_variant


@pytest.fixture
def fresh(monkeypatch):
    """Nothing of it is remembered, here or afterwards."""

    def forget():
        variants._usable.cache_clear()
        cuda_failure.cache_clear()

    monkeypatch.delenv("SLEPIAN_PRT_VARIANT", raising=False)
    forget()
    yield monkeypatch
    forget()


def probe_ends_with(monkeypatch, returncode, stderr=""):
    """A device file is there, and the child that tries it ends so."""
    monkeypatch.setattr(variants.os.path, "exists", lambda path: path == "/dev/nvidiactl" or os.path.lexists(path))
    run = SimpleNamespace(returncode=returncode, stderr=stderr, stdout="")
    monkeypatch.setattr(variants.subprocess, "run", lambda *_, **__: run)


@pytest.mark.parametrize("name", ["llvm_ad_rbg", "scalar_rgb", "llvm_ad_spectral", "cuda_ad_mono"])
def test_variants_that_transport_is_not_traced_in(name):
    with pytest.raises(UserError, match=r"^variant must be llvm_ad_rgb or cuda_ad_rgb"), chosen_variant(name):
        pass


def test_the_choice_is_kept_for_the_block_and_for_children(fresh):
    fresh.setenv("SLEPIAN_PRT_VARIANT", "cuda_ad_rgb")
    module = imported_mitsuba()
    before = module.variant() or "scalar_rgb"
    module.set_variant("scalar_rgb")
    with chosen_variant("llvm_ad_rgb"):
        assert usable_variant() == "llvm_ad_rgb"
        assert os.environ["SLEPIAN_PRT_VARIANT"] == "llvm_ad_rgb"
        with mitsuba() as mi:
            assert mi.variant() == "llvm_ad_rgb"
    assert os.environ["SLEPIAN_PRT_VARIANT"] == "cuda_ad_rgb"
    assert module.variant() == "scalar_rgb"
    module.set_variant(before)
    fresh.delenv("SLEPIAN_PRT_VARIANT")
    with chosen_variant("llvm_ad_rgb"):
        pass
    assert "SLEPIAN_PRT_VARIANT" not in os.environ


def test_the_environment_is_read_each_time(fresh):
    probe_ends_with(fresh, 0)
    assert usable_variant() == "cuda_ad_rgb"
    fresh.setenv("SLEPIAN_PRT_VARIANT", "llvm_ad_rgb")
    fresh.setattr(variants, "prepare_llvm", lambda: "")
    assert usable_variant() == "llvm_ad_rgb"


@pytest.mark.parametrize(
    ("returncode", "stderr", "told"),
    [
        (1, "Traceback\nRuntimeError: the driver is too old\n\n", "RuntimeError: the driver is too old"),
        (-11, "", "OptiX kills the process, signal 11"),
        (3, "", "OptiX ends with exit status 3"),
    ],
)
def test_a_device_that_does_not_work(returncode, stderr, told, fresh):
    """It is left alone unless it was asked for, and the doctor says why and what may help."""
    probe_ends_with(fresh, returncode, stderr)
    assert cuda_failure() == told
    fresh.setattr(variants, "prepare_llvm", lambda: "")
    assert usable_variant() == "llvm_ad_rgb"
    fresh.setenv("SLEPIAN_PRT_VARIANT", "cuda_ad_rgb")
    with pytest.raises(UserError, match=r"^SLEPIAN_PRT_VARIANT must be one that works here, and cuda_ad_rgb does not"):
        usable_variant()
    fresh.setattr(machine, "_speed", lambda: None)
    found = next(finding for finding in machine.examine()[:-1] if finding.subject == "CUDA")
    assert told in found.value
    assert "driver of version 535" in found.remedy


def test_without_a_device(fresh):
    fresh.setattr(variants.os.path, "exists", lambda _: False)
    fresh.setattr(variants.subprocess, "run", lambda *_, **__: pytest.fail("tried all the same"))
    assert cuda_failure() == "no NVIDIA device"


def test_a_device_that_does_not_answer(fresh):
    def wait(*_, timeout, **__):
        raise subprocess.TimeoutExpired("python", timeout)

    probe_ends_with(fresh, 0)
    fresh.setattr(variants.subprocess, "run", wait)
    assert cuda_failure() == "OptiX does not answer"


@pytest.mark.parametrize(
    ("stdout", "told"),
    [
        ("NVIDIA H100 80GB HBM3, 81559 MiB, 570.86.15\nanother, 1 MiB, 1\n", "81559 MiB, driver 570.86.15"),
        ("No devices were found\n", "a device"),
    ],
)
def test_the_device_by_name(stdout, told, fresh):
    run = SimpleNamespace(returncode=0, stdout=stdout)
    fresh.setattr(machine.subprocess, "run", lambda *_, **__: run)
    assert told in machine._device()


# --- On the command line ---------------------------------------------------------------------------------------------


def test_the_option_is_on_all_commands_that_trace():
    named = {
        name
        for name in COMMANDS
        if any(option.name == "variant" for option in cli.get_command(click.Context(cli), name).params)
    }
    assert named == set(COMMANDS) - {"info", "spectrum"}


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("scalar_rgb", "--variant must be llvm_ad_rgb or cuda_ad_rgb: 'scalar_rgb' traces one ray at a time"),
        ("cuda", "--variant must be llvm_ad_rgb or cuda_ad_rgb: 'cuda' is not one that transport is traced in"),
        ("cuda_ad_rgb", "--variant must be one that works here, and cuda_ad_rgb does not (no NVIDIA device): use"),
    ],
)
def test_one_line_says_what_is_wrong(name, told, fresh, capsys, tmp_path):
    fresh.setattr(variants, "cuda_failure", lambda: "no NVIDIA device")
    assert main(["precompute", "mesh.ply", "-o", str(tmp_path / "a.prt"), "--variant", name]) == 2
    said = capsys.readouterr().err
    assert told in said
    assert said.count("\n") == 1


def test_commands_run_in_the_variant_asked_for(fresh):
    """Which is no longer set afterwards."""
    seen = []

    @click.command()
    @variant_option
    def look():
        seen.append((usable_variant(), os.environ["SLEPIAN_PRT_VARIANT"]))

    assert CliRunner().invoke(look, ["--variant", "llvm_ad_rgb"]).exit_code == 0
    assert seen == [("llvm_ad_rgb", "llvm_ad_rgb")]
    assert "SLEPIAN_PRT_VARIANT" not in os.environ
