"""Dimensions of measured surfaces, each with a stated definition and a robust fit; lengths mm."""

from reconstruction.evaluate.flatness import ArealRoughness, Flatness, areal_roughness, flatness
from reconstruction.evaluate.profile import BarWidth, StepHeight, bar_width, step_height
from reconstruction.evaluate.solids import BallFit, CylinderFit, fit_ball, fit_cylinder

__all__ = [
    "ArealRoughness",
    "BallFit",
    "BarWidth",
    "CylinderFit",
    "Flatness",
    "StepHeight",
    "areal_roughness",
    "bar_width",
    "fit_ball",
    "fit_cylinder",
    "flatness",
    "step_height",
]
