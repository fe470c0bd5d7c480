"""Predict the uncertainty of a measurement without rendering its frames: press, trace, predict.

No frame is rendered or decoded, and no random noise is used. The stages before the frames are those
of the measurement, and their results are cached in the same memory.
"""

from collections.abc import Callable

import numpy as np

from reconstruction.arrays import at_pixels
from reconstruction.codes import CODES
from reconstruction.errors import FitError, InputError
from twin.config.models import Experiment
from twin.config.sensor_layer import SensorLayer
from twin.mechanics import PressedElastomer
from twin.mechanics.choice import is_slab
from twin.optics.stack import Truth
from twin.pipeline.lit_frames import loaded, traced, viewed
from twin.pipeline.memory import Memory
from twin.pipeline.press import PressedFace, press
from twin.pipeline.slab_object import bound_slab, slab_object
from twin.results.bound import bound_figures, has_bound
from twin.results.compensated import slab_bound_name
from twin.results.figures import Metric
from twin.results.names import may_compensate
from twin.results.parts import press_metrics
from twin.results.prediction import PredictedMaps, predict
from twin.results.sequence import frame_count, sequence_ms


def predicted(
    experiment: Experiment, pressed: PressedFace, memory: Memory
) -> tuple[PredictedMaps, Truth]:
    """Trace a pressed face, and predict coordinate and sigma of every camera pixel.

    Returns
    -------
    the predicted maps, and the true surface at the pixels

    Raises
    ------
    InputError : for the reasons of `twin.pipeline.measure`
    MissingBackend : there is no usable Dr.Jit backend
    """
    return _prediction(experiment, pressed, memory)()


def _prediction(
    experiment: Experiment, pressed: PressedFace, memory: Memory, ahead: bool = False
) -> Callable[[], tuple[PredictedMaps, Truth]]:
    """Trace a pressed face, and return a function that makes the prediction.

    Parameters
    ----------
    ahead : True: evaluate the trace before the function is returned, so that any thread may call
        it
    """
    geometry = loaded(experiment, pressed, memory)
    view = viewed(experiment, geometry, memory)
    rays = traced(experiment, geometry, view, memory)
    from twin.pipeline.trace import maps_of_patches

    truth = view.value.truth
    made = maps_of_patches(rays.value, view.value) if ahead else None

    def predict_from(watched: Experiment) -> PredictedMaps:
        return predict(watched, made or maps_of_patches(rays.value, view.value), truth)

    inputs = view.token, rays.token
    return lambda: (memory.recall("prediction", experiment, inputs, predict_from).value, truth)


def bounds_of(
    experiment: Experiment, pressed: PressedFace, memory: Memory
) -> Callable[[], dict[str, Metric]]:
    """Trace a pressed face, and return a function that returns the bounds of the measurands.

    A bound is the least standard deviation that any unbiased evaluation of the frames can have. The
    function does not render, so that any thread may call it. It returns no bounds if the trace is
    not sufficient to predict them, see `has_bound`.
    """
    if not has_bound(experiment):
        return dict
    prediction = _prediction(experiment, pressed, memory, ahead=True)
    return lambda: bound_figures(experiment, *prediction(), pressed.pressed)


def bounds_alone(
    experiment: Experiment, memory: Memory
) -> tuple[PressedElastomer, dict[str, Metric]]:
    """Press, trace and predict, without rendering; return the press and the figures.

    The figures are those of the press, the exposure time, and the bounds of the measurands.

    Raises
    ------
    InputError : the trace is not sufficient for a bound of this experiment, or for the reasons of
        `twin.pipeline.measure`
    MissingBackend : there is no usable Dr.Jit backend
    """
    if not has_bound(experiment):
        closed = ", ".join(code.name for code in CODES if code.has_closed_form)
        raise InputError(
            f"modality = '{experiment.modality}', render.engine = '{experiment.render.engine}', "
            f"render.bounces = {experiment.bounces}, patterns.code = '{experiment.patterns.code}': "
            "no bound without a measurement; allowed contact_fpp by one_trace without bounces, and "
            f"the codes {closed} with fringes along both axes, white and black"
        )
    pressed = press(experiment, memory)
    prediction, truth = predicted(experiment, pressed, memory)
    figures = press_metrics(pressed.pressed) | {
        "exposure_ms": prediction.exposure_ms,
        "frames": frame_count(experiment),
        "sequence_ms": sequence_ms(experiment, prediction.exposure_ms),
    }
    bounds = bound_figures(experiment, prediction, truth, pressed.pressed)
    return pressed.pressed, figures | bounds


def object_bounds(experiment: Experiment, layer: SensorLayer, memory: Memory) -> dict[str, Metric]:
    """Return the bounds of the fitted parameters of an object under a thick slab, by figure name.

    A bound is the least standard deviation of a parameter, in um or degrees. It is computed from
    the predicted sigma of the coat's points and the derivatives of the coat by the parameters. The
    bounds are None if the coat does not determine the parameters. For other layouts the result is
    empty.

    Parameters
    ----------
    layer : nominal elastomer and load, with their uncertainties

    Raises
    ------
    InputError : for the reasons of `twin.pipeline.measure`
    MissingBackend : there is no usable Dr.Jit backend
    """
    fitted = is_slab(experiment.elastomer) and may_compensate(experiment)
    if not (fitted and has_bound(experiment)):
        return {}
    slab = slab_object(layer, experiment.specimen)
    prediction, _ = predicted(experiment, press(experiment, memory), memory)
    points = at_pixels(prediction.points.points_world_mm, prediction.valid).astype(np.float64)
    single = at_pixels(prediction.single_mm, prediction.valid).astype(np.float64)
    try:
        sigma = bound_slab(points, single, slab)
    except FitError:
        return {slab_bound_name(path): None for path in slab.fitted_paths}
    return {
        slab_bound_name(path): value if path.endswith("_deg") else 1e3 * value
        for path, value in sigma.items()
    }
