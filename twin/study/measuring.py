"""What a worker does for one case: measure it, sharing stages with the cases before it."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from twin.config import Experiment
from twin.pipeline import Memory, measure
from twin.pipeline.press import press
from twin.pipeline.reads import Path as FieldPath
from twin.results.face import face_figures
from twin.results.figures import Metrics
from twin.results.folder import write_kept
from twin.results.record import Measurement
from twin.results.score import metrics
from twin.study.rigs import RigCovariance, seen_with

StageReads = tuple[tuple[FieldPath, ...], ...]
MoreFigures = Callable[[Measurement], Metrics]

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
    """

    trial: int = 0
    board: str = ""
    seed: int = 0
    face_only: bool = False


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
    """

    keep: tuple[str, ...] = ()
    rigs: RigCovariance | None = None
    more: MoreFigures | None = None
    memory: Memory = field(default_factory=Memory)

    def __call__(self, experiment: Experiment, conditions: Conditions = AS_IT_IS) -> Answer:
        """Measure one case.

        Raises
        ------
        InputError
            Something in the experiment cannot be pressed, rendered or fitted.
        MissingBackend
            No usable Dr.Jit backend.
        """
        if conditions.face_only:
            return Answer(face_figures(experiment, press(experiment, self.memory).pressed))
        done = measure(experiment, memory=self.memory, trial=conditions.trial)
        figures, rigs = {**done.metrics, **self._more(done)}, self.rigs
        if conditions.board and rigs is not None and experiment.method.fringes:
            exact = {**metrics(done.score), **self._more(done)}
            true = done.fringes.capture.calibration
            done = seen_with(done, rigs.draw(true, conditions.seed, conditions.trial))
            figures = {f"{TRUE_RIG}{name}": value for name, value in exact.items()}
            figures |= {**done.metrics, **self._more(done)}
        return Answer(figures, lambda folder: write_kept(folder, done, self.keep))

    def _more(self, done: Measurement) -> Metrics:
        return {} if self.more is None else self.more(done)

    def reads(self) -> StageReads:
        """Fields that each stage looked at for the latest case, first stage first."""
        return tuple(paths for _, _, _, paths in self.memory.stages())


@dataclass(frozen=True)
class Measuring:
    """Makes the measurer of a worker; equal ones share it."""

    rigs: RigCovariance | None = None
    more: MoreFigures | None = None

    def __call__(self, keep: tuple[str, ...]) -> CaseMeasurer:
        """Return a measurer with an empty memory."""
        return CaseMeasurer(keep, self.rigs, self.more)


PLAINLY = Measuring()
