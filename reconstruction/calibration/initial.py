"""Compute starting values of a calibration: the camera by OpenCV, the projector by resection.

OpenCV's camera calibration starts from a principal point in the middle of the image and rejects
one outside the image. The principal point of a projector may be outside. Therefore the calibrated
camera gives the board features of all poses as ONE set of points in space. The projection matrix of
the projector follows from these points and its coordinates linearly, for any principal point.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from scipy.linalg import rq

from reconstruction.arrays import FloatArray, FloatImage
from reconstruction.calibration.observation import Observation
from reconstruction.calibration.parameters import Freedom, RigEstimate, rigid
from reconstruction.calibration.plane_images import normaliser
from reconstruction.errors import InputError
from reconstruction.rig.pinhole import Pinhole

MIN_POSES = 3
SQUARE_PIXELS = Freedom()
# Only the focal length is estimated: other parameters are weakly determined at the start.
CAMERA_FLAGS = (
    cv2.CALIB_FIX_PRINCIPAL_POINT
    | cv2.CALIB_FIX_ASPECT_RATIO
    | cv2.CALIB_ZERO_TANGENT_DIST
    | cv2.CALIB_FIX_K1
    | cv2.CALIB_FIX_K2
    | cv2.CALIB_FIX_K3
)
# Least angle between any two board normals; with less, focal length and distance are not separable.
MIN_TILT_SPREAD_DEG = 3.0
# Accepted results of a resection: focal length in image widths, and the ratio of fy / fx to the
# pixel ratio.
FOCAL_WIDTHS, MAX_RATIO = (0.3, 20.0), 1.3
# Tilted views of a small field hardly separate focal length and distance: the fit is started from
# several values and the best is used. The same applies to a free pixel ratio.
FOCAL_FACTORS, USUAL_RATIOS = (1.0, 0.5, 2.0), (1.0, 0.5, 2.0)
# Least extent in projector pixels of the features of all poses.
LEAST_EXTENT_PX = 8.0
# Throw ratio of a typical projector, used if the resection fails.
FALLBACK_THROW = 1.4


def starting_rig(
    observations: Sequence[Observation], freedom: Freedom = SQUARE_PIXELS
) -> RigEstimate:
    """Return a first estimate of camera, projector and all poses.

    Parameters
    ----------
    observations : one per board pose
    freedom : only its pixel ratios are used

    Raises
    ------
    InputError : too few poses, or the poses do not determine the camera
    """
    if len(observations) < MIN_POSES:
        raise InputError(
            f"{len(observations)} board poses given, needed are {MIN_POSES} (better 12), tilted "
            "in different directions"
        )
    camera, motions = _start_camera(observations, freedom.camera_pixel_ratio)
    _require_tilts(motions)
    points_cam_mm, pixels = _in_space(observations, motions)
    size, ratio = observations[0].projector_size_px, freedom.projector_pixel_ratio
    projector, motion = _start_projector(points_cam_mm, pixels, size, ratio)
    return RigEstimate(camera, projector, motion, motions)


def is_resected(observations: Sequence[Observation], freedom: Freedom) -> bool:
    """Return True if the projector's linear solution has all features in front of the projector."""
    motions = _start_camera(observations, freedom.camera_pixel_ratio)[1]
    return resect(*_in_space(observations, motions)) is not None


