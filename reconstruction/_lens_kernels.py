"""Camera rays of one image row: the inverse of the lens distortion, pixel by pixel."""

from typing import Any, NamedTuple

import numpy as np

from reconstruction._jit import compiled, inlined
from reconstruction.pinhole import INVERSE_STEPS, distort, distortion_jacobian

# Newton squares the error: a step below 1e-7 leaves far less than 1e-12.
RAY_TOLERANCE = 1e-7

distort_inlined = inlined(distort)
distortion_jacobian_inlined = inlined(distortion_jacobian)


class Lens(NamedTuple):
    """Intrinsics of one device, pixels and OpenCV coefficients."""

    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float]
    is_ideal: bool


@inlined
def _undistort(x_target: float, y_target: float, x: float, y: float, lens: Lens) -> Any:
    """Return (x, y, found) from a start close to the solution."""
    for _ in range(INVERSE_STEPS):
        x_now, y_now = distort_inlined(x, y, lens.distortion)
        xx, xy, yy = distortion_jacobian_inlined(x, y, lens.distortion)
        x_miss, y_miss = x_target - x_now, y_target - y_now
        determinant = xx * yy - xy * xy
        scale = 1.0 / determinant
        dx, dy = scale * (yy * x_miss - xy * y_miss), scale * (xx * y_miss - xy * x_miss)
        x, y = x + dx, y + dy
        if abs(dx) + abs(dy) < RAY_TOLERANCE:
            # Beyond a fold the Jacobian is no longer positive definite: another ray's solution.
            return x, y, xx > 0.0 and determinant > 0.0
    return x, y, False


class Rays(NamedTuple):
    """Rays (x, y, 1) in the camera frame, (row, col), and where the lens has an inverse."""

    x: Any
    y: Any
    found: Any


@compiled
def ray_rows(first_row: int, end_row: int, camera: Lens, rays: Rays) -> None:
    """Write the normalised coordinates of image rows, and whether the lens has an inverse.

    How far the lens bends each ray starts from what it did in the row before: neighbours bend
    alike, and the pixels of a row do not wait for each other.
    """
    width = rays.x.shape[1]
    x_bend, y_bend = np.zeros(width), np.zeros(width)
    x_scale = 1.0 / camera.fx
    for row in range(first_row, end_row):
        y_image = (row - camera.cy) / camera.fy
        for col in range(width):
            x_image = (col - camera.cx) * x_scale
            x, y, found = x_image, y_image, True
            if not camera.is_ideal:
                x, y, found = _undistort(
                    x_image, y_image, x_image + x_bend[col], y_image + y_bend[col], camera
                )
                x_bend[col] = x - x_image if found else 0.0
                y_bend[col] = y - y_image if found else 0.0
            rays.x[row, col], rays.y[row, col], rays.found[row, col] = x, y, found
