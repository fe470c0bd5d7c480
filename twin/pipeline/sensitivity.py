"""How a pressed sheet moves with its data: derivatives by numbers of the experiment."""

from collections.abc import Sequence

from reconstruction.errors import InputError
from twin.config import Experiment
from twin.mechanics import PressedElastomer
from twin.mechanics.choice import settled_with
from twin.mechanics.models import PressInput, SettledPress
from twin.pipeline.gradients import value_at, with_number
from twin.pipeline.press import Progress, with_texture
from twin.results.parts import press_metrics
from twin.results.press_derivatives import PressDerivative

# Central differences of linearised presses: their rounding error is below 1e-6. A larger
# step would let single points begin to touch, which no derivative includes.
_STEP = 1e-6
_TABLES = ("elastomer", "press", "specimen")


def press_derivatives(
    experiment: Experiment, paths: Sequence[str], progress: Progress | None = None
) -> tuple[PressedElastomer, list[PressDerivative]]:
    """Press a thin sheet and differentiate it, by the implicit function theorem at its equilibrium.

    Parameters
    ----------
    paths : dotted, of numbers of elastomer, press and specimen, such as `elastomer.thickness_mm`
    progress : called with the finished share of the press's load steps

    Returns
    -------
    the press, and of it without the coat's texture a derivative by each number

    Raises
    ------
    InputError : a path is no such number; no thin sheet presses; it sticks; a number changes the
        sheet's grid; or several equilibria are near the solution
    """
    for path in paths:
        if path.partition(".")[0] not in _TABLES:
            raise InputError(f"{path}: found no derivative by it; allowed: {', '.join(_TABLES)}.*")
        value_at(experiment, path)
    rest = settled_with(_data(experiment), progress)
    derivatives = [_derivative(experiment, path, rest) for path in paths]
    return with_texture(experiment, rest.result()), derivatives


def _derivative(experiment: Experiment, path: str, rest: SettledPress) -> PressDerivative:
    value = value_at(experiment, path)
    step = _STEP * max(abs(value), 1.0)
    low, high = (
        rest.nearby(_data(with_number(experiment, path, stepped)))
        for stepped in (value - step, value + step)
    )
    before, after = _figures(low), _figures(high)
    return PressDerivative(
        path,
        (high.face_z_mm - low.face_z_mm) / (2 * step),
        {name: (after[name] - before[name]) / (2 * step) for name in before},
    )


def _data(experiment: Experiment) -> PressInput:
    return PressInput(
        experiment.mechanics, experiment.specimen, experiment.elastomer, experiment.press
    )


def _figures(pressed: PressedElastomer) -> dict[str, float]:
    figures = press_metrics(pressed)
    return {name: value for name, value in figures.items() if isinstance(value, float)}
