"""Pinhole with Brown-Conrady distortion, in OpenCV's frame: x right, y down, z forward, mm.

Pixel (0, 0) is the CENTRE of the first pixel. Normalised coordinates are (x / z, y / z).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from reconstruction.arrays import Doubles
from reconstruction.checks import require_integer, require_number
from reconstruction.errors import InputError

NO_DISTORTION = (0.0, 0.0, 0.0, 0.0, 0.0)
# Newton doubles the digits per step: 1e-12 leaves the returned point far below the 1e-10 promised.
INVERSE_TOLERANCE = 1e-12
INVERSE_STEPS = 30


def distort(x: Any, y: Any, distortion: tuple[float, ...]) -> tuple[Any, Any]:
    """Return the distorted normalised coordinates (OpenCV, Brown 1966); scalars or arrays."""
    k1, k2, p1, p2, k3 = distortion
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    x_distorted = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    y_distorted = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    return x_distorted, y_distorted


def distortion_jacobian(x: Any, y: Any, distortion: tuple[float, ...]) -> tuple[Any, Any, Any]:
    """Return d(xd)/dx, d(xd)/dy = d(yd)/dx and d(yd)/dy of `distort`; the matrix is symmetric."""
    k1, k2, p1, p2, k3 = distortion
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2.0 * (k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3))
    xx = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
    xy = slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y
    yy = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
    return xx, xy, yy


@dataclass(frozen=True)
class Pinhole:
    """Intrinsics of a camera or of a projector; the principal point may lie off the image.

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
            require_number(f"pinhole {name}", getattr(self, name), 0.0, open_low=True)
        for name in ("cx_px", "cy_px"):
            require_number(f"pinhole {name}", getattr(self, name), -1e9)
        if not isinstance(self.distortion, tuple) or len(self.distortion) != 5:
            raise InputError(
                f"pinhole distortion is {self.distortion!r}; give the five numbers k1 k2 p1 p2 k3"
            )
        for value in self.distortion:
            require_number("pinhole distortion", value, -1e9)

    def project(self, points_dev_mm: ArrayLike) -> Doubles:
        """Return the pixels where points in this device's frame appear.

        Parameters
        ----------
        points_dev_mm : (..., 3) float, mm, all with z > 0

        Returns
        -------
        (..., 2) float, px; also outside the image

        Raises
        ------
        InputError : a point lies beside or behind the device
        """
        points = np.asarray(points_dev_mm, dtype=np.float64)
        if points.ndim == 0 or points.shape[-1] != 3:
            raise InputError(f"points to project have shape {points.shape}; give (..., 3)")
        if not bool(np.all(points[..., 2] > 0.0)):
            raise InputError("a point to project has z <= 0; it must lie in front of the device")
        x, y = distort(
            points[..., 0] / points[..., 2], points[..., 1] / points[..., 2], self.distortion
        )
        return np.stack([self.fx_px * x + self.cx_px, self.fy_px * y + self.cy_px], axis=-1)

    def unproject(self, pixels_px: ArrayLike) -> Doubles:
        """Return the normalised coordinates seen at pixels, the inverse of `project`.

        Parameters
        ----------
        pixels_px : (..., 2) float, px

        Returns
        -------
        (..., 2) float, accurate to 1e-10

        Raises
        ------
        InputError : the distortion has no inverse at a pixel
        """
        pixels = np.asarray(pixels_px, dtype=np.float64)
        if pixels.ndim == 0 or pixels.shape[-1] != 2:
            raise InputError(f"pixels to unproject have shape {pixels.shape}; give (..., 2)")
        x_target = (pixels[..., 0] - self.cx_px) / self.fx_px
        y_target = (pixels[..., 1] - self.cy_px) / self.fy_px
        return np.stack(self._undistort(x_target, y_target), axis=-1)

    def _undistort(self, x_target: Doubles, y_target: Doubles) -> tuple[Doubles, Doubles]:
        x, y = x_target.copy(), y_target.copy()
        dx, dy = np.zeros_like(x), np.zeros_like(y)
        # A folding distortion throws the iteration to infinity: that ends in the error below.
        with np.errstate(over="ignore", invalid="ignore"):
            for _ in range(INVERSE_STEPS):
                dx, dy = _newton_step(x, y, x_target, y_target, self.distortion)
                x, y = x + dx, y + dy
                if float(np.max(np.hypot(dx, dy), initial=0.0)) < INVERSE_TOLERANCE:
                    break
            xx, xy, yy = distortion_jacobian(x, y, self.distortion)
            # Beyond a fold the Jacobian is no longer positive definite: another ray's solution.
            converged = np.hypot(dx, dy) < INVERSE_TOLERANCE
            if bool(np.all(converged & (xx > 0.0) & (xx * yy > xy * xy))):
                return x, y
        raise InputError(
            f"distortion {self.distortion} has no inverse at some of the pixels; "
            "it folds the image there: fit fewer coefficients or stay inside the calibrated field"
        )


def _newton_step(
    x: Doubles, y: Doubles, x_target: Doubles, y_target: Doubles, distortion: tuple[float, ...]
) -> tuple[Doubles, Doubles]:
    x_now, y_now = distort(x, y, distortion)
    xx, xy, yy = distortion_jacobian(x, y, distortion)
    determinant = np.where(xx * yy - xy * xy == 0.0, np.inf, xx * yy - xy * xy)
    x_miss, y_miss = x_target - x_now, y_target - y_now
    return (yy * x_miss - xy * y_miss) / determinant, (xx * y_miss - xy * x_miss) / determinant
