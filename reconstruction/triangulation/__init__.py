"""Triangulate: intersect each camera ray with the projector's light plane or ray.

The points are in the world frame (z up, towards the devices), mm. The only unknown of a camera ray
is the depth d along the camera's optical axis. It is computed by Gauss-Newton iteration from the
projector coordinates u_i (column, row or both) with the weights 1 / sigma_i^2. Its standard
deviation is sigma_d = (sum_i (du_i / dd)^2 / sigma_i^2)^(-1/2). The standard deviations of the
point along the world axes are sigma_xyz = sigma_d |R (x, y, 1)|. Here (x, y, 1) is the ray in the
camera frame, and R rotates from the camera to the world frame.

Below plane clear layers (a window, a gel) both rays are refracted by Snell's law, see `_layers`.
The unknown is then the depth below the last interface.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np

from reconstruction.arrays import BoolImage, FloatArray, FloatImage, Reason, ReasonImage
from reconstruction.compact import Bits, Half, RaySpread, keeps_compact, stored_value
from reconstruction.compiling import run_over_rows
from reconstruction.decoding import AxisDecode, Decoded
from reconstruction.decoding._rows import BIAS
from reconstruction.decoding.plan import SIGMA_UNIT_PX
from reconstruction.errors import InputError, require_number
from reconstruction.rig.calibration import Calibration
from reconstruction.rig.layers import PlaneLayers
from reconstruction.triangulation._layers import LayeredRig, SpreadRows, meet_rows_below
from reconstruction.triangulation._ray import (
    Fringe,
    LensPair,
    Match,
    Motion,
    PointRows,
    lens_of,
    meet_rows,
)
from reconstruction.triangulation.normals import surface_normals

# The first row of a band needs more iterations than the others, which start from the row above.
BAND_ROWS = 48
# Unit in which sigma_d is stored in half precision: values from 6e-11 to 64 mm.
SIGMA_UNIT_MM = 2.0**-10

Use = Literal["column", "row", "both"]


@dataclass(frozen=True)
class EpipolarTolerance:
    """Largest allowed difference of a decoded coordinate from the projection of the point.

    The projection is that of the triangulated point into the projector. The default allows one
    projector pixel plus five standard deviations. Errors of real calibrations are smaller, some
    0.1 px; a wrong fringe order causes a larger difference, a whole period.

    Parameters
    ----------
    absolute_px : constant part of the allowed distance, projector px
    sigmas : additional part, in standard deviations of the distance
    """

    absolute_px: float = 1.0
    sigmas: float = 5.0

    def __post_init__(self) -> None:
        require_number("epipolar absolute_px", self.absolute_px, 0.0)
        require_number("epipolar sigmas", self.sigmas, 0.0)


@keeps_compact("sigma_xyz_mm")
@dataclass(frozen=True, eq=False)
class PointMap:
    """The triangulated point of each camera pixel and its standard deviation.

    Points and standard deviations are 0 where mask_reason is not VALID.

    Parameters
    ----------
    points_world_mm : (row, col, xyz) float, world frame
    sigma_xyz_mm : (row, col, xyz) float, predicted standard deviations along the world axes. They
        follow from those of the projector coordinates and do not include the uncertainty of the
        calibration. The error of a point is along its camera ray, so its covariance
        `covariance_mm2` has rank 1. The array is computed at each access
    mask_reason : (row, col) uint8, codes of `Reason`
    T_world_from_cam : (4, 4) float, pose of the camera, translation in mm
    """

    points_world_mm: FloatImage
    sigma_xyz_mm: FloatImage
    mask_reason: ReasonImage
    T_world_from_cam: FloatArray

    @property
    def sigma_z_mm(self) -> FloatImage:
        """Predicted standard deviation of world z, (row, col), mm; 0 where masked."""
        sigma = stored_value(self, "sigma_xyz_mm")
        return sigma.component(2) if isinstance(sigma, RaySpread) else self.sigma_xyz_mm[..., 2]

    @property
    def normals_world(self) -> FloatImage:
        """Measured unit normals towards the camera, (row, col, xyz); 0 where not known.

        Each access computes them from neighbouring points, see `normals.surface_normals`.
        """
        return surface_normals(self.points_world_mm, self.valid)

    @cached_property
    def points_cam_mm(self) -> FloatImage:
        """The points in the camera's frame (z = depth), (row, col, xyz) mm; 0 where masked."""
        T = self.T_world_from_cam
        points = (self.points_world_mm - T[:3, 3]) @ T[:3, :3]
        return np.where(self.valid[..., np.newaxis], points, 0.0).astype(np.float32)

    @property
    def covariance_mm2(self) -> FloatImage:
        """Covariance matrix of each point in the world frame, (row, col, xyz, xyz), mm^2."""
        along = self.points_world_mm - self.T_world_from_cam[:3, 3].astype(np.float32)
        signed = np.copysign(self.sigma_xyz_mm, along)
        return signed[..., :, np.newaxis] * signed[..., np.newaxis, :]

    @property
    def valid(self) -> BoolImage:
        """Whether a pixel has a triangulated point, (row, col) bool."""
        return np.equal(self.mask_reason, Reason.VALID)


