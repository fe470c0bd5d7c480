"""Parameter vector of the rig and all board poses, and the projection of board features by it.

| elements | parameters |
|---|---|
| 0 to 8 | fx fy cx cy k1 k2 p1 p2 k3 of the camera |
| 9 to 17 | the same numbers of the projector |
| 18 to 23 | T_proj_from_cam: rotation vector (rad), translation (mm) |
| 6 per pose | T_cam_from_board: rotation vector (rad), translation (mm) |

A field of view of a few degrees does not determine all parameters. By default (`Freedom`) the
parameters are fixed or free as follows:

- The ratio fy / fx, the width of a pixel divided by its height, is given for both devices. The
  geometry of chips is more exact than the 0.01 % that the poses could determine. The ratio is 1 for
  square pixels, and 2 for a chip with diamond pixels whose columns are counted at half their number
  (LightCrafter 4500: 912 x 1140).
- Of the camera's distortion only k1 is free. Over a field of view of 4 degrees the effects of k2
  and k3 are far below the noise. Tangential terms are not separable from the principal point.
- The projector has no distortion. The board covers a small off-axis part of the projector image.
  There a radial term is not separable from a shift and a change of focal length.
- Both principal points are free. An error of the camera's would cause a tilt; the projector's is
  far off-axis and not known in advance.
- The defocus of the camera (`defocus_slopes_px`) has two free coefficients, which are zero for a
  camera that is in focus everywhere. If neglected, defocus would bias principal points and
  rotations.
"""

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from reconstruction.arrays import FloatArray
from reconstruction.errors import InputError, require_number
from reconstruction.pixel_shape import PIXEL_RATIOS
from reconstruction.rig.pinhole import Pinhole

INTRINSICS = ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2", "k3")
MOTION = ("rx_rad", "ry_rad", "rz_rad", "tx_mm", "ty_mm", "tz_mm")
CAMERA, PROJECTOR = slice(0, 9), slice(9, 18)
STEREO = slice(18, 24)
POSES = 24
Distortion = Literal["k1", "k2", "p1", "p2", "k3"]


@dataclass(frozen=True, eq=False)
class RigEstimate:
    """Estimate of the whole rig and of the board poses.

    Parameters
    ----------
    camera, projector : intrinsics
    T_proj_from_cam : (4, 4), translation in mm
    T_cam_from_board : (pose, 4, 4), translation in mm
    """

    camera: Pinhole
    projector: Pinhole
    T_proj_from_cam: FloatArray
    T_cam_from_board: FloatArray


def pack(rig: RigEstimate) -> FloatArray:
    """Return the parameter vector of a rig, (24 + 6 * poses,); the module's text has the layout."""
    motions = [rig.T_proj_from_cam, *rig.T_cam_from_board]
    vectors = [np.append(rotation_vector(T[:3, :3]), T[:3, 3]) for T in motions]
    parts = [_intrinsics(rig.camera), _intrinsics(rig.projector), *vectors]
    return np.concatenate(parts)


def unpack(vector: FloatArray, camera: Pinhole, projector: Pinhole) -> RigEstimate:
    """Return the rig of a parameter vector; `camera` and `projector` give only the image sizes."""
    motions = vector[STEREO.start :].reshape(-1, 6)
    matrices = np.stack([rigid(motion[:3], motion[3:]) for motion in motions])
    return RigEstimate(
        _pinhole(vector[CAMERA], camera),
        _pinhole(vector[PROJECTOR], projector),
        matrices[0],
        matrices[1:],
    )


def _intrinsics(device: Pinhole) -> FloatArray:
    return np.array(
        [device.fx_px, device.fy_px, device.cx_px, device.cy_px, *device.distortion], np.float64
    )


def _pinhole(values: FloatArray, like: Pinhole) -> Pinhole:
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = (float(value) for value in values)
    return Pinhole(like.width_px, like.height_px, fx, fy, cx, cy, (k1, k2, p1, p2, k3))


def rotation_vector(rotation: FloatArray) -> FloatArray:
    """Return the rotation vector (3,), rad, of a rotation matrix (3, 3).

    OpenCV's function is not used, because it rounds rotations near 180 degrees to 1e-5. A camera
    that looks down on a board has such a rotation.
    """
    return np.asarray(Rotation.from_matrix(rotation).as_rotvec())


def rigid(rotation: FloatArray, shift: FloatArray) -> FloatArray:
    """Return the motion (4, 4) of a rotation vector, rad, and a shift, mm, each (3,) or (3, 1)."""
    matrix = np.eye(4)
    matrix[:3, :3] = cv2.Rodrigues(np.array(rotation))[0]
    matrix[:3, 3] = np.ravel(shift)
    return matrix


def pose_slice(pose: int) -> slice:
    """Return the place of the motion of a board pose in the parameter vector."""
    return slice(POSES + 6 * pose, POSES + 6 * pose + 6)


