"""Pinhole model with Brown-Conrady distortion, in OpenCV's frame: x right, y down, z forward, mm.

Pixel (0, 0) is the CENTRE of the first pixel. Normalised coordinates are (x / z, y / z).

A model with barrel distortion folds the image: beyond some field angle, the fold, the distorted
radius decreases again. Points beyond the fold are not visible. Image points at a larger radius than
the image of the fold have no ray. The distortion is inverted by Newton's method, with the same step
in numpy, in the compiled kernels and in the renderer.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from reconstruction.arrays import BoolImage, FloatArray
from reconstruction.errors import InputError, require_integer, require_number

NO_DISTORTION = (0.0, 0.0, 0.0, 0.0, 0.0)
# Newton's method doubles the number of exact digits per step: after a step below 1e-12 the error is
# far below 1e-10.
INVERSE_TOLERANCE = 1e-12
INVERSE_STEPS = 30
# A fold more than a million focal lengths off axis is ignored.
LEAST_INVERSE = 1e-12
# Limits that no device reaches; numbers outside of them would overflow in the calculation.
LEAST_FOCAL_PX, MOST_PX = 1e-3, 1e9
# Twelve halvings give a precision of 1/4096 of the distance from the image's centre to a corner.
CORNER_HALVINGS = 12


def distort(x: Any, y: Any, distortion: tuple[float, ...]) -> tuple[Any, Any]:
    """Return the distorted coordinates of normalised coordinates x, y: scalars or arrays.

    The model is that of OpenCV (Brown 1966), with the coefficients k1, k2, p1, p2, k3.
    """
    k1, k2, p1, p2, k3 = distortion
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    x_distorted = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    y_distorted = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    return x_distorted, y_distorted


def distortion_jacobian(x: Any, y: Any, distortion: tuple[float, ...]) -> tuple[Any, Any, Any]:
    """Return the Jacobian of `distort`, which is symmetric: d(xd)/dx, d(xd)/dy, d(yd)/dy.

    (xd, yd) are the distorted coordinates of the normalised coordinates (x, y).
    """
    k1, k2, p1, p2, k3 = distortion
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2.0 * (k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3))
    xx = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
    xy = slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y
    yy = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
    return xx, xy, yy


def newton_step(
    x_residual: Any, y_residual: Any, jacobian: tuple[Any, Any, Any]
) -> tuple[Any, Any]:
    """Return the Newton step in x and y, which to first order makes the residuals 0.

    The residuals are target minus distorted coordinates; `jacobian` is the result of
    `distortion_jacobian`.
    """
    xx, xy, yy = jacobian
    scale = 1.0 / (xx * yy - xy * xy)
    return scale * (yy * x_residual - xy * y_residual), scale * (xx * y_residual - xy * x_residual)


def is_before_fold(x: Any, y: Any, jacobian: tuple[Any, Any, Any], fold_square: float) -> Any:
    """Return True if the distorted radius increases all the way from the centre to (x, y).

    Beyond a fold the Jacobian is not positive definite. Beyond a second fold the Jacobian is
    positive definite again, but there x^2 + y^2 exceeds `fold_square`.

    Parameters
    ----------
    x, y : normalised coordinates, scalars or arrays
    jacobian : result of `distortion_jacobian` at (x, y)
    fold_square : result of the function `fold_square`
    """
    xx, xy, yy = jacobian
    return (xx > 0.0) & (xx * yy > xy * xy) & (x * x + y * y < fold_square)


def fold_square(distortion: tuple[float, ...]) -> float:
    """Return the squared normalised radius of the first fold of the radial part; inf: no fold.

    It is the least s = r^2 > 0 with d(r radial)/dr = 1 + 3 k1 s + 5 k2 s^2 + 7 k3 s^3 = 0. The
    equation is solved for 1 / s.
    """
    k1, k2, _, _, k3 = distortion
    roots = np.roots([1.0, 3.0 * k1, 5.0 * k2, 7.0 * k3])
    real = roots.real[np.abs(roots.imag) <= 1e-9 * np.abs(roots)]
    largest = float(np.max(real, initial=0.0))
    return 1.0 / largest if largest > LEAST_INVERSE else np.inf


@dataclass(frozen=True)
class Pinhole:
    """Intrinsics of a camera or of a projector; the principal point may be outside the image.

    Parameters
    ----------
    width_px, height_px : image size
    fx_px, fy_px : focal lengths
    cx_px, cy_px : principal point
    distortion : k1, k2, p1, p2, k3 in OpenCV's order
    """

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: tuple[float, float, float, float, float] = NO_DISTORTION

    def __post_init__(self) -> None:
        require_integer("pinhole width_px", self.width_px, 1, 1_000_000)
        require_integer("pinhole height_px", self.height_px, 1, 1_000_000)
        for name in ("fx_px", "fy_px"):
            require_number(f"pinhole {name}", getattr(self, name), LEAST_FOCAL_PX, MOST_PX)
        for name in ("cx_px", "cy_px"):
            require_number(f"pinhole {name}", getattr(self, name), -MOST_PX, MOST_PX)
        if not isinstance(self.distortion, tuple) or len(self.distortion) != 5:
            raise InputError(
                f"pinhole distortion is {self.distortion!r}; give the five numbers k1 k2 p1 p2 k3"
            )
        for value in self.distortion:
            require_number("pinhole distortion", value, -1e9, 1e9)

    def project(self, points_dev_mm: ArrayLike) -> FloatArray:
        """Return the image positions, px, of points in this device's frame.

        Parameters
        ----------
        points_dev_mm : (..., 3) float, mm, all with z > 0

        Returns
        -------
        (..., 2) float, px: column and row; also of points outside the image

        Raises
        ------
        InputError : a point is not in front of the device
        """
        points = np.asarray(points_dev_mm, dtype=np.float64)
        if points.ndim == 0 or points.shape[-1] != 3:
            raise InputError(f"points to project have shape {points.shape}; give (..., 3)")
        if not bool(np.all(points[..., 2] > 0.0)):
            raise InputError("a point to project has z <= 0; it must be in front of the device")
        x, y = distort(
            points[..., 0] / points[..., 2], points[..., 1] / points[..., 2], self.distortion
        )
        return np.stack([self.fx_px * x + self.cx_px, self.fy_px * y + self.cy_px], axis=-1)

    def unproject(self, pixels_px: ArrayLike) -> FloatArray:
        """Return the normalised coordinates of image positions, the inverse of `project`.

        Parameters
        ----------
        pixels_px : (..., 2) float, px: column and row

        Returns
        -------
        (..., 2) float: x / z and y / z, accurate to 1e-10

        Raises
        ------
        InputError : the distortion has no inverse at a pixel
        """
        pixels = np.asarray(pixels_px, dtype=np.float64)
        if pixels.ndim == 0 or pixels.shape[-1] != 2:
            raise InputError(f"pixels to unproject have shape {pixels.shape}; give (..., 2)")
        rays, has_ray = self._rays(pixels)
        if not has_ray.all():
            raise InputError(
                f"distortion {self.distortion} has no inverse at some of the pixels; "
                "it folds the image there: fit fewer coefficients or stay inside the calibrated "
                "field"
            )
        return rays

    def seen_corners(self) -> FloatArray:
        """Return the normalised coordinates at the four corners of the image, (4, 2).

        The order is top left, top right, bottom right, bottom left. A corner without a ray is
        replaced by the last point with a ray on the line from the image's centre to the corner.

        Raises
        ------
        InputError : the distortion has no inverse at the image's centre
        """
        right, bottom = self.width_px - 0.5, self.height_px - 0.5
        corners = np.array([[-0.5, -0.5], [right, -0.5], [right, bottom], [-0.5, bottom]])
        centre = corners.mean(axis=0)
        low, high = self._rays(corners)[1].astype(float)[:, np.newaxis], np.ones((4, 1))
        for _ in range(CORNER_HALVINGS):
            middle = (low + high) / 2.0
            has_ray = self._rays(centre + middle * (corners - centre))[1][:, np.newaxis]
            low, high = np.where(has_ray, middle, low), np.where(has_ray, high, middle)
        return self.unproject(centre + low * (corners - centre))

    def _rays(self, pixels_px: FloatArray) -> tuple[FloatArray, BoolImage]:
        """Return normalised coordinates (..., 2) and a mask (...), True where they exist."""
        x_target = (pixels_px[..., 0] - self.cx_px) / self.fx_px
        y_target = (pixels_px[..., 1] - self.cy_px) / self.fy_px
        x, y, close = x_target, y_target, np.zeros(x_target.shape, np.bool_)
        # Beyond a fold the iteration may diverge, also to infinity.
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            for _ in range(INVERSE_STEPS):
                x_now, y_now = distort(x, y, self.distortion)
                jacobian = distortion_jacobian(x, y, self.distortion)
                dx, dy = newton_step(x_target - x_now, y_target - y_now, jacobian)
                x, y, close = x + dx, y + dy, np.hypot(dx, dy) < INVERSE_TOLERANCE
                if close.all():
                    break
            jacobian = distortion_jacobian(x, y, self.distortion)
            before = is_before_fold(x, y, jacobian, fold_square(self.distortion))
        return np.stack([x, y], axis=-1), np.asarray(close & before)
