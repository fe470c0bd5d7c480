"""What to read off an adjustment: parameters with their uncertainty, residuals of every pose."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import Doubles
from reconstruction.calibration.adjustment import Adjustment
from reconstruction.calibration.observation import Observation
from reconstruction.calibration.parameters import INTRINSICS, MOTION, STEREO, Rig, rotation_vector
from reconstruction.errors import InputError
from reconstruction.rig.calibration import Calibration

COVERAGE_FACTOR = 2.0
"""Expanded uncertainty U = k sigma, k = 2: about 95 % (JCGM 100, 6.2)."""


@dataclass(frozen=True)
class Parameter:
    """One number of the rig; sigma 0: held fixed."""

    name: str
    value: float
    sigma: float

    @property
    def expanded(self) -> float:
        """Expanded uncertainty, k = 2."""
        return COVERAGE_FACTOR * self.sigma


@dataclass(frozen=True)
class PoseResidual:
    """Root mean square misses of one pose, px; epipolar: distance from the epipolar line."""

    name: str
    features: int
    left_out: int
    camera_px: float
    projector_px: float
    epipolar_px: float


def parameters(found: Adjustment) -> list[Parameter]:
    """Return every parameter of the rig with its standard uncertainty, baseline included."""
    names = [
        *(f"camera_{name}" for name in INTRINSICS),
        *(f"projector_{name}" for name in INTRINSICS),
        *(f"stereo_{name}" for name in MOTION),
    ]
    values, sigmas = found.vector, np.sqrt(np.diag(found.covariance))
    rows = [Parameter(name, float(values[k]), float(sigmas[k])) for k, name in enumerate(names)]
    return [*rows, _baseline(found)]


def parameters_of(rig: Rig | Calibration) -> dict[str, float]:
    """Return the same parameters of a known rig, to compare with."""
    T = rig.T_proj_from_cam
    found: dict[str, float] = {}
    for device, lens in (("camera", rig.camera), ("projector", rig.projector)):
        numbers = (lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px, *lens.distortion)
        found |= {f"{device}_{name}": n for name, n in zip(INTRINSICS, numbers, strict=True)}
    motion = [*rotation_vector(T[:3, :3]), *T[:3, 3]]
    found |= {f"stereo_{name}": float(n) for name, n in zip(MOTION, motion, strict=True)}
    return found | {"baseline_mm": float(np.linalg.norm(T[:3, 3]))}


def _baseline(found: Adjustment) -> Parameter:
    shift = slice(STEREO.start + 3, STEREO.stop)
    length = float(np.linalg.norm(found.vector[shift]))
    along = found.vector[shift] / length
    return Parameter(
        "baseline_mm", length, float(np.sqrt(along @ found.covariance[shift, shift] @ along))
    )


def pose_residuals(found: Adjustment, observations: Sequence[Observation]) -> list[PoseResidual]:
    """Return the residuals of every pose, over the features that took part."""
    rows = []
    for k, seen in enumerate(observations):
        used, misses = found.used[k], found.misses_px[k][found.used[k]]
        rows.append(
            PoseResidual(
                name=seen.name,
                features=int(used.sum()),
                left_out=int((~used).sum()),
                camera_px=_rms(misses[:, :2]),
                projector_px=_rms(misses[:, 2:]),
                epipolar_px=_rms(epipolar_misses_px(found.rig, found.measured_px[k][used])),
            )
        )
    return rows


def epipolar_misses_px(rig: Rig | Calibration, measured_px: Doubles) -> Doubles:
    """Return the distances of projector points from their camera points' epipolar lines, px.

    Parameters
    ----------
    rig : both devices
    measured_px : (n, 4) float, camera x, y, projector column, row

    Notes
    -----
    Lines are drawn on the undistorted projector image and scaled by its focal length.
    """
    T = rig.T_proj_from_cam
    seen = _rays(rig.camera.unproject(measured_px[:, :2]))
    shown = _rays(rig.projector.unproject(measured_px[:, 2:]))
    lines = np.cross(T[:3, 3], seen @ T[:3, :3].T)
    distance = np.sum(lines * shown, axis=1) / np.linalg.norm(lines[:, :2], axis=1)
    return np.asarray(distance * np.sqrt(rig.projector.fx_px * rig.projector.fy_px))


def pupil_diameter_mm(found: Adjustment) -> float:
    """Return the aperture that the blur of tilted boards tells; 0 where it is not seen.

    To about a tenth; a plausibility check (focal length over f-number), not a measurement.
    """
    seen = found.pupil_mm2 > 3.0 * found.pupil_sigma_mm2
    return 4.0 * float(np.sqrt(found.pupil_mm2)) if seen else 0.0


def calibration_of(found: Adjustment, reference_pose: int = 0) -> Calibration:
    """Return the calibration; the world is the board frame of one pose (z towards the devices).

    Raises
    ------
    InputError : there is no such pose
    """
    poses = len(found.rig.T_cam_from_board)
    if not 0 <= reference_pose < poses:
        raise InputError(f"reference pose is {reference_pose}; allowed are 0 to {poses - 1}")
    T_world_from_cam = _inverse(found.rig.T_cam_from_board[reference_pose])
    T_world_from_proj = T_world_from_cam @ _inverse(found.rig.T_proj_from_cam)
    return Calibration(found.rig.camera, found.rig.projector, T_world_from_cam, T_world_from_proj)


def _inverse(motion: Doubles) -> Doubles:
    back = np.eye(4)
    back[:3, :3] = motion[:3, :3].T
    back[:3, 3] = -motion[:3, :3].T @ motion[:3, 3]
    return back


def _rays(normalised: Doubles) -> Doubles:
    return np.column_stack([normalised, np.ones(len(normalised))])


def _rms(values: Doubles) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0
