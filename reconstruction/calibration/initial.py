"""Starting values: the camera by OpenCV, the projector as the inverse camera by resection.

OpenCV starts from a principal point in the middle of the image and refuses a guess outside it; a
projector's may lie outside. The camera's calibration turns all boards into ONE spatial set of
points, from which a projection matrix follows linearly, wherever its principal point is.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from scipy.linalg import rq

from reconstruction.arrays import FloatArray, FloatImage
from reconstruction.calibration.observation import Observation
from reconstruction.calibration.parameters import RigEstimate, rigid
from reconstruction.calibration.plane_images import normaliser
from reconstruction.errors import InputError
from reconstruction.rig.pinhole import Pinhole

MIN_POSES = 3
# Only the focal length is left free: the start must not wander in weakly determined directions.
CAMERA_FLAGS = (
    cv2.CALIB_FIX_PRINCIPAL_POINT
    | cv2.CALIB_FIX_ASPECT_RATIO
    | cv2.CALIB_ZERO_TANGENT_DIST
    | cv2.CALIB_FIX_K1
    | cv2.CALIB_FIX_K2
    | cv2.CALIB_FIX_K3
)
# Board normals must spread by this much, or focal length and distance are exchangeable.
MIN_TILT_SPREAD_DEG = 3.0
# What a resection may find without being called a failure: focal length in image widths, ratio of
# the two focal lengths.
FOCAL_WIDTHS, MAX_RATIO = (0.3, 20.0), 1.3
# Throw ratio of a usual projector, where the resection fails.
FALLBACK_THROW = 1.4


def starting_rig(observations: Sequence[Observation]) -> RigEstimate:
    """Return a first estimate of the whole rig.

    Raises
    ------
    InputError : too few poses, or the poses do not determine the camera
    """
    if len(observations) < MIN_POSES:
        raise InputError(
            f"{len(observations)} board poses given, needed are {MIN_POSES} (better 12), tilted "
            "in different directions"
        )
    camera, motions = _start_camera(observations)
    _require_tilts(motions)
    poses = zip(observations, motions, strict=True)
    points_cam_mm = np.concatenate([seen.points_mm @ T[:3, :3].T + T[:3, 3] for seen, T in poses])
    pixels = np.concatenate([seen.projector_px for seen in observations])
    projector, motion = _start_projector(points_cam_mm, pixels, observations[0].projector_size_px)
    return RigEstimate(camera, projector, motion, motions)


def _require_tilts(motions: FloatArray) -> None:
    normals = motions[:, :3, 2]
    cosines = np.clip(normals @ normals.T, -1.0, 1.0)
    if np.degrees(np.arccos(cosines.min())) < MIN_TILT_SPREAD_DEG:
        raise _undetermined()


def _start_camera(observations: Sequence[Observation]) -> tuple[Pinhole, FloatArray]:
    size = observations[0].camera_size_px
    objects = [seen.points_mm.astype(np.float32) for seen in observations]
    images = [seen.camera_px.astype(np.float32).reshape(-1, 1, 2) for seen in observations]
    guess = cv2.initCameraMatrix2D(objects, images, size, 1.0)
    if not (np.all(np.isfinite(guess)) and guess[0, 0] > 0.0):
        raise _undetermined()
    # Tilted views of a small field leave focal length and distance nearly exchangeable: several
    # starts, the best fit wins.
    factors = (1.0, 0.5, 2.0)
    tries = [_calibrate_camera(objects, images, size, guess, factor) for factor in factors]
    error, matrix, rotations, shifts = min(tries, key=lambda found: found[0])
    if not np.isfinite(error):
        raise _undetermined()
    f, cx, cy = float(matrix[0, 0]), float(matrix[0, 2]), float(matrix[1, 2])
    motions = np.stack([rigid(r, t) for r, t in zip(rotations, shifts, strict=True)])
    return Pinhole(size[0], size[1], f, f, cx, cy), motions


def _calibrate_camera(
    objects: list[FloatImage],
    images: list[FloatImage],
    size: tuple[int, int],
    guess: FloatArray,
    by: float,
) -> tuple[float, FloatArray, Sequence[FloatArray], Sequence[FloatArray]]:
    matrix = np.array(guess, dtype=np.float64)
    matrix[0, 0] = matrix[1, 1] = by * guess[0, 0]
    matrix[:2, 2] = (size[0] - 1) / 2.0, (size[1] - 1) / 2.0
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | CAMERA_FLAGS
    try:
        found = cv2.calibrateCamera(objects, images, size, matrix, np.zeros(5), flags=flags)
    except cv2.error:
        return np.inf, matrix, (), ()
    error, matrix, _, rotations, shifts = found[:5]
    return float(error), matrix, rotations, shifts


def _undetermined() -> InputError:
    return InputError(
        "the board poses do not determine the camera's focal length: tilt the board by 10 to 25 "
        "degrees in at least three directions"
    )


def _start_projector(
    points_cam_mm: FloatArray, pixels_px: FloatArray, size: tuple[int, int]
) -> tuple[Pinhole, FloatArray]:
    found = resect(points_cam_mm, pixels_px)
    if found is not None:
        matrix, motion = found
        fx, fy = float(matrix[0, 0]), float(matrix[1, 1])
        low, high = FOCAL_WIDTHS[0] * size[0], FOCAL_WIDTHS[1] * size[0]
        if low < fx < high and 1.0 / MAX_RATIO < fx / fy < MAX_RATIO:
            cx, cy = float(matrix[0, 2]), float(matrix[1, 2])
            return Pinhole(size[0], size[1], fx, fy, cx, cy), motion
    # Noise swamps the linear solution: an ordinary projector with a centred lens, put where the
    # points say; the adjustment moves its principal point.
    f = FALLBACK_THROW * size[0]
    matrix = np.array([[f, 0.0, (size[0] - 1) / 2], [0.0, f, (size[1] - 1) / 2], [0.0, 0.0, 1.0]])
    ok, rotation, shift = cv2.solvePnP(
        points_cam_mm, pixels_px, matrix, np.zeros(5), flags=cv2.SOLVEPNP_SQPNP
    )
    if not ok:
        raise InputError("the projector cannot be placed: its coordinates fit no pinhole")
    device = Pinhole(size[0], size[1], f, f, float(matrix[0, 2]), float(matrix[1, 2]))
    return device, rigid(rotation, shift)


def resect(points_mm: FloatArray, pixels_px: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Return camera matrix (3, 3) and motion (4, 4) of a pinhole from points in space, or None.

    Notes
    -----
    Direct linear transformation with normalised coordinates: Hartley and Zisserman, Multiple View
    Geometry, algorithm 7.1. The principal point may lie anywhere.
    """
    space, image = normaliser(points_mm), normaliser(pixels_px)
    X = np.column_stack([points_mm, np.ones(len(points_mm))]) @ space.T
    u, v = (np.column_stack([pixels_px, np.ones(len(pixels_px))]) @ image.T)[:, :2].T
    zero = np.zeros_like(X)
    upper, lower = [X, zero, -u[:, np.newaxis] * X], [zero, X, -v[:, np.newaxis] * X]
    design = np.concatenate([np.hstack(upper), np.hstack(lower)])
    solution = np.linalg.svd(design, full_matrices=False)[2][-1].reshape(3, 4)
    P = np.linalg.inv(image) @ solution @ space
    return _decompose(P, points_mm)


def _decompose(P: FloatArray, points_mm: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    if np.linalg.det(P[:, :3]) < 0.0:
        P = -P
    matrix, rotation = rq(P[:, :3])
    if matrix[2, 2] == 0.0 or not np.all(np.isfinite(matrix)):
        return None
    signs = np.diag(np.sign(np.diag(matrix)))
    matrix, rotation = matrix @ signs, signs @ rotation
    motion = np.eye(4)
    motion[:3, :3] = rotation
    motion[:3, 3] = np.linalg.solve(matrix, P[:, 3])
    depth = points_mm @ rotation[2] + motion[2, 3]
    if np.linalg.det(rotation) < 0.0 or depth.min() <= 0.0:
        return None
    return matrix / matrix[2, 2], motion