def triangulate(
    decoded: Decoded,
    calibration: Calibration,
    use: Use = "column",
    tolerance: EpipolarTolerance | None = None,
) -> PointMap:
    """Triangulate a point for each camera pixel with decoded projector coordinates.

    Parameters
    ----------
    decoded : projector coordinates of every camera pixel, along one axis or both
    calibration : geometry of the rig, for the image size of `decoded`
    use : coordinate that determines the depth; "both": both of them, weighted by 1 / sigma^2. Each
        decoded coordinate is compared with the projection of the point. If only one axis was
        decoded, `use` must be that axis, and there is no comparison
    tolerance : pixels with a larger difference get the reason EPIPOLAR_MISMATCH

    Raises
    ------
    InputError : the image size is not that of the calibration, `use` is unknown, or `use` is an
        axis that was not decoded
    """
    _check(decoded, calibration, use)
    limits = tolerance or EpipolarTolerance()
    # With one coordinate only there is no epipolar test.
    allowed_px = float(limits.absolute_px) if len(decoded.axes) == 2 else np.inf
    match = Match(use != "row", use != "column", allowed_px, float(limits.sigmas))
    if calibration.layers is None:
        return _in_air(decoded, calibration, match)
    return _below(calibration.layers, decoded, calibration, match)


def _in_air(decoded: Decoded, calibration: Calibration, match: Match) -> PointMap:
    shape = decoded.mask_reason.shape
    points = np.zeros((*shape, 3), np.float32)
    sigma_depth = Half(np.zeros(shape, np.uint16), SIGMA_UNIT_MM)
    reason = decoded.mask_reason.copy()
    unit = np.float32(BIAS / SIGMA_UNIT_MM)
    output = PointRows(points.reshape(shape[0], -1), sigma_depth.bits, unit, reason)
    rig = LensPair(
        lens_of(calibration.camera),
        lens_of(calibration.projector),
        _motion(calibration.T_proj_from_cam),
        _motion(calibration.T_world_from_cam),
    )
    fringe = _fringe(decoded)
    run_over_rows(meet_rows, shape[0], fringe, match, rig, output, band_rows=BAND_ROWS)
    T_world_from_cam = calibration.T_world_from_cam
    spread: Any = RaySpread(points, sigma_depth, T_world_from_cam)
    return PointMap(points, spread, reason, T_world_from_cam)


def _below(
    layers: PlaneLayers, decoded: Decoded, calibration: Calibration, match: Match
) -> PointMap:
    shape = decoded.mask_reason.shape
    points, spread = np.zeros((2, *shape, 3), np.float32)
    reason = decoded.mask_reason.copy()
    x_mm, y_mm, z_mm = (float(value) for value in calibration.T_world_from_proj[:3, 3])
    output = SpreadRows(points.reshape(shape[0], -1), spread.reshape(shape[0], -1), reason)
    rig = LayeredRig(
        lens_of(calibration.camera),
        lens_of(calibration.projector),
        _motion(calibration.T_world_from_cam),
        _motion(np.asarray(np.linalg.inv(calibration.T_world_from_proj))),
        (x_mm, y_mm, z_mm),
        np.array(layers.tops_mm),
        np.array(layers.iors),
    )
    fringe = _fringe(decoded)
    run_over_rows(meet_rows_below, shape[0], fringe, match, rig, output, band_rows=BAND_ROWS)
    return PointMap(points, spread, reason, calibration.T_world_from_cam)


def _fringe(decoded: Decoded) -> Fringe:
    column, row = decoded.column, decoded.row
    sigmas, unit = (_packed_sigma(column), _packed_sigma(row)), np.float32(SIGMA_UNIT_PX / BIAS)
    return Fringe(column.coordinate_px, row.coordinate_px, *sigmas, unit)


def _check(decoded: Decoded, calibration: Calibration, use: str) -> None:
    if use not in get_args(Use):
        raise InputError(f"use is {use!r}; allowed are 'column', 'row' and 'both'")
    if use not in decoded.axes and len(decoded.axes) == 1:
        raise InputError(f"use is {use!r}; only {decoded.axes[0]!r} was decoded")
    rows, cols = decoded.mask_reason.shape
    camera = calibration.camera
    if (rows, cols) != (camera.height_px, camera.width_px):
        raise InputError(
            f"the images are {cols} x {rows} px, the calibrated camera is "
            f"{camera.width_px} x {camera.height_px} px; use the calibration of this image size"
        )


def _packed_sigma(axis: AxisDecode) -> Bits:
    sigma = stored_value(axis, "sigma_px")
    if isinstance(sigma, Half) and sigma.unit == SIGMA_UNIT_PX:
        return sigma.bits
    return Half.of(axis.sigma_px, SIGMA_UNIT_PX).bits


def _motion(matrix: FloatArray) -> Motion:
    return tuple(tuple(float(value) for value in line) for line in matrix[:3])
