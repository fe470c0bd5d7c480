"""What the coated face alone would give: radius and width without light, noise or calibration.

One press costs a tenth of a second; sensitivities and explanations need hundreds of them.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from reconstruction.errors import FitError, InputError
from reconstruction.evaluate.fit import SphereFit, fit_sphere
from twin.config import Experiment, vary
from twin.mechanics import PressedElastomer
from twin.paper.repeats import rod_width
from twin.paper.scatter import Input, nominal_of
from twin.pipeline.press import press_specimen
from twin.specimens import Sphere, shape_of


@dataclass(frozen=True)
class Contribution:
    """What one input adds to an output's standard uncertainty (JCGM 100, 5.1.3 and 5.1.2, note).

    Attributes
    ----------
    name, key : of the input
    input_u : standard uncertainty of the input, in its own unit
    output_u_mm : of the output, by first and second differences over one standard uncertainty
    """

    name: str
    key: str
    input_u: float
    output_u_mm: float


def face_points_mm(pressed: PressedElastomer) -> np.ndarray:
    """Return the nodes of the coated face, (n, 3) float, world mm."""
    x, y = np.meshgrid(pressed.face_x_mm, pressed.face_y_mm)
    return np.column_stack([x.ravel(), y.ravel(), pressed.face_z_mm.ravel()])


def cap_fit(points_mm: np.ndarray, ball: Sphere, roi_radius_mm: float) -> SphereFit:
    """Fit the face over one ball's region, as the score does over camera pixels.

    Raises
    ------
    FitError
        Too few points.
    """
    lateral = np.hypot(points_mm[:, 0] - ball.x_mm, points_mm[:, 1] - ball.y_mm)
    return fit_sphere(points_mm[lateral <= roi_radius_mm])


def face_figures(experiment: Experiment) -> dict[str, float]:
    """Return apparent radii and RMSE of the balls, or the width of the rod; mm.

    Raises
    ------
    InputError
        The press fails, or its face shows neither ball nor rod.
    """
    points = face_points_mm(press_specimen(experiment))
    found: dict[str, float] = {}
    for number, ball in enumerate(shape_of(experiment.specimen).spheres(), start=1):
        fit = cap_fit(points, ball, experiment.score.roi_radius_mm)
        found[f"sphere_{number}_radius_mm"] = fit.radius_mm
        found[f"sphere_{number}_rmse_mm"] = fit.stats.rmse_mm
    if experiment.specimen.kind == "rods":
        figures = rod_width(experiment, points, "")
        if "rod_failure" in figures:
            raise FitError(str(figures["rod_failure"]))
        found |= figures
    return found


def contributions(
    experiment: Experiment,
    inputs: Mapping[str, Input],
    output: str,
    figures_of: Callable[[Experiment], Mapping[str, float]] = face_figures,
) -> list[Contribution]:
    """Return the inputs' contributions to an output, largest first.

    The second-order term is that of each input alone: 1/2 (f'' u^2)^2 for a normal distribution.

    Raises
    ------
    InputError
        As `figures_of`.
    """
    found, middle = [], float(figures_of(experiment)[output])
    for name, one in inputs.items():
        nominal = nominal_of(experiment, one.key)
        u = one.standard_uncertainty(nominal)
        ends = [_at(experiment, one.key, nominal + step, figures_of)[output] for step in (-u, u)]
        found.append(Contribution(name, one.key, u, _of_differences(ends[0], middle, ends[1])))
    return sorted(found, key=lambda one: -one.output_u_mm)


def _of_differences(low: float, middle: float, high: float) -> float:
    """Return the standard deviation of the parabola through three points, of a normal input.

    A rod at rest is symmetric in tilt and yaw: there the slope is nothing and the bend is all.
    """
    slope, bend = (high - low) / 2, high + low - 2 * middle
    return float(np.hypot(slope, bend / np.sqrt(2.0)))


def _at(
    experiment: Experiment,
    key: str,
    value: float,
    figures_of: Callable[[Experiment], Mapping[str, float]],
) -> Mapping[str, float]:
    try:
        return figures_of(vary(experiment, {key: value}))
    except InputError as error:
        raise InputError(f"{key} = {value:g}: {error}") from None
