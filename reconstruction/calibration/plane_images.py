"""Compute images of a plane: homographies, circles, defocus, and projector coordinates.

Homographies are fitted by the normalised direct linear transformation (Hartley 1997).

**Perspective bias of dots.** The centre of the image of a circle is not the image of the circle's
centre. The dual conic of a circle with the centre c = (a, b, 1) and the radius r in the board plane
is c c^T - r^2 diag(1, 1, 0). A homography H with the columns h1, h2, h3 maps it to
(Hc)(Hc)^T - r^2 (h1 h1^T + h2 h2^T). The centre of the image, an ellipse, is the last column of
this matrix divided by its last element. Heikkila, IEEE PAMI 22, 1066 (2000), corrects the same
bias; dual conics: Hartley and Zisserman, Multiple View Geometry, 2.2.3.

**Defocus.** A tilted board out of focus is displaced from its image through the centre of the lens.
Symbols: f focal length, px; n normal of the board; P a point of the board at the depth Z, in the
camera frame, mm; Z_f the depth in focus; k the mean square of the x coordinate over the pupil (a
quarter of its squared radius), mm^2.

Viewed from the position s on the pupil, the image of P is displaced by s f (1 / Z_f - 1 / Z)
exactly. A surface element at P is viewed from s with an area proportional to n . (P - s), and a
matt surface reflects in proportion to it. Therefore the mean over the pupil, the centroid of a
blurred dot, is displaced by

    b = -k n_xy / (n . P) f (1 / Z_f - 1 / Z).

The mean of a smooth function, such as the phase, over the blurred footprint of a pixel has a
displacement of the same size. It adds, so that the phase measured at the displaced dot has an error
that corresponds to 2 b. For any middle depth Z_m, b is linear in k and in k (1 / Z_f - 1 / Z_m).
These two coefficients are adjusted. The phase is also biased towards brighter parts of the board,
by the variance of the blur times the relative gradient of brightness. This is neglected (rendered
with f/8, 6 mm out of focus: 3e-4 projector pixels).

**Projector coordinates.** The projector coordinates of a feature are computed from the phase of the
white print around it. For a flat board the map from camera to projector pixels is a homography,
except for lens distortion. Moreno and Taubin, 3DIMPVT 2012, fit one homography per corner to
Gray-code integers. Here one homography is fitted to the PHASE of the white pixels of the whole
board. Around each feature a cubic polynomial is fitted to the remaining distortion. Dark ink, with
a weak phase, and mixed edge pixels are excluded.
"""

from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import BoolImage, FloatArray
from reconstruction.calibration.boards import Indices
from reconstruction.decoding.decode import Decoded
from reconstruction.errors import InputError
from reconstruction.rig.pinhole import Pinhole

# Error of the phase that is measured at a dot out of focus, in units of the dot's displacement b.
PHASE_SHARE = 2.0


def apply_homography(H: FloatArray, points: FloatArray) -> FloatArray:
    """Return the points (n, 2) mapped by the homography H (3, 3)."""
    mapped = points @ H[:, :2].T + H[:, 2]
    return np.asarray(mapped[:, :2] / mapped[:, 2:])


def fit_homography(source: FloatArray, target: FloatArray) -> FloatArray:
    """Return the homography H (3, 3) that maps points `source` (n, 2) to `target` (n, 2).

    H is the least squares solution of the direct linear transformation; n must be at least 4.

    Raises
    ------
    InputError : there are fewer than four points, or all are on one line
    """
    if len(source) < 4:
        raise InputError(f"a homography needs 4 points, found {len(source)}")
    scale_source, scale_target = normaliser(source), normaliser(target)
    x, y = apply_homography(scale_source, source).T
    u, v = apply_homography(scale_target, target).T
    zero, ones = np.zeros_like(x), np.ones_like(x)
    upper = np.column_stack([x, y, ones, zero, zero, zero, -u * x, -u * y, -u])
    lower = np.column_stack([zero, zero, zero, x, y, ones, -v * x, -v * y, -v])
    design = np.concatenate([upper, lower])
    # The solution is the eigenvector of the smallest eigenvalue of A^T A, which is 9 x 9.
    values, vectors = np.linalg.eigh(design.T @ design)
    if values[1] < 1e-12 * values[-1]:
        raise InputError("the points of a homography are on one line")
    H = np.linalg.inv(scale_target) @ vectors[:, 0].reshape(3, 3) @ scale_source
    return np.asarray(H / H[2, 2])