def project_pose(
    vector: FloatArray, pose: int, points_mm: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Project the points of a board in one pose into both devices.

    Parameters
    ----------
    vector : parameter vector, which may be followed by further parameters
    pose : index of the board pose
    points_mm : (n, 3) float, board frame

    Returns
    -------
    (n, 4) float: camera x, y, projector column, row, px
    (n, 4, parameters) float: the derivatives of these four numbers by all elements of `vector`
    """
    place = pose_slice(pose)
    motion, stereo = vector[place], vector[STEREO]
    pixels = np.zeros((len(points_mm), 4))
    slopes = np.zeros((len(points_mm), 4, len(vector)))
    pixels[:, :2], along = _project(points_mm, motion, vector[CAMERA])
    slopes[:, :2, place], slopes[:, :2, CAMERA] = along[..., :6], along[..., 6:]
    inside, by_motion = _move(points_mm, motion)
    pixels[:, 2:], along = _project(inside, stereo, vector[PROJECTOR])
    # A displacement of the point in the camera frame acts like a change of the translation of
    # T_proj_from_cam by the displacement in the projector's frame.
    by_point = along[..., 3:6] @ cv2.Rodrigues(stereo[:3].copy())[0]
    slopes[:, 2:, place] = by_point @ by_motion
    slopes[:, 2:, STEREO], slopes[:, 2:, PROJECTOR] = along[..., :6], along[..., 6:]
    return pixels, slopes


def _project(
    points_mm: FloatArray, motion: FloatArray, lens: FloatArray
) -> tuple[FloatArray, FloatArray]:
    matrix = np.array([[lens[0], 0.0, lens[2]], [0.0, lens[1], lens[3]], [0.0, 0.0, 1.0]])
    # OpenCV keeps views of its arguments: pass copies.
    rotation, shift, distortion = motion[:3].copy(), motion[3:].copy(), lens[4:].copy()
    pixels, slopes = cv2.projectPoints(points_mm, rotation, shift, matrix, distortion)[:2]
    return pixels.reshape(-1, 2), slopes.reshape(-1, 2, 15)


def _move(points_mm: FloatArray, motion: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return points (n, 3) after a rigid motion (6,), and their derivatives by it, (n, 3, 6)."""
    rotation, derivative = cv2.Rodrigues(motion[:3].copy())
    turned = derivative.reshape(3, 3, 3)  # by rotation vector, row, column
    slopes = np.zeros((len(points_mm), 3, 6))
    slopes[..., :3] = np.einsum("kij,nj->nik", turned, points_mm)
    slopes[..., 3:] = np.eye(3)
    return points_mm @ rotation.T + motion[3:], slopes


@dataclass(frozen=True)
class Freedom:
    """Selection of the device parameters that a calibration estimates.

    The poses of the board and of the projector are always estimated.

    Parameters
    ----------
    camera_distortion, projector_distortion : names of the coefficients to estimate; others are 0
    camera_principal_point, projector_principal_point : whether the principal point is estimated
    camera_pixel_ratio, projector_pixel_ratio : given fy / fx, the width of a pixel divided by its
        height; None: the ratio is estimated
    camera_defocus : whether the effect of the camera's aperture on tilted boards is estimated

    Raises
    ------
    InputError : unknown or repeated coefficient, or a pixel ratio out of range
    """

    camera_distortion: tuple[Distortion, ...] = ("k1",)
    projector_distortion: tuple[Distortion, ...] = ()
    camera_principal_point: bool = True
    projector_principal_point: bool = True
    camera_pixel_ratio: float | None = 1.0
    projector_pixel_ratio: float | None = 1.0
    camera_defocus: bool = True

    def __post_init__(self) -> None:
        for device, ratio in (
            ("camera", self.camera_pixel_ratio),
            ("projector", self.projector_pixel_ratio),
        ):
            if ratio is not None:
                require_number(f"{device} pixel ratio", ratio, *PIXEL_RATIOS)
        for name in (*self.camera_distortion, *self.projector_distortion):
            if name not in INTRINSICS[4:]:
                allowed = ", ".join(INTRINSICS[4:])
                raise InputError(f"distortion coefficient is {name!r}; allowed are {allowed}")
        for names in (self.camera_distortion, self.projector_distortion):
            if len(set(names)) < len(names):
                raise InputError(f"distortion coefficients are {', '.join(names)}; name each once")


def admissible(freedom: Freedom, vector: FloatArray) -> FloatArray:
    """Return the parameter vector with the given pixel ratios; fx * fy is kept."""
    moved = vector.copy()
    for device, ratio in (
        (CAMERA, freedom.camera_pixel_ratio),
        (PROJECTOR, freedom.projector_pixel_ratio),
    ):
        if ratio is not None:
            focal = slice(device.start, device.start + 2)
            moved[focal] = np.sqrt(np.prod(vector[focal])) * np.sqrt([1.0 / ratio, ratio])
    return moved


def freedom_matrix(freedom: Freedom, size: int) -> FloatArray:
    """Return the matrix (size, free) that maps changes of the free to those of all parameters."""
    columns = [
        *_device_columns(
            size,
            CAMERA.start,
            freedom.camera_pixel_ratio,
            freedom.camera_principal_point,
            freedom.camera_distortion,
        ),
        *_device_columns(
            size,
            PROJECTOR.start,
            freedom.projector_pixel_ratio,
            freedom.projector_principal_point,
            freedom.projector_distortion,
        ),
    ]
    columns += [_unit(size, k) for k in range(STEREO.start, size)]
    return np.stack(columns, axis=1)


def _device_columns(
    size: int,
    first: int,
    pixel_ratio: float | None,
    principal_point: bool,
    distortion: tuple[Distortion, ...],
) -> list[FloatArray]:
    fx, fy = _unit(size, first), _unit(size, first + 1)
    focal = [fx, fy] if pixel_ratio is None else [fx + pixel_ratio * fy]
    names = (("cx_px", "cy_px") if principal_point else ()) + tuple(distortion)
    return [*focal, *(_unit(size, first + INTRINSICS.index(name)) for name in names)]


def _unit(size: int, index: int) -> FloatArray:
    column = np.zeros(size)
    column[index] = 1.0
    return column
