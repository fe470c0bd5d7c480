"""The vertical plane through a specimen's apexes, and profiles in it.

Positions along the plane's trace are s, mm, 0 at the middle of the apexes, increasing with world x.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from reconstruction.arrays import FloatArray
from twin.config.models import Experiment
from twin.mechanics import PressedElastomer
from twin.shape import Sphere
from twin.specimens import height_above_lowest, shape_of


@dataclass(frozen=True, eq=False)
class Trace:
    """A straight line in the world xy plane."""

    origin_mm: FloatArray
    direction: FloatArray

    def points(self, s_mm: FloatArray) -> FloatArray:
        """Return world xy of positions s, (n, 2)."""
        return self.origin_mm + s_mm[:, None] * self.direction

    def position(self, x_mm: Any, y_mm: Any) -> Any:
        """Return the position s of the foot of world points."""
        return (x_mm - self.origin_mm[0]) * self.direction[0] + (
            y_mm - self.origin_mm[1]
        ) * self.direction[1]

    def offset(self, x_mm: Any, y_mm: Any) -> Any:
        """Return the signed distance of world points from the line."""
        return (y_mm - self.origin_mm[1]) * self.direction[0] - (
            x_mm - self.origin_mm[0]
        ) * self.direction[1]

    @property
    def axis(self) -> str:
        """Label of the direction of the line."""
        return "x" if abs(self.direction[1]) < 1e-9 else "along the section"


def trace_through_apexes(experiment: Experiment) -> Trace:
    """Line through the first and the last apex; along x for one apex or none."""
    balls = shape_of(experiment.specimen).spheres()
    if not balls:
        return Trace(np.array([0.0, experiment.specimen.y_mm]), np.array([1.0, 0.0]))
    first, last = _xy(balls[0]), _xy(balls[-1])
    along, length = last - first, float(np.hypot(*(last - first)))
    direction = along / length if length else np.array([1.0, 0.0])
    if abs(direction[1]) < 1e-9:  # along x: positions are world x
        return Trace(np.array([0.0, (first[1] + last[1]) / 2]), np.array([1.0, 0.0]))
    return Trace((first + last) / 2, direction if direction[0] >= -1e-12 else -direction)


def specimen_profile(
    experiment: Experiment, pressed: PressedElastomer, trace: Trace, s_mm: FloatArray
) -> FloatArray:
    """World z of the pressed-in specimen's upper side at positions s; -inf where there is none."""
    points = trace.points(s_mm)
    height = np.diagonal(height_above_lowest(experiment.specimen, points[:, 0], points[:, 1]))
    return np.asarray(pressed.depth_mm + experiment.elastomer.touched_plane_mm - height)


def face_profile(pressed: PressedElastomer, trace: Trace, s_mm: FloatArray) -> FloatArray:
    """World z of the coated face at positions s; 0 beyond the rim."""
    grid = (pressed.face_y_mm, pressed.face_x_mm)
    return _along(grid, pressed.face_z_mm, trace, s_mm, fill=0.0)


def touched_profile(
    experiment: Experiment, pressed: PressedElastomer, trace: Trace, s_mm: FloatArray
) -> FloatArray:
    """World z of the touched face at positions s; undeformed beyond the outermost cells."""
    grid = (pressed.y_mm, pressed.x_mm)
    fill = experiment.elastomer.touched_plane_mm
    return _along(grid, pressed.touched_face_mm, trace, s_mm, fill)


def slab_span(experiment: Experiment, trace: Trace) -> tuple[float, float]:
    """Return the positions s of both ends of the slab along the trace."""
    half = np.array([experiment.elastomer.length_x_mm, experiment.elastomer.length_y_mm]) / 2
    with np.errstate(divide="ignore"):
        crossings = (np.array([[-1.0], [1.0]]) * half - trace.origin_mm) / trace.direction
    ends = np.sort(crossings, axis=0)
    return float(ends[0].max()), float(ends[1].min())


def _xy(ball: Sphere) -> FloatArray:
    return np.array([ball.x_mm, ball.y_mm])


def _along(
    grid_yx: tuple[FloatArray, FloatArray],
    values: FloatArray,
    trace: Trace,
    s_mm: FloatArray,
    fill: float,
) -> FloatArray:
    sample = RegularGridInterpolator(grid_yx, values, bounds_error=False, fill_value=fill)
    return np.asarray(sample(trace.points(s_mm)[:, ::-1]))