def normaliser(points: FloatArray) -> FloatArray:
    """Return the matrix (d + 1, d + 1) that scales points (n, d) to mean 0 and RMS 1.

    It acts on homogeneous coordinates.
    """
    centre = points.mean(axis=0)
    scale = 1.0 / (float(np.sqrt(np.mean((points - centre) ** 2))) or 1.0)
    scaling = np.diag(np.append(np.full(len(centre), scale), 1.0))
    scaling[:-1, -1] = -scale * centre
    return scaling


def ellipse_centres(
    points_dev_mm: FloatArray, radii_mm: FloatArray, rotation: FloatArray
) -> FloatArray:
    """Return the centres (n, 2), normalised coordinates, of the ellipses that circles appear as.

    Parameters
    ----------
    points_dev_mm : (n, 3) float, mm, centres of the circles in the device's frame
    radii_mm : (n,) float, mm, radii of the circles
    rotation : (3, 3) float; its first two columns span the plane of the circles in that frame
    """
    plane = rotation[:, :2] @ rotation[:, :2].T
    shrink = radii_mm**2
    last = points_dev_mm * points_dev_mm[:, 2:] - shrink[:, np.newaxis] * plane[:, 2]
    return np.asarray(last[:, :2] / last[:, 2:])


def centre_bias_px(
    device: Pinhole, points_dev_mm: FloatArray, radii_mm: FloatArray, rotation: FloatArray
) -> FloatArray:
    """Return the centre of each dot's image minus the image of the dot's centre, (n, 2) px.

    The lens distortion is assumed to be constant over one dot; the error is of third order in the
    angular size of the dot. The parameters are those of `ellipse_centres`.
    """
    centres = ellipse_centres(points_dev_mm, radii_mm, rotation)
    homogeneous = np.column_stack([centres, np.ones(len(centres))])
    return device.project(homogeneous) - device.project(points_dev_mm)


def defocus_slopes_px(
    camera: Pinhole, points_cam_mm: FloatArray, normal: FloatArray, middle_mm: float
) -> FloatArray:
    """Return the derivatives of the displacement b, px, by both coefficients of the defocus.

    The result is (n, x and y, coefficient); the coefficients are k and k (1 / Z_f - 1 / Z_m).

    Parameters
    ----------
    camera : intrinsics; the distortion is neglected
    points_cam_mm : (n, 3) float, points of the board, camera frame
    normal : (xyz) float, unit normal of the board, camera frame
    middle_mm : the middle depth Z_m
    """
    focal_px = np.array([camera.fx_px, camera.fy_px])
    slope = -focal_px * normal[:2] / (points_cam_mm @ normal)[:, np.newaxis]
    depth = 1.0 / middle_mm - 1.0 / points_cam_mm[:, 2]
    return np.stack([slope * depth[:, np.newaxis], slope], axis=-1)


GLOBAL_PIXELS, LOCAL_PIXELS = 40_000, 6_000
MIN_LOCAL_PIXELS = 60
# Least share of the white pixels on each side of a feature (left, right, above, below), so that the
# polynomial does not extrapolate.
MIN_HALF_SHARE = 0.25
# Largest deviation, px, of a coordinate from the median around a feature. A wrong fringe order
# deviates by a whole period, lens distortion by far less than this limit.
OUTLIER_PX = 2.0


