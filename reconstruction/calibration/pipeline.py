"""Calibrate a rig from observations of a board; report parameters, residuals and checks.

Each parameter has an uncertainty, each pose its residuals. As an independent check of lengths, the
calibrated rig can measure the features of a board (`locate_features`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.calibration.adjustment import DIVERGES, Adjustment, AdjustOptions, adjust
from reconstruction.calibration.diagnosis import NO_CAUSE, remedy_for
from reconstruction.calibration.initial import starting_rig
from reconstruction.calibration.observation import Observation
from reconstruction.calibration.parameters import (
    INTRINSICS,
    MOTION,
    STEREO,
    Freedom,
    RigEstimate,
    rigid,
    rotation_vector,
)
from reconstruction.calibration.plane_images import centre_bias_px
from reconstruction.calibration.plausibility import adjustment_checks, misfits, pupil_doubt
from reconstruction.errors import InputError
from reconstruction.rig.calibration import Calibration
from reconstruction.rig.epipolar import epipolar_residuals_px
from reconstruction.rig.plausibility import Check, implausible, require_plausible

COVERAGE_FACTOR = 2.0
"""Coverage factor k of the expanded uncertainty U = k sigma: about 95 % (JCGM 100, 6.2)."""
STEPS = 4


@dataclass(frozen=True)
class Parameter:
    """One parameter of the calibrated rig and its standard uncertainty.

    name : name, which ends with the unit
    sigma : standard uncertainty; 0: the parameter was fixed
    """

    name: str
    value: float
    sigma: float

    @property
    def expanded(self) -> float:
        """Expanded uncertainty of the parameter, k = 2."""
        return COVERAGE_FACTOR * self.sigma


@dataclass(frozen=True)
class PoseResidual:
    """Residuals of one board pose.

    name : name of the pose
    features, left_out : number of features in the fit, and of excluded features
    camera_px, projector_px : RMS reprojection residual in each device
    epipolar_px : RMS distance of the projector points from the epipolar lines of the camera points
    """

    name: str
    features: int
    left_out: int
    camera_px: float
    projector_px: float
    epipolar_px: float


def parameters(fit: Adjustment) -> list[Parameter]:
    """Return all parameters of the rig, and the baseline, with their standard uncertainties."""
    names = [
        *(f"camera_{name}" for name in INTRINSICS),
        *(f"projector_{name}" for name in INTRINSICS),
        *(f"stereo_{name}" for name in MOTION),
    ]
    values, sigmas = fit.vector, np.sqrt(np.diag(fit.covariance))
    rows = [Parameter(name, float(values[k]), float(sigmas[k])) for k, name in enumerate(names)]
    return [*rows, _baseline(fit)]


def parameters_of(rig: RigEstimate | Calibration) -> dict[str, float]:
    """Return the values of a known rig by the names that `parameters` uses, for comparison."""
    T = rig.T_proj_from_cam
    numbers_by_name: dict[str, float] = {}
    for device, lens in (("camera", rig.camera), ("projector", rig.projector)):
        values = (lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px, *lens.distortion)
        numbers_by_name |= {
            f"{device}_{name}": n for name, n in zip(INTRINSICS, values, strict=True)
        }
    motion = [*rotation_vector(T[:3, :3]), *T[:3, 3]]
    numbers_by_name |= {f"stereo_{name}": float(n) for name, n in zip(MOTION, motion, strict=True)}
    return numbers_by_name | {"baseline_mm": float(np.linalg.norm(T[:3, 3]))}


def _baseline(fit: Adjustment) -> Parameter:
    shift = slice(STEREO.start + 3, STEREO.stop)
    length = float(np.linalg.norm(fit.vector[shift]))
    along = fit.vector[shift] / length
    return Parameter(
        "baseline_mm", length, float(np.sqrt(along @ fit.covariance[shift, shift] @ along))
    )


def pose_residuals(fit: Adjustment, observations: Sequence[Observation]) -> list[PoseResidual]:
    """Return the RMS residuals of each pose over the features that the fit included."""
    rows = []
    for k, observation in enumerate(observations):
        used, residuals = fit.used[k], fit.residuals_px[k][fit.used[k]]
        rows.append(
            PoseResidual(
                name=observation.name,
                features=int(used.sum()),
                left_out=int((~used).sum()),
                camera_px=_rms(residuals[:, :2]),
                projector_px=_rms(residuals[:, 2:]),
                epipolar_px=_rms(epipolar_residuals_px(fit.rig, fit.measured_px[k][used])),
            )
        )
    return rows


def pupil_diameter_mm(fit: Adjustment) -> float:
    """Return the aperture diameter of the camera lens, mm, from the blur of tilted boards.

    The result is 0 if `pupil_mm2` is below three of its standard uncertainties. The diameter is
    accurate to about 10 %. Use it only to check the f-number, focal length / diameter.
    """
    is_significant = fit.pupil_mm2 > 3.0 * fit.pupil_sigma_mm2
    return 4.0 * float(np.sqrt(fit.pupil_mm2)) if is_significant else 0.0


def calibration_of(fit: Adjustment) -> Calibration:
    """Return the calibration of an adjusted rig.

    The world frame is the board frame of the first pose, with z towards the devices.
    """
    T_world_from_cam = _inverse(fit.rig.T_cam_from_board[0])
    T_world_from_proj = T_world_from_cam @ _inverse(fit.rig.T_proj_from_cam)
    return Calibration(fit.rig.camera, fit.rig.projector, T_world_from_cam, T_world_from_proj)


def _inverse(motion: FloatArray) -> FloatArray:
    back = np.eye(4)
    back[:3, :3] = motion[:3, :3].T
    back[:3, 3] = -motion[:3, :3].T @ motion[:3, 3]
    return back


def _rays(normalised: FloatArray) -> FloatArray:
    return np.column_stack([normalised, np.ones(len(normalised))])


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0


@dataclass(frozen=True, eq=False)
class Calibrated:
    """Result of a calibration.

    Attributes
    ----------
    calibration : geometry of the rig; the world frame is the board frame of the first pose
    adjustment : parameter vector, covariance and residuals
    parameters : parameters of the rig with their standard uncertainties
    poses : residuals of each pose
    checks : plausibility checks, all of them passed
    doubts : warnings about residuals that the model does not explain, and about an implausible
        aperture, without which the rig was then calibrated
    """

    calibration: Calibration
    adjustment: Adjustment
    parameters: tuple[Parameter, ...]
    poses: tuple[PoseResidual, ...]
    checks: tuple[Check, ...]
    doubts: tuple[str, ...] = ()


def calibrate(
    observations: Sequence[Observation], options: AdjustOptions | None = None
) -> Calibrated:
    """Calibrate camera and projector from observations of a board in several poses.

    Parameters
    ----------
    observations : one per board pose; the board frame of the first pose becomes the world frame
    options : estimated parameters and corrections; None: the defaults. The pixel ratio of the
        projector that the captures state replaces the default, 1

    Raises
    ------
    InputError : too few poses, different image sizes, poses that do not determine the rig, or an
        implausible result. If a mistake in the input explains the result, the message names it
    """
    sizes = {
        (observation.camera_size_px, observation.projector_size_px) for observation in observations
    }
    if len(sizes) > 1:
        raise InputError(
            f"the poses have different image sizes (camera, projector): {sorted(sizes)}; "
            "calibrate each size by itself"
        )
    chosen = _as_stated(observations, options or AdjustOptions())
    fit, doubt = _adjusted(observations, chosen)
    checks = _plausible(observations, chosen, fit)
    return Calibrated(
        calibration=calibration_of(fit),
        adjustment=fit,
        parameters=tuple(parameters(fit)),
        poses=tuple(pose_residuals(fit, observations)),
        checks=checks,
        doubts=(*([doubt] if doubt else []), *misfits(fit, observations)),
    )


def _as_stated(observations: Sequence[Observation], options: AdjustOptions) -> AdjustOptions:
    """Return the options with the projector's pixel ratio of the captures, if none is given."""
    stated = {observation.projector_pixel_ratio for observation in observations} or {1.0}
    if len(stated) > 1:
        ratios = ", ".join(f"{ratio:g}" for ratio in sorted(stated))
        raise InputError(f"the captures state different pixel_ratio ({ratios}); give one in all")
    if options.freedom.projector_pixel_ratio != Freedom.projector_pixel_ratio:
        return options
    freedom = replace(options.freedom, projector_pixel_ratio=stated.pop())
    return replace(options, freedom=freedom)


