"""Check whether the result of a calibration (`Adjustment`) is plausible for a real rig.

| quantity | plausible range | reason for the limit |
|---|---|---|
| RMS residual of the worst pose, per device | see below | a worse calibration is useless |
| share of excluded features | up to 25 % | dirt excludes fewer, a wrong model excludes more |
| relative uncertainty of focal lengths and baseline | up to 25 % | k = 2: 50 % of the value |
| fy / fx, divided by the declared ratio | 1 +- (3 % + 5 sigma) | chips are exact, boards to 1 % |
| depth of every feature | above 0 | the board is in front of both devices |
| angle of incidence on the board | up to 88 degrees | both devices view the printed face |

The diameter of the aperture, from the blur of tilted boards, is checked separately (`pupil_doubt`).
If it is implausible, the defocus model was fitted to residuals with another cause, and the rig is
adjusted without defocus.

The limit of the RMS residual is the largest of 1 px, 1/2000 of the image diagonal, and 5 times the
detection scatter. The residuals of lenses that the model does not describe exactly are below this
limit; those of wrong boards and wrong image sizes are above.

The detection scatter is the robust standard deviation of the features from a smooth map of the
board into the image. The map is a homography and a cubic polynomial and can describe any lens, so
the scatter does not depend on the calibration.
"""

from collections.abc import Sequence

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.calibration.adjustment import MAD_TO_SIGMA, Adjustment
from reconstruction.calibration.observation import Observation
from reconstruction.calibration.parameters import CAMERA, PROJECTOR, STEREO, Freedom
from reconstruction.calibration.plane_images import apply_homography, fit_homography
from reconstruction.errors import InputError
from reconstruction.rig.calibration import DEVICES
from reconstruction.rig.plausibility import (
    BASELINES_MM,
    TRIANGULATION_ANGLES_DEG,
    Check,
    lens_checks,
)

MOST_RMS_PX, DIAGONALS_PER_RMS, MOST_SCATTERS = 1.0, 2000.0, 5.0
# Least RMS residual that gives a warning, if it also exceeds MOST_SCATTERS times the scatter.
LEAST_DOUBT_PX = 0.2
MOST_LEFT_OUT = 0.25
MOST_RELATIVE_SIGMA = 0.25
RATIO_TOLERANCE, RATIO_SIGMAS = 0.03, 5.0
MOST_INCIDENCE_DEG = 88.0
# Largest pupil diameter per focal length in px: pixels of 30 um (binned), lens with f-number 0.7.
MOST_PUPIL_MM_PER_FOCAL_PX = 0.030 / 0.7
PUPIL_SIGMAS = 3.0
# x^i y^j with i + j <= 3
CUBIC_TERMS = 10
# Camera and projector among the columns of residuals.
PARTS = slice(0, 2), slice(2, 4)


def adjustment_checks(
    fit: Adjustment, observations: Sequence[Observation], freedom: Freedom
) -> tuple[Check, ...]:
    """Return all checks of an adjustment: value and plausible range of each quantity."""
    used = np.concatenate(fit.used)
    return (
        *_rms_checks(fit, observations),
        Check("left_out_share", float(1.0 - used.mean()), 0.0, MOST_LEFT_OUT),
        *_certainty_checks(fit),
        *lens_checks("camera", fit.rig.camera),
        *lens_checks("projector", fit.rig.projector),
        *_ratio_checks(fit, freedom),
        *_place_checks(fit, observations),
    )


def pupil_doubt(fit: Adjustment) -> str:
    """Return why the camera's aperture is implausible; "" if plausible or not significant.

    Notes
    -----
    The diameter of the aperture is focal length / f-number. As the focal length is known in pixels
    only, the limit of the diameter is fx times 0.043 mm. The estimated mean square of the pupil
    coordinate must not be significantly negative.
    """
    if abs(fit.pupil_mm2) <= PUPIL_SIGMAS * fit.pupil_sigma_mm2:
        return ""
    if fit.pupil_mm2 < 0.0:
        return f"mean square of the place on the pupil is {fit.pupil_mm2:.3g} mm2, plausible from 0"
    diameter_mm = 4.0 * float(np.sqrt(fit.pupil_mm2))
    most_mm = MOST_PUPIL_MM_PER_FOCAL_PX * fit.rig.camera.fx_px
    check = Check("camera_pupil_diameter_mm", diameter_mm, 0.0, most_mm)
    return "" if check.is_plausible else str(check)


def detection_scatter_px(
    observations: Sequence[Observation], pixels_px: Sequence[FloatArray]
) -> float:
    """Return the detection scatter in one device, px: the median over poses; 0: too few points.

    Parameters
    ----------
    pixels_px : for each pose (n, 2) float, the features in the pixels of the device
    """
    spreads = [
        _scatter_px(observation.points_mm[:, :2], pixels)
        for observation, pixels in zip(observations, pixels_px, strict=True)
        if len(pixels) >= 2 * CUBIC_TERMS
    ]
    return float(np.median(spreads)) if spreads else 0.0


