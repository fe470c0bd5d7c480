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
from reconstruction.rig.plane_view import points_at_height, projector_px
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
        projector_px(calibration, points_at_height(calibration, height_mm))[..., AXES.index(axis)]
        for height_mm in (z_mm, z_mm + reference.sigma_mm)
    )
    return Expected(middle, np.abs(above - middle), reference.islands)


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
    seen_px = projector_px(calibration, points.points_world_mm.astype(np.float64))
    expected_px = np.where(points.valid, seen_px[..., AXES.index(axis)], np.nan)
    return Expected(expected_px, np.full(blank.shape, EPIPOLAR_SIGMA_PX), "all")
