"""Expected projector coordinates by a calibration: of a plane, and on epipolar lines."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from reconstruction.arrays import FloatArray, Reason
from reconstruction.codes import Expected
from reconstruction.decoding import AxisDecode, Decoded, Expect, PhaseReference
from reconstruction.decoding.reference import expect_at_pixels
from reconstruction.errors import InputError
from reconstruction.patterns import AXES, Axis
from reconstruction.rig.calibration import Calibration
from reconstruction.triangulation import triangulate

EPIPOLAR_SIGMA_PX = 1.0
"""Standard deviation of a coordinate by triangulation of the other one, by the calibration."""


def expect_by_rig(reference: PhaseReference | None, calibration: Calibration) -> Expect | None:
    """Return the function that expects coordinates by a reference and the calibration.

    A marked pixel precedes the plane. Without both, the coordinate follows from that along the
    other axis. None: there is no reference.

    Raises
    ------
    InputError : a plane or an epipolar line is needed below clear layers, or a marked pixel is
        outside the image
    """
    camera = calibration.camera
    marked = expect_at_pixels(reference, (camera.height_px, camera.width_px))
    if reference is None or (marked is None and reference.z_mm is None):
        return None

    def expect(axis: Axis, known: Mapping[Axis, FloatArray]) -> Expected | None:
        expected = marked(axis, known) if marked else None
        if expected is not None:
            return expected
        if calibration.layers is not None:
            raise InputError(
                "reference_z_mm and epipolar lines are not available below [layers]; give"
                f" reference_pixels with the projector {axis}"
            )
        if reference.z_mm is not None:
            return _on_plane(reference, calibration, axis)
        return _on_epipolar_lines(calibration, axis, known)

    return expect


def _on_plane(reference: PhaseReference, calibration: Calibration, axis: Axis) -> Expected:
    z_mm = reference.z_mm or 0.0
    middle, above = (
        _seen_px(calibration, _at_height(calibration, height_mm))[..., AXES.index(axis)]
        for height_mm in (z_mm, z_mm + reference.sigma_mm)
    )
    return Expected(middle, np.abs(above - middle), reference.islands)


def _at_height(calibration: Calibration, z_mm: float) -> FloatArray:
    """Return the point of each camera ray on the plane z, (row, col, xyz) mm, world."""
    camera, T = calibration.camera, calibration.T_world_from_cam
    pixels = np.stack(np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px)), -1)
    flat = camera.unproject(pixels.reshape(-1, 2).astype(np.float64))
    rays = np.column_stack([flat, np.ones(len(flat))]) @ T[:3, :3].T
    points = rays * ((z_mm - T[2, 3]) / rays[:, 2:]) + T[:3, 3]
    return np.asarray(points.reshape(camera.height_px, camera.width_px, 3))


def _seen_px(calibration: Calibration, points_mm: FloatArray) -> FloatArray:
    """Return the projector pixels of world points, (row, col, column and row) px."""
    T = np.linalg.inv(calibration.T_world_from_proj)
    inside = points_mm.reshape(-1, 3) @ T[:3, :3].T + T[:3, 3]
    return np.asarray(calibration.projector.project(inside).reshape(*points_mm.shape[:2], 2))


def _on_epipolar_lines(
    calibration: Calibration, axis: Axis, known: Mapping[Axis, FloatArray]
) -> Expected | None:
    """Return the coordinates of the points that the other axis gives; None: it is not known yet."""
    if not known:
        return None
    source, coordinate_px = next(iter(known.items()))
    is_known = np.isfinite(coordinate_px)
    blank: Any = np.zeros(coordinate_px.shape, np.float32)
    zeros = (blank,) * 8
    filled = AxisDecode(np.where(is_known, coordinate_px, 0.0).astype(np.float32), *zeros)
    empty = AxisDecode(blank, *zeros)
    reason = np.where(is_known, Reason.VALID, Reason.ORDER_UNCERTAIN).astype(np.uint8)
    pair = (filled, empty) if source == "column" else (empty, filled)
    points = triangulate(Decoded(*pair, reason, (source,)), calibration, source)
    seen_px = _seen_px(calibration, points.points_world_mm.astype(np.float64))
    expected_px = np.where(points.valid, seen_px[..., AXES.index(axis)], np.nan)
    return Expected(expected_px, np.full(blank.shape, EPIPOLAR_SIGMA_PX), "all")
