import errno
import os
import shutil
import subprocess
import sys
import textwrap

import numpy as np

from reconstruction import compiling, errors, kernel_cache, machine, native, reading, sealing
from reconstruction.decoding._decode import decode_band


def test_bands_cover_every_row_once():
    counts = np.zeros(37, int)

    def count(first_row, end_row, step):
        counts[first_row:end_row] += step

    compiling.run_over_rows(count, 37, 3)
    assert np.all(counts == 3)


def test_errors_of_a_band_reach_the_caller():
    def fail(first_row, end_row):
        raise ZeroDivisionError

    try:
        compiling.run_over_rows(fail, 5)
    except ZeroDivisionError:
        return
    raise AssertionError("the error was lost")


def test_a_full_disk_costs_only_the_time_of_the_next_process(monkeypatch):
    """Why: numba would raise, and a measurement end because the disk of its kernels is full."""
    calls = []

    def save(*_):
        calls.append(1)
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("numba.core.caching.IndexDataCacheFile.save", save)

    @compiling.compiled
    def twice(x):
        return 2 * x

    assert twice(2.0) == 4.0
    assert calls


def run_kernel(folder, files, program):
    """Run a program with copies of the compiling modules, which store kernels in `folder`."""
    package = folder / "reconstruction"
    package.mkdir(exist_ok=True)
    (package / "__init__.py").touch()  # or the installed package would win
    for module in (compiling, errors, kernel_cache, machine, native, reading, sealing):
        shutil.copy(module.__file__, package)
    for name, text in (files | {"_outer.py": textwrap.dedent(program)}).items():
        (package / name).parent.mkdir(exist_ok=True)
        (package / name).write_text(text)
    done = subprocess.run(
        [sys.executable, "-B", "-m", "reconstruction._outer"],
        cwd=folder,
        env=os.environ | {"NUMBA_CACHE_DIR": str(folder / "cache")},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return float(done.stdout)


def test_stored_kernels_depend_on_all_kernel_sources(tmp_path):
    """Why: numba itself would keep code into which another module's old function was inlined."""
    cache_file = decode_band._cache._cache_file
    assert cache_file._source_stamp == compiling.SOURCE_DIGEST
    program = """
        from reconstruction.compiling import compiled, inlined
        from reconstruction.rig.sensor import formula
        inner = inlined(formula)
        @compiled
        def outer(x):
            return inner(x)
        if __name__ == "__main__":
            print(outer(1.0))
    """
    for factor in (2, 3):
        files = {"rig/sensor.py": f"def formula(x):\n    return {factor} * x\n"}
        assert run_kernel(tmp_path, files, program) == factor


def test_stored_kernels_may_name_types_that_are_gone(tmp_path):
    """Why: numba reads the names of a kernel's argument types before it looks at the digest."""
    program = """
        from reconstruction.compiling import compiled
        from reconstruction._lines import {name}
        @compiled
        def outer(pair):
            return pair.a + pair.b
        if __name__ == "__main__":
            print(outer({name}(1.0, 2.0)))
    """
    for name in ("Pair", "Couple"):
        pair = f"from collections import namedtuple\n{name} = namedtuple('{name}', 'a b')\n"
        assert run_kernel(tmp_path, {"_lines.py": pair}, program.format(name=name)) == 3.0
