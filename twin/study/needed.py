"""How much of a measurement a study needs: what its metrics, goals and constraints name.

A study that names bounds alone (and figures of the press) presses and traces, but renders no frame,
draws no noise and decodes nothing.
"""

from typing import Literal

from twin.config.models import Experiment
from twin.config.sensor_layer import SensorLayer, sensor_layer_of
from twin.config.study import Study
from twin.results.bound import is_bound_name
from twin.results.derivatives import differentiated
from twin.results.names import OF_A_PRESS, may_compensate, of_the_object
from twin.study.derived import DERIVED, OF_A_MEASUREMENT

Bound = Literal["no", "beside", "alone"]
_WITHOUT_FRAMES = {*OF_A_PRESS, "exposure_ms", "warnings"}


def bound_needed(study: Study) -> Bound:
    """Tell whether bounds are asked for, and whether anything but them.

    A search without `metrics` needs what it searches by; any other study without them, everything.
    """
    names = named_figures(study)
    if not any(is_bound_name(name) for name in names):
        return "no"
    everything = not study.metrics and study.sampling.method not in ("optimise", "gradient")
    others = [name for name in names if not is_bound_name(name) and not _known_without(name)]
    return "beside" if everything or others or set(study.keep) - {"press"} else "alone"


def compensation_needed(study: Study) -> bool:
    """Tell whether figures of the object behind the coat are named."""
    return of_the_object(named_figures(study))


def layer_for(experiment: Experiment) -> SensorLayer | None:
    """Return what an experiment says of elastomer, load and form; None where no object is found."""
    if not may_compensate(experiment):
        return None
    return sensor_layer_of(experiment).model_copy(update={"specimen": experiment.specimen})


def derivatives_needed(study: Study, experiment: Experiment) -> tuple[str, ...]:
    """Return the fields that a gradient search needs derivatives by: those that have some."""
    if study.gradient is None:
        return ()
    known = differentiated(experiment)
    return tuple(str(axis.path) for axis in study.axis if axis.path in known)


def _known_without(name: str) -> bool:
    return name in _WITHOUT_FRAMES or (name in DERIVED and name not in OF_A_MEASUREMENT)


def named_figures(study: Study) -> list[str]:
    """Return the figures that a study names: metrics, goals, and what constraints bound."""
    bounds = [name for one in study.constraint for name in (one.value, one.per) if name]
    goals = [one.metric for one in study.goals]
    return [*study.metrics, *goals, *(name for name in bounds if "." not in name)]
