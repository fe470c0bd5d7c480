"""What a worker does for one case: measure it, sharing stages with the cases before it.

Trials measure with a rig as a calibration would have found it. The calibration of a rig on rendered
board poses states a covariance, from which such rigs are drawn: what differs from the true rig is
what a new calibration adds, not an assumed number.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.calibration.parameters import POSES, RigEstimate, pack, unpack
from reconstruction.pipeline import Reconstruction
from reconstruction.reading import read_json
from reconstruction.rig.calibration import Calibration
from reconstruction.triangulation import triangulate
from twin.config import Experiment, digest
from twin.config.board import load_board
from twin.config.digest import keyed_sequence
from twin.config.sensor_layer import SensorLayer
from twin.mechanics import PressedElastomer
from twin.output import replace_json, versions
from twin.pipeline import Memory, measure
from twin.pipeline.bound import bounds_alone, object_bounds
from twin.pipeline.calibration import calibrate_rendered, calibration_metrics
from twin.pipeline.captures import options_of
from twin.pipeline.compensation import with_compensation
from twin.pipeline.gradients import bound_gradient
from twin.pipeline.memory import Path as FieldPath
from twin.pipeline.press import press
from twin.pipeline.progress import ProgressCallback, no_progress
from twin.results.figures import Metric, Metrics
from twin.results.folder import write_kept
from twin.results.parts import face_figures, write_pressed
from twin.results.record import Measurement
from twin.results.score import metrics, score
from twin.results.under_sheet import SheetCompensation

CALIBRATION_FILE = "calibration.json"


@dataclass(frozen=True)
class RigCovariance:
    """How well a calibration knows a rig; compared and hashed by content.

    Attributes
    ----------
    rows : (24, 24), camera, projector and the motion between them, order of
        `reconstruction.calibration.parameters`
    """

    rows: tuple[tuple[float, ...], ...]

    @classmethod
    def of(cls, rows: Sequence[Sequence[float]] | FloatArray) -> "RigCovariance":
        """Take a covariance, (24, 24)."""
        return cls(tuple(tuple(map(float, row)) for row in rows))

    def draw(self, true: Calibration, seed: int, trial: int) -> Calibration:
        """Return a rig as one calibration found it; trial 0 is the true rig."""
        if not trial:
            return true
        covariance = np.array(self.rows, np.float64)
        rng = np.random.default_rng(keyed_sequence(seed, "calibration", trial))
        step = _correlated(covariance, rng.standard_normal(len(covariance)))
        vector = pack(
            RigEstimate(true.camera, true.projector, true.T_proj_from_cam, np.eye(4)[None])
        )
        vector[:POSES] += step
        found = unpack(vector, true.camera, true.projector)
        # The world hangs on the camera: a calibrated world frame of its own would move every point
        # alike, which no fitted radius or width feels.
        world_from_proj = true.T_world_from_cam @ np.linalg.inv(found.T_proj_from_cam)
        return Calibration(
            found.camera, found.projector, true.T_world_from_cam, world_from_proj, true.layers
        )


def _correlated(covariance: FloatArray, normal: FloatArray) -> FloatArray:
    """Turn independent standard normal numbers into a draw from a covariance, (n,) float."""
    # Through the correlation: radians and pixels differ by nine orders of magnitude in variance.
    sigma = np.sqrt(np.diag(covariance))
    free = sigma > 0
    correlation = covariance[np.ix_(free, free)] / np.outer(sigma[free], sigma[free])
    values, vectors = np.linalg.eigh(correlation)
    step = np.zeros_like(sigma)
    step[free] = sigma[free] * (vectors @ (np.sqrt(np.maximum(values, 0.0)) * normal[free]))
    return step


def calibrated(
    folder: Path, experiment: Experiment, board: str, watch: ProgressCallback = no_progress
) -> RigCovariance:
    """Return how well a calibration on rendered board poses knows the experiment's rig.

    Kept in the folder, with its figures, and taken from there where rig, board and versions are the
    same.

    Raises
    ------
    InputError, MissingBackend : as `calibrate_rendered`
    """
    shown, path = load_board(board), folder / CALIBRATION_FILE
    mark: dict[str, Any] = {
        "digest": f"{digest(experiment)} {shown.model_dump_json()}",
        "versions": versions(),
    }
    kept = read_json(path) if path.is_file() else {}
    if {name: kept.get(name) for name in mark} == mark:
        return RigCovariance.of(kept["covariance"])
    done = calibrate_rendered(experiment, shown, watch=watch)
    rows = done.result.adjustment.covariance[:POSES, :POSES].tolist()
    replace_json(path, mark | {"figures": calibration_metrics(done), "covariance": rows})
    return RigCovariance.of(rows)


def seen_with(done: Measurement, rig: Calibration) -> Measurement:
    """Return a measurement with fringes as it is when its images are triangulated with a rig."""
    images, options = done.fringes, options_of(done.experiment.decode)
    decoded = images.reconstruction.decoded
    maps = Reconstruction(decoded, triangulate(decoded, rig, options.use, options.tolerance))
    scored = score(done.experiment, maps, done.truth)
    return replace(
        done,
        images=replace(images, reconstruction=maps),
        score=scored,
        metrics={**done.metrics, **metrics(scored)},
        compensation=_compensation_of(done, maps),
    ).with_object()


def _compensation_of(done: Measurement, maps: Reconstruction) -> SheetCompensation | None:
    before = done.compensation
    return before and replace(before, points=maps.point_map)


StageReads = tuple[tuple[FieldPath, ...], ...]
MoreFigures = Callable[[Measurement], Metrics]
FurtherFiles = Callable[[Measurement], Callable[[Path], None]]

TRUE_RIG = "true_rig_"
"""What figures begin with that were measured on the same images with the true rig."""


@dataclass(frozen=True)
class Conditions:
    """How a case is measured, beside what its experiment says.

    Attributes
    ----------
    trial : repetition, which keys the noise of the camera and the draw of a rig
    board : what the calibration rests on from which the rig is drawn; empty: the true rig
    seed : of the drawn rigs
    face_only : press, and evaluate the coated face itself: no light, noise or calibration
    bound : "beside": also how well each dimension can be known; "alone": press, trace and say that,
        without frames, noise and decoding
    derivatives : fields by which the bounds are differentiated; figures BOUND_by_FIELD
    layer : what is believed of elastomer and load, by which the object behind the coat is found;
        figures compensated_NAME; None: it is not
    """

    trial: int = 0
    board: str = ""
    seed: int = 0
    face_only: bool = False
    bound: Literal["no", "beside", "alone"] = "no"
    derivatives: tuple[str, ...] = ()
    layer: SensorLayer | None = None


AS_IT_IS = Conditions()


@dataclass(frozen=True)
class Answer:
    """What a case gave.

    Attributes
    ----------
    figures : as in result.json of `twin measure`
    write : puts the arrays asked for into the case's folder
    """

    figures: Metrics
    write: Callable[[Path], None] = lambda _: None


@dataclass
class CaseMeasurer:
    """Measures case after case; one per process, for it keeps the stages' latest results.

    Attributes
    ----------
    keep : arrays to write per case: "press", "capture", "points"
    rigs : from which drawn rigs are drawn
    more : further figures of a measurement
    further : makes further files of a nominal measurement, whose trial is 0; returns what writes
        them
    calibrations : folder in which those of photometric sensors are kept; None: they are not
    """

    keep: tuple[str, ...] = ()
    rigs: RigCovariance | None = None
    more: MoreFigures | None = None
    further: FurtherFiles | None = None
    calibrations: Path | None = None
    memory: Memory = field(default_factory=Memory)
    _asked_before: dict[str, int] = field(default_factory=dict, init=False)

    def __call__(self, experiment: Experiment, conditions: Conditions = AS_IT_IS) -> Answer:
        """Measure one case.

        Raises
        ------
        InputError, MissingBackend : as `twin.pipeline.measure`
        """
        self._asked_before = self.memory.requests()
        self.memory.calibrations = self.calibrations
        if conditions.face_only:
            return Answer(face_figures(experiment, press(experiment, self.memory).pressed))
        if conditions.derivatives:
            return Answer(_with_derivatives(experiment, conditions.derivatives, self.memory))
        if conditions.bound == "alone":
            pressed, found = bounds_alone(experiment, self.memory)
            if conditions.layer:
                found |= object_bounds(experiment, conditions.layer, self.memory)
            return Answer(found, lambda folder: self._write_press(folder, pressed))
        beside = conditions.bound == "beside"
        done = measure(
            experiment,
            memory=self.memory,
            trial=conditions.trial,
            bound=beside,
            layer=conditions.layer,
        )
        rigs = self.rigs
        if conditions.board and rigs is not None and experiment.method.fringes:
            exact = {**metrics(done.score), **done.object.figures, **self._more(done)}
            true = done.fringes.capture.calibration
            done = seen_with(done, rigs.draw(true, conditions.seed, conditions.trial))
            done = _compensated(done, conditions)
            figures = {f"{TRUE_RIG}{name}": value for name, value in exact.items()}
            figures |= {**done.metrics, **self._more(done)}
            return Answer(figures, lambda folder: write_kept(folder, done, self.keep))
        done = _compensated(done, conditions)
        figures = {**done.metrics, **self._more(done)}
        if beside and conditions.layer:
            figures |= object_bounds(experiment, conditions.layer, self.memory)
        return Answer(figures, self._writer(done, conditions))

    def _writer(self, done: Measurement, conditions: Conditions) -> Callable[[Path], None]:
        # What may fail is made now: writing is only about the disk.
        further = self.further if conditions.trial == 0 else None
        write_further = None if further is None else further(done)

        def write(folder: Path) -> None:
            write_kept(folder, done, self.keep)
            if write_further is not None:
                write_further(folder)

        return write

    def _write_press(self, folder: Path, pressed: PressedElastomer) -> None:
        if "press" in self.keep:
            write_pressed(folder, pressed)

    def _more(self, done: Measurement) -> Metrics:
        return {} if self.more is None else self.more(done)

    def reads(self) -> StageReads:
        """Fields that each stage looked at for the latest case, first stage first."""
        before = self._asked_before
        return tuple(
            paths if computed + recalled > before.get(name, 0) else ()
            for name, computed, recalled, paths in self.memory.stages()
        )


def _compensated(done: Measurement, conditions: Conditions) -> Measurement:
    return with_compensation(done, conditions.layer) if conditions.layer else done


def _with_derivatives(
    experiment: Experiment, paths: tuple[str, ...], memory: Memory
) -> dict[str, Metric]:
    figures, slopes = bound_gradient(experiment, paths, memory)
    found = dict(figures)
    for name, values in slopes.items():
        found |= {f"{name}_by_{p}": float(v) for p, v in zip(paths, values, strict=True)}
    return found


@dataclass(frozen=True)
class Measuring:
    """Makes the measurer of a worker; equal ones share it."""

    rigs: RigCovariance | None = None
    more: MoreFigures | None = None
    further: FurtherFiles | None = None
    calibrations: Path | None = None

    def __call__(self, keep: tuple[str, ...]) -> CaseMeasurer:
        """Return a measurer with an empty memory."""
        return CaseMeasurer(keep, self.rigs, self.more, self.further, self.calibrations)


PLAINLY = Measuring()
