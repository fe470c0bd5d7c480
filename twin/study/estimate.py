"""Estimate of run time and disk space of a study before it runs."""

import math
import shutil
from dataclasses import dataclass

from reconstruction.errors import counted
from twin.config import Experiment
from twin.config.board import load_board
from twin.config.study import Study
from twin.mechanics.choice import possible_models
from twin.mechanics.models import PressInput
from twin.optics.light import pattern_set
from twin.study.cases import Cases
from twin.study.measuring import CALIBRATION_FILE
from twin.study.record import StudyRecord
from twin.study.store import Store
from twin.study.trials import drawn_board

# Measured on two cores of 2.5 GHz. Most of the time is needed for the camera noise, then for
# loading a pressed face.
_SECONDS_PER_FRAME_PIXEL = 9e-8
_SECONDS_PER_CASE = 0.3
_SECONDS_PER_PRESS, _SECONDS_PER_SHEET = 3.0, 20.0
_BYTES_PER_CASE = 24_000
_BYTES_PER_PIXEL = {"points": 160, "capture": 0, "press": 0}
_BYTES_PER_FRAME_PIXEL = 2
_PRESS_BYTES = 80_000_000


@dataclass(frozen=True)
class Estimate:
    """Estimated run time and disk space of a run.

    They are right within a factor of two for slabs and sheets, and worse for solids.

    Attributes
    ----------
    cases : number of different cases of the study
    known : number of cases that are already in the store
    excluded : number of cases that constraints exclude
    seconds : run time, s
    disk_bytes : disk space of the new cases, bytes
    free_bytes : free space on the disk of the store, bytes
    step : 1 if all cases were examined; n if those of every n-th point were, and the sums were
        scaled
    """

    cases: int
    known: int
    excluded: int
    seconds: float
    disk_bytes: float
    free_bytes: int
    step: int = 1


def estimate(record: StudyRecord, cases: Cases, store: Store, workers: int) -> Estimate:
    """Estimate run time and disk space of the cases that are not yet in the store."""
    known = store.finished() if store.exists() else set()
    unique = cases.unique()
    missing = [case for case in unique if case.digest not in known]
    presses = {_pressing(case.experiment): press_seconds(case.experiment) for case in missing}
    work = sum(_case_seconds(case.experiment) for case in missing) + sum(presses.values())
    folder = next(p for p in (store.folder, *store.folder.parents) if p.exists())
    return Estimate(
        cases=len(unique) * cases.step,
        known=(len(unique) - len(missing)) * cases.step,
        excluded=cases.excluded * cases.step,
        seconds=work * cases.step / workers + _calibration_seconds(record, store),
        disk_bytes=cases.step * sum(_case_bytes(record.study, case.experiment) for case in missing),
        free_bytes=shutil.disk_usage(folder).free,
        step=cases.step,
    )


def _calibration_seconds(record: StudyRecord, store: Store) -> float:
    """Return the time, s, in which one process calibrates the rig for trials.

    It is 0 if trials do not draw rigs, or if the calibration is in the store.
    """
    board = drawn_board(record.study, record.base)
    if not board or (store.folder / CALIBRATION_FILE).is_file():
        return 0.0
    return len(load_board(board).poses) * _case_seconds(record.base)


def _pressing(experiment: Experiment) -> str:
    parts = {"mechanics", "specimen", "elastomer", "press"}
    return experiment.model_dump_json(include=parts)


def press_seconds(experiment: Experiment) -> float:
    """Return the approximate run time of one press of the experiment, s."""
    scene = experiment
    case = PressInput(scene.mechanics, scene.specimen, scene.elastomer, scene.press)
    wraps = any(model.wraps for model in possible_models(case))
    return _SECONDS_PER_SHEET if wraps else _SECONDS_PER_PRESS


def _pixels(experiment: Experiment) -> int:
    camera = experiment.camera
    return (camera.width_px // camera.binning) * (camera.height_px // camera.binning)


def _frame_pixels(experiment: Experiment) -> int:
    frames = len(pattern_set(experiment.projector, experiment.patterns).frames)
    return frames * _pixels(experiment)


def _case_seconds(experiment: Experiment) -> float:
    return _SECONDS_PER_CASE + _frame_pixels(experiment) * _SECONDS_PER_FRAME_PIXEL


def _case_bytes(study: Study, experiment: Experiment) -> float:
    bytes_per_case = _BYTES_PER_CASE
    if "points" in study.keep:
        bytes_per_case += _BYTES_PER_PIXEL["points"] * _pixels(experiment)
    if "capture" in study.keep:
        bytes_per_case += _BYTES_PER_FRAME_PIXEL * _frame_pixels(experiment)
    return bytes_per_case + (_PRESS_BYTES if "press" in study.keep else 0)


def estimate_line(estimated: Estimate) -> str:
    """Return an estimate as one line of text."""
    preview = f"about {counted(estimated.cases, 'case')}, from one point in {estimated.step}"
    parts = [counted(estimated.cases, "case") if estimated.step == 1 else preview]
    if estimated.excluded:
        parts.append(f"{estimated.excluded} more excluded by constraints")
    if estimated.known:
        parts.append(f"{estimated.known} of them in the store")
    parts.append(f"about {duration(estimated.seconds)}")
    parts.append(f"{_size(estimated.disk_bytes)} of {_size(estimated.free_bytes)} free disk")
    return ", ".join(parts)


def duration(seconds: float) -> str:
    """Return a time as text with the unit s, min or h."""
    if seconds < 90:
        return f"{math.ceil(seconds)} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _size(count: float) -> str:
    for unit, size in (("GB", 1e9), ("MB", 1e6)):
        if count >= size:
            return f"{count / size:.1f} {unit}"
    return f"{count / 1e3:.0f} kB"
