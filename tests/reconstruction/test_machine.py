"""Resources of the machine: freed memory is used again."""

import ctypes
import subprocess
import sys
from pathlib import Path

import pytest

_COUNT = """
import sys
from pathlib import Path
import numpy as np
from reconstruction.machine import keep_freed_memory
if sys.argv[1] == "keep":
    keep_freed_memory()
def faults():
    # proc(5): minflt is field 10, the eighth after the name in brackets
    return int(Path("/proc/self/stat").read_text().rpartition(")")[2].split()[7])
# 40 MB each: more than the C library keeps by itself.
images = [np.ones(5_000_000) for _ in range(5)]
del images
before = faults()
for _ in range(10):
    image = np.ones(5_000_000)
    image = image * 2.0 + image
print(faults() - before)
"""


def _page_faults(how: str) -> int:
    done = subprocess.run(
        [sys.executable, "-c", _COUNT, how], check=True, capture_output=True, text=True
    )
    return int(done.stdout)


@pytest.mark.skipif(
    not hasattr(ctypes.CDLL(None), "mallopt") or not Path("/proc/self/stat").exists(),
    reason="no GNU C library, or no Linux that counts page faults",
)
def test_freed_memory_is_not_zeroed_again():
    """The system gives a page at its first touch: memory that was used before touches none.

    Otherwise thirty arrays of 40 MB fault at least once in 2 MB, the largest pages there are.
    """
    assert _page_faults("keep") < 100
    assert _page_faults("ordinary") > 300
