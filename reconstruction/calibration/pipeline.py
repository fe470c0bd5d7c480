"""From observations of a board to the calibration."""

from collections.abc import Sequence
from dataclasses import dataclass

from reconstruction.calibration.adjustment import Adjustment, AdjustOptions, adjust
from reconstruction.calibration.initial import starting_rig
from reconstruction.calibration.observation import Observation
from reconstruction.calibration.quality import (
    Parameter,
    PoseResidual,
    calibration_of,
    parameters,
    pose_residuals,
)
from reconstruction.errors import InputError
from reconstruction.rig.calibration import Calibration


@dataclass(frozen=True, eq=False)
class Calibrated:
    """Result of a calibration."""

    calibration: Calibration
    adjustment: Adjustment
    parameters: tuple[Parameter, ...]
    poses: tuple[PoseResidual, ...]


def calibrate(
    observations: Sequence[Observation],
    options: AdjustOptions | None = None,
    reference_pose: int = 0,
) -> Calibrated:
    """Calibrate camera and projector.

    Parameters
    ----------
    observations : one per board pose
    options : free parameters
    reference_pose : the board frame of this pose becomes the world frame

    Raises
    ------
    InputError : too few poses, different image sizes, or poses that do not determine the rig
    """
    sizes = {(seen.camera_size_px, seen.projector_size_px) for seen in observations}
    if len(sizes) > 1:
        raise InputError(
            f"the poses have different image sizes (camera, projector): {sorted(sizes)}; "
            "calibrate each size by itself"
        )
    found = adjust(observations, starting_rig(observations), options)
    return Calibrated(
        calibration=calibration_of(found, reference_pose),
        adjustment=found,
        parameters=tuple(parameters(found)),
        poses=tuple(pose_residuals(found, observations)),
    )
