"""Measure specimens by several methods, and write each measurement into its own result folder.

A comparison is one folder. The measurement of experiment NAME by METHOD is in `NAME/METHOD/`, in
the format of `twin measure`; `result.json` has the figures of all measurements. Finished
measurements in the folder are not repeated.

For methods with fringes the rig is that of the experiment. Photometric stereo needs a different
sensor with a different gel, so specimen, scoring and load of the experiment are copied to a
photometric rig. By default both presses have the same force. They may have the same depth instead;
then the forces differ, because a gel bonded to a window is far stiffer than a free sheet.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, overload

from reconstruction.errors import InputError
from reconstruction.reading import is_regular, read_json
from twin.config import Experiment, digest, load_experiment, vary
from twin.config.loading import by_method, validate_experiment
from twin.config.methods import METHODS, TRAITS, Method
from twin.config.models import Press, Provenance
from twin.config.schema import validated
from twin.output import (
    RESULT_FILE,
    adding,
    claimed,
    output_folder,
    versions,
    write_json,
)
from twin.pipeline.memory import Memory
from twin.pipeline.methods import measure_into
from twin.pipeline.press import press_specimen
from twin.pipeline.progress import ProgressCallback, no_progress
from twin.results.figures import Figures, Metrics
from twin.results.rows import draw_rows, rows_as_arrays

if TYPE_CHECKING:
    import xarray

    from reconstruction.drawing import Drawing

Match = Literal["force", "depth"]

# Significant digits of a computed force: further digits of the finite-element model vary.
_FORCE_DIGITS = 4
# Fields copied to the photometric rig. The seed is not copied: one sensor measures all specimens,
# with the noise and the reference presses of the rig.
_CARRIED = ("name", "description", "specimen", "stage", "score")
_LOAD = ("control", "depth_mm", "force_n")
_DRAWN = ("z_rmse_um", "completeness", "object_rms_um")
"""Figures that `Comparison.plot` draws."""


@dataclass(frozen=True)
class PhotometricPlan:
    """Sensor with which a comparison represents photometric stereo, and its load.

    Attributes
    ----------
    rig : TOML file without specimen, or the name of a shipped rig
    settings : values by dotted path that replace those of the rig
    match : quantity that is equal to that of the experiment's own press: force (N) or depth (mm)
    """

    rig: str = "rigs/gelsight_mini"
    settings: Mapping[str, Any] = field(default_factory=dict)
    match: Match = "force"


def case_for(experiment: Experiment, method: Method, plan: PhotometricPlan) -> Experiment:
    """Return the experiment with which a comparison measures a specimen by one method.

    For photometric stereo it is the photometric rig with specimen, scoring and load of
    `experiment`. An experiment with lamps has a photometric rig already, which is used.

    Raises
    ------
    InputError : the photometric rig cannot be used, or the experiment's own press fails
    """
    if TRAITS[method].fringes or experiment.lamps:
        return vary(experiment, by_method(method))
    return _carried_over(experiment, _rig(plan), plan.match)


def _rig(plan: PhotometricPlan) -> Experiment:
    stand_in = {"name": "rig", "specimen": {"kind": "flat"}}
    try:
        rig = load_experiment(plan.rig, stand_in | dict(plan.settings))
    except InputError as error:
        raise InputError(f"photometric rig: {error}") from None
    if rig.method.fringes:
        raise InputError(
            f"{plan.rig}: modality: found '{rig.modality}', allowed 'photometric_stereo' for the "
            "photometric rig"
        )
    return rig


def _carried_over(experiment: Experiment, rig: Experiment, match: Match) -> Experiment:
    press, origin = _load(experiment, rig, match)
    tree = rig.model_dump(mode="python", exclude={"provenance"})
    tree |= experiment.model_dump(mode="python", include=set(_CARRIED))
    tree["press"] = press.model_dump(mode="python")
    theirs = {
        path: source
        for path, source in rig.provenance.items()
        if path.partition(".")[0] not in _CARRIED and path.removeprefix("press.") not in _LOAD
    }
    ours = {
        path: source
        for path, source in experiment.provenance.items()
        if path.partition(".")[0] in _CARRIED
    }
    provenance = {path: source.model_dump() for path, source in (theirs | ours | origin).items()}
    return validate_experiment(tree | {"provenance": provenance}, where=experiment.name)


def _load(
    experiment: Experiment, rig: Experiment, match: Match
) -> tuple[Press, dict[str, Provenance]]:
    """Return the press settings of the photometric rig, and the provenance of the load.

    The load has the force or depth, see `match`, of the experiment's own press, which is computed
    if it is not stated.
    """
    pitches = rig.press.model_dump(include={"solver_pitch_mm", "relief_pitch_mm"})
    own = experiment.press
    if match == own.control:
        press = Press(control=match, depth_mm=own.depth_mm, force_n=own.force_n, **pitches)
        name = "press.force_n" if match == "force" else "press.depth_mm"
        source = experiment.provenance.get(name)
        return press, {name: source} if source else {}
    pressed = press_specimen(experiment)
    why = f"computed: the press of the same specimen into {_gel(experiment)}"
    if match == "force":
        force_n = float(f"{pressed.force_n:.{_FORCE_DIGITS}g}")
        press = validated(Press, {"control": "force", "force_n": force_n} | pitches, "press.")
        return press, {"press.force_n": Provenance(source=f"{why}, {own.depth_mm:g} mm deep")}
    depth_mm = float(f"{pressed.depth_mm:.{_FORCE_DIGITS}g}")
    press = validated(Press, {"control": "depth", "depth_mm": depth_mm} | pitches, "press.")
    return press, {"press.depth_mm": Provenance(source=f"{why} with {own.force_n:g} N")}


def _gel(experiment: Experiment) -> str:
    slab = experiment.elastomer
    return f"the experiment's own elastomer ({slab.thickness_mm:g} mm, {slab.layout})"


COMMAND = "compare"
_NAMES = (RESULT_FILE, "report.html", "figures")

Filler = Callable[[Path, Experiment, ProgressCallback, Memory], None]


@dataclass(frozen=True)
class Outcome:
    """Result of measuring one specimen by one method.

    Attributes
    ----------
    name, description : those of the experiment
    method : method of the measurement
    digest : hash of the experiment that was measured; empty if it could not be measured
    figures : metrics of result.json; None if the specimen could not be measured
    failure : reason why it could not be measured, in one line; empty if it was measured
    reused : True if the folder already contained the finished measurement
    """

    name: str
    description: str
    method: Method
    digest: str = ""
    figures: Metrics | None = None
    failure: str = ""
    reused: bool = False


@dataclass(frozen=True)
class Comparison(Sequence[Outcome]):
    """Results of a comparison, including failed measurements.

    They are ordered by experiment, then by method.
    """

    outcomes: tuple[Outcome, ...]

    @overload
    def __getitem__(self, at: int) -> Outcome: ...
    @overload
    def __getitem__(self, at: slice) -> tuple[Outcome, ...]: ...
    def __getitem__(self, at: int | slice) -> Outcome | tuple[Outcome, ...]:
        return self.outcomes[at]

    def __len__(self) -> int:
        return len(self.outcomes)

    def __repr__(self) -> str:
        shown = "; ".join(f"{name}: {value}" for name, value in self._in_short().items())
        return f"<Comparison: {shown}>"

    def _repr_html_(self) -> str:
        from reconstruction.drawing import as_html

        return as_html("comparison", self._in_short(), self.plot())

    def _in_short(self) -> dict[str, str]:
        """Return RMS error and share of points of each measurement, or its failure, as texts."""
        return {f"{each.name}, {each.method}": _in_short(each) for each in self.outcomes}

    def plot(self) -> "Drawing":
        """Return a figure of RMS errors and completeness by specimen and method."""
        return draw_rows(self._rows(), "specimen", _DRAWN, by="method")

    def to_xarray(self) -> "xarray.Dataset":
        """Return specimen, method, failure and all figures of each measurement, along `case`.

        A figure that a measurement does not have is NaN.
        """
        rows = self._rows()
        names = dict.fromkeys(name for row in rows for name in row)
        return rows_as_arrays(rows, [*names]).to_xarray()

    def _rows(self) -> list[Mapping[str, Any]]:
        return [
            {"specimen": outcome.name, "method": outcome.method, "failure": outcome.failure}
            | dict(outcome.figures or {})
            for outcome in self.outcomes
        ]


def _in_short(outcome: Outcome) -> str:
    if outcome.failure:
        return outcome.failure
    figures = Figures(outcome.figures or {})
    rmse_um, share = figures.get("z_rmse_um"), figures.get("completeness")
    error = "no error of z" if rmse_um is None else f"error of z {rmse_um:.3g} um RMS"
    return error if share is None else f"{error}, points on {100 * share:.1f} %"


def methods_named(text: str) -> tuple[Method, ...]:
    """Return the methods in a comma-separated list.

    Raises
    ------
    InputError : a method is unknown or named twice, or the list is empty
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
    """Measure an experiment, and write the files of `twin measure` into a folder, but no report."""
    measure_into(folder, "measure", experiment, watch, memory)


