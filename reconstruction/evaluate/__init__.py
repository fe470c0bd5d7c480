"""Measure dimensions of surfaces, each with a stated definition and a robust fit; lengths in mm.

A module of this package is imported at the first use of one of its names, because importing SciPy's
optimisers takes half a second.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from reconstruction.evaluate.baselines import score_baseline
    from reconstruction.evaluate.fit import fit_sphere_algebraic
    from reconstruction.evaluate.methods import DataSetScore, ScoredMethod, score_dataset
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
    from reconstruction.evaluate.predictions import PredictionScore, score_predictions
    from reconstruction.evaluate.robust import BallFit, CylinderFit, fit_ball, fit_cylinder

__all__ = [
    "ArealRoughness",
    "BallFit",
    "BarWidth",
    "CylinderFit",
    "DataSetScore",
    "Flatness",
    "PredictionScore",
    "ScoredMethod",
    "StepHeight",
    "areal_roughness",
    "bar_width",
    "break_width",
    "fit_ball",
    "fit_cylinder",
    "fit_sphere_algebraic",
    "flatness",
    "score_baseline",
    "score_dataset",
    "score_predictions",
    "slope_change_width",
    "step_height",
]

_MODULES = {
    "fit_sphere_algebraic": "fit",
    "DataSetScore": "methods",
    "ScoredMethod": "methods",
    "score_dataset": "methods",
    "ArealRoughness": "plane",
    "BarWidth": "plane",
    "Flatness": "plane",
    "StepHeight": "plane",
    "areal_roughness": "plane",
    "bar_width": "plane",
    "break_width": "plane",
    "flatness": "plane",
    "slope_change_width": "plane",
    "step_height": "plane",
    "PredictionScore": "predictions",
    "score_baseline": "baselines",
    "score_predictions": "predictions",
    "BallFit": "robust",
    "CylinderFit": "robust",
    "fit_ball": "robust",
    "fit_cylinder": "robust",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
