"""What the coated face alone would give: the cheap stage, without light, noise or calibration.

A press of a slab costs a tenth of a second, a measurement seconds: sensitivities and explanations
need hundreds of them.
"""

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.evaluate.fit import SphereFit, fit_sphere
from twin.config import Experiment
from twin.mechanics import PressedElastomer
from twin.results.figures import Metric
from twin.results.parts import press_metrics
from twin.results.rods import rod_figures
from twin.specimens import Sphere, shape_of


def face_figures(experiment: Experiment, pressed: PressedElastomer) -> dict[str, Metric]:
    """Return the figures of a press, and of its face under the names of a measurement.

    Radius and RMSE of the balls, and width and height of a single rod, are those of the face itself
    over the region that is scored.

    Raises
    ------
    FitError
        A ball's region holds too few nodes.
    """
    points = face_points_mm(pressed)
    found = press_metrics(pressed) | rod_figures(experiment, points)
    for number, ball in enumerate(shape_of(experiment.specimen).spheres(), start=1):
        fit = cap_fit(points, ball, experiment.score.roi_radius_mm)
        found[f"sphere_{number}_radius_mm"] = fit.radius_mm
        found[f"sphere_{number}_rmse_mm"] = fit.stats.rmse_mm
    return found


def face_points_mm(pressed: PressedElastomer) -> FloatArray:
    """Return the nodes of the coated face, (n, 3) float, world mm."""
    x, y = np.meshgrid(pressed.face_x_mm, pressed.face_y_mm)
    return np.column_stack([x.ravel(), y.ravel(), pressed.face_z_mm.ravel()])


def cap_fit(points_mm: FloatArray, ball: Sphere, roi_radius_mm: float) -> SphereFit:
    """Fit the face over one ball's region, as the score does over camera pixels.

    Raises
    ------
    FitError
        Too few points.
    """
    lateral = np.hypot(points_mm[:, 0] - ball.x_mm, points_mm[:, 1] - ball.y_mm)
    return fit_sphere(points_mm[lateral <= roi_radius_mm])
