"""Dimensions of measured surfaces, each with a stated definition and a robust fit; lengths mm."""

from reconstruction.evaluate.cylinder import CylinderFit, fit_cylinder
from reconstruction.evaluate.plane import Flatness, flatness
from reconstruction.evaluate.profile import BarWidth, StepHeight, bar_width, step_height
from reconstruction.evaluate.roughness import ArealRoughness, areal_roughness
from reconstruction.evaluate.sphere import BallFit, fit_ball

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
