"""Convert a calibration to the fields of a rig: poses and lenses of camera and projector.

A rig has fewer parameters than a calibration. The rays of both image centres intersect in one point
of the coat, the camera's pixels are square, the projector's have the ratio that the capture states,
and the principal point is offset along one direction only. The rig is fitted by least squares, so
that it projects points near the coat to the same pixels as the calibration does. The misfit, px, is
the RMS of the residuals. The common point of the rays becomes the origin of the world frame.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from reconstruction.arrays import FloatArray
from reconstruction.errors import InputError
from reconstruction.pixel_shape import PixelRatio, width_over_height
from reconstruction.rig.calibration import Calibration, Pinhole
from reconstruction.rig.plausibility import require_plausible, rig_checks
from twin.config.models import Pose
from twin.optics.rig import world_from_device

_GRID = 7
_HEIGHTS_MM = (-1.0, 2.0)
_MOST_MISFIT_PX = 0.5
_MOST_OFF_RATIO = 0.03
_RATIO_REMEDY = 'set [projector] pixel_ratio of capture.toml to this ratio, or to "diamond"'


@dataclass(frozen=True)
class Placed:
    """Camera and projector in the parameters of a rig.

    Attributes
    ----------
    camera_focal_px, projector_focal_px : focal lengths in columns
    axis_row_px : row of the projector's optical axis
    origin_mm : (xyz) the rig's origin in the world frame of the calibration
    misfit_px : RMS residual over the image of the camera, and over that of the projector
    """

    camera_pose: Pose
    projector_pose: Pose
    camera_focal_px: float
    projector_focal_px: float
    axis_row_px: float
    origin_mm: tuple[float, float, float]
    misfit_px: tuple[float, float]

    @property
    def is_close(self) -> bool:
        """Whether the rig agrees with the calibration within the allowed misfit."""
        return max(self.misfit_px) < _MOST_MISFIT_PX


def place(calibration: Calibration, pixel_ratio: PixelRatio = 1.0) -> Placed:
    """Return the rig that best fits a calibration.

    Parameters
    ----------
    pixel_ratio : shape of the projector's pixels as the capture states it, see
        `reconstruction.pixel_shape`

    Raises
    ------
    InputError : the camera does not look down at the plane z = 0, the calibration is implausible,
        its camera pixels are not square, or its projector pixels have another ratio
    """
    require_plausible(rig_checks(calibration), "calibrate again, see docs/calibration.md")
    ratio = width_over_height(pixel_ratio)
    _require_ratio(calibration.camera, "camera", 1.0, "give images with square pixels")
    _require_ratio(calibration.projector, "projector", ratio, _RATIO_REMEDY)
    origin = _looked_at(calibration)
    points = _points(calibration)
    camera, projector = calibration.camera, calibration.projector
    wanted = (
        _projected(camera, calibration.T_world_from_cam, points),
        _projected(projector, calibration.T_world_from_proj, points),
    )
    cam_mm = calibration.T_world_from_cam[:3, 3] - origin
    proj_mm = calibration.T_world_from_proj[:3, 3] - origin
    start = np.array(
        [*origin[:2], *cam_mm, 0.0, camera.fx_px, *proj_mm, 0.0, projector.fx_px, projector.cy_px]
    )
    start[5] = _roll_rad(calibration.T_world_from_cam, _square_camera(camera, start[6]), cam_mm)
    start[10] = _roll_rad(
        calibration.T_world_from_proj,
        _rig_projector(projector, start[11], start[12], ratio),
        proj_mm,
    )

    def devices(p: FloatArray) -> list[tuple[Pinhole, FloatArray]]:
        centre = np.array([p[0], p[1], origin[2]])
        parts = (
            (_square_camera(camera, p[6]), p[2:5], p[5]),
            (_rig_projector(projector, p[11], p[12], ratio), p[7:10], p[10]),
        )
        placed = []
        for pinhole, position_mm, roll_rad in parts:
            motion = world_from_device(_pose(position_mm, roll_rad), pinhole)
            motion[:3, 3] += centre
            placed.append((pinhole, motion))
        return placed

    def off_px(p: FloatArray) -> FloatArray:
        pairs = zip(devices(p), wanted, strict=True)
        return np.concatenate(
            [(_projected(*device, points) - there).ravel() for device, there in pairs]
        )

    p = _fitted(off_px, start)
    return _placed(p, off_px(p), float(origin[2]))


def _placed(p: FloatArray, off_px: FloatArray, origin_z_mm: float) -> Placed:
    """Return the rig of fitted parameters and residuals."""
    rms_px = np.sqrt(2.0 * np.mean(off_px.reshape(2, -1) ** 2, axis=1))
    return Placed(
        _pose(p[2:5], p[5]),
        _pose(p[7:10], p[10]),
        float(p[6]),
        float(p[11]),
        float(p[12]),
        (float(p[0]), float(p[1]), origin_z_mm),
        (float(rms_px[0]), float(rms_px[1])),
    )


def _require_ratio(device: Pinhole, name: str, stated: float, remedy: str) -> None:
    ratio = device.fy_px / device.fx_px
    if not abs(ratio / stated - 1.0) <= _MOST_OFF_RATIO:
        raise InputError(
            f"calibration: the {name}'s pixels are {ratio:.3g} times as wide as high (fy / fx), "
            f"allowed {stated:g} within {_MOST_OFF_RATIO:.0%}; {remedy}"
        )


def _fitted(off_px: Callable[[FloatArray], FloatArray], start: FloatArray) -> FloatArray:
    scale = np.maximum(np.abs(start), 1.0)
    solution = least_squares(off_px, start, x_scale=scale, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    return np.asarray(solution.x)


def _looked_at(calibration: Calibration) -> FloatArray:
    """Return the intersection (xyz), mm, of the ray of the camera's image centre with z = 0."""
    camera, motion = calibration.camera, calibration.T_world_from_cam
    centre = np.array([(camera.width_px - 1) / 2, (camera.height_px - 1) / 2])
    ray = motion[:3, :3] @ np.append(camera.unproject(centre), 1.0)
    if not (ray[2] < 0.0 < motion[2, 3]):
        raise InputError(
            "calibration: the camera does not look down at z = 0; give a world frame with the z "
            "axis from the coat to the devices"
        )
    return np.asarray(motion[:3, 3] - ray * (motion[2, 3] / ray[2]))