def _adjusted(
    observations: Sequence[Observation], options: AdjustOptions
) -> tuple[Adjustment, str]:
    """Return the adjustment and a warning; "": no warning.

    If the estimated aperture is implausible, the adjustment is without defocus, and the warning
    gives the reason.
    """
    start = starting_rig(observations, options.freedom)
    try:
        fit = adjust(observations, start, options)
        doubt = pupil_doubt(fit)
        if not doubt:
            return fit, ""
        sharp = replace(options, freedom=replace(options.freedom, camera_defocus=False))
        return adjust(observations, start, sharp), (
            f"{doubt}: the residuals are not blur of a camera out of focus; "
            "calibrated without that term"
        )
    except InputError as error:
        remedy = remedy_for(observations, options, None)
        if remedy == NO_CAUSE and str(error) != DIVERGES:  # the error has its own remedy
            raise
        raise InputError(f"{error}; {remedy}") from error


def _plausible(
    observations: Sequence[Observation], options: AdjustOptions, fit: Adjustment
) -> tuple[Check, ...]:
    checks = adjustment_checks(fit, observations, options.freedom)
    if implausible(checks):
        require_plausible(checks, remedy_for(observations, options, fit))
    return checks


def locate_features(calibration: Calibration, observation: Observation) -> FloatArray:
    """Return the triangulated positions of the features of a board, (n, 3) mm, world frame.

    The dimensions of the board are used only to correct the perspective bias of dot centres, an
    effect below a micrometre. Otherwise the distances between the points do not depend on the
    board's nominal dimensions.
    """
    camera = calibration.camera
    T = _rough_pose(calibration, observation)
    inside = observation.points_mm @ T[:3, :3].T + T[:3, 3]
    bias = centre_bias_px(camera, inside, observation.radii_mm, T[:3, :3])
    projector_px = observation.projector_px - np.einsum("nij,nj->ni", observation.slopes, bias)
    rays = _rays(camera.unproject(observation.camera_px - bias))
    points = rays * _depths(calibration, rays, projector_px, inside[:, 2])[:, np.newaxis]
    world = calibration.T_world_from_cam
    return np.asarray(points @ world[:3, :3].T + world[:3, 3])


