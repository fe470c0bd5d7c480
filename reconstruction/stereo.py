"""Triangulate between two cameras: the projector only marks the surface.

A pixel of the first camera and a position in the image of the second camera belong together if they
have the same projector column and row. The position is computed by Newton's method from the
projection of the point that the first camera gives with the projector. Column and row of the second
camera and their derivatives are interpolated bilinearly between its pixels.

The second camera then takes the place of the projector in `triangulate`. Errors of the projector's
lens model have no influence on the result, except by the pose by which the two calibrations are
joined. The standard deviations of the position follow from those of the coordinates of both
cameras: J^-1 diag(sigma_c^2, sigma_r^2) J^-T, with the Jacobian J of column and row by position.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from reconstruction.arrays import BoolImage, FloatArray, FloatImage, Reason
from reconstruction.decoding import AxisDecode, Decoded
from reconstruction.errors import InputError
from reconstruction.rig.calibration import Calibration
from reconstruction.triangulation import EpipolarTolerance, PointMap, triangulate

STEPS = 4
CLOSE_PX = 0.02
"""Largest difference of the projector coordinates of two positions that belong together."""
LEAST_DETERMINANT = 1e-3
"""Least change of area, projector pixels per camera pixel, at which a position is determined."""


@dataclass(frozen=True, eq=False)
class DecodedView:
    """Projector coordinates of one camera, and the rig that consists of it and the projector."""

    decoded: Decoded
    calibration: Calibration


@dataclass(frozen=True, eq=False)
class _Position:
    """Position in the second image of every pixel of the first one.

    Parameters
    ----------
    at_px : (row, col, column and row) position
    miss_px : (row, col, column and row) difference of the projector coordinates, first less second,
        before the last step
    jacobian : (row, col, 2, 2) derivatives of projector column and row by position
    known : (row, col) bool, all four pixels around the position have coordinates
    """

    at_px: FloatArray
    miss_px: FloatArray
    jacobian: FloatArray
    known: BoolImage


def triangulate_cameras(
    first: DecodedView,
    second: DecodedView,
    points: PointMap,
    tolerance: EpipolarTolerance | None = None,
) -> PointMap:
    """Triangulate the pixels of the first camera with the second camera.

    Parameters
    ----------
    points : points of the first camera and the projector, world of `first.calibration`; start of
        the search
    tolerance : as in `triangulate`, in pixels of the second camera

    Returns
    -------
    Points in the world of `first.calibration`; pixels without a partner have the reason NO_POINT

    Raises
    ------
    InputError : one of the cameras has no decoded column or row, or the calibrations have layers
    """
    _check(first, second)
    rig = _rig_of_cameras(first.calibration, second.calibration)
    position = _matched(first.decoded, second.decoded, _start_px(points, rig))
    decoded = _positions_as_decoded(first.decoded, second.decoded, position)
    return triangulate(decoded, rig, "both", tolerance)


def _check(first: DecodedView, second: DecodedView) -> None:
    for view in (first, second):
        if len(view.decoded.axes) < 2:
            raise InputError(
                "two cameras are triangulated by projector columns and rows; found only "
                f"{view.decoded.axes[0]}s: capture patterns along both axes"
            )
        if view.calibration.layers is not None:
            raise InputError(
                "two cameras are triangulated in air; found a calibration with clear layers: "
                "triangulate each camera with the projector"
            )


def _rig_of_cameras(first: Calibration, second: Calibration) -> Calibration:
    """Return the rig of both cameras, the second one in the place of the projector."""
    T_first_from_second = first.T_world_from_proj @ np.linalg.inv(second.T_world_from_proj)
    pose = T_first_from_second @ second.T_world_from_cam
    return Calibration(first.camera, second.camera, first.T_world_from_cam, pose)


def _start_px(points: PointMap, rig: Calibration) -> FloatArray:
    """Project the points into the second camera, (row, col, 2); pixels without one: -1."""
    T = np.linalg.inv(rig.T_world_from_proj)
    in_second_mm = points.points_world_mm @ T[:3, :3].T + T[:3, 3]
    usable = points.valid & (in_second_mm[..., 2] > 0.0)
    at_px = np.full((*usable.shape, 2), -1.0)
    at_px[usable] = rig.projector.project(in_second_mm[usable])
    return at_px


def _matched(first: Decoded, second: Decoded, at_px: FloatArray) -> _Position:
    """Compute the position in the second image with the projector coordinates of each pixel."""
    target_px = np.stack([first.column.coordinate_px, first.row.coordinate_px], axis=-1)
    maps = [second.column.coordinate_px, second.row.coordinate_px]
    slopes = [np.gradient(image)[::-1] for image in maps]
    outside = (~second.valid).astype(np.float32)
    for _ in range(STEPS):
        here = np.stack([_at(image, at_px) for image in maps], axis=-1)
        rows = [np.stack([_at(slope, at_px) for slope in pair], axis=-1) for pair in slopes]
        position = _Position(
            at_px, target_px - here, np.stack(rows, axis=-2), _at(outside, at_px, 1.0) == 0.0
        )
        at_px = at_px + _newton_step(position)
    return replace(position, at_px=at_px)


def _at(image: FloatImage, at_px: FloatArray, border: float = 0.0) -> FloatArray:
    """Interpolate an image bilinearly at positions (row, col, 2)."""
    x, y = (at_px[..., axis].astype(np.float32) for axis in (0, 1))
    values = cv2.remap(
        np.ascontiguousarray(image, np.float32),
        x,
        y,
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=border,
    )
    return np.asarray(values, np.float64)


def _newton_step(position: _Position) -> FloatArray:
    """Return the step, (row, col, 2) px, that removes the miss to first order, at most 2 px."""
    inverse = _inverse(position.jacobian)
    step = np.einsum("rcij,rcj->rci", inverse, position.miss_px)
    return np.asarray(np.clip(step, -2.0, 2.0))


def _inverse(jacobian: FloatArray) -> FloatArray:
    """Return the inverse of 2 x 2 matrices; 0 where the determinant is too small."""
    (a, b), (c, d) = np.moveaxis(jacobian, (-2, -1), (0, 1))
    determinant = a * d - b * c
    usable = np.abs(determinant) > LEAST_DETERMINANT
    scale = np.divide(1.0, determinant, out=np.zeros_like(determinant), where=usable)
    adjugate = np.stack([np.stack([d, -b], axis=-1), np.stack([-c, a], axis=-1)], axis=-2)
    return np.asarray(adjugate * scale[..., np.newaxis, np.newaxis])


def _positions_as_decoded(first: Decoded, second: Decoded, position: _Position) -> Decoded:
    """Return the positions as if the second camera were the projector."""
    inverse = _inverse(position.jacobian)
    close = np.all(np.abs(position.miss_px) < CLOSE_PX, axis=-1)
    usable = first.valid & position.known & close & np.any(inverse != 0.0, axis=(-2, -1))
    variance = [
        axis.sigma_px.astype(np.float64) ** 2 + _at(other.sigma_px, position.at_px) ** 2
        for axis, other in ((first.column, second.column), (first.row, second.row))
    ]
    spread_px = np.sqrt(np.einsum("rcij,jrc->rci", inverse**2, np.array(variance)))
    reason = np.where(first.valid & ~usable, Reason.NO_POINT, first.mask_reason)
    column, row = (
        _as_axis(axis, position.at_px[..., index], spread_px[..., index], usable)
        for index, axis in enumerate((first.column, first.row))
    )
    return Decoded(column, row, reason.astype(np.uint8))


def _as_axis(
    axis: AxisDecode, coordinate_px: FloatArray, sigma_px: FloatArray, usable: BoolImage
) -> AxisDecode:
    return replace(
        axis,
        coordinate_px=np.where(usable, coordinate_px, 0.0).astype(np.float32),
        sigma_px=np.where(usable, sigma_px, 0.0).astype(np.float32),
    )
