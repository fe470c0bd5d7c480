"""Pose of the projector in the camera's frame, from the R and T of another program's file.

Programs store R and T in different conventions. A wrong one is detected by the distances of decoded
points from epipolar lines, or without a capture if the central rays diverge.

| convention | meaning; x: coordinates of a point in the device's frame |
|---|---|
| forward | x_projector = R x_camera + T (OpenCV's stereoCalibrate) |
| inverse | x_camera = R x_projector + T |
| transposed | x_projector = R^T x_camera + T (matrix that multiplies rows, or stored by columns) |
| position | x_projector = R (x_camera - T): T is the projector's position in the camera's frame |
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

import cv2
import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import InputError
from reconstruction.rig.epipolar import epipolar_residuals_px
from reconstruction.rig.named_numbers import DEVICES, ROTATION, TRANSLATION, NamedNumbers
from reconstruction.rig.pinhole import Pinhole

Pose = Literal["forward", "inverse", "transposed", "position"]
POSES: tuple[Pose, ...] = get_args(Pose)

MOST_EPIPOLAR_PX = 3.0
"""Largest allowed median distance, px, of decoded points from the epipolar lines of a rig."""

# Another convention than "forward" must fit a capture better by this factor.
_CLEARLY = 3.0
# Least sine of the angle between the central rays; below, they are parallel.
LEAST_SINE = 0.02
# Least share of decoded points in front of both devices.
_LEAST_IN_FRONT = 0.5


@dataclass(frozen=True, eq=False)
class ReadPose:
    """Pose in one convention, and how well a capture agrees with it.

    Attributes
    ----------
    T_proj_from_cam : (4, 4), translation in mm
    convention : convention of R and T in the file
    reason : why this convention was chosen, one line; "": it is the usual one, unchecked
    epipolar_px : median distance of the decoded points from the epipolar lines; None: no capture
    """

    T_proj_from_cam: FloatArray
    convention: Pose
    reason: str = ""
    epipolar_px: float | None = None


@dataclass(frozen=True, eq=False)
class _Candidate:
    camera: Pinhole
    projector: Pinhole
    T_proj_from_cam: FloatArray


def stored_motion(names: NamedNumbers) -> FloatArray:
    """Return R and T as stored, (4, 4), in the file's unit: from the first device to the second.

    Raises
    ------
    InputError : there is no pose, or R is no rotation
    """
    whole = names.of_rig("motion", ("tcncnm1", "tprojfromcam", "extrinsics", "motion"), {16})
    if whole is not None:
        return _rigid(whole.reshape(4, 4)[:3, :3], whole.reshape(4, 4)[:3, 3])
    rotation = names.of_rig("rotation", ROTATION, {3, 9})
    translation = names.of_rig("translation", TRANSLATION, {3})
    if rotation is None and (rows := names.of_rig("", ("rotationofcamera2",), {9})) is not None:
        rotation = rows.reshape(3, 3).T
        translation = names.of_rig("", ("translationofcamera2",), {3})
    if rotation is not None and translation is not None:
        return _rigid(rotation, translation)
    for motion in (_of_two_poses(names), _of_projector(names), _of_rectified(names)):
        if motion is not None:
            return motion
    key, sizes = ("rotation", {3, 9}) if rotation is None else ("translation", {3})
    raise names.missing(
        "rotation R and translation T from the first device to the second", key, sizes
    )


def _of_projector(names: NamedNumbers) -> FloatArray | None:
    """Return the motion from the only pose in the files, that of the projector (Rp, Tp)."""
    rotation = names.of_device("projector", "", ROTATION, {3, 9})
    translation = names.of_device("projector", "", TRANSLATION, {3})
    return None if rotation is None or translation is None else _rigid(rotation, translation)


def _of_two_poses(names: NamedNumbers) -> FloatArray | None:
    """Return the motion from the poses x_device = R x_world + T of both devices; None: no poses."""
    motions = []
    for device in DEVICES:
        rotation = names.of_device(device, "", ROTATION, {3, 9})
        translation = names.of_device(device, "", TRANSLATION, {3})
        if rotation is None or translation is None:
            return None
        motions.append(_rigid(rotation, translation))
    return motions[1] @ inverse(motions[0])


def _of_rectified(names: NamedNumbers) -> FloatArray | None:
    """Return the motion from rectification and projection matrices, as ROS stores a pair.

    A rectified point of the second device is that of the first, moved by P[:, 3] / focal length.
    """
    turns, moves = [], []
    for device in DEVICES:
        turn = names.of_device(device, "", ("rectificationmatrix",), {9})
        projection = names.of_device(device, "", ("projectionmatrix",), {12})
        if turn is None or projection is None:
            return None
        P = projection.reshape(3, 4)
        turns.append(_rigid(turn, np.zeros(3)))
        moves.append(np.array([P[0, 3] / P[0, 0], P[1, 3] / P[1, 1], 0.0]))
    apart = moves[1] - moves[0]
    return inverse(turns[1]) @ _rigid(np.eye(3), apart) @ turns[0] if np.any(apart) else None


def _rigid(rotation: FloatArray, translation: FloatArray) -> FloatArray:
    if rotation.size == 3:
        rotation = np.asarray(cv2.Rodrigues(rotation.reshape(3, 1))[0], np.float64)
    motion = np.eye(4)
    motion[:3, :3] = nearest_rotation(rotation.reshape(3, 3))
    motion[:3, 3] = translation.ravel()
    return motion


def inverse(motion: FloatArray) -> FloatArray:
    """Return the inverse of a rigid motion (4, 4)."""
    return np.asarray(np.linalg.inv(motion), np.float64)


def nearest_rotation(matrix: FloatArray) -> FloatArray:
    """Return the rotation nearest to a matrix that was printed with few digits.

    Raises
    ------
    InputError : the matrix differs from a rotation by more than 1e-3
    """
    left, stretch, right = np.linalg.svd(matrix)
    if np.abs(stretch - 1).max() > 1e-3 or np.linalg.det(matrix) < 0:
        raise InputError(f"R is no rotation: its singular values are {stretch.tolist()}")
    return np.asarray(left @ right)


def in_convention(stored: FloatArray, convention: Pose) -> FloatArray:
    """Return the motion x_projector = R x_camera + T, (4, 4), from R and T in a convention."""
    R, T = stored[:3, :3], stored[:3, 3]
    if convention == "inverse":
        return inverse(stored)
    motion = np.eye(4)
    motion[:3, :3] = R.T if convention == "transposed" else R
    motion[:3, 3] = -R @ T if convention == "position" else T
    return motion


def pose_in_file(
    devices: tuple[Pinhole, Pinhole],
    stored: FloatArray,
    convention: Pose | None,
    measured_px: FloatArray | None,
    *,
    is_trusted: bool = False,
) -> ReadPose:
    """Return the pose of R and T in the given convention, or in the one that the capture confirms.

    Parameters
    ----------
    devices : camera and projector
    stored : (4, 4), R and T as stored, translation in mm
    convention : convention of R and T; None: "forward", or another that fits the capture better
    measured_px : (n, 4) decoded points, camera x, y, projector column, row; None: no capture
    is_trusted : without a capture, accept central rays that diverge

    Raises
    ------
    InputError : the capture contradicts every convention or the given one; or there is no capture,
        no given convention, and the central rays diverge
    """
    if measured_px is not None:
        return _confirmed(devices, stored, convention, measured_px)
    motion = in_convention(stored, convention or "forward")
    if convention is None and not is_trusted and not _meet(devices, motion):
        meeting = [pose for pose in POSES if _meet(devices, in_convention(stored, pose))]
        raise InputError(
            "R and T are implausible: the central rays of camera and projector diverge; they meet "
            f"with {' or '.join(f'--pose {pose}' for pose in meeting) or 'no convention'}; give "
            "the right one, or a capture of the rig: --check CAPTURE"
        )
    return ReadPose(motion, convention or "forward")


def _confirmed(
    devices: tuple[Pinhole, Pinhole],
    stored: FloatArray,
    convention: Pose | None,
    measured_px: FloatArray,
) -> ReadPose:
    misfits = {
        pose: _misfit_px(devices, in_convention(stored, pose), measured_px) for pose in POSES
    }
    best = min(POSES, key=lambda pose: misfits[pose])
    chosen = convention or ("forward" if misfits["forward"] <= _CLEARLY * misfits[best] else best)
    if not misfits[chosen] <= MOST_EPIPOLAR_PX:
        raise InputError(
            f"the capture contradicts the calibration: median distance from the epipolar lines "
            f"{_listed(misfits)}; allowed up to {MOST_EPIPOLAR_PX:g} px; "
            + (
                f"use --pose {best}"
                if misfits[best] <= MOST_EPIPOLAR_PX
                else "check binning, the image sizes, the pixels of the patterns, and which device "
                "is the first (--projector-first)"
            )
        )
    reason = f"median distance from the epipolar lines {_listed(misfits)}"
    return ReadPose(in_convention(stored, chosen), chosen, reason, misfits[chosen])


def _listed(misfits: Mapping[Pose, float]) -> str:
    return ", ".join(
        f"{pose} {misfit:.2g} px" if np.isfinite(misfit) else f"{pose}: points behind a device"
        for pose, misfit in misfits.items()
    )


def _misfit_px(
    devices: tuple[Pinhole, Pinhole], motion: FloatArray, measured_px: FloatArray
) -> float:
    """Return the median distance from epipolar lines, px; inf if most points are behind."""
    rig = _Candidate(*devices, motion)
    rays = [
        np.column_stack((device.unproject(pixels), np.ones(len(pixels))))
        for device, pixels in zip(devices, (measured_px[:, :2], measured_px[:, 2:]), strict=True)
    ]
    in_front = np.all(_depths_mm(rays[0], rays[1], motion) > 0.0, axis=1)
    if not np.mean(in_front) >= _LEAST_IN_FRONT:
        return float(np.inf)
    return float(np.nanmedian(np.abs(epipolar_residuals_px(rig, measured_px))))


def _meet(devices: tuple[Pinhole, Pinhole], motion: FloatArray) -> bool:
    """Return True if the rays of both image centres are parallel or meet in front of both devices.

    Both are projected on the plane of the camera's ray and the baseline: an oblique projector's
    light may pass above the camera's axis.
    """
    camera, projector = (_central_ray(device) for device in devices)
    R = motion[:3, :3]
    centre, ray = -R.T @ motion[:3, 3], R.T @ projector
    aside = centre - (centre @ camera) * camera
    distance = float(np.linalg.norm(aside))
    towards = -float(ray @ aside) / distance if distance else 0.0
    if abs(towards) < LEAST_SINE:
        return True
    along = distance / towards
    return along > 0.0 and float(centre @ camera + along * (ray @ camera)) > 0.0


def _central_ray(device: Pinhole) -> FloatArray:
    """Return the unit vector, (3,), from a device to the centre of its image."""
    centre = np.array([[(device.width_px - 1) / 2, (device.height_px - 1) / 2]])
    ray = np.append(device.unproject(centre)[0], 1.0)
    return np.asarray(ray / np.linalg.norm(ray))


def _depths_mm(
    camera_rays: FloatArray, projector_rays: FloatArray, motion: FloatArray
) -> FloatArray:
    """Return the depths (n, 2), mm, along both axes, at which pairs of rays are closest."""
    turned, T = camera_rays @ motion[:3, :3].T, motion[:3, 3]
    aa, bb = np.sum(turned**2, axis=1), np.sum(projector_rays**2, axis=1)
    ab = np.sum(turned * projector_rays, axis=1)
    a_T, b_T = turned @ T, projector_rays @ T
    # Minimum of |s a + T - t b| over s and t; parallel rays have no finite one.
    with np.errstate(divide="ignore", invalid="ignore"):
        s, t = np.array([ab * b_T - bb * a_T, aa * b_T - ab * a_T]) / (aa * bb - ab**2)
    return np.column_stack((s, t))