def _rough_pose(calibration: Calibration, observation: Observation) -> FloatArray:
    flat = np.ascontiguousarray(calibration.camera.unproject(observation.camera_px))
    rotation, shift = cv2.solvePnP(
        observation.points_mm, flat, np.eye(3), np.zeros(5), flags=cv2.SOLVEPNP_IPPE
    )[1:3]
    return rigid(rotation, shift)


def _depths(
    calibration: Calibration, rays: FloatArray, projector_px: FloatArray, start_mm: FloatArray
) -> FloatArray:
    """Return the depths (n,), mm, along camera rays (n, 3) that best fit the projector pixels.

    The fit takes a few Gauss-Newton steps from the depths `start_mm`.
    """
    T, depth, step_mm = calibration.T_proj_from_cam, start_mm.copy(), 1e-3
    for _ in range(STEPS):
        places = [
            calibration.projector.project((rays * d[:, np.newaxis]) @ T[:3, :3].T + T[:3, 3])
            for d in (depth - step_mm, depth + step_mm)
        ]
        slope = (places[1] - places[0]) / (2.0 * step_mm)
        residual = projector_px - (places[0] + places[1]) / 2.0
        depth = depth + np.sum(slope * residual, axis=1) / np.sum(slope * slope, axis=1)
    return depth


def length_errors_mm(
    points_world_mm: FloatArray, observation: Observation, length_mm: float
) -> FloatArray:
    """Return measured minus nominal distances, (m,) mm, of pairs of features.

    The pairs are all those with the nominal distance `length_mm` on the board.

    Parameters
    ----------
    points_world_mm : (n, 3) measured positions of the features of `observation`
    length_mm : nominal distance of the pairs
    """
    nominal = np.linalg.norm(observation.points_mm[:, np.newaxis] - observation.points_mm, axis=-1)
    first, second = np.nonzero(np.triu(np.abs(nominal - length_mm) < 1e-6))
    measured = np.linalg.norm(points_world_mm[first] - points_world_mm[second], axis=1)
    return np.asarray(measured - nominal[first, second])
