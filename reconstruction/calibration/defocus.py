"""Where a tilted board out of focus appears: not quite where the lens's centre sees it.

Symbols: f focal length, px; n normal of the board, P a point of it at the depth Z, camera frame,
mm; Z_f depth in focus; k mean square of the pupil's x (a quarter of its squared radius), mm^2.

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

from reconstruction.arrays import Doubles
from reconstruction.rig.pinhole import Pinhole

# Displacement of the phase read at a dot, over that of the dot.
PHASE_SHARE = 2.0


def defocus_slopes_px(
    camera: Pinhole, points_cam_mm: Doubles, normal: Doubles, middle_mm: float
) -> Doubles:
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