def compare(
    experiments: Sequence[Experiment],
    methods: Sequence[Method],
    out: Path,
    fill: Filler = measure_whole,
    *,
    watch: ProgressCallback = no_progress,
    plan: PhotometricPlan | None = None,
    inputs: Iterable[Path] = (),
) -> Comparison:
    """Measure every experiment by every method, and write the results to a folder.

    All measurements use one cache of stage results, so that a sensor is calibrated only once.

    Parameters
    ----------
    experiments : at least one experiment; all names must differ
    methods : methods, in the order of the results
    out : folder of the comparison; a comparison that it already contains is continued
    fill : function that measures one experiment into a folder; the folder gets its final name when
        the function has returned
    watch : called with the stage and its finished fraction, 0 to 1
    plan : sensor and load of photometric stereo; None: a GelSight Mini under the same force
    inputs : files that the experiments read; InputError if `out` is one of them or contains one

    Returns
    -------
    Comparison
        Results by experiment, then by method, including failed measurements.

    Raises
    ------
    InputError : two experiments have the same name, or `out` is no comparison or cannot be written
    MissingBackend : there is no usable Dr.Jit backend
    """
    _refuse_namesakes(experiments)
    run = _Run(out, fill, watch, plan or PhotometricPlan(), Memory())
    with claimed(out, COMMAND, _NAMES, inputs):
        outcomes = [
            _outcome(experiment, method, run) for experiment in experiments for method in methods
        ]
        _write(out, outcomes)
    return Comparison(tuple(outcomes))


