"""The same specimens by several methods, each measurement in a result folder of its own.

Everything of one comparison lies in one folder, `NAME/METHOD/` as `twin measure` writes it, and
`result.json` over all. A measurement that lies there finished is not made again.

Fringes are projected by the experiment's own rig. Photometric stereo is another sensor with another
gel: specimen, scoring and load of the experiment are carried over to a rig of its own. The load is
the force by default, as two sensors on one press would feel it. The same depth is another
comparison: a gel bonded to a window resists far more than a free sheet.
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
    alone_in,
    claim,
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

# Digits kept of a force that was computed: the last ones of the finite-element model vary.
_FORCE_DIGITS = 4
# Not the seed: all specimens meet one sensor, whose noise and reference presses are the rig's.
_CARRIED = ("name", "description", "specimen", "stage", "score")
_LOAD = ("control", "depth_mm", "force_n")
_DRAWN = ("z_rmse_um", "completeness", "object_rms_um")
"""Figures that a notebook shows."""


@dataclass(frozen=True)
class PhotometricPlan:
    """Which sensor stands for photometric stereo, and what its press has in common.

    Attributes
    ----------
    rig : TOML file without specimen, or the name of a shipped rig
    settings : values by dotted path laid over the rig
    match : what both presses share: force (N) or depth (mm)
    """

    rig: str = "rigs/gelsight_mini"
    settings: Mapping[str, Any] = field(default_factory=dict)
    match: Match = "force"


def case_for(experiment: Experiment, method: Method, plan: PhotometricPlan) -> Experiment:
    """Return the experiment as `method` measures it.

    An experiment that brings lamps of its own is a photometric rig already and stays as it is.

    Raises
    ------
    InputError : the rig cannot be used, or the experiment's own press fails
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
        path: one
        for path, one in rig.provenance.items()
        if path.partition(".")[0] not in _CARRIED and path.removeprefix("press.") not in _LOAD
    }
    ours = {
        path: one
        for path, one in experiment.provenance.items()
        if path.partition(".")[0] in _CARRIED
    }
    kept = {path: one.model_dump() for path, one in (theirs | ours | origin).items()}
    return validate_experiment(tree | {"provenance": kept}, where=experiment.name)


def _load(
    experiment: Experiment, rig: Experiment, match: Match
) -> tuple[Press, dict[str, Provenance]]:
    """Return the press of the rig under the experiment's load, and where the load comes from."""
    pitches = rig.press.model_dump(include={"solver_pitch_mm", "relief_pitch_mm"})
    own = experiment.press
    if match == own.control:
        press = Press(control=match, depth_mm=own.depth_mm, force_n=own.force_n, **pitches)
        name = "press.force_n" if match == "force" else "press.depth_mm"
        found = experiment.provenance.get(name)
        return press, {name: found} if found else {}
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


@dataclass(frozen=True)
class Comparison(Sequence[Outcome]):
    """Specimens by methods, by experiment, then by method; also those that failed."""

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
        """Return error and share of points, or the failure, of each measurement as texts."""
        return {f"{one.name}, {one.method}": _in_short(one) for one in self.outcomes}

    def plot(self) -> "Drawing":
        """Draw errors and share of points by specimen and method: a Matplotlib figure."""
        return draw_rows(self._rows(), "specimen", _DRAWN, by="method")

    def to_xarray(self) -> "xarray.Dataset":
        """Return specimen, method, failure and all figures, along `case`; NaN where none is."""
        rows = self._rows()
        names = dict.fromkeys(name for row in rows for name in row)
        return rows_as_arrays(rows, [*names]).to_xarray()

    def _rows(self) -> list[Mapping[str, Any]]:
        return [
            {"specimen": one.name, "method": one.method, "failure": one.failure}
            | dict(one.figures or {})
            for one in self.outcomes
        ]


def _in_short(outcome: Outcome) -> str:
    if outcome.failure:
        return outcome.failure
    figures = Figures(outcome.figures or {})
    rmse_um, share = figures.get("z_rmse_um"), figures.get("completeness")
    error = "no error of z" if rmse_um is None else f"error of z {rmse_um:.3g} um RMS"
    return error if share is None else f"{error}, points on {100 * share:.1f} %"


def methods_named(text: str) -> tuple[Method, ...]:
    """Read a comma-separated list of methods.

    Raises
    ------
    InputError : an unknown method, one named twice, or none
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
    inputs: Iterable[Path] = (),
) -> Comparison:
    """Measure every experiment by every method, into `out`.

    All measurements share one memory, so that a sensor is calibrated once.

    Parameters
    ----------
    experiments : at least one, each with a name of its own
    methods : in the order in which they are shown
    out : folder of the comparison; an earlier one is continued
    fill : measures one experiment into a folder, which becomes visible when it is complete
    plan : sensor and load of photometric stereo; a GelSight Mini under the same force by default
    inputs : files that `out` must not hold, see `claim`

    Returns
    -------
    Comparison
        By experiment, then by method. Measurements that failed are among them.

    Raises
    ------
    InputError : two experiments of one name, or `out` is no comparison or cannot be written
    MissingBackend : no usable Dr.Jit backend
    """
    _refuse_namesakes(experiments)
    claim(out, COMMAND, _NAMES, inputs)
    run = _Run(out, fill, watch, plan or PhotometricPlan(), Memory())
    with alone_in(out):
        found = [_outcome(one, method, run) for one in experiments for method in methods]
        _write(out, found)
    return Comparison(tuple(found))


def read_outcomes(folder: Path) -> Comparison:
    """Read a finished comparison.

    Raises
    ------
    InputError : the folder holds none, or its result is damaged
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
    """Return whether a folder holds a finished comparison."""
    path = folder / RESULT_FILE
    return is_regular(path) and read_json(path).get("command") == COMMAND


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

    def watch(stage: str, fraction: float, /) -> None:
        run.watch(f"{name}, {method}: {stage}", fraction)

    try:
        case = case_for(experiment, method, run.plan)
        kept = _finished(folder, case)
        if kept is None:
            with output_folder(folder) as working:
                run.fill(working, case, watch, run.memory)
    except InputError as error:
        line = " ".join(str(error).split())
        return Outcome(name, told, method, failure=line)
    figures = kept or read_json(folder / RESULT_FILE)["metrics"]
    return Outcome(name, told, method, digest(case), figures, reused=kept is not None)


def _finished(folder: Path, case: Experiment) -> Metrics | None:
    """Metrics of the same measurement by the same versions, if the folder holds it."""
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
    cases = [{k: v for k, v in asdict(one).items() if k != "reused"} for one in outcomes]
    content = {"command": COMMAND, "cases": cases, "versions": versions()}
    with adding(out, RESULT_FILE) as folder:
        write_json(folder / RESULT_FILE, {"schema_version": 1, **content})
