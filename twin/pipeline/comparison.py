"""The same specimens by several methods, each measurement in a result folder of its own.

Everything of one comparison lies in one folder, `NAME/METHOD/` as `twin measure` writes it, and
`result.json` over all. A measurement that lies there finished is not made again.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from reconstruction.errors import InputError
from twin.config import Experiment, digest
from twin.config.methods import METHODS, Method
from twin.output import (
    RESULT_FILE,
    adding,
    claim,
    output_folder,
    read_json,
    versions,
    write_json,
)
from twin.pipeline.instruments import PhotometricPlan, case_for
from twin.pipeline.memory import Memory
from twin.pipeline.methods import measure_into
from twin.pipeline.progress import ProgressCallback, no_progress
from twin.results.figures import Metrics

COMMAND = "compare"
_NAMES = (RESULT_FILE, "report.html", "figures")

Filler = Callable[[Path, Experiment, ProgressCallback, Memory], None]


@dataclass(frozen=True)
class Outcome:
    """One specimen by one method.

    Attributes
    ----------
    name : name of the experiment
    figures : metrics of result.json; empty when it could not be measured
    failure : why it could not, in one line; empty when it was
    reused : the folder held it already
    """

    name: str
    description: str
    method: Method
    digest: str = ""
    figures: Metrics | None = None
    failure: str = ""
    reused: bool = False


def methods_named(text: str) -> tuple[Method, ...]:
    """Read a comma-separated list of methods.

    Raises
    ------
    InputError
        An unknown method, one named twice, or none.
    """
    names = [name.strip() for name in text.split(",")]
    known: dict[str, Method] = {method: method for method in METHODS}
    unknown = [name for name in names if name not in known]
    if unknown or len(set(names)) < len(names):
        raise InputError(
            f"--methods {text}: found {', '.join(unknown) or 'a method twice'}, allowed "
            f"{', '.join(METHODS)}, each once and separated by commas"
        )
    return tuple(known[name] for name in names)


def measure_whole(
    folder: Path, experiment: Experiment, watch: ProgressCallback, memory: Memory
) -> None:
    """Fill a result folder as `twin measure` does, but for its report."""
    measure_into(folder, "measure", experiment, watch, memory)


def compare(
    experiments: Sequence[Experiment],
    methods: Sequence[Method],
    out: Path,
    fill: Filler = measure_whole,
    *,
    watch: ProgressCallback = no_progress,
    plan: PhotometricPlan | None = None,
) -> list[Outcome]:
    """Measure every experiment by every method, into `out`.

    Parameters
    ----------
    experiments : at least one, each with a name of its own
    methods : in the order in which they are shown
    out : folder of the comparison; an earlier one is continued
    fill : measures one experiment into a folder, which becomes visible when it is complete
    watch : progress callback
    plan : sensor and load of photometric stereo; a GelSight Mini under the same force by default

    Returns
    -------
    list of Outcome
        By experiment, then by method. What could not be measured is among them.

    Raises
    ------
    InputError
        Two experiments of one name, or `out` is no comparison or cannot be written.
    MissingBackend
        No usable Dr.Jit backend.
    """
    _refuse_namesakes(experiments)
    claim_comparison(out)
    outcomes = measure_each(experiments, methods, out, fill, watch=watch, plan=plan)
    _write(out, outcomes)
    return outcomes


def claim_comparison(out: Path, inputs: Iterable[Path] = ()) -> None:
    """Make `out` the folder of a comparison, or go on with the one there; see `claim`."""
    claim(out, COMMAND, _NAMES, inputs)


def measure_each(
    experiments: Sequence[Experiment],
    methods: Sequence[Method],
    out: Path,
    fill: Filler = measure_whole,
    *,
    watch: ProgressCallback = no_progress,
    plan: PhotometricPlan | None = None,
    memory: Memory | None = None,
) -> list[Outcome]:
    """Measure as `compare` does, but write nothing except the folders NAME/METHOD.

    All measurements share one memory, so that a sensor is calibrated once.
    """
    run = _Run(out, fill, watch, plan or PhotometricPlan(), memory or Memory())
    return [_outcome(experiment, method, run) for experiment in experiments for method in methods]


def read_outcomes(folder: Path) -> list[Outcome]:
    """Read a finished comparison.

    Raises
    ------
    InputError
        The folder holds none, or its result is damaged.
    """
    result = read_json(folder / RESULT_FILE)
    if result.get("command") != COMMAND:
        raise InputError(f"{folder}: result of command {result.get('command')!r}, no comparison")
    try:
        return [Outcome(**case) for case in result["cases"]]
    except (KeyError, TypeError):
        raise InputError(
            f"{folder / RESULT_FILE}: cases are damaged; run twin compare again"
        ) from None


def is_comparison(folder: Path) -> bool:
    """Return whether a folder holds a finished comparison."""
    path = folder / RESULT_FILE
    return path.is_file() and read_json(path).get("command") == COMMAND


@dataclass(frozen=True)
class _Run:
    """What all measurements of one comparison share; see `compare`."""

    out: Path
    fill: Filler
    watch: ProgressCallback
    plan: PhotometricPlan
    memory: Memory


def _outcome(experiment: Experiment, method: Method, run: _Run) -> Outcome:
    name, told = experiment.name, experiment.description
    folder = run.out / name / method
    try:
        case = case_for(experiment, method, run.plan)
        kept = _finished(folder, case)
        if kept is None:
            with output_folder(folder) as working:
                run.fill(working, case, _labelled(run.watch, f"{name}, {method}"), run.memory)
    except InputError as error:
        line = " ".join(str(error).split())
        return Outcome(name, told, method, failure=line)
    figures = kept or read_json(folder / RESULT_FILE)["metrics"]
    return Outcome(name, told, method, digest(case), figures, reused=kept is not None)


def _finished(folder: Path, case: Experiment) -> Metrics | None:
    """Metrics of the same measurement by the same versions, if the folder holds it."""
    if not (folder / RESULT_FILE).is_file():
        return None
    result = read_json(folder / RESULT_FILE)
    same = result.get("digest") == digest(case) and result.get("versions") == versions()
    figures = result.get("metrics")
    return figures if same and isinstance(figures, dict) else None


def _labelled(watch: ProgressCallback, label: str) -> ProgressCallback:
    return lambda stage, fraction: watch(f"{label}: {stage}", fraction)


def _refuse_namesakes(experiments: Sequence[Experiment]) -> None:
    names = [experiment.name for experiment in experiments]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(
            f"name: found {', '.join(twice)} in more than one experiment; each needs its own, "
            "because results lie under it"
        )


def _write(out: Path, outcomes: list[Outcome]) -> None:
    cases = [
        {
            "name": one.name,
            "description": one.description,
            "method": one.method,
            "digest": one.digest,
            "figures": one.figures,
            "failure": one.failure,
        }
        for one in outcomes
    ]
    content = {"command": COMMAND, "cases": cases, "versions": versions()}
    with adding(out, RESULT_FILE) as folder:
        write_json(folder / RESULT_FILE, {"schema_version": 1, **content})