def _in_space(
    observations: Sequence[Observation], motions: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the features of all poses: camera frame, (n, 3) mm; projector pixels, (n, 2) px."""
    poses = zip(observations, motions, strict=True)
    points = [observation.points_mm @ T[:3, :3].T + T[:3, 3] for observation, T in poses]
    return np.concatenate(points), np.concatenate(
        [observation.projector_px for observation in observations]
    )


def _require_tilts(motions: FloatArray) -> None:
    normals = motions[:, :3, 2]
    cosines = np.clip(normals @ normals.T, -1.0, 1.0)
    if np.degrees(np.arccos(cosines.min())) < MIN_TILT_SPREAD_DEG:
        raise _undetermined()


def _start_camera(
    observations: Sequence[Observation], pixel_ratio: float | None
) -> tuple[Pinhole, FloatArray]:
    size = observations[0].camera_size_px
    objects = [observation.points_mm.astype(np.float32) for observation in observations]
    images = [
        observation.camera_px.astype(np.float32).reshape(-1, 1, 2) for observation in observations
    ]
    tries = [
        _calibrate_camera(objects, images, size, guess, factor)
        for ratio in (USUAL_RATIOS if pixel_ratio is None else (pixel_ratio,))
        if (guess := _camera_guess(objects, images, size, ratio)) is not None
        for factor in FOCAL_FACTORS
    ]
    if not tries:
        raise _undetermined()
    error, matrix, rotations, shifts = min(tries, key=lambda trial: trial[0])
    if not np.isfinite(error):
        raise _undetermined()
    fx, fy, cx, cy = (float(matrix[place]) for place in ((0, 0), (1, 1), (0, 2), (1, 2)))
    motions = np.stack([rigid(r, t) for r, t in zip(rotations, shifts, strict=True)])
    return Pinhole(size[0], size[1], fx, fy, cx, cy), motions


def _camera_guess(
    objects: list[FloatImage], images: list[FloatImage], size: tuple[int, int], pixel_ratio: float
) -> FloatArray | None:
    guess = cv2.initCameraMatrix2D(objects, images, size, 1.0 / pixel_ratio)
    return guess if np.all(np.isfinite(guess)) and guess[0, 0] > 0.0 else None


def _calibrate_camera(
    objects: list[FloatImage],
    images: list[FloatImage],
    size: tuple[int, int],
    guess: FloatArray,
    by: float,
) -> tuple[float, FloatArray, Sequence[FloatArray], Sequence[FloatArray]]:
    matrix = np.array(guess, dtype=np.float64)
    matrix[:2, :2] *= by
    matrix[:2, 2] = (size[0] - 1) / 2.0, (size[1] - 1) / 2.0
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | CAMERA_FLAGS
    try:
        solution = cv2.calibrateCamera(objects, images, size, matrix, np.zeros(5), flags=flags)
    except cv2.error:
        return np.inf, matrix, (), ()
    error, matrix, _, rotations, shifts = solution[:5]
    return float(error), matrix, rotations, shifts


def _undetermined() -> InputError:
    return InputError(
        "the board poses do not determine the camera's focal length: tilt the board by 10 to 25 "
        "degrees in at least three directions"
    )


def _start_projector(
    points_cam_mm: FloatArray,
    pixels_px: FloatArray,
    size: tuple[int, int],
    pixel_ratio: float | None,
) -> tuple[Pinhole, FloatArray]:
    _require_spread(pixels_px)
    resection = resect(points_cam_mm, pixels_px)
    if resection is not None:
        matrix, motion = resection
        fx, fy = float(matrix[0, 0]), float(matrix[1, 1])
        low, high = FOCAL_WIDTHS[0] * size[0], FOCAL_WIDTHS[1] * size[0]
        deviation = 1.0 if pixel_ratio is None else fy / fx / pixel_ratio
        if low < fx < high and 1.0 / MAX_RATIO < deviation < MAX_RATIO:
            cx, cy = float(matrix[0, 2]), float(matrix[1, 2])
            return Pinhole(size[0], size[1], fx, fy, cx, cy), motion
    # The linear solution fails with strong noise. Then the start is a typical projector with its
    # principal point in the image centre; the points give its pose.
    fx = FALLBACK_THROW * size[0]
    fy = (pixel_ratio or 1.0) * fx
    matrix = np.array([[fx, 0.0, (size[0] - 1) / 2], [0.0, fy, (size[1] - 1) / 2], [0.0, 0.0, 1.0]])
    ok, rotation, shift = cv2.solvePnP(
        points_cam_mm, pixels_px, matrix, np.zeros(5), flags=cv2.SOLVEPNP_SQPNP
    )
    if not ok:
        raise InputError("the projector has no pose: its coordinates fit no pinhole")
    device = Pinhole(size[0], size[1], fx, fy, float(matrix[0, 2]), float(matrix[1, 2]))
    return device, rigid(rotation, shift)


def _require_spread(pixels_px: FloatArray) -> None:
    for name, extent_px in zip(("column", "row"), np.ptp(pixels_px, axis=0), strict=True):
        if not extent_px >= LEAST_EXTENT_PX:
            raise InputError(
                f"the projector {name}s of all features are within {extent_px:.2g} px, needed are "
                f"{LEAST_EXTENT_PX:g}; check that the images show the patterns of capture.toml"
            )


def resect(points_mm: FloatArray, pixels_px: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Return camera matrix (3, 3) and pose (4, 4) of a pinhole from points and their images.

    None: the linear solution is no pinhole with all points in front of it.

    Parameters
    ----------
    points_mm : (n, 3) points in space; the pose maps their frame to the device's frame
    pixels_px : (n, 2) images of the points

    Notes
    -----
    Direct linear transformation with normalised coordinates: Hartley and Zisserman, Multiple View
    Geometry, algorithm 7.1. The principal point may be outside the image.
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
    if not np.all(np.isfinite(matrix)) or not np.all(np.diag(matrix)):
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
