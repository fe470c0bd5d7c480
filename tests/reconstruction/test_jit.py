import os
import shutil
import subprocess
import sys
import textwrap

import numpy as np

from reconstruction import _jit, cores
from reconstruction.decoding._decode import decode_rows


def test_bands_cover_every_row_once():
    counts = np.zeros(37, int)

    def count(first_row, end_row, step):
        counts[first_row:end_row] += step

    _jit.run_over_rows(count, 37, 3)
    assert np.all(counts == 3)


def test_errors_of_a_band_reach_the_caller():
    def fail(first_row, end_row):
        raise ZeroDivisionError

    try:
        _jit.run_over_rows(fail, 5)
    except ZeroDivisionError:
        return
    raise AssertionError("the error was lost")


def test_stored_kernels_depend_on_all_kernel_sources(tmp_path):
    """Why: numba itself would keep code into which another module's old function was inlined."""
    cache_file = decode_rows._cache._cache_file
    assert cache_file._source_stamp == _jit.SOURCE_DIGEST
    folder = tmp_path / "reconstruction"
    (folder / "rig").mkdir(parents=True)
    (folder / "__init__.py").touch()  # or the installed package would win
    program = """
        from reconstruction._jit import compiled, inlined
        from reconstruction.rig.sensor import formula
        inner = inlined(formula)
        @compiled
        def outer(x):
            return inner(x)
        if __name__ == "__main__":
            print(outer(1.0))
    """
    for module in (_jit, cores):
        shutil.copy(module.__file__, folder)
    (folder / "_outer.py").write_text(textwrap.dedent(program))
    printed = []
    for factor in (2, 3):
        (folder / "rig" / "sensor.py").write_text(f"def formula(x):\n    return {factor} * x\n")
        done = subprocess.run(
            [sys.executable, "-B", "-m", "reconstruction._outer"],
            cwd=tmp_path,
            env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")},
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr
        printed.append(float(done.stdout))
    assert printed == [2.0, 3.0]
