"""What a measurement will know, without making it: press, trace, predict.

No frame is rendered, no noise drawn, nothing decoded; the stages before the frames are those of the
measurement, and kept in the same memory.
"""

from collections.abc import Callable

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
    return _prediction(experiment, pressed, memory)()


def _prediction(
    experiment: Experiment, pressed: PressedFace, memory: Memory, ahead: bool = False
) -> Callable[[], tuple[PredictedMaps, Truth]]:
    """Trace, and return what predicts from it; in any thread, where images are made `ahead`."""
    geometry = loaded(experiment, pressed, memory)
    view = viewed(experiment, geometry, memory)
    rays = traced(experiment, geometry, view, memory)
    from twin.pipeline.trace import maps_of_patches

    truth = view.value.truth
    made = maps_of_patches(rays.value, view.value) if ahead else None

    def predict_from(seen: Experiment) -> PredictedMaps:
        return predict(seen, made or maps_of_patches(rays.value, view.value), truth)

    inputs = view.token, rays.token
    return lambda: (memory.recall("prediction", experiment, inputs, predict_from).value, truth)


def bounds_of(
    experiment: Experiment, pressed: PressedFace, memory: Memory
) -> Callable[[], dict[str, Metric]]:
    """Trace, and return what finds the bounds of the measurands, in any thread: it renders nothing.

    The bounds are empty where the trace alone has none.
    """
    if not has_bound(experiment):
        return dict
    prediction = _prediction(experiment, pressed, memory, ahead=True)
    return lambda: bound_figures(experiment, *prediction(), pressed.pressed)


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
