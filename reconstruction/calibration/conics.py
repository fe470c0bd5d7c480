"""Where a circle's image has its centre: not where the circle's centre is imaged.

The dual conic of a circle with centre c = (a, b, 1) and radius r in the board plane is
c c^T - r^2 diag(1, 1, 0); a homography H maps it to (Hc)(Hc)^T - r^2 (h1 h1^T + h2 h2^T), and the
centre of the image ellipse is its last column over its last element. (Heikkila, IEEE PAMI 22, 1066
(2000), corrects the same bias; dual form: Hartley and Zisserman, Multiple View Geometry, 2.2.3.)
"""

import numpy as np

from reconstruction.arrays import Doubles
from reconstruction.rig.pinhole import Pinhole


def ellipse_centres(points_dev_mm: Doubles, radii_mm: Doubles, rotation: Doubles) -> Doubles:
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
    device: Pinhole, points_dev_mm: Doubles, radii_mm: Doubles, rotation: Doubles
) -> Doubles:
    """Return ellipse centre minus imaged circle centre, (n, 2) px.

    The lens distortion moves both alike; its change over one dot is left out (third order in the
    dot's angular size).
    """
    centres = ellipse_centres(points_dev_mm, radii_mm, rotation)
    homogeneous = np.column_stack([centres, np.ones(len(centres))])
    return device.project(homogeneous) - device.project(points_dev_mm)
