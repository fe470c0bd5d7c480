"""Fast replacements of a measurement, importable by worker processes."""

import multiprocessing
import os
import signal
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from reconstruction.errors import InputError
from twin.config import digest
from twin.study.engine import Run
from twin.study.index import Index
from twin.study.measuring import NOMINAL_CONDITIONS, CaseResult
from twin.study.record import read_record
from twin.study.store import Store
from twin.study.workers import local_workers

LOG_VARIABLE = "FAKE_LOG"


@dataclass
class Fake:
    """Computes figures from the experiment's numbers; writes each start into a log file."""

    keep: tuple[str, ...] = ()
    seconds: float = 0.004

    def __call__(self, experiment, conditions=NOMINAL_CONDITIONS):
        _log(digest(experiment))
        time.sleep(self.seconds)
        noise = np.random.default_rng(experiment.seed).normal()
        value = experiment.coating.base_albedo * experiment.patterns.period_px + noise
        return CaseResult({"value": value, "period": experiment.patterns.period_px, "warnings": []})

    def reads(self):
        return ((("coating", "base_albedo"),), (("patterns", "period_px"),))


class Meeting(Fake):
    """Ends a case when another process has begun as many as this one."""

    def __call__(self, experiment, conditions=NOMINAL_CONDITIONS):
        _log(os.getpid())
        until = time.monotonic() + 60
        while not _others_have_begun_as_many():
            if time.monotonic() > until:
                raise TimeoutError("no case beside this one")
            time.sleep(0.002)
        return CaseResult({"value": experiment.coating.base_albedo, "warnings": []})


class Failing(Fake):
    """Refuses one albedo, breaks on another, kills its process on a third."""

    def __call__(self, experiment, conditions=NOMINAL_CONDITIONS):
        albedo = experiment.coating.base_albedo
        if albedo == 0.2:
            raise InputError("coating.base_albedo: found 0.2,\nwhich this test refuses")
        if albedo == 0.3:
            raise ZeroDivisionError("broken")
        if albedo == 0.4:
            os.kill(os.getpid(), signal.SIGKILL)
        return super().__call__(experiment, conditions)


def _log(*words):
    if LOG_VARIABLE in os.environ:
        with Path(os.environ[LOG_VARIABLE]).open("a") as file:
            file.write(" ".join(map(str, words)) + "\n")


def _others_have_begun_as_many():
    begun = Counter(Path(os.environ[LOG_VARIABLE]).read_text().split())
    return len(begun) > 1 and min(begun.values()) >= begun[str(os.getpid())]


def run_here(folder, log):
    """Go on with the study of a store in this process; entry point of processes to be killed."""
    os.environ[LOG_VARIABLE] = str(log)
    store = Store(Path(folder))
    store.open()
    cases = read_record(store.folder).cases().unique()
    Run(store, local_workers(1), make_measurer=Fake, done=Index(store).enter)(cases)


class Bowl(Fake):
    """A parabola over albedo and flake roughness, lowest at (0.4, 0.6), and a slope."""

    def __call__(self, experiment, conditions=NOMINAL_CONDITIONS):
        coating = experiment.coating
        bowl = (coating.base_albedo - 0.4) ** 2 + (coating.flake_roughness - 0.6) ** 2
        figures = {"bowl": bowl, "bowl_albedo": coating.base_albedo, "warnings": []}
        return CaseResult(figures | {"slope": coating.flake_roughness})


class Blind(Fake):
    """Measures no point at an albedo of 0.5 and more; else the error is the albedo."""

    def __call__(self, experiment, conditions=NOMINAL_CONDITIONS):
        albedo = experiment.coating.base_albedo
        visible = albedo < 0.5
        return CaseResult(
            {
                "points": 100 if visible else 0,
                "lit_pixels": 100,
                "z_rmse_um": albedo if visible else None,
                "completeness": 1.0 if visible else 0.0,
                "exposure_ms": 1.0 / albedo,
                "unfitted_balls": [],
                "warnings": [],
            }
        )


class Slow(Fake):
    """Takes a minute per case."""

    def __call__(self, experiment, conditions=NOMINAL_CONDITIONS):
        if experiment.coating.base_albedo > 0.1:
            time.sleep(60)
        return super().__call__(experiment, conditions)


def run_slowly(folder, pids):
    """Run a study on a worker process, and report its process id as soon as it computes."""

    def tell(_):
        if not worker_pids:
            worker_pids.extend(process.pid for process in multiprocessing.active_children())
            pids.put(list(worker_pids))

    worker_pids = []
    store = Store(Path(folder))
    cases = read_record(store.folder).cases().unique()
    Run(store, local_workers(1, cores=1), make_measurer=Slow, done=tell)(cases)
