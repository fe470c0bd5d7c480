"""Differentiate a pressed thin sheet by numbers of the experiment."""

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

# Relative step of central differences of linearised presses; their rounding error is below 1e-6.
# With a larger step single points would begin to touch, which a derivative does not include.
_STEP = 1e-6
_TABLES = ("elastomer", "press", "specimen")


def press_derivatives(
    experiment: Experiment, paths: Sequence[str], progress: Progress | None = None
) -> tuple[PressedElastomer, list[PressDerivative]]:
    """Press a thin sheet, and differentiate its equilibrium by numbers of the experiment.

    The derivatives are by the implicit function theorem at the equilibrium.

    Parameters
    ----------
    paths : dotted paths of numbers of elastomer, press and specimen, such as
        `elastomer.thickness_mm`
    progress : function that is called with the finished share, 0 to 1, of the load steps; None: no
        calls

    Returns
    -------
    the pressed elastomer, and one derivative per path, of the press without the coat's texture

    Raises
    ------
    InputError : a path is not that of a number of these tables; the elastomer is no thin sheet or
        sticks; a number changes the grid of the sheet; or several equilibria are near the solution
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
