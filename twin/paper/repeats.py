"""Repeat a measurement as its experimenters would, and keep every trial in a small file.

Trial 0 is the nominal one with the true rig. In every other trial the specimen is put back and
pressed anew, the camera's noise is new, and the rig is as one calibration found it.
"""

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.errors import FitError, InputError
from reconstruction.pipeline import Reconstruction, reconstruct
from reconstruction.triangulation import triangulate
from twin.config import Experiment, digest
from twin.output import replace_json, versions
from twin.paper.rig_draws import RigScatter
from twin.paper.rods import SECTION_LENGTH_MM, middle_of, section_of
from twin.paper.scatter import Scatter, draw, drawn_values
from twin.pipeline.fringes import options_of, take
from twin.pipeline.progress import Stopwatch, Watcher, nobody
from twin.results.record import Recording
from twin.results.score import metrics, score
from twin.specimens import shape_of

Figures = dict[str, Any]


@dataclass(frozen=True)
class Trial:
    """One repetition.

    Attributes
    ----------
    number : 0 is the nominal one
    drawn : values of the inputs by dotted path
    figures : what was measured, by names with units
    """

    number: int
    drawn: dict[str, float]
    figures: Figures


@dataclass(frozen=True, eq=False)
class Repeated:
    """What is repeated: an experiment, the spread of its inputs, and how one trial is measured.

    Attributes
    ----------
    name : folder of its trials
    measure : takes the drawn experiment and the number of the trial
    method : names what `measure` does beside the experiment; part of a trial's digest
    """

    name: str
    experiment: Experiment
    scatter: Scatter
    measure: Callable[[Experiment, int], Figures]
    method: str = ""

    def trial(self, folder: Path, number: int) -> Trial:
        """Return one trial; it is taken only if `folder` does not hold it already.

        Raises
        ------
        InputError, MissingBackend
            As `twin.pipeline.take`.
        """
        drawn = draw(self.experiment, self.scatter, number)
        values = drawn_values(self.experiment, self.scatter, number) if number else {}
        path = folder / self.name / f"trial_{number:04d}.json"
        named = f"{digest(drawn)} {self.method} {number}"
        try:
            figures = kept(path, named, partial(self.measure, drawn, number))
        except InputError as error:
            raise InputError(f"{self.name}, trial {number}: {error}") from None
        return Trial(number, values, figures)

    def trials(
        self, folder: Path, numbers: Sequence[int], watch: Watcher = nobody
    ) -> Iterator[Trial]:
        """Yield the trials of these numbers; 0 is the nominal one."""
        for done, number in enumerate(numbers):
            watch(f"trials of {self.name}", done / len(numbers))
            yield self.trial(folder, number)
        watch(f"trials of {self.name}", 1.0)


def kept(path: Path, named: str, compute: Callable[[], Figures]) -> Figures:
    """Return what a file keeps of the same inputs and versions, or compute and keep it."""
    mark = {"digest": named, "versions": versions()}
    if path.is_file():
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
        except ValueError:
            found = {}
        if {key: found.get(key) for key in mark} == mark:
            figures: Figures = found["figures"]
            return figures
    figures = compute()
    path.parent.mkdir(parents=True, exist_ok=True)
    replace_json(path, mark | {"figures": figures})
    return figures


def measure_fringes(rigs: RigScatter, seed: int, experiment: Experiment, trial: int) -> Figures:
    """Measure once; figures with the drawn rig, and under `true_rig_` those with the true one."""
    _, recording = take(experiment, Stopwatch(), trial)
    options = options_of(experiment.decode)
    exact = reconstruct(recording.capture, options)
    figures = {f"true_rig_{name}": v for name, v in evaluate(experiment, exact, recording).items()}
    if not trial:
        return figures | evaluate(experiment, exact, recording)
    found = triangulate(exact.decoded, rigs.draw(seed, trial), options.use, options.tolerance)
    measured = Reconstruction(exact.decoded, found)
    return figures | evaluate(experiment, measured, recording)


def evaluate(experiment: Experiment, measured: Reconstruction, recording: Recording) -> Figures:
    """Return the figures of `twin measure`, and of a rod its width and height."""
    figures = metrics(score(experiment, measured, recording.truth))
    if experiment.specimen.kind == "rods":
        figures |= _rod_figures(experiment, measured, recording)
    return figures


def _rod_figures(experiment: Experiment, measured: Reconstruction, recording: Recording) -> Figures:
    valid = measured.point_map.valid & recording.truth.lit
    found = measured.point_map.points_world_mm[valid]
    true = recording.truth.points_world_mm[valid]
    return rod_width(experiment, found, "") | rod_width(experiment, true, "true_face_")


def rod_width(experiment: Experiment, points_mm: NDArray[Any], prefix: str) -> Figures:
    """Return width and height of a rod's section; nothing, and why, when it has no crest."""
    centre = middle_of(shape_of(experiment.specimen))
    section = section_of(points_mm.astype(np.float64), SECTION_LENGTH_MM, centre)
    try:
        bar = section.width()
    except FitError as error:
        return {f"{prefix}rod_failure": str(error)}
    return {f"{prefix}rod_width_mm": bar.width_mm, f"{prefix}rod_height_mm": bar.height_mm}
