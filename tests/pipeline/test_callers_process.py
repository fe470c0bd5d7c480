"""Calls do not change the process of their caller, in any thread; simultaneous first calls.

A new process each: the first call imports and starts the renderer.
"""

import json
import subprocess
import sys
from typing import Any

# The caller uses Mitsuba, in another variant, and has settings of its own.
CALLER = """
import gc, json, os, signal, sys, threading, warnings
import cv2, drjit as dr, matplotlib, mitsuba as mi, numba, numpy as np, threadpoolctl
import scipy.sparse, scipy.special  # they enter filters of their own

mi.set_variant("scalar_rgb")
mi.set_log_level(mi.LogLevel.Error)
dr.set_thread_count(3)
dr.set_flag(dr.JitFlag.SymbolicLoops, False)
cv2.setNumThreads(3)
numba.set_num_threads(1)
np.seterr(under="raise")
np.random.seed(5)
gc.set_threshold(600, 9, 9)
warnings.simplefilter("error", EncodingWarning)
signal.signal(signal.SIGTERM, lambda *_: None)

def state():
    return {
        "variant": mi.variant(),
        "log level": str(mi.log_level()),
        "Dr.Jit threads": dr.thread_count(),
        "Dr.Jit flags": [name for name in dir(dr.JitFlag) if name[0].isupper()
                         and dr.flag(getattr(dr.JitFlag, name))],
        "OpenCV threads": cv2.getNumThreads(),
        "Numba threads": numba.get_num_threads(),
        "BLAS threads": [one["num_threads"] for one in threadpoolctl.threadpool_info()][:1],
        "numpy errors": np.geterr(),
        "numpy random": np.random.get_state()[1].tolist(),
        "gc": [gc.isenabled(), *gc.get_threshold()],
        "warnings": repr(warnings.filters),
        "signals": repr([signal.getsignal(number) for number in signal.valid_signals()]),
        "environment": dict(os.environ),
        "folder": os.getcwd(),
        "matplotlib": repr(dict(matplotlib.rcParams)),
        "threads": threading.active_count(),
        "limits": [sys.getrecursionlimit(), sys.getswitchinterval()],
    }

def difference(call):
    before = state()
    try:
        call()
        outcome = "done"
    except Exception as error:
        outcome = type(error).__name__
    after = state()
    return [outcome, {name: repr((before[name], after[name]))[:400] for name in before
                      if before[name] != after[name]}]
"""

BALLS = """
import json, sys, threading, twin
small = {"camera.binning": 4, "camera.width_px": 640, "camera.height_px": 480,
         "patterns.steps": 3, "press.solver_pitch_mm": 0.2, "press.relief_pitch_mm": 0.05}
balls = twin.load_experiment("examples/slab_balls", small)
"""

LEAVING = """
bare = twin.load_experiment("examples/slab_balls", small | {"specimen.x_mm": 50.0})
wall = lambda stage, done: 1 / 0 if stage == "render" and done > 0 else None
json.dump([difference(lambda: twin.measure(balls)),
           difference(lambda: twin.measure(bare)),
           difference(lambda: twin.measure(balls, wall))], sys.stdout)
"""

THREADS = """
found = {}

def measure(name, memory):
    try:
        found[name] = dict(twin.measure(balls, memory=memory).figures)
    except BaseException as error:
        found[name] = repr(error)

shared = twin.Memory()
threads = [threading.Thread(target=measure, args=(name, shared)) for name in ("first", "second")]
[one.start() for one in threads]
[one.join() for one in threads]
measure("after", twin.Memory())
json.dump(found, sys.stdout, default=repr)
"""


def answer_of(script: str) -> Any:
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_a_call_leaves_the_process_as_it_was():
    """A measurement, a press that is rejected, and an error in the middle of rendering."""
    outcomes = answer_of(CALLER + BALLS + LEAVING)
    assert [outcome for outcome, _ in outcomes] == ["done", "PressError", "ZeroDivisionError"]
    assert [changed for _, changed in outcomes] == [{}, {}, {}]


def test_first_measurements_in_two_threads_are_those_of_one():
    """No module is imported before, and both threads share the stages' cache."""
    digests = answer_of(BALLS + THREADS)
    assert isinstance(digests["after"], dict)
    assert digests == dict.fromkeys(digests, digests["after"])