@dataclass(frozen=True, eq=False)
class ProjectorPoints:
    """Projector coordinates of n camera positions on the board, and their local derivatives.

    Parameters
    ----------
    pixels_px : (n, 2) float, projector column and row
    slopes : (n, 2, 2) float, d(projector column, row) / d(camera x, y)
    located : (n,) bool, whether enough decoded pixels are around the position
    """

    pixels_px: FloatArray
    slopes: FloatArray
    located: BoolImage


def projector_points(
    decoded: Decoded, white: BoolImage, features_px: FloatArray, reach_px: float
) -> ProjectorPoints:
    """Return the projector coordinates of the features of a board.

    Parameters
    ----------
    decoded : projector coordinates of the camera pixels
    white : (row, col) bool, True at the pixels to use, those of white print
    features_px : (n, 2) float, camera x, y of the features
    reach_px : half side of the window around each feature, camera px

    Raises
    ------
    InputError : too few white pixels are decoded
    """
    usable = white & decoded.valid
    H = _board_map(decoded, usable)
    count = len(features_px)
    pixels, slopes = apply_homography(H, features_px), _slopes(H, features_px)
    is_located = np.zeros(count, dtype=np.bool_)
    for k, centre in enumerate(features_px):
        local = _local_residual(decoded, usable, H, centre, reach_px)
        if local is not None:
            pixels[k] += local[0]
            slopes[k] += local[1:3].T / reach_px
            is_located[k] = True
    return ProjectorPoints(pixels, slopes, is_located)


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
    coordinates = [axis.coordinate_px[row, col] for axis in (decoded.column, decoded.row)]
    return np.stack(coordinates, axis=-1).astype(np.float64)


def _slopes(H: FloatArray, points: FloatArray) -> FloatArray:
    """Return the Jacobian (n, 2, 2) of the homography H at points (n, 2)."""
    depth = points @ H[2, :2] + H[2, 2]
    mapped = apply_homography(H, points)
    slopes = H[np.newaxis, :2, :2] - mapped[:, :, np.newaxis] * H[2, :2]
    return np.asarray(slopes / depth[:, np.newaxis, np.newaxis])


def _local_residual(
    decoded: Decoded, usable: BoolImage, H: FloatArray, centre: FloatArray, reach_px: float
) -> FloatArray | None:
    """Fit a cubic polynomial to measured minus homography coordinates around a feature.

    Returns its coefficients (10, 2), px, for x, y from `centre` in units of `reach_px`: 1, x, y ...
    None: too few usable pixels, or too few on one side of the feature. Radial distortion is
    cubic, so a quadratic polynomial would be biased in a one-sided window.
    """
    low = np.maximum(np.floor(centre - reach_px), 0).astype(int)
    high = np.ceil(centre + reach_px).astype(int) + 1
    row, col = np.nonzero(usable[low[1] : high[1], low[0] : high[0]])
    if len(row) < MIN_LOCAL_PIXELS:
        return None
    stride = max(1, len(row) // LOCAL_PIXELS)
    row, col = row[::stride] + low[1], col[::stride] + low[0]
    camera = np.column_stack([col, row]).astype(np.float64)
    residual = _coordinates(decoded, row, col) - apply_homography(H, camera)
    good = np.max(np.abs(residual - np.median(residual, axis=0)), axis=1) < OUTLIER_PX
    x, y = ((camera[good] - centre) / reach_px).T
    shares = [np.mean(x > 0.0), np.mean(y > 0.0)]
    if min(shares) < MIN_HALF_SHARE or max(shares) > 1.0 - MIN_HALF_SHARE:
        return None
    cubic = (x * x * x, x * x * y, x * y * y, y * y * y)
    design = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y, *cubic])
    # The normal equations are well conditioned, because |x| and |y| are at most about 1. They take
    # 5 % of the time of an SVD of all rows.
    return np.asarray(np.linalg.lstsq(design.T @ design, design.T @ residual[good], rcond=None)[0])
