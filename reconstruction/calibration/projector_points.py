"""Projector coordinates at board features, from the phase of the white print around them.

The map from camera to projector pixels is a homography for a flat board, but for lens distortion
(Moreno and Taubin, 3DIMPVT 2012, fit one per corner to Gray-code integers). Here it is fitted to
the PHASE of the white pixels of the whole board, and round each feature a cubic of what is left
follows the distortion: dark ink, which has little phase, and mixed edge pixels take no part.
"""

from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import BoolImage, FloatArray
from reconstruction.calibration.boards import Indices
from reconstruction.calibration.plane_images import apply_homography, fit_homography
from reconstruction.decoding.decode import Decoded
from reconstruction.errors import InputError

GLOBAL_PIXELS, LOCAL_PIXELS = 40_000, 6_000
MIN_LOCAL_PIXELS = 60
# Left, right, above and below a feature lies at least this share of the white pixels each: no
# extrapolation.
MIN_HALF_SHARE = 0.25
# A wrong fringe order is a whole period off; the distortion of the board's map is far less.
OUTLIER_PX = 2.0


@dataclass(frozen=True, eq=False)
class ProjectorPoints:
    """The local camera-to-projector map at n features.

    Parameters
    ----------
    pixels_px : (n, 2) float, projector column and row
    slopes : (n, 2, 2) float, d(column, row) / d(camera x, y)
    found : (n,) bool
    """

    pixels_px: FloatArray
    slopes: FloatArray
    found: BoolImage


def projector_points(
    decoded: Decoded, white: BoolImage, features_px: FloatArray, reach_px: float
) -> ProjectorPoints:
    """Return the projector coordinates of camera positions.

    Parameters
    ----------
    decoded : projector coordinates of the camera pixels
    white : (row, col) bool, the pixels to use
    features_px : (n, 2) float, camera x, y
    reach_px : half side of the window round each feature

    Raises
    ------
    InputError : hardly any white pixel is decoded
    """
    usable = white & decoded.valid
    H = _board_map(decoded, usable)
    count = len(features_px)
    pixels, slopes = apply_homography(H, features_px), _slopes(H, features_px)
    found = np.zeros(count, dtype=np.bool_)
    for k, centre in enumerate(features_px):
        local = _local_residual(decoded, usable, H, centre, reach_px)
        if local is not None:
            pixels[k] += local[0]
            slopes[k] += local[1:3].T / reach_px
            found[k] = True
    return ProjectorPoints(pixels, slopes, found)


def _board_map(decoded: Decoded, usable: BoolImage) -> FloatArray:
    row, col = np.nonzero(usable)
    if len(row) < 1000:
        raise InputError(
            f"only {len(row)} white pixels of the board are decoded; needed are 1000: "
            "check the projector's aim, focus and the exposure"
        )
    stride = max(1, len(row) // GLOBAL_PIXELS)
    row, col = row[::stride], col[::stride]
    camera = np.column_stack([col, row]).astype(np.float64)
    projector = _coordinates(decoded, row, col)
    H = fit_homography(camera, projector)
    near = np.max(np.abs(apply_homography(H, camera) - projector), axis=1) < 10.0 * OUTLIER_PX
    return fit_homography(camera[near], projector[near]) if near.sum() >= 1000 else H


def _coordinates(decoded: Decoded, row: Indices, col: Indices) -> FloatArray:
    found = [axis.coordinate_px[row, col] for axis in (decoded.column, decoded.row)]
    return np.stack(found, axis=-1).astype(np.float64)


def _slopes(H: FloatArray, points: FloatArray) -> FloatArray:
    """Return the derivative of the homography at points, (n, 2, 2)."""
    depth = points @ H[2, :2] + H[2, 2]
    mapped = apply_homography(H, points)
    slopes = H[np.newaxis, :2, :2] - mapped[:, :, np.newaxis] * H[2, :2]
    return np.asarray(slopes / depth[:, np.newaxis, np.newaxis])


def _local_residual(
    decoded: Decoded, usable: BoolImage, H: FloatArray, centre: FloatArray, reach_px: float
) -> FloatArray | None:
    """Fit a cubic (1, x, y, ...) to what the homography leaves: coefficients (10, 2) at reach 1.

    Radial distortion is a cubic: a quadratic would lean where the window is one-sided.
    """
    low = np.maximum(np.floor(centre - reach_px), 0).astype(int)
    high = np.ceil(centre + reach_px).astype(int) + 1
    row, col = np.nonzero(usable[low[1] : high[1], low[0] : high[0]])
    if len(row) < MIN_LOCAL_PIXELS:
        return None
    stride = max(1, len(row) // LOCAL_PIXELS)
    row, col = row[::stride] + low[1], col[::stride] + low[0]
    camera = np.column_stack([col, row]).astype(np.float64)
    left = _coordinates(decoded, row, col) - apply_homography(H, camera)
    good = np.max(np.abs(left - np.median(left, axis=0)), axis=1) < OUTLIER_PX
    x, y = ((camera[good] - centre) / reach_px).T
    if not _surrounded(x, y):
        return None
    cubic = (x * x * x, x * x * y, x * y * y, y * y * y)
    design = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y, *cubic])
    # Normal equations: well conditioned at reach 1, and 20 times faster than an SVD of all rows.
    return np.asarray(np.linalg.lstsq(design.T @ design, design.T @ left[good], rcond=None)[0])


def _surrounded(x: FloatArray, y: FloatArray) -> bool:
    shares = [np.mean(x > 0.0), np.mean(y > 0.0)]
    return bool(min(shares) >= MIN_HALF_SHARE and max(shares) <= 1.0 - MIN_HALF_SHARE)
