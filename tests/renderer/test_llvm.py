import os
import stat

import pytest

from slepian_prt.cli.machine import examine
from slepian_prt.renderer import llvm
from slepian_prt.renderer.variants import _usable


@pytest.fixture
def memory(tmp_path, monkeypatch):
    """A fresh memory of probes, so that none of the machine's is used."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "slepian_prt" / "llvm.json"


def test_finds_one_that_works():
    path, tried = llvm.find()
    assert path is not None, tried
    assert tried[-1].works


def test_a_library_that_kills_the_process_is_survived(memory, tmp_path, monkeypatch, request):
    """A stand-in for LLVM 15: aborts as soon as it is loaded."""
    source = tmp_path / "killer.c"
    source.write_text("#include <stdlib.h>\n__attribute__((constructor)) static void die(void) { abort(); }\n")
    library = tmp_path / "libLLVM-15.so"
    if os.system(f"cc -shared -fPIC -o {library} {source} 2>/dev/null") != 0:
        pytest.skip("no C compiler to make a library that aborts")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(library))
    monkeypatch.setenv("SLEPIAN_PRT_VARIANT", "llvm_ad_rgb")
    path, tried = llvm.find()
    assert path is None
    _usable.cache_clear()
    request.addfinalizer(_usable.cache_clear)
    assert "kills the process" in tried[0].failure
    findings = {f.subject: f for f in examine() if not f.ok}
    assert "kills the process" in findings["LLVM"].value
    assert "libllvm19" in findings["LLVM"].remedy
    assert not findings["variant"].ok


def test_a_file_that_is_no_library(memory, tmp_path):
    fake = tmp_path / "libLLVM.so"
    fake.write_bytes(b"no library")
    result = llvm.probe(str(fake))
    assert not result.works
    assert llvm.probe(str(tmp_path / "missing.so")).failure == "no such file"


def test_probes_are_remembered_per_file(memory, tmp_path, monkeypatch):
    fake = tmp_path / "libLLVM.so"
    fake.write_bytes(b"no library")
    first = llvm.probe(str(fake))
    assert memory.exists()
    monkeypatch.setattr(llvm, "_try_in_child", lambda path: pytest.fail("asked again"))
    assert llvm.probe(str(fake)) == first
    monkeypatch.setattr(llvm, "_try_in_child", lambda path: "")
    fake.write_bytes(b"another library")
    assert llvm.probe(str(fake)).works


def test_a_home_that_cannot_be_written_does_no_harm(tmp_path, monkeypatch):
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    fake = tmp_path / "libLLVM.so"
    fake.write_bytes(b"no library")
    fake.chmod(stat.S_IRUSR)
    assert not llvm.probe(str(fake)).works


def test_what_is_remembered_goes_to_no_file_that_others_foresee(memory, tmp_path, monkeypatch):
    memory.parent.mkdir(parents=True)
    (tmp_path / "mine").write_text("kept")
    (memory.parent / f"llvm.json.{os.getpid()}").symlink_to(tmp_path / "mine")
    fake = tmp_path / "libLLVM.so"
    fake.write_bytes(b"no library")
    monkeypatch.setattr(llvm, "_try_in_child", lambda path: "")
    assert llvm.probe(str(fake)).works
    assert (tmp_path / "mine").read_text() == "kept"
    assert memory.is_file()
    monkeypatch.setattr(llvm.os, "replace", lambda *_: fail_on(28))
    fake.write_bytes(b"another library")
    assert llvm.probe(str(fake)).works
    assert len(list(memory.parent.iterdir())) == 2


def fail_on(number: int) -> None:
    raise OSError(number, os.strerror(number))


def test_newest_first(monkeypatch):
    assert llvm._version("/usr/lib/x86_64-linux-gnu/libLLVM.so.19.1") == 19
    assert llvm._version("/usr/lib/llvm-22/lib/libLLVM.so.1") == 22
    assert llvm._version("/usr/lib/x86_64-linux-gnu/libLLVM-15.so.1") == 15
