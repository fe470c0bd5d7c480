"""What a worker does for one case: measure it, sharing stages with the cases before it."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from twin.config import Experiment
from twin.pipeline import Memory, measure
from twin.pipeline.reads import Path as FieldPath
from twin.results.folder import write_kept

Figures = dict[str, Any]
StageReads = tuple[tuple[FieldPath, ...], ...]


@dataclass(frozen=True)
class Answer:
    """What a case gave.

    Attributes
    ----------
    figures : as in result.json of `twin measure`
    write : puts the arrays asked for into the case's folder
    """

    figures: Figures
    write: Callable[[Path], None] = lambda _: None


@dataclass
class CaseMeasurer:
    """Measures case after case; one per process, for it keeps the stages' latest results.

    Attributes
    ----------
    keep : arrays to write per case: "press", "capture", "points"
    """

    keep: tuple[str, ...] = ()
    memory: Memory = field(default_factory=Memory)

    def __call__(self, experiment: Experiment) -> Answer:
        """Measure one case.

        Raises
        ------
        InputError
            Something in the experiment cannot be pressed, rendered or fitted.
        MissingBackend
            No usable Dr.Jit backend.
        """
        done = measure(experiment, memory=self.memory)
        return Answer(done.figures, lambda folder: write_kept(folder, done, self.keep))

    def reads(self) -> StageReads:
        """Fields that each stage looked at for the latest case, first stage first."""
        return tuple(paths for _, _, _, paths in self.memory.stages())
