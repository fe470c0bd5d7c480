"""How many threads may run side by side here: programs that share a machine agree on it."""

import os

VARIABLE = "NUMBA_NUM_THREADS"
"""Environment variable that limits the threads of this process, as it limits Numba's."""


def threads() -> int:
    """Return the number of cores that this process may use, or less where VARIABLE says so."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    told = os.environ.get(VARIABLE, "")
    return max(1, min(cores or 1, int(told) if told.isdecimal() else cores or 1))
