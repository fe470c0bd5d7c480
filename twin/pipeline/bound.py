"""What a measurement will know, without making it: press, trace, predict.

No frame is rendered, no noise drawn, nothing decoded; the stages before the frames are those of the
measurement, and kept in the same memory.
"""

from reconstruction.errors import InputError
from twin.config.models import Experiment
from twin.mechanics import PressedElastomer
from twin.optics.stack import Truth
from twin.pipeline.fringes import loaded, traced, viewed
from twin.pipeline.memory import Memory
from twin.pipeline.press import PressedFace, press
from twin.results.bound import bound_figures, has_bound
from twin.results.figures import Metric
from twin.results.parts import press_metrics
from twin.results.prediction import PredictedMaps, predict


def predicted(
    experiment: Experiment, pressed: PressedFace, memory: Memory
) -> tuple[PredictedMaps, Truth]:
    """Trace a pressed face, and predict what a measurement will know of every pixel.

    Raises
    ------
    InputError : as `twin.pipeline.measure`
    MissingBackend : no usable Dr.Jit backend
    """
    geometry = loaded(experiment, pressed, memory)
    view = viewed(experiment, geometry, memory)
    rays = traced(experiment, geometry, view, memory)
    from twin.pipeline.trace import maps_of_patches

    found = memory.recall(
        "prediction",
        experiment,
        (view.token, rays.token),
        lambda seen: predict(seen, maps_of_patches(rays.value, view.value), view.value.truth),
    )
    return found.value, view.value.truth


def bounds_of(experiment: Experiment, pressed: PressedFace, memory: Memory) -> dict[str, Metric]:
    """Return the bounds of an experiment's measurands; empty where the trace alone has none."""
    if not has_bound(experiment):
        return {}
    return bound_figures(experiment, *predicted(experiment, pressed, memory), pressed.pressed)


def bounds_alone(
    experiment: Experiment, memory: Memory
) -> tuple[PressedElastomer, dict[str, Metric]]:
    """Press, trace and predict; return the press, and its figures with the bounds.

    Raises
    ------
    InputError : the trace alone has no bound of this experiment, or as `twin.pipeline.measure`
    MissingBackend : no usable Dr.Jit backend
    """
    if not has_bound(experiment):
        raise InputError(
            f"modality = '{experiment.modality}', render.engine = '{experiment.render.engine}', "
            f"render.bounces = {experiment.bounces}, patterns.code = '{experiment.patterns.code}': "
            "no bound without a measurement; allowed contact_fpp by one_trace without bounces, and "
            "every code but micro"
        )
    pressed = press(experiment, memory)
    prediction, truth = predicted(experiment, pressed, memory)
    figures = press_metrics(pressed.pressed) | {"exposure_ms": prediction.exposure_ms}
    found = bound_figures(experiment, prediction, truth, pressed.pressed)
    return pressed.pressed, figures | found
