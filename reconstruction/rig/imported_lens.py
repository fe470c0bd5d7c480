"""Lens of a device as in a calibration file of another program, and its fit by five coefficients.

The centre of the first pixel is (0, 0), except in the files of MATLAB's calibrator. There it is
(1, 1), and the camera matrix multiplies row vectors from the right.
"""

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from scipy.optimize import least_squares

from reconstruction.arrays import FloatArray
from reconstruction.errors import InputError
from reconstruction.rig.named_numbers import (
    COEFFICIENTS,
    DISTORTION,
    HEIGHTS,
    MATRIX,
    SHAPES,
    SIZES,
    WIDTHS,
    NamedNumbers,
    plain,
)
from reconstruction.rig.pinhole import Pinhole

MOST_REFIT_PX = 0.05
"""Largest allowed error, px, of the fit of a lens model by k1, k2, p1, p2, k3 without skew."""

# Grid of points (columns, rows) of the lens fit.
_GRID = (41, 31)


@dataclass(frozen=True, eq=False)
class ImportedLens:
    """Lens of a device as in the file: camera matrix with skew, any number of coefficients.

    Parameters
    ----------
    matrix : (3, 3) camera matrix, px
    distortion : (n,) coefficients in OpenCV's order, n = 4, 5, 8, 12 or 14
    size : image size (width, height), px; None: it is not in the file
    """

    matrix: FloatArray
    distortion: FloatArray
    size: tuple[int, int] | None

    def pinhole(self, name: str, size: tuple[int, int] | None) -> tuple[Pinhole, float]:
        """Return a pinhole with five coefficients without skew, and its largest deviation, px.

        If the lens has another model, the pinhole is fitted to the lens.
        """
        size = size or self.size
        if size is None:
            raise InputError(f"the {name}'s image size is not in the file; give --{name}-size")
        k = self.matrix
        fx, fy, cx, cy = (float(k[place]) for place in ((0, 0), (1, 1), (0, 2), (1, 2)))
        ideal = Pinhole(size[0], size[1], fx, fy, cx, cy)
        if k[0, 1] == 0.0 and not np.any(self.distortion[5:]):
            five = np.zeros(5)
            five[: self.distortion.size] = self.distortion[:5]
            return replace(ideal, distortion=_five(five)), 0.0
        return _refitted(name, ideal, self)


def _five(values: FloatArray) -> tuple[float, float, float, float, float]:
    k1, k2, p1, p2, k3 = (float(value) for value in values)
    return (k1, k2, p1, p2, k3)


def _refitted(name: str, start: Pinhole, lens: ImportedLens) -> tuple[Pinhole, float]:
    """Fit a pinhole with five coefficients to a lens; return it and its largest deviation, px.

    The fit minimises the distances, px, on a grid of points over the image.
    """
    u, v = np.meshgrid(
        *(
            np.linspace(0, n - 1, m)
            for n, m in zip((start.width_px, start.height_px), _GRID, strict=True)
        )
    )
    pixels = np.stack((u.ravel(), v.ravel()), axis=-1)
    k = lens.matrix
    y = (pixels[:, 1] - k[1, 2]) / k[1, 1]
    x = (pixels[:, 0] - k[0, 2] - k[0, 1] * y) / k[0, 0]
    eye = np.eye(3)
    enough = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-12)
    places = np.stack((x, y), axis=-1)[:, np.newaxis]
    rays = cv2.undistortPoints(places, eye, lens.distortion, None, eye, eye, enough)[:, 0]
    points = np.column_stack((rays, np.ones(len(rays))))

    def pinhole(values: FloatArray) -> Pinhole:
        fx, fy, cx, cy = (float(value) for value in values[:4])
        changed = replace(start, fx_px=fx, fy_px=fy, cx_px=cx, cy_px=cy)
        return replace(changed, distortion=_five(values[4:]))

    def residual_px(values: FloatArray) -> FloatArray:
        missed: FloatArray = (pinhole(values).project(points) - pixels).ravel()
        return missed

    begin = np.array([start.fx_px, start.fy_px, start.cx_px, start.cy_px, 0.0, 0.0, 0.0, 0.0, 0.0])
    if not np.all(np.isfinite(residual_px(begin))):
        raise InputError(
            f"the {name}'s lens has no rays in parts of its image; found {lens.distortion.tolist()}"
        )
    solved: Any = least_squares(residual_px, begin, x_scale="jac", xtol=1e-14, ftol=1e-14)
    largest = float(np.abs(residual_px(solved.x)).max())
    if not largest <= MOST_REFIT_PX:
        raise InputError(
            f"the {name}'s lens ({lens.distortion.size} coefficients, skew {k[0, 1]:g}) differs by "
            f"{largest:.2g} px from the best fit of k1, k2, p1, p2, k3 without skew; allowed "
            f"{MOST_REFIT_PX:g}; calibrate with these five"
        )
    return pinhole(solved.x), largest


