"""Digital twin of a contact fringe-projection sensor: press, render, record, decode, score.

    import twin

    experiment = twin.load_experiment("paper/two_balls")
    harder = twin.vary(experiment, {"elastomer.shore_a": 20})
    done = twin.measure(harder)
    print(done.figures)  # metrics by name, units in the names

| name | what it is |
|---|---|
| `Experiment`, `load_experiment`, `vary` | sensor, specimen, press as data: read, changed |
| `press` | experiment to `PressedElastomer`: both faces, pressure, force |
| `render` | experiment to the light of every frame, and the truth behind it |
| `measure` | experiment to `Measurement`, the whole way by any method; `Memory` shares stages |
| `Measurement` | points, sigma, reason, truth, score, images and figures of one measurement |
| `with_compensation` | a measurement with figures `compensated_*`: the object behind the coat |
| `compare` | experiments by several methods, into a folder |
| `load_study`, `StudyRecord`, `sweep` | a design space as data, and into its store |
| `load_problem`, `identify` | which values of unknown fields agree with measurements |
| `plugin` | loads a Python file that adds kinds of coatings, materials and other parts |
| `uncertainty` | a measurement repeated with its inputs drawn anew: intervals, ranked budget |

Nothing is imported before it is asked for. Captures, real or rendered: see `reconstruction`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from reconstruction.registry import load_plugin as plugin
    from twin.config import Experiment, load_experiment, vary
    from twin.config.problem import load_problem
    from twin.config.study import load_study
    from twin.identification.run import identify
    from twin.pipeline import Measurement, Memory, measure, render
    from twin.pipeline.comparison import compare
    from twin.pipeline.compensation import with_compensation
    from twin.pipeline.press import press_specimen as press
    from twin.study.record import StudyRecord
    from twin.study.sweep import sweep
    from twin.uncertainty.trials import uncertainty

__all__ = [
    "Experiment",
    "Measurement",
    "Memory",
    "StudyRecord",
    "compare",
    "identify",
    "load_experiment",
    "load_problem",
    "load_study",
    "measure",
    "plugin",
    "press",
    "render",
    "sweep",
    "uncertainty",
    "vary",
    "with_compensation",
]

#: where each name lives, and what it is called there if otherwise; a dot: the package itself
_PLACES = {
    "Experiment": "twin.config",
    "Measurement": "twin.pipeline",
    "Memory": "twin.pipeline",
    "StudyRecord": "twin.study.record",
    "compare": "twin.pipeline.comparison",
    "identify": "twin.identification.run",
    "load_experiment": "twin.config",
    "load_problem": "twin.config.problem",
    "load_study": "twin.config.study",
    "measure": "twin.pipeline",
    "plugin": "reconstruction.registry:load_plugin",
    "press": "twin.pipeline.press:press_specimen",
    "render": "twin.pipeline",
    "sweep": "twin.study.sweep",
    "uncertainty": "twin.uncertainty:.",
    "vary": "twin.config",
    "with_compensation": "twin.pipeline.compensation",
}


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    place, _, other = _PLACES[name].partition(":")
    module = import_module(place)
    return module if other == "." else getattr(module, other or name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
