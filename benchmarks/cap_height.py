"""The published figure of known balls under a photometric-stereo sensor."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.photometric.calibration_ball import ContactCircle

# Radius at which caps are measured, in contact radii.
CAP_SHARE = 0.8


def cap_height_ratio(
    height_mm: NDArray[np.floating[Any]],
    circle: ContactCircle,
    ball_radius_mm: float,
    pitch_mm: float,
) -> float:
    """Return the height of a ball's cap, centre to 0.8 contact radii, over the true one.

    Independent of the zero level, and inside the rim of the contact.
    """
    rows, cols = height_mm.shape
    row, col = np.ogrid[:rows, :cols]
    radii_px = np.hypot(row - circle.row_px, col - circle.col_px)
    ring_px = CAP_SHARE * circle.radius_px
    ring, centre = np.abs(radii_px - ring_px) < 0.7, radii_px < 1.5
    sagitta_mm = ball_radius_mm - np.sqrt(ball_radius_mm**2 - (ring_px * pitch_mm) ** 2)
    return float((height_mm[centre].mean() - height_mm[ring].mean()) / sagitta_mm)
