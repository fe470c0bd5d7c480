"""Find a change of the input that makes an implausible calibration plausible.

For each common mistake with real rigs, a copy of the observations is corrected or the model is
extended, and the rig is calibrated again. The first change for which all checks pass is reported.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.calibration.adjustment import Adjustment, AdjustOptions, adjust
from reconstruction.calibration.initial import MIN_POSES, is_resected, starting_rig
from reconstruction.calibration.observation import Observation
from reconstruction.calibration.parameters import Distortion, Freedom, rotation_vector
from reconstruction.calibration.plausibility import RATIO_TOLERANCE, adjustment_checks
from reconstruction.errors import InputError
from reconstruction.rig.plausibility import implausible

NO_CAUSE = (
    "check that every pose shows the board of the board file, at rest, and that the description of "
    "the captures has the projector's size and the order and sign of the frames"
)
MIRRORED = "mirrored"
# Largest RMS residual of a trial after its first iteration; it is larger with a wrong change.
GIVE_UP_PX = 5.0
# Radial distortion coefficients that are estimated if the lenses may distort strongly.
RADIAL: tuple[Distortion, ...] = ("k1", "k2")


@dataclass(frozen=True, eq=False)
class _Trial:
    """A trial calibration: changed observations or options, and the remedy to report on success.

    remedy : sentence for the error message; "" or MIRRORED: it is made from the result
    """

    observations: Sequence[Observation]
    options: AdjustOptions
    remedy: str


def remedy_for(
    observations: Sequence[Observation], options: AdjustOptions, failed: Adjustment | None
) -> str:
    """Return advice for the user: the change that makes the calibration plausible.

    If no change does, the advice is NO_CAUSE, a general list of points to check.

    Parameters
    ----------
    failed : the implausible adjustment; None: the adjustment failed
    """
    for trial in _trials(observations, options, failed):
        fit = _plausible_fit(trial)
        if fit is not None:
            return _remedy(trial, fit, options.freedom)
    return NO_CAUSE


def _plausible_fit(trial: _Trial) -> Adjustment | None:
    try:
        start = starting_rig(trial.observations, trial.options.freedom)
        fit = adjust(trial.observations, start, trial.options, GIVE_UP_PX)
    except InputError:
        return None
    checks = adjustment_checks(fit, trial.observations, trial.options.freedom)
    return None if implausible(checks) else fit


def _trials(
    observations: Sequence[Observation], options: AdjustOptions, failed: Adjustment | None
) -> Iterator[_Trial]:
    free = replace(options.freedom, camera_pixel_ratio=None, projector_pixel_ratio=None)
    released = replace(options, freedom=free)
    trials = [
        _Trial(observations, released, ""),
        _Trial([_mirrored(observation) for observation in observations], released, MIRRORED),
    ]
    # For mirrored projector images the linear solution has the boards behind the projector.
    yield from trials if is_resected(observations, free) else reversed(trials)
    radial = replace(options.freedom, camera_distortion=RADIAL, projector_distortion=RADIAL)
    yield _Trial(
        observations,
        replace(options, freedom=radial),
        "the lenses distort more than the model allows: estimate more coefficients "
        "(--camera-distortion k1 k2 --projector-distortion k1 k2)",
    )
    if failed is not None and len(observations) > MIN_POSES:
        worst = int(np.argmax([_rms(residuals) for residuals in failed.residuals_px]))
        yield _Trial(
            [observation for k, observation in enumerate(observations) if k != worst],
            options,
            f"{observations[worst].name} does not fit the other poses: the board, camera or "
            "projector moved during it, or it shows another board; remove it",
        )


def _rms(residuals_px: FloatArray) -> float:
    return float(np.sqrt(np.mean(residuals_px**2)))


def _mirrored(observation: Observation) -> Observation:
    """Return the observation with the projector columns counted in the opposite direction."""
    columns = observation.projector_size_px[0] - 1 - observation.projector_px[:, 0]
    return replace(
        observation,
        projector_px=np.column_stack([columns, observation.projector_px[:, 1]]),
        slopes=observation.slopes * np.array([[-1.0], [1.0]]),
    )


def _remedy(trial: _Trial, fit: Adjustment, declared: Freedom) -> str:
    if trial.remedy not in ("", MIRRORED):
        return trial.remedy
    parts = [] if trial.remedy == "" else [_mirror_remedy(fit)]
    return "; ".join([*parts, *_ratio_remedies(fit, declared)]) or NO_CAUSE


def _mirror_remedy(fit: Adjustment) -> str:
    """Return advice for mirrored projector images: axes exchanged, or one counted backwards."""
    roll_deg = abs(np.degrees(rotation_vector(fit.rig.T_proj_from_cam[:3, :3])[2]))
    if 45.0 < roll_deg < 135.0:
        return (
            "the projector's image is mirrored: columns and rows are exchanged, or one of them is "
            "counted backwards; correct axis, sign or order of the frames in capture.toml"
        )
    return (
        "the projector's image is mirrored: columns or rows are counted backwards, or the camera's "
        "images are mirrored; correct sign or order of the frames in capture.toml"
    )


def _ratio_remedies(fit: Adjustment, declared: Freedom) -> Iterator[str]:
    projector, camera = fit.rig.projector, fit.rig.camera
    ratio = projector.fy_px / projector.fx_px
    if _differs(ratio, declared.projector_pixel_ratio):
        yield (
            f"the projector's pixels are {ratio:.3g} times as wide as high (fy / fx): give "
            f"--projector-pixel-ratio {_simple(ratio):.3g}, or correct its size, "
            f"{projector.width_px} x {projector.height_px} px: of square pixels it is "
            f"{round(projector.width_px * _simple(ratio))} x {projector.height_px}; or state "
            "pixel_ratio in the description of the captures"
        )
    ratio = camera.fy_px / camera.fx_px
    if _differs(ratio, declared.camera_pixel_ratio):
        yield (
            f"the camera's pixels are {ratio:.3g} times as wide as high (fy / fx): give "
            f"--camera-pixel-ratio {_simple(ratio):.3g}, or check that the board's squares are "
            "square and its data"
        )


def _differs(ratio: float, declared: float | None) -> bool:
    return declared is not None and abs(ratio / declared - 1.0) > RATIO_TOLERANCE


def _simple(ratio: float) -> float:
    """Return 2, 1 or 1/2 if the ratio is equal to it within RATIO_TOLERANCE, else the ratio."""
    near = [simple for simple in (0.5, 1.0, 2.0) if abs(ratio / simple - 1.0) < RATIO_TOLERANCE]
    return near[0] if near else ratio
