"""How a plane appears in an image: homographies, circles, and what lies out of focus.

Homographies are fitted by the normalised direct linear transformation (Hartley 1997).

A circle's image has its centre not where the circle's centre is imaged. The dual conic of a circle
with centre c = (a, b, 1) and radius r in the board plane is c c^T - r^2 diag(1, 1, 0); a homography
H maps it to (Hc)(Hc)^T - r^2 (h1 h1^T + h2 h2^T), and the centre of the image ellipse is its last
column over its last element. (Heikkila, IEEE PAMI 22, 1066 (2000), corrects the same bias; dual
form: Hartley and Zisserman, Multiple View Geometry, 2.2.3.)

A tilted board out of focus appears not quite where the lens's centre sees it. Symbols: f focal
length, px; n normal of the board, P a point of it at the depth Z, camera frame, mm; Z_f depth in
focus; k mean square of the pupil's x (a quarter of its squared radius), mm^2.

A place s of the pupil sees the point displaced by s f (1 / Z_f - 1 / Z), exactly, and a piece of
the board there as an area proportional to n . (P - s), as a matt board sends its light. The mean
over the pupil is therefore displaced by

    b = -k n_xy / (n . P) f (1 / Z_f - 1 / Z),

the centroid of a blurred dot. The mean of a smooth function, such as the phase, over what one pixel
gathers is displaced alike and in the same sense, so that the phase read at the displaced dot is off
by twice b. It is linear in k and in k (1 / Z_f - 1 / Z_m) for any middle depth Z_m: these two are
adjusted. Left out: the phase also leans towards where the board is brighter, by the blur's variance
times the relative gradient (rendered with f/8, 6 mm out of focus: 3e-4 projector pixels).
"""

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import InputError
from reconstruction.rig.pinhole import Pinhole

# Displacement of the phase read at a dot, over that of the dot.
PHASE_SHARE = 2.0


def apply_homography(H: FloatArray, points: FloatArray) -> FloatArray:
    """Map points (n, 2) by H (3, 3)."""
    mapped = points @ H[:, :2].T + H[:, 2]
    return np.asarray(mapped[:, :2] / mapped[:, 2:])


def fit_homography(source: FloatArray, target: FloatArray) -> FloatArray:
    """Return the H (3, 3) that maps source (n, 2) to target (n, 2), n >= 4, least squares.

    Raises
    ------
    InputError : fewer than four points, or all on one line
    """
    if len(source) < 4:
        raise InputError(f"a homography needs 4 points, found {len(source)}")
    scale_source, scale_target = _normaliser(source), _normaliser(target)
    x, y = apply_homography(scale_source, source).T
    u, v = apply_homography(scale_target, target).T
    zero, one = np.zeros_like(x), np.ones_like(x)
    upper = np.column_stack([x, y, one, zero, zero, zero, -u * x, -u * y, -u])
    lower = np.column_stack([zero, zero, zero, x, y, one, -v * x, -v * y, -v])
    design = np.concatenate([upper, lower])
    # The eigenvector of the smallest eigenvalue of A^T A: 9 x 9 however many points there are.
    values, vectors = np.linalg.eigh(design.T @ design)
    if values[1] < 1e-12 * values[-1]:
        raise InputError("the points of a homography lie on one line")
    H = np.linalg.inv(scale_target) @ vectors[:, 0].reshape(3, 3) @ scale_source
    return np.asarray(H / H[2, 2])


def _normaliser(points: FloatArray) -> FloatArray:
    centre = points.mean(axis=0)
    spread = float(np.sqrt(np.mean((points - centre) ** 2)))
    scale = 1.0 / spread if spread > 0.0 else 1.0
    return np.array(
        [[scale, 0.0, -scale * centre[0]], [0.0, scale, -scale * centre[1]], [0.0, 0.0, 1.0]]
    )


def ellipse_centres(
    points_dev_mm: FloatArray, radii_mm: FloatArray, rotation: FloatArray
) -> FloatArray:
    """Return the centres of the images of flat circles, normalised coordinates, (n, 2).

    Parameters
    ----------
    points_dev_mm : (n, 3) float, mm, circle centres in the device's frame
    radii_mm : (n,) float, mm
    rotation : (3, 3) float, its first two columns span the circles' plane in that frame
    """
    plane = rotation[:, :2] @ rotation[:, :2].T
    shrink = radii_mm**2
    last = points_dev_mm * points_dev_mm[:, 2:] - shrink[:, np.newaxis] * plane[:, 2]
    return np.asarray(last[:, :2] / last[:, 2:])


def centre_bias_px(
    device: Pinhole, points_dev_mm: FloatArray, radii_mm: FloatArray, rotation: FloatArray
) -> FloatArray:
    """Return ellipse centre minus imaged circle centre, (n, 2) px.

    The lens distortion moves both alike; its change over one dot is left out (third order in the
    dot's angular size).
    """
    centres = ellipse_centres(points_dev_mm, radii_mm, rotation)
    homogeneous = np.column_stack([centres, np.ones(len(centres))])
    return device.project(homogeneous) - device.project(points_dev_mm)


def defocus_slopes_px(
    camera: Pinhole, points_cam_mm: FloatArray, normal: FloatArray, middle_mm: float
) -> FloatArray:
    """Return the derivatives of b by both coefficients, (n, 2, 2): x and y px, coefficient.

    Parameters
    ----------
    camera : distortion is left out
    points_cam_mm : (n, 3) float
    normal : (xyz) float, unit normal of the board, camera frame
    middle_mm : Z_m
    """
    focal_px = np.array([camera.fx_px, camera.fy_px])
    slope = -focal_px * normal[:2] / (points_cam_mm @ normal)[:, np.newaxis]
    depth = 1.0 / middle_mm - 1.0 / points_cam_mm[:, 2]
    return np.stack([slope * depth[:, np.newaxis], slope], axis=-1)