def _scatter_px(points_mm: FloatArray, pixels_px: FloatArray) -> float:
    try:
        flat = apply_homography(fit_homography(points_mm, pixels_px), points_mm)
    except InputError:
        return 0.0
    x, y = ((flat - flat.mean(axis=0)) / np.ptp(flat, axis=0)).T
    terms = np.stack([x**i * y**j for i in range(4) for j in range(4 - i)], axis=-1)
    residual = pixels_px - terms @ np.linalg.lstsq(terms, pixels_px)[0]
    freedom = len(pixels_px) / (len(pixels_px) - CUBIC_TERMS)
    return float(MAD_TO_SIGMA * np.median(np.abs(residual)) * np.sqrt(freedom))


def _rms_checks(fit: Adjustment, observations: Sequence[Observation]) -> list[Check]:
    sizes = observations[0].camera_size_px, observations[0].projector_size_px
    checks = []
    for name, size, part in zip(DEVICES, sizes, PARTS, strict=True):
        scatter = detection_scatter_px(observations, [m[:, part] for m in fit.measured_px])
        limit = max(MOST_RMS_PX, np.hypot(*size) / DIAGONALS_PER_RMS, MOST_SCATTERS * scatter)
        worst = max(_pose_rms_px(fit, part))
        checks.append(Check(f"{name}_worst_pose_rms_px", worst, 0.0, float(limit)))
    return checks


def _pose_rms_px(fit: Adjustment, part: slice) -> list[float]:
    pairs = zip(fit.residuals_px, fit.used, strict=True)
    return [float(np.sqrt(np.mean(residual[used, part] ** 2))) for residual, used in pairs]


def misfits(fit: Adjustment, observations: Sequence[Observation]) -> tuple[str, ...]:
    """Return a message for each device with residuals far above the detection scatter."""
    texts = []
    for name, part in zip(DEVICES, PARTS, strict=True):
        scatter = detection_scatter_px(observations, [m[:, part] for m in fit.measured_px])
        rms = _pose_rms_px(fit, part)
        worst = int(np.argmax(rms))
        if scatter > 0.0 and rms[worst] > max(LEAST_DOUBT_PX, MOST_SCATTERS * scatter):
            texts.append(
                f"{name}: the residuals of {observations[worst].name} are {rms[worst]:.2g} px RMS, "
                f"{rms[worst] / scatter:.0f} times the scatter of detection: something moved "
                "during a pose, the board is bent, or a lens distorts more than the model allows"
            )
    return tuple(texts)


def _certainty_checks(fit: Adjustment) -> list[Check]:
    sigmas = np.sqrt(np.diag(fit.covariance))
    shift = slice(STEREO.start + 3, STEREO.stop)
    baseline = fit.vector[shift]
    length = float(np.linalg.norm(baseline))
    sigma = float(np.sqrt(baseline @ fit.covariance[shift, shift] @ baseline)) / length
    relative = {
        "camera_focal_length": sigmas[CAMERA.start] / fit.vector[CAMERA.start],
        "projector_focal_length": sigmas[PROJECTOR.start] / fit.vector[PROJECTOR.start],
        "baseline": sigma / length,
    }
    return [
        Check(f"{name}_relative_uncertainty", float(value), 0.0, MOST_RELATIVE_SIGMA)
        for name, value in relative.items()
    ]


def _ratio_checks(fit: Adjustment, freedom: Freedom) -> list[Check]:
    checks = []
    for name, declared, ratio in (
        ("camera", freedom.camera_pixel_ratio, fit.pixel_ratios[0]),
        ("projector", freedom.projector_pixel_ratio, fit.pixel_ratios[1]),
    ):
        if declared is not None and np.isfinite(ratio.sigma):
            margin = RATIO_TOLERANCE + RATIO_SIGMAS * ratio.sigma / declared
            value = ratio.value / declared
            checks.append(Check(f"{name}_pixel_ratio_over_declared", value, 1 - margin, 1 + margin))
    return checks


def _place_checks(fit: Adjustment, observations: Sequence[Observation]) -> list[Check]:
    """Return the checks of depths, angles of incidence, baseline and triangulation angle."""
    stereo = fit.rig.T_proj_from_cam
    centre_mm = -stereo[:3, :3].T @ stereo[:3, 3]
    depths, cosines, angles = [], [], []
    for observation, T in zip(observations, fit.rig.T_cam_from_board, strict=True):
        points = observation.points_mm @ T[:3, :3].T + T[:3, 3]
        directions = [_directions(place - points) for place in (np.zeros(3), centre_mm)]
        depths.append([points[:, 2].min(), (points @ stereo[2, :3] + stereo[2, 3]).min()])
        cosines.append([(direction @ T[:3, 2]).min() for direction in directions])
        angles.append(np.median(_degrees(np.sum(directions[0] * directions[1], axis=1))))
    depth, incidence = np.min(depths, axis=0), _degrees(np.min(cosines, axis=0))
    checks = []
    for k, name in enumerate(DEVICES):
        checks.append(Check(f"{name}_least_depth_mm", float(depth[k]), 1e-3, np.inf))
        most = float(incidence[k])
        checks.append(Check(f"{name}_incidence_deg", most, 0.0, MOST_INCIDENCE_DEG))
    angle = float(np.median(angles))
    baseline_mm = float(np.linalg.norm(stereo[:3, 3]))
    checks.append(Check("baseline_mm", baseline_mm, *BASELINES_MM))
    return [*checks, Check("triangulation_angle_deg", angle, *TRIANGULATION_ANGLES_DEG)]


def _directions(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def _degrees(cosines: FloatArray) -> FloatArray:
    return np.asarray(np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0))))
