"""Do one piece of work in a process of its own, in any environment: time it, store its result.

`python -m benchmarks.contest.child CONTESTANT WORK INPUT.npz OUTPUT.npz REPEATS` calls the function
WORK of `benchmarks.contest.with_CONTESTANT` with the arrays of the input file. The function returns
an action without arguments, whose set-up is not timed. After a first call, which compiles, the
action is called REPEATS times. The output file has the arrays that the action returns; the last
line of the output is {"seconds": median processor time, "memory_bytes": peak of the process}.

Only NumPy and the standard library are used: an environment of another program has no more. The
process is bound to one core before NumPy is imported, because libraries count the cores on import.
"""

import importlib
import json
import os
import statistics
import sys
import time
from collections.abc import Callable

if __name__ == "__main__" and hasattr(os, "sched_setaffinity"):  # of Linux
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})

import numpy as np

from benchmarks._harness import resident_bytes

Arrays = dict[str, np.ndarray]


def timed(action: Callable[[], Arrays], repeats: int) -> tuple[Arrays, float]:
    """Return the result of an action, and its median processor time after a first call, s."""
    result, times = action(), []
    for _ in range(repeats):
        start = time.process_time()
        result = action()
        times.append(time.process_time() - start)
    return result, statistics.median(times)


def main(contestant: str, work: str, source: str, target: str, repeats: str) -> None:
    """Do the work; the arguments are those of the command line."""
    module = importlib.import_module(f"benchmarks.contest.with_{contestant}")
    with np.load(source) as file:
        inputs = dict(file)
    result, seconds = timed(getattr(module, work)(inputs), int(repeats))
    np.savez(target, **result)
    figures = {"seconds": seconds, "memory_bytes": resident_bytes("VmHWM")}
    print(json.dumps(figures), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