def read_outcomes(folder: Path) -> Comparison:
    """Return the results of a finished comparison in a folder.

    Raises
    ------
    InputError : the folder contains no finished comparison, or its result.json is damaged
    """
    result = read_json(folder / RESULT_FILE)
    if result.get("command") != COMMAND:
        raise InputError(f"{folder}: result of command {result.get('command')!r}, no comparison")
    try:
        return Comparison(tuple(Outcome(**case) for case in result["cases"]))
    except (KeyError, TypeError):
        raise InputError(
            f"{folder / RESULT_FILE}: cases are damaged; run twin compare again"
        ) from None


def is_comparison(folder: Path) -> bool:
    """Return True if a folder contains a finished comparison."""
    path = folder / RESULT_FILE
    return is_regular(path) and read_json(path).get("command") == COMMAND


@dataclass(frozen=True)
class _Run:
    """Settings common to all measurements of one comparison; see `compare`."""

    out: Path
    fill: Filler
    watch: ProgressCallback
    plan: PhotometricPlan
    memory: Memory


def _outcome(experiment: Experiment, method: Method, run: _Run) -> Outcome:
    name, description = experiment.name, experiment.description
    folder = run.out / name / method

    def watch(stage: str, fraction: float, /) -> None:
        run.watch(f"{name}, {method}: {stage}", fraction)

    try:
        case = case_for(experiment, method, run.plan)
        finished = _finished(folder, case)
        if finished is None:
            with output_folder(folder) as working:
                run.fill(working, case, watch, run.memory)
    except InputError as error:
        line = " ".join(str(error).split())
        return Outcome(name, description, method, failure=line)
    figures = finished or read_json(folder / RESULT_FILE)["metrics"]
    return Outcome(name, description, method, digest(case), figures, reused=finished is not None)


def _finished(folder: Path, case: Experiment) -> Metrics | None:
    """Return the metrics in a result folder; None if it has no result of this case.

    The result must have been computed from an equal experiment by the same software versions.
    """
    if not is_regular(folder / RESULT_FILE):
        return None
    result = read_json(folder / RESULT_FILE)
    same = result.get("digest") == digest(case) and result.get("versions") == versions()
    figures = result.get("metrics")
    return figures if same and isinstance(figures, dict) else None


def _refuse_namesakes(experiments: Sequence[Experiment]) -> None:
    names = [experiment.name for experiment in experiments]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(
            f"name: found {', '.join(twice)} in more than one experiment; each needs its own, "
            "because results lie under it"
        )


def _write(out: Path, outcomes: list[Outcome]) -> None:
    cases = [{k: v for k, v in asdict(outcome).items() if k != "reused"} for outcome in outcomes]
    content = {"command": COMMAND, "cases": cases, "versions": versions()}
    with adding(out, RESULT_FILE) as folder:
        write_json(folder / RESULT_FILE, {"schema_version": 1, **content})
