"""Digital twin of a contact fringe-projection sensor: press, render, record, decode, score.

    import twin

    experiment = twin.load_experiment("paper/two_balls")
    harder = twin.vary(experiment, {"elastomer.shore_a": 20})
    done = twin.measure(harder)
    print(done.figures)  # metrics by name, units in the names

A module is imported when one of its names is used. Every result has a one-line `repr`, a table and
a picture in notebooks, `plot()` (a Matplotlib figure) and, where it has arrays, `to_xarray()`. The
package `reconstruction` processes captures, real or rendered.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # for type checkers and editors; a test compares these lines with `NAMES`
    from reconstruction.pipeline import reconstruct as reconstruct
    from reconstruction.registry import load_plugin
    from twin.adoption.adopt import adopt_rig
    from twin.config import Experiment as Experiment
    from twin.config import load_experiment as load_experiment
    from twin.config import vary as vary
    from twin.config.problem import load_problem as load_problem
    from twin.config.study import load_study as load_study
    from twin.identification.run import identify as identify
    from twin.pipeline import Measurement as Measurement
    from twin.pipeline import Memory as Memory
    from twin.pipeline import measure as measure
    from twin.pipeline import render as render
    from twin.pipeline.calibration import calibrate_rig
    from twin.pipeline.comparison import compare as compare
    from twin.pipeline.compensation import compensate as compensate
    from twin.pipeline.compensation import with_compensation as with_compensation
    from twin.pipeline.press import press_specimen
    from twin.propagation.trials import uncertainty as uncertainty
    from twin.study.record import StudyRecord as StudyRecord
    from twin.study.sweep import sweep as sweep

    adopt, calibrate, plugin, press = adopt_rig, calibrate_rig, load_plugin, press_specimen

NAMES = {
    "Experiment": ("twin.config", "sensor, specimen and press as data"),
    "load_experiment": ("twin.config", "an experiment from a file, or a shipped one by its name"),
    "vary": ("twin.config", "an experiment with other values of some keys"),
    "plugin": (
        "reconstruction.registry:load_plugin",
        "loads a Python file that adds kinds of coatings, materials and other parts",
    ),
    "press": (
        "twin.pipeline.press:press_specimen",
        "experiment to `PressedElastomer`: both faces, pressure, force",
    ),
    "render": ("twin.pipeline", "experiment to the light of every frame, and the true surface"),
    "measure": ("twin.pipeline", "experiment to `Measurement`, all stages, by any method"),
    "Measurement": (
        "twin.pipeline",
        "points, sigma, reason, truth, score, images and figures of one measurement",
    ),
    "Memory": ("twin.pipeline", "results of stages that several measurements share"),
    "compensate": (
        "twin.pipeline.compensation",
        "measured points and a layer to the object behind the coat, its contact and force",
    ),
    "with_compensation": (
        "twin.pipeline.compensation",
        "a measurement with figures `compensated_*`, of the object behind the coat",
    ),
    "compare": ("twin.pipeline.comparison", "experiments by several methods, into a folder"),
    "load_study": ("twin.config.study", "a design space as data"),
    "StudyRecord": ("twin.study.record", "a study with the experiment that it varies"),
    "sweep": ("twin.study.sweep", "a study into its store"),
    "load_problem": (
        "twin.config.problem",
        "unknown fields, and measurements that depend on them",
    ),
    "identify": (
        "twin.identification.run",
        "values of unknown fields that agree with measurements",
    ),
    "uncertainty": (
        "twin.propagation.trials",
        "a measurement repeated with varied inputs: coverage intervals, ranked budget",
    ),
    "adopt": (
        "twin.adoption.adopt:adopt_rig",
        "captures of a real rig to its twin: each field with range and source",
    ),
    "calibrate": (
        "twin.pipeline.calibration:calibrate_rig",
        "captures of a board, real or rendered, to camera and projector",
    ),
    "reconstruct": ("reconstruction.pipeline", "a capture to points, sigma and reasons"),
}
"""Public names: module (with the name there, after a colon, if it differs) and meaning.

`__all__`, `help(twin)` and the API page of the documentation are made from this table.
"""

__all__ = [*NAMES]
_TABLE = [f"| `{name}` | {meaning} |" for name, (_, meaning) in NAMES.items()]
__doc__ = "\n".join([__doc__ or "", "| name | meaning |", "|---|---|", *_TABLE, ""])


def __getattr__(name: str) -> Any:
    if name not in NAMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, _, inner = NAMES[name][0].partition(":")
    return getattr(import_module(module), inner or name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
