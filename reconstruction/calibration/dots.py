"""Dots in an image, to a few thousandths of a pixel: grey-level centroids of what is ink."""

from dataclasses import dataclass

import cv2
import numpy as np

from reconstruction.arrays import BoolImage, Doubles, FloatImage
from reconstruction.calibration.boards import Indices

# A smaller blob has too few pixels for its shape to be judged.
MIN_AREA_PX = 40
# The area must be that of the ellipse with the same second moments: within this share.
ELLIPSE_TOLERANCE = 0.12
MIN_AXIS_RATIO = 0.45
# In units of the dot's own ellipse: ink ends inside the first, white lies between the other two.
CENTROID_REACH, RING_INNER, RING_OUTER = 1.25, 1.3, 1.65


@dataclass(frozen=True, eq=False)
class Dots:
    """Dots found in an image.

    Parameters
    ----------
    centres_px : (n, 2) float, centroid of the ink
    areas_px : (n,) float
    moments_px2 : (n, 2, 2) float, second moments of the filled ellipse
    """

    centres_px: Doubles
    areas_px: Doubles
    moments_px2: Doubles

    def chosen(self, keep: Indices) -> "Dots":
        """Return the dots of an index array."""
        return Dots(self.centres_px[keep], self.areas_px[keep], self.moments_px2[keep])


def find_dots(relative: FloatImage, threshold: float) -> Dots:
    """Find dark ellipses in a brightness relative to white; those cut by the border are left out.

    Centres are those of the thresholded blobs; `refine_centres` makes them sub-pixel.
    """
    ink = (relative < threshold).astype(np.uint8)
    count, labels, stats, centroids = cv2.connectedComponentsWithStats(ink, connectivity=4)
    found = [
        (centroids[k], float(stats[k, cv2.CC_STAT_AREA]), moments)
        for k in range(1, count)
        if _inside(stats[k], ink.shape)
        and (moments := _moments(labels, k, stats[k])) is not None
        and _is_ellipse(moments, float(stats[k, cv2.CC_STAT_AREA]))
    ]
    return Dots(
        np.array([entry[0] for entry in found], dtype=np.float64).reshape(-1, 2),
        np.array([entry[1] for entry in found], dtype=np.float64),
        np.array([entry[2] for entry in found], dtype=np.float64).reshape(-1, 2, 2),
    )


def _inside(stats: Doubles, shape: tuple[int, int]) -> bool:
    left, top, width, height, area = stats
    touches = left <= 0 or top <= 0 or left + width >= shape[1] or top + height >= shape[0]
    # Fewer than a quarter of the image: the dark surroundings of the board are no dot.
    return not touches and MIN_AREA_PX <= area <= 0.25 * shape[0] * shape[1]


def _moments(labels: Doubles, label: int, stats: Doubles) -> Doubles | None:
    left, top, width, height, _ = stats
    if not MIN_AXIS_RATIO / 2 < width / height < 2 / MIN_AXIS_RATIO:
        return None
    y, x = np.nonzero(labels[top : top + height, left : left + width] == label)
    return np.cov(np.stack([x, y]).astype(np.float64), bias=True)


def _is_ellipse(moments: Doubles, area: float) -> bool:
    low, high = np.linalg.eigvalsh(moments)
    ellipse_area = 4.0 * np.pi * np.sqrt(max(low * high, 0.0))
    return bool(
        abs(ellipse_area / area - 1.0) < ELLIPSE_TOLERANCE and low > MIN_AXIS_RATIO**2 * high
    )


def refine_centres(relative: FloatImage, dots: Dots) -> tuple[Doubles, BoolImage]:
    """Return grey-level centroids of the ink, (n, 2) px, and which dots have a whole white ring.

    Each dot is compared with a plane of white fitted round it, so that shading does not shift it:
    ink = 1 - brightness / white. The centroid of a uniform ellipse is its centre, whatever
    symmetric blur lies on it.
    """
    centres = dots.centres_px.copy()
    found = np.zeros(len(centres), dtype=np.bool_)
    for k, (start, moments) in enumerate(zip(dots.centres_px, dots.moments_px2, strict=True)):
        centre = _centroid(relative, start, moments)
        if centre is not None:
            centres[k], found[k] = centre, True
    return centres, found


def _centroid(relative: FloatImage, centre: Doubles, moments: Doubles) -> Doubles | None:
    for _ in range(2):  # the window follows the centre once
        window = _window(relative, centre, moments)
        if window is None:
            return None
        x, y, values, reach = window
        ring = (reach > RING_INNER) & (reach < RING_OUTER)
        design = np.column_stack([np.ones(ring.sum()), x[ring], y[ring]])
        plane = np.linalg.lstsq(design, values[ring], rcond=None)[0]
        ink = 1.0 - values / (plane[0] + plane[1] * x + plane[2] * y)
        ink = np.where(reach < CENTROID_REACH, ink, 0.0)
        total = float(ink.sum())
        if not total > 0.0:
            return None
        centre = centre + np.array([np.sum(ink * x), np.sum(ink * y)]) / total
    return centre


def _window(
    relative: FloatImage, centre: Doubles, moments: Doubles
) -> tuple[Doubles, Doubles, Doubles, Doubles] | None:
    """Cut a dot out: x, y from its centre, brightness, distance in units of its ellipse."""
    half = np.ceil(2.0 * RING_OUTER * np.sqrt(np.diag(moments))).astype(int) + 1
    first = np.rint(centre).astype(int) - half
    last = np.rint(centre).astype(int) + half + 1
    if first.min() < 0 or last[0] > relative.shape[1] or last[1] > relative.shape[0]:
        return None
    values = relative[first[1] : last[1], first[0] : last[0]].astype(np.float64)
    x, y = np.meshgrid(np.arange(first[0], last[0]), np.arange(first[1], last[1]))
    x, y = x - centre[0], y - centre[1]
    inverse = np.linalg.inv(moments)
    square = inverse[0, 0] * x * x + 2.0 * inverse[0, 1] * x * y + inverse[1, 1] * y * y
    return x, y, values, 0.5 * np.sqrt(square)
