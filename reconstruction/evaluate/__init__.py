"""Dimensions of measured surfaces, each with a stated definition and a robust fit; lengths mm."""

from reconstruction.evaluate.fit import fit_sphere_algebraic
from reconstruction.evaluate.plane import (
    ArealRoughness,
    BarWidth,
    Flatness,
    StepHeight,
    areal_roughness,
    bar_width,
    break_width,
    flatness,
    slope_change_width,
    step_height,
)
from reconstruction.evaluate.robust import BallFit, CylinderFit, fit_ball, fit_cylinder

__all__ = [
    "ArealRoughness",
    "BallFit",
    "BarWidth",
    "CylinderFit",
    "Flatness",
    "StepHeight",
    "areal_roughness",
    "bar_width",
    "break_width",
    "fit_ball",
    "fit_cylinder",
    "fit_sphere_algebraic",
    "flatness",
    "slope_change_width",
    "step_height",
]
