"""Stages that a study needs, depending on the figures that the study names.

Figures are named in metrics, goals and constraints. A study that names only bounds and figures of
the press runs the press and the ray tracing, without frames, noise and decoding.
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
_WITHOUT_FRAMES = {*OF_A_PRESS, "exposure_ms", "frames", "sequence_ms", "warnings"}


def bound_needed(study: Study) -> Bound:
    """Return whether the bounds on uncertainties are needed, and whether also a measurement is.

    "no": only the measurement; "alone": only the bounds; "beside": both. A study without `metrics`
    needs all figures, but a search needs only its objectives and constraints.
    """
    names = named_figures(study)
    if not any(is_bound_name(name) for name in names):
        return "no"
    everything = not study.metrics and study.sampling.method not in ("optimise", "gradient")
    others = [name for name in names if not is_bound_name(name) and not _known_without(name)]
    return "beside" if everything or others or set(study.keep) - {"press"} else "alone"


def compensation_needed(study: Study) -> bool:
    """Return True if the study names a figure of the object behind the coat."""
    return of_the_object(named_figures(study))


def layer_for(experiment: Experiment) -> SensorLayer | None:
    """Return elastomer, load and specimen as assumed for the reconstruction behind the coat.

    None if the object behind the coat is not reconstructed.
    """
    if not may_compensate(experiment):
        return None
    return sensor_layer_of(experiment).model_copy(update={"specimen": experiment.specimen})


def derivatives_needed(study: Study, experiment: Experiment) -> tuple[str, ...]:
    """Return the fields with respect to which a gradient search differentiates the bounds.

    They are the fields of the axes that automatic differentiation supports; none without a search.
    """
    if study.gradient is None:
        return ()
    known = differentiated(experiment)
    return tuple(str(axis.path) for axis in study.axis if axis.path in known)


def _known_without(name: str) -> bool:
    return name in _WITHOUT_FRAMES or (name in DERIVED and name not in OF_A_MEASUREMENT)


def named_figures(study: Study) -> list[str]:
    """Return the names of the figures in metrics, goals and constraints of a study."""
    bounds = [name for limit in study.constraint for name in (limit.value, limit.per) if name]
    goals = [goal.metric for goal in study.goals]
    return [*study.metrics, *goals, *(name for name in bounds if "." not in name)]
