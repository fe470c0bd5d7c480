"""Native readers in a child: its data and the reason of a crash are returned."""

import os
import threading

import numpy as np
import pytest
import scipy.io

from reconstruction import native
from reconstruction.errors import CaptureError
from reconstruction.native import read_in_child
from reconstruction.rig.importing import numbers_of


def child_that(tmp_path, monkeypatch, does: str):
    (tmp_path / "child.py").write_text(f"import os, sys\n{does}\n")
    monkeypatch.setattr(native, "_CHILD", tmp_path / "child.py")
    monkeypatch.setattr(native, "LEAST_LIMIT_S", 0.5)
    (tmp_path / "x").touch()


@pytest.mark.parametrize(
    ("does", "message"),
    [
        ("os.kill(os.getpid(), 11)", "HDF5 crashes on it, signal 11"),
        ("os.abort()", "HDF5 crashes on it, signal 6"),
        ("print('two\\nlines'); sys.exit(1)", "two lines"),
        ("sys.exit(1)", "it cannot be read"),
    ],
)
def test_the_end_of_a_child_is_one_line(tmp_path, monkeypatch, does, message):
    child_that(tmp_path, monkeypatch, does)
    with pytest.raises(OSError, match=rf"x: is damaged \({message}\)$") as caught:
        read_in_child("HDF5", tmp_path / "x")
    assert "\n" not in str(caught.value)


def test_numbers_of_matlab_are_read_by_the_child_only(tmp_path, monkeypatch):
    """SciPy's reader crashes on some damaged files."""
    values = {"om": np.array([[0.1, -0.2, 1e-300]]), "s": {"n": 3, "word": "abc", "t": [1.5, 2.0]}}
    scipy.io.savemat(tmp_path / "x.mat", values)
    monkeypatch.setattr(scipy.io, "loadmat", lambda *_, **__: pytest.fail("read here"))
    result = numbers_of(tmp_path / "x.mat")
    assert sorted(result) == ["om", "s/n", "s/t"]
    np.testing.assert_array_equal(result["om"].ravel(), [0.1, -0.2, 1e-300])
    np.testing.assert_array_equal(result["s/t"], [1.5, 2.0])


def test_a_truncated_matlab_file_raises_an_error(tmp_path):
    scipy.io.savemat(tmp_path / "x.mat", {"om": np.ones((50, 3))})
    whole = (tmp_path / "x.mat").read_bytes()
    (tmp_path / "x.mat").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(CaptureError, match=r"x\.mat: is no MATLAB file: .*is damaged") as caught:
        numbers_of(tmp_path / "x.mat")
    assert "\n" not in str(caught.value)


def test_output_of_a_library_is_discarded_and_ours_is_not(capfd):
    """Blocks of several threads overlap; native code writes to the streams themselves."""
    together = threading.Barrier(4)

    def read() -> None:
        with native.quiet():
            together.wait()
            os.write(1, b"native")
            os.write(2, b"native")
            print("binding")
            together.wait()

    threads = [threading.Thread(target=read) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    print("ours")
    os.write(2, b"ours, too")
    assert capfd.readouterr() == ("ours\n", "ours, too")


def test_an_error_inside_passes_and_the_streams_come_back(capfd):
    with pytest.raises(ValueError, match="message"), native.quiet():
        raise ValueError("message")
    os.write(1, b"back")
    assert capfd.readouterr().out == "back"