def _points(calibration: Calibration) -> FloatArray:
    """Return points (n, xyz), mm, on two planes near z = 0, seen all over the camera image."""
    camera, motion = calibration.camera, calibration.T_world_from_cam
    x, y = np.meshgrid(
        np.linspace(0, camera.width_px - 1, _GRID), np.linspace(0, camera.height_px - 1, _GRID)
    )
    pixels = np.stack([x.ravel(), y.ravel()], axis=-1)
    rays = np.append(camera.unproject(pixels), np.ones((len(pixels), 1)), axis=1)
    rays = rays @ motion[:3, :3].T
    return np.concatenate(
        [motion[:3, 3] + rays * ((z - motion[2, 3]) / rays[:, 2:3]) for z in _HEIGHTS_MM]
    )


def _projected(pinhole: Pinhole, motion: FloatArray, points_mm: FloatArray) -> FloatArray:
    inside = (points_mm - motion[:3, 3]) @ motion[:3, :3]
    return np.asarray(pinhole.project(inside))


def _square_camera(camera: Pinhole, focal_px: float) -> Pinhole:
    centre = (camera.width_px - 1) / 2, (camera.height_px - 1) / 2
    return replace(camera, fx_px=focal_px, fy_px=focal_px, cx_px=centre[0], cy_px=centre[1])


def _rig_projector(
    projector: Pinhole, focal_px: float, axis_row_px: float, ratio: float
) -> Pinhole:
    return replace(
        projector,
        fx_px=focal_px,
        fy_px=focal_px * ratio,
        cx_px=(projector.width_px - 1) / 2,
        cy_px=axis_row_px,
    )


def _pose(position_mm: FloatArray, roll_rad: float) -> Pose:
    standoff_mm = float(np.linalg.norm(position_mm))
    polar = np.arccos(np.clip(position_mm[2] / standoff_mm, -1.0, 1.0))
    azimuth = np.arctan2(position_mm[1], position_mm[0])
    roll = (roll_rad + np.pi) % (2.0 * np.pi) - np.pi
    return Pose(
        standoff_mm=standoff_mm,
        polar_deg=float(np.rad2deg(min(polar, np.deg2rad(89.9)))),
        azimuth_deg=float(np.rad2deg(azimuth)),
        roll_deg=float(np.rad2deg(roll)),
    )


def _roll_rad(motion: FloatArray, pinhole: Pinhole, position_mm: FloatArray) -> float:
    """Return the roll angle, rad, at which a pose's image axes agree best with the calibration.

    `motion` is (4, 4), from device to world in the calibration; `position_mm` is the device's
    position relative to the rig's origin.
    """
    at_zero = world_from_device(_pose(position_mm, 0.0), pinhole)[:3, :3]
    turn = at_zero.T @ motion[:3, :3]
    return float(np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1]))
