"""Measurement of one case by a worker, which reuses the stage results of earlier cases.

Trials measure with a calibrated rig in place of the true rig. The calibration of the rig on
rendered board poses gives a covariance, from which the calibrated rigs are drawn. Their deviation
from the true rig is therefore the error of a simulated calibration, not an assumed number.
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
from twin.pipeline.board_calibration import calibration_metrics
from twin.pipeline.bound import bounds_alone, object_bounds
from twin.pipeline.calibration import calibrate_rendered
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
    """Covariance of the parameters of a calibrated rig, compared and hashed by content.

    Attributes
    ----------
    rows : (24, 24) covariance of the parameters of camera, projector and the pose of the projector
        relative to the camera, in order and units of `reconstruction.calibration.parameters`
    """

    rows: tuple[tuple[float, ...], ...]

    @classmethod
    def of(cls, rows: Sequence[Sequence[float]] | FloatArray) -> "RigCovariance":
        """Make an instance from the rows of a covariance, (24, 24)."""
        return cls(tuple(tuple(map(float, row)) for row in rows))

    def draw(self, true: Calibration, seed: int, trial: int) -> Calibration:
        """Return the true rig plus a random calibration error, drawn from this covariance.

        Trial 0 has no error. Equal seed and trial give equal errors.
        """
        if not trial:
            return true
        covariance = np.array(self.rows, np.float64)
        rng = np.random.default_rng(keyed_sequence(seed, "calibration", trial))
        step = _correlated(covariance, rng.standard_normal(len(covariance)))
        vector = pack(
            RigEstimate(true.camera, true.projector, true.T_proj_from_cam, np.eye(4)[None])
        )
        vector[:POSES] += step
        estimate = unpack(vector, true.camera, true.projector)
        # The world frame is fixed to the camera: an error of the calibrated world frame would move
        # all points alike, which changes no fitted radius or width.
        world_from_proj = true.T_world_from_cam @ np.linalg.inv(estimate.T_proj_from_cam)
        return Calibration(
            estimate.camera, estimate.projector, true.T_world_from_cam, world_from_proj, true.layers
        )


def _correlated(covariance: FloatArray, normal: FloatArray) -> FloatArray:
    """Return a draw (n,) from a covariance (n, n), given n independent standard normal numbers."""
    # The correlation matrix is decomposed: the variances of radians and pixels differ by a factor
    # of 1e9.
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
    """Calibrate the rig of an experiment on rendered board poses; return the rig's covariance.

    The covariance and the figures of the calibration are stored in the folder. If rig, board and
    versions are unchanged, the stored covariance is returned.

    Raises
    ------
    InputError, MissingBackend : for the reasons of `calibrate_rendered`
    """
    shown, path = load_board(board), folder / CALIBRATION_FILE
    mark: dict[str, Any] = {
        "digest": f"{digest(experiment)} {shown.model_dump_json()}",
        "versions": versions(),
    }
    stored = read_json(path) if path.is_file() else {}
    if {name: stored.get(name) for name in mark} == mark:
        return RigCovariance.of(stored["covariance"])
    done = calibrate_rendered(experiment, shown, watch=watch)
    rows = done.result.adjustment.covariance[:POSES, :POSES].tolist()
    replace_json(path, mark | {"figures": calibration_metrics(done), "covariance": rows})
    return RigCovariance.of(rows)


def retriangulated(done: Measurement, rig: Calibration) -> Measurement:
    """Return a measurement after triangulation of its decoded images with another rig."""
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
"""Prefix of the figures that are evaluated from the same images with the true rig."""


@dataclass(frozen=True)
class Conditions:
    """Conditions of a measurement that are not part of its experiment.

    Attributes
    ----------
    trial : number of the repetition; it seeds the noise of the camera and the draw of a rig
    board : calibration target of the calibration from which the rig is drawn; empty: the true rig
    seed : seed of the drawn rigs
    face_only : True: press, and evaluate the coated face itself, without light, noise or
        calibration
    bound : whether the lower bounds on the uncertainties of dimensions are computed. "no": only
        measure; "beside": measure and compute the bounds; "alone": press, trace rays and compute
        the bounds, without frames, noise and decoding
    derivatives : fields with respect to which the bounds are differentiated; the figures are named
        BOUND_by_FIELD
    layer : assumed elastomer and load for the reconstruction of the object behind the coat, with
        figures named compensated_NAME; None: the object is not reconstructed
    """

    trial: int = 0
    board: str = ""
    seed: int = 0
    face_only: bool = False
    bound: Literal["no", "beside", "alone"] = "no"
    derivatives: tuple[str, ...] = ()
    layer: SensorLayer | None = None


NOMINAL_CONDITIONS = Conditions()


@dataclass(frozen=True)
class CaseResult:
    """Figures and arrays of a measured case.

    Attributes
    ----------
    figures : figures by name, as in `result.json` of `twin measure`
    write : function that writes the requested arrays into the folder of the case
    """

    figures: Metrics
    write: Callable[[Path], None] = lambda _: None


@dataclass
class CaseMeasurer:
    """Measurer of cases; one instance per process, as it caches the latest result of each stage.

    Attributes
    ----------
    keep : names of the arrays to write per case: "press", "capture", "points"
    rigs : covariance from which calibrated rigs are drawn; None: the true rig is used
    more : function that returns further figures of a measurement
    further : function that prepares additional files of a nominal measurement (trial 0) and
        returns a function that writes them
    calibrations : folder that caches the calibrations of photometric sensors; None: no cache
    memory : latest result of each stage
    """

    keep: tuple[str, ...] = ()
    rigs: RigCovariance | None = None
    more: MoreFigures | None = None
    further: FurtherFiles | None = None
    calibrations: Path | None = None
    memory: Memory = field(default_factory=Memory)
    _computed_before: dict[str, int] = field(default_factory=dict, init=False)

    def __call__(
        self, experiment: Experiment, conditions: Conditions = NOMINAL_CONDITIONS
    ) -> CaseResult:
        """Measure one case and return its figures.

        Raises
        ------
        InputError, MissingBackend : for the reasons of `twin.pipeline.measure`
        """
        self._computed_before = self.memory.requests()
        self.memory.calibrations = self.calibrations
        if conditions.face_only:
            return CaseResult(face_figures(experiment, press(experiment, self.memory).pressed))
        if conditions.derivatives:
            return CaseResult(_with_derivatives(experiment, conditions.derivatives, self.memory))
        if conditions.bound == "alone":
            pressed, figures = bounds_alone(experiment, self.memory)
            if conditions.layer:
                figures |= object_bounds(experiment, conditions.layer, self.memory)
            return CaseResult(figures, lambda folder: self._write_press(folder, pressed))
        with_bounds = conditions.bound == "beside"
        done = measure(
            experiment,
            memory=self.memory,
            trial=conditions.trial,
            bound=with_bounds,
            layer=conditions.layer,
        )
        rigs = self.rigs
        if conditions.board and rigs is not None and experiment.method.fringes:
            exact = {**metrics(done.score), **done.object.figures, **self._more(done)}
            true = done.fringes.capture.calibration
            done = retriangulated(done, rigs.draw(true, conditions.seed, conditions.trial))
            done = _compensated(done, conditions)
            figures = {f"{TRUE_RIG}{name}": value for name, value in exact.items()}
            figures |= {**done.metrics, **self._more(done)}
            return CaseResult(figures, lambda folder: write_kept(folder, done, self.keep))
        done = _compensated(done, conditions)
        figures = {**done.metrics, **self._more(done)}
        if with_bounds and conditions.layer:
            figures |= object_bounds(experiment, conditions.layer, self.memory)
        return CaseResult(figures, self._writer(done, conditions))

    def _writer(self, done: Measurement, conditions: Conditions) -> Callable[[Path], None]:
        # The content is computed here, where it may fail; `write` then only accesses the disk.
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
        """Return the field paths that each stage read for the latest case, first stage first."""
        before = self._computed_before
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
    figures_by_name = dict(figures)
    for name, values in slopes.items():
        figures_by_name |= {f"{name}_by_{p}": float(v) for p, v in zip(paths, values, strict=True)}
    return figures_by_name


@dataclass(frozen=True)
class Measuring:
    """Factory of the measurer of a worker; equal factories share one measurer.

    The attributes are those of `CaseMeasurer`.
    """

    rigs: RigCovariance | None = None
    more: MoreFigures | None = None
    further: FurtherFiles | None = None
    calibrations: Path | None = None

    def __call__(self, keep: tuple[str, ...]) -> CaseMeasurer:
        """Return a measurer that writes the arrays named in `keep`, with an empty cache."""
        return CaseMeasurer(keep, self.rigs, self.more, self.further, self.calibrations)


DEFAULT_MEASURING = Measuring()
