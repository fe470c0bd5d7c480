"""The backend is tested in a child process: a crash there does not affect this process."""

import _ctypes
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.endless import not_for_ever
from twin.optics import backend
from twin.optics.backend import (
    CHOICE_VARIABLE,
    LIBRARY_VARIABLE,
    LLVM_VARIANT,
    Backend,
    MissingBackend,
    cache_file,
    find_backend,
    probe,
)
from twin.optics.session import activate

ABORTING = """
import os, sys
sys.stderr.write("LLVM ERROR: Cannot select: 0x55d0: f64 = fminimum 0x55d1, 0x55d2\\n")
sys.stderr.write("  0x55d1: f64 = extract_vector_elt\\n")
sys.stderr.flush()
os.abort()
"""


@pytest.fixture
def llvm_only(monkeypatch, tmp_path):
    """A machine without CUDA, without choices in the environment and with an empty cache."""
    for name in (LIBRARY_VARIABLE, CHOICE_VARIABLE):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(backend, "has_cuda_driver", lambda: False)
    return monkeypatch


@pytest.fixture
def good_library(llvm_only, tmp_path):
    """A library that the (replaced) probe accepts; yields it and the list of the probes made."""
    library = tmp_path / "libLLVM.so.19.1"
    library.write_bytes(b"")
    probes = []

    def accept(variant, path=None):
        probes.append(path)
        return Backend(variant, path, "19.1.7")

    llvm_only.setattr(backend, "probe", accept)
    llvm_only.setattr(backend, "llvm_candidates", lambda: [library])
    return library, probes


def replace_drjit(monkeypatch, folder, source):
    (folder / "drjit.py").write_text(source)
    monkeypatch.setenv("PYTHONPATH", str(folder))


def test_text_file_is_refused(tmp_path):
    bogus = tmp_path / "libLLVM.so.19"
    bogus.write_text("not a library")
    assert "cannot start" in probe(LLVM_VARIANT, str(bogus)).reason


def test_library_that_is_not_llvm_is_refused():
    assert "cannot start" in probe(LLVM_VARIANT, _ctypes.__file__).reason


def test_abort_in_the_child_is_a_refusal(monkeypatch, tmp_path):
    replace_drjit(monkeypatch, tmp_path, ABORTING)
    assert probe(LLVM_VARIANT, "/any").reason == "SIGABRT LLVM ERROR: Cannot select fminimum"


def test_child_that_hangs_is_a_refusal(monkeypatch, tmp_path):
    replace_drjit(monkeypatch, tmp_path, "import time; time.sleep(60)")
    assert probe(LLVM_VARIANT, "/any", timeout_s=1.0).reason == "no answer within 1 s"


def test_missing_system_library_is_reported(monkeypatch, tmp_path):
    words = "libatomic.so.1: cannot open shared object file: No such file or directory"
    replace_drjit(monkeypatch, tmp_path, f"raise ImportError({words!r})")
    with pytest.raises(MissingBackend, match=r"libatomic\.so\.1 is missing: .*libatomic1"):
        probe(LLVM_VARIANT, "/any")


def test_missing_backend_names_the_package_to_install(llvm_only):
    llvm_only.setattr(backend, "llvm_candidates", list)
    with pytest.raises(MissingBackend) as caught:
        find_backend()
    message = str(caught.value)
    assert "no libLLVM found" in message
    assert "apt-get install libllvm19" in message
    assert "\n" not in message


def test_every_refused_library_is_named(llvm_only, tmp_path):
    replace_drjit(llvm_only, tmp_path, ABORTING)
    llvm_only.setattr(backend, "llvm_candidates", lambda: [Path("/x/libLLVM-15.so.1")])
    with pytest.raises(MissingBackend, match=r"libLLVM-15\.so\.1: SIGABRT"):
        find_backend()


def test_named_library_that_does_not_work_is_an_error(llvm_only, tmp_path):
    llvm_only.setenv(LIBRARY_VARIABLE, str(tmp_path / "absent.so"))
    with pytest.raises(MissingBackend, match=r"DRJIT_LIBLLVM_PATH=.*absent\.so does not work"):
        find_backend()


def test_named_library_comes_first(good_library, monkeypatch):
    library, probes = good_library
    named = library.with_name("libLLVM-18.so.1")
    named.write_bytes(b"")
    monkeypatch.setenv(LIBRARY_VARIABLE, str(named))
    assert find_backend().library == str(named)
    assert probes == [str(named)]


def test_unknown_choice_is_an_error(llvm_only):
    llvm_only.setenv(CHOICE_VARIABLE, "vulkan")
    with pytest.raises(MissingBackend, match="TWIN_BACKEND=vulkan is unknown: use llvm or cuda"):
        find_backend()


def test_finding_is_remembered(good_library):
    _, probes = good_library
    assert find_backend() == find_backend()
    assert len(probes) == 1


def test_fresh_probes_again(good_library):
    _, probes = good_library
    find_backend()
    find_backend(fresh=True)
    assert len(probes) == 2


def test_replaced_library_is_probed_again(good_library):
    library, probes = good_library
    find_backend()
    os.utime(library, ns=(1, 1))
    find_backend()
    assert len(probes) == 2


@pytest.mark.parametrize("content", ["", "[1]", '{"a": 1', "null"])
def test_damaged_cache_is_ignored(good_library, content):
    cache_file().parent.mkdir(parents=True)
    cache_file().write_text(content)
    assert find_backend().version == "19.1.7"


def test_a_pipe_in_place_of_the_cache_is_ignored(good_library):
    """It was opened, and waited for its writer."""
    library, _ = good_library
    cache_file().parent.mkdir(parents=True)
    os.mkfifo(cache_file())
    with not_for_ever():
        assert find_backend() == Backend(LLVM_VARIANT, str(library), "19.1.7")
    assert cache_file().is_file()


def test_entry_of_another_form_is_ignored(good_library):
    _, probes = good_library
    find_backend()
    text = cache_file().read_text().replace("variant", "kind")
    cache_file().write_text(text)
    find_backend()
    assert len(probes) == 2


def test_unwritable_cache_is_no_error(good_library):
    cache_file().parent.parent.write_text("a file where the folder should be")
    assert find_backend().version == "19.1.7"


def test_newest_library_comes_first(monkeypatch, tmp_path):
    names = ["libLLVM-15.so.1", "libLLVM.so.19.1", "libLLVM.so.9", "libLLVM-18.so.1"]
    strangers = ["libLLVMSPIRVLib.so.19", "libLLVM-19.a"]
    for name in names + strangers:
        (tmp_path / name).write_bytes(b"")
    (tmp_path / "libLLVM.so").symlink_to("libLLVM.so.19.1")
    monkeypatch.setattr(backend, "_LIBRARY_FOLDERS", (str(tmp_path),))
    monkeypatch.setattr(backend, "_linker_cache", lambda: iter(()))
    result = [path.name for path in backend.llvm_candidates() if path.parent == tmp_path]
    assert result == ["libLLVM.so.19.1", "libLLVM-18.so.1", "libLLVM-15.so.1", "libLLVM.so.9"]


def test_activate_is_idempotent(mi):
    first = activate()
    assert activate() == first
    assert mi.variant() == first.variant


def test_module_does_not_import_mitsuba():
    code = "import sys, twin.optics.backend; sys.exit('mitsuba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