def read_lens(names: NamedNumbers, device: str) -> ImportedLens:
    """Return the lens of a device, "camera" or "projector", from the numbers of the files.

    Raises
    ------
    InputError : the camera matrix or the distortion is missing, or the matrix has another form
    """
    stored = names.of_device(device, "matrix", MATRIX, {9})
    first_px = 0.0
    if stored is not None:
        stored = stored.reshape(3, 3)
        is_matlab = "cameraparameters" in plain(names.used[f"{device} {MATRIX[0]}"])
        first_px = 1.0 if is_matlab else 0.0
        matrix = stored.T if stored[2, 0] != 0.0 else stored
    else:
        matrix = _of_toolbox(names, device)
    if not np.allclose(matrix[[1, 2, 2, 2], [0, 0, 1, 2]], (0.0, 0.0, 0.0, 1.0)):
        raise InputError(f"the camera matrix of the {device} is {matrix.tolist()}")
    matrix = matrix - np.array([[0, 0, first_px], [0, 0, first_px], [0, 0, 0]])
    return ImportedLens(matrix, _distortion(names, device), _size(names, device))


def _of_toolbox(names: NamedNumbers, device: str) -> FloatArray:
    focal = names.of_device(device, "", ("fc",), {2})
    centre = names.of_device(device, "", ("cc",), {2})
    if focal is None or centre is None:
        raise names.missing(f"camera matrix of the {device}", f"{device}_matrix", {9})
    (fx, fy), (cx, cy) = focal.ravel(), centre.ravel()
    skew = names.of_device(device, "", ("alphac",), {1})
    return np.array([[fx, 0.0 if skew is None else float(skew) * fx, cx], [0, fy, cy], [0, 0, 1]])


def _distortion(names: NamedNumbers, device: str) -> FloatArray:
    coefficients = names.of_device(device, "distortion", DISTORTION, COEFFICIENTS)
    if coefficients is not None:
        return coefficients.ravel()
    radial = names.of_device(device, "", ("radialdistortion",), {2, 3})
    tangential = names.of_device(device, "", ("tangentialdistortion",), {2})
    if radial is None:
        counts = ", ".join(map(str, COEFFICIENTS))
        raise names.missing(
            f"distortion of the {device} ({counts} coefficients)",
            f"{device}_distortion",
            COEFFICIENTS,
        )
    bent = np.zeros(2) if tangential is None else tangential.ravel()
    return np.concatenate((radial.ravel()[:2], bent, radial.ravel()[2:]))


def _size(names: NamedNumbers, device: str) -> tuple[int, int] | None:
    width = names.of_device(device, "width", WIDTHS, {1})
    height = names.of_device(device, "height", HEIGHTS, {1})
    if width is not None and height is not None:
        return int(width.item()), int(height.item())
    for quantity, usual in (("size", SIZES), ("shape", SHAPES)):
        both = names.of_device(device, quantity, usual, {2})
        if both is not None:
            first, second = (int(value) for value in both.ravel())
            is_matlab = "cameraparameters" in plain(names.used[f"{device} {usual[0]}"])
            return (second, first) if quantity == "shape" or is_matlab else (first, second)
    return None
