"""Camera pixels averaged on a regular world grid, so that maps are in mm for every camera pose.

Frames: points (n, xyz) world mm; maps (row along y, col along x), row 0 at the smallest y.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.config.models import Experiment
from twin.optics.rig import camera_pinhole

# Finer cells would leave gaps between the pixels of an oblique camera.
_PIXELS_PER_CELL = 2.0


@dataclass(frozen=True, eq=False)
class WorldMap:
    """Mean values per cell; cells without a point are masked.

    Attributes
    ----------
    values : (row, col) masked float
    x_mm, y_mm : (col,), (row,) float, cell centres, ascending
    pitch_mm : float
    """

    values: "np.ma.MaskedArray[Any, Any]"
    x_mm: NDArray[np.float64]
    y_mm: NDArray[np.float64]
    pitch_mm: float

    @property
    def extent_mm(self) -> tuple[float, float, float, float]:
        """Outline for imshow with origin='lower': left, right, bottom, top."""
        half = self.pitch_mm / 2
        return (
            float(self.x_mm[0] - half),
            float(self.x_mm[-1] + half),
            float(self.y_mm[0] - half),
            float(self.y_mm[-1] + half),
        )

    def trimmed(self) -> "WorldMap":
        """Leave out border rows and columns less than half filled: perspective frays the rim."""
        filled = ~np.ma.getmaskarray(self.values)
        rows = np.flatnonzero(filled.mean(axis=1) >= 0.5)
        cols = np.flatnonzero(filled.mean(axis=0) >= 0.5)
        if not rows.size or not cols.size:
            return self
        down, across = slice(rows[0], rows[-1] + 1), slice(cols[0], cols[-1] + 1)
        return WorldMap(
            self.values[down, across], self.x_mm[across], self.y_mm[down], self.pitch_mm
        )


def pixel_on_face_mm(experiment: Experiment) -> float:
    """Size of a camera pixel on the undeformed coated face at the centre of the image."""
    return experiment.camera.pose.standoff_mm / camera_pinhole(experiment.camera).fx_px


def average_on_grid(
    points_world_mm: NDArray[Any], values: NDArray[Any], pixel_mm: float, most_cells: int
) -> WorldMap:
    """Average `values` (n,) of `points_world_mm` (n, xyz), n > 0, on square cells.

    Parameters
    ----------
    pixel_mm : a cell is at least two camera pixels wide
    most_cells : and at least so wide that the longer side has no more cells than this
    """
    x_mm, y_mm = points_world_mm[:, 0].astype(float), points_world_mm[:, 1].astype(float)
    span_mm = max(float(np.ptp(x_mm)), float(np.ptp(y_mm)))
    pitch_mm = max(_PIXELS_PER_CELL * pixel_mm, span_mm / most_cells)
    x0_mm, y0_mm = float(x_mm.min()), float(y_mm.min())
    col = ((x_mm - x0_mm) / pitch_mm).astype(np.intp)
    row = ((y_mm - y0_mm) / pitch_mm).astype(np.intp)
    rows, cols = int(row.max()) + 1, int(col.max()) + 1
    cell = row * cols + col
    count = np.bincount(cell, minlength=rows * cols)
    total = np.bincount(cell, weights=values.astype(float), minlength=rows * cols)
    mean = np.ma.masked_array(total / np.maximum(count, 1), mask=count == 0)
    return WorldMap(
        values=mean.reshape(rows, cols),
        x_mm=x0_mm + pitch_mm * (np.arange(cols, dtype=np.float64) + 0.5),
        y_mm=y0_mm + pitch_mm * (np.arange(rows, dtype=np.float64) + 0.5),
        pitch_mm=pitch_mm,
    )
