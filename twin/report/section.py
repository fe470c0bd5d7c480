"""The vertical plane through the apexes of a specimen, and profiles in this plane.

The trace is the line of the plane in world xy. Positions s along the trace are in mm. s is 0 in the
middle between the apexes and increases with world x.
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

_POINTS_PER_GRID = 64
"""Points of a profile per grid of heights, whose time grows with their square."""


@dataclass(frozen=True, eq=False)
class Trace:
    """A straight line in the world xy plane: point with s = 0 (mm), and unit direction."""

    origin_mm: FloatArray
    direction: FloatArray

    def points(self, s_mm: FloatArray) -> FloatArray:
        """Return the world points at positions s (n,), as (n, xy), mm."""
        return self.origin_mm + s_mm[:, None] * self.direction

    def position(self, x_mm: Any, y_mm: Any) -> Any:
        """Return the position s, mm, of the perpendicular projection of world points, mm."""
        return (x_mm - self.origin_mm[0]) * self.direction[0] + (
            y_mm - self.origin_mm[1]
        ) * self.direction[1]

    def offset(self, x_mm: Any, y_mm: Any) -> Any:
        """Return the signed distance, mm, of world points from the line."""
        return (y_mm - self.origin_mm[1]) * self.direction[0] - (
            x_mm - self.origin_mm[0]
        ) * self.direction[1]

    @property
    def axis(self) -> str:
        """Axis label for positions s: "x" if the line is along x, else "along the section"."""
        return "x" if abs(self.direction[1]) < 1e-9 else "along the section"


def trace_through_apexes(experiment: Experiment) -> Trace:
    """Return the line through the apexes of the first and the last ball.

    With one ball or none, the line is along world x, and s is world x.
    """
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
    """Return world z (mm) of the upper side of the pressed specimen at positions s.

    The value is -inf outside the specimen.
    """
    points = trace.points(s_mm)
    # A specimen has its heights on a grid only, whose diagonal is the profile.
    parts = np.array_split(points, max(1, len(points) // _POINTS_PER_GRID))
    height = np.concatenate(
        [np.diagonal(height_above_lowest(experiment.specimen, *part.T)) for part in parts]
    )
    return np.asarray(pressed.depth_mm + experiment.elastomer.touched_plane_mm - height)


def face_profile(pressed: PressedElastomer, trace: Trace, s_mm: FloatArray) -> FloatArray:
    """Return world z (mm) of the coated face at positions s; 0 beyond the rim."""
    grid = (pressed.face_y_mm, pressed.face_x_mm)
    return _along(grid, pressed.face_z_mm, trace, s_mm, fill=0.0)


def touched_profile(
    experiment: Experiment, pressed: PressedElastomer, trace: Trace, s_mm: FloatArray
) -> FloatArray:
    """Return world z (mm) of the touched face at positions s.

    Beyond the outermost cells, the face is assumed to be undeformed.
    """
    grid = (pressed.y_mm, pressed.x_mm)
    fill = experiment.elastomer.touched_plane_mm
    return _along(grid, pressed.touched_face_mm, trace, s_mm, fill)


def slab_span(experiment: Experiment, trace: Trace) -> tuple[float, float]:
    """Return the positions s, mm, of the two points where the trace crosses the slab's border."""
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
