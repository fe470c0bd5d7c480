"""Where a ball touches: the circle in an image, found from its difference to the background."""

from dataclasses import dataclass

import cv2
import numpy as np

from reconstruction.arrays import Doubles, FloatImage
from reconstruction.errors import FitError

SMOOTHING_PX = 5
SECTORS = 72
ROUNDS = 3
# Share of the ring's typical contrast below which a direction shows no edge (no lamp on that side).
LEAST_CONTRAST = 0.35
# Directions that miss the fitted circle by more than this many robust sigmas are left out.
OUTLIER_SIGMAS = 2.5
SIGMA_PER_MAD = 1.4826


@dataclass(frozen=True)
class ContactCircle:
    """Circle in pixels; centres of pixels have whole coordinates."""

    row_px: float
    col_px: float
    radius_px: float


def find_contact_circle(
    image: FloatImage, background: FloatImage, threshold_levels: float = 15.0
) -> ContactCircle:
    """Find the contact of a ball.

    Parameters
    ----------
    image, background : (row, col, 3), 8-bit levels
    threshold_levels : Euclidean colour difference that tells touched from untouched gel

    Raises
    ------
    FitError : nothing touched, or no circle

    Notes
    -----
    The largest region above the threshold, holes closed, gives a first circle; it includes the
    skirt that the gel forms around the ball. The slope of a ball grows up to the edge of contact
    and drops beyond it, so in every direction the colour difference peaks there: a circle is
    fitted to these peaks, outliers left out, until it stays.
    """
    difference = cv2.GaussianBlur(
        np.linalg.norm(image.astype(np.float32) - background, axis=2), (0, 0), SMOOTHING_PX / 3.0
    )
    circle = _first_circle(difference, threshold_levels)
    for _ in range(ROUNDS):
        circle = _refined(difference, circle)
    rows, cols = difference.shape
    inside = -0.5 <= circle.row_px <= rows - 0.5 and -0.5 <= circle.col_px <= cols - 0.5
    if not inside or circle.radius_px < SMOOTHING_PX:
        raise FitError(
            f"no contact circle: the best one has centre ({circle.row_px:.1f}, "
            f"{circle.col_px:.1f}) px and radius {circle.radius_px:.1f} px; centre the ball in the "
            "field and press deeper"
        )
    return circle


def _first_circle(difference: FloatImage, threshold_levels: float) -> ContactCircle:
    touched = (difference > threshold_levels).astype(np.uint8)
    touched = cv2.morphologyEx(touched, cv2.MORPH_CLOSE, np.ones((7, 7), np.uint8))
    outlines, _ = cv2.findContours(touched, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not outlines:
        raise FitError(
            f"no contact: the colour differs by at most {difference.max():.1f} levels from the "
            f"background, below the threshold {threshold_levels:g}; press deeper or lower it"
        )
    outline = max(outlines, key=cv2.contourArea)
    (col_px, row_px), radius_px = cv2.minEnclosingCircle(outline)
    return ContactCircle(row_px, col_px, max(float(radius_px), 1.0))


def _refined(difference: FloatImage, circle: ContactCircle) -> ContactCircle:
    """Fit a circle to the peaks of the difference along rays from the centre."""
    angles = 2.0 * np.pi * np.arange(SECTORS) / SECTORS
    radii = np.arange(0.4 * circle.radius_px, 1.3 * circle.radius_px, 0.5)
    rows = circle.row_px + np.outer(np.sin(angles), radii)
    cols = circle.col_px + np.outer(np.cos(angles), radii)
    rays = cv2.remap(
        difference,
        cols.astype(np.float32),
        rows.astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
    )
    peak = np.argmax(rays, axis=1)
    height = rays[np.arange(SECTORS), peak]
    # A ray without a peak of its own rises to the end: the edge lies elsewhere or outside.
    clear = (height > LEAST_CONTRAST * np.median(height)) & (peak > 0) & (peak < len(radii) - 1)
    at = np.arange(SECTORS)[clear], peak[clear]
    return _robust_circle(np.column_stack([rows[at], cols[at]]))


def _robust_circle(points: Doubles) -> ContactCircle:
    kept = points
    for _ in range(3):
        if len(kept) < SECTORS // 4:
            raise FitError(
                f"no contact circle: an edge shows in {len(kept)} of {SECTORS} directions only; "
                "press one ball, centred in the field"
            )
        circle = _circle_through(kept)
        miss = np.hypot(points[:, 0] - circle.row_px, points[:, 1] - circle.col_px)
        miss = np.abs(miss - circle.radius_px)
        kept = points[miss <= OUTLIER_SIGMAS * SIGMA_PER_MAD * np.median(miss) + 0.5]
    return circle


def _circle_through(points: Doubles) -> ContactCircle:
    """Least squares of |p|^2 = 2 c p + k (Kåsa 1976, IEEE Trans. Instrum. Meas. 25, 8)."""
    offset = points.mean(axis=0)
    local = points - offset
    system = np.column_stack([2.0 * local, np.ones(len(local))])
    row, col, rest = np.linalg.lstsq(system, np.sum(local**2, axis=1))[0]
    radius = float(np.sqrt(max(rest + row * row + col * col, 0.0)))
    return ContactCircle(float(row + offset[0]), float(col + offset[1]), radius)
