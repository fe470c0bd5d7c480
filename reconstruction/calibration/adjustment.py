"""Estimate camera, projector and all board poses by one least squares adjustment.

The adjustment minimises the reprojection residuals of all features in camera and projector pixels.
The projector coordinate of a feature is measured at the detected camera position of the feature.
An error d of that position therefore also appears in the projector, as G d with the local slope G =
d(projector) / d(camera). Independent residuals are those of the camera, and those of the projector
minus G d. Each kind is weighted by its standard deviation, which is estimated from the residuals.

The covariance of the parameters includes the correlation of the errors of neighbouring features
(module `covariance`). Adjustment: Triggs et al., Bundle Adjustment - A Modern Synthesis, 2000.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import least_squares

from reconstruction.arrays import BoolImage, FloatArray
from reconstruction.calibration.covariance import PoseBlock, inverse_normal, robust_covariance
from reconstruction.calibration.observation import Observation
from reconstruction.calibration.parameters import (
    CAMERA,
    PROJECTOR,
    Freedom,
    RigEstimate,
    admissible,
    freedom_matrix,
    pack,
    pose_slice,
    project_pose,
    unpack,
)
from reconstruction.calibration.plane_images import PHASE_SHARE, centre_bias_px, defocus_slopes_px
from reconstruction.errors import InputError
from reconstruction.rig.plausibility import implausible, lens_checks

# Number of solutions, each with the dot biases and weights of the previous one. The bias of dot
# centres depends on the poses and is at most some 0.1 px: it converges in one turn.
TURNS = 4
# A feature is excluded (a dirty or half-hidden dot) if a residual exceeds both this number of
# standard deviations and this number of pixels; exact data have no outliers.
OUTLIER_SPREADS, MIN_OUTLIER_PX = 6.0, 1e-3
# Lower limit of the standard deviation: exact data would get infinite weight.
MIN_SPREAD_PX = 1e-9
MAD_TO_SIGMA = 1.4826
DIVERGES = "the adjustment diverges: no camera and projector fit all features of all poses"
# Coefficients of the camera's defocus, at the end of the vector.
DEFOCUS = 2


@dataclass(frozen=True)
class AdjustOptions:
    """Selection of the estimated parameters and of a correction.

    Parameters
    ----------
    freedom : selection of the estimated parameters
    correct_dot_bias : whether the perspective bias of dot centres is corrected
    """

    freedom: Freedom = field(default_factory=Freedom)
    correct_dot_bias: bool = True


@dataclass(frozen=True)
class PixelRatio:
    """Estimate of fy / fx of a device; `sigma`: standard uncertainty, inf if not determined."""

    value: float
    sigma: float


@dataclass(frozen=True, eq=False)
class Adjustment:
    """Result of the adjustment: the rig, its uncertainty and the residuals.

    Parameters
    ----------
    rig : camera, projector and poses
    vector : (p,) float, parameter vector in the layout of module `parameters`
    covariance : (p, p) float, covariance of `vector` for errors of the features that are correlated
        within a pose; 0 for fixed parameters
    independent_covariance : (p, p) float, the covariance if all errors are independent
    pupil_mm2 : mean square of the x coordinate over the camera's pupil, which is a quarter of the
        squared pupil radius; 0 if it is not estimated
    pupil_sigma_mm2 : standard uncertainty of `pupil_mm2`
    measured_px : for each pose (n, 4) float: camera x, y, projector column, row of the features,
        corrected for the perspective bias of dots and the displacement by defocus
    residuals_px : for each pose (n, 4) float: measured minus projected
    used : for each pose (n,) bool, features included in the fit
    spread_px : standard deviation of the camera's residuals, and that of the projector's residuals
        after subtraction of the part that the camera's residuals cause
    degrees_of_freedom : number of residuals of the used features minus number of free parameters
    pixel_ratios : fy / fx of camera and projector, estimated by one further step of the adjustment
        with both ratios free
    """

    rig: RigEstimate
    vector: FloatArray
    covariance: FloatArray
    independent_covariance: FloatArray
    pupil_mm2: float
    pupil_sigma_mm2: float
    measured_px: tuple[FloatArray, ...]
    residuals_px: tuple[FloatArray, ...]
    used: tuple[BoolImage, ...]
    spread_px: tuple[float, float]
    degrees_of_freedom: int
    pixel_ratios: tuple[PixelRatio, PixelRatio]


def adjust(
    observations: Sequence[Observation],
    start: RigEstimate,
    options: AdjustOptions | None = None,
    most_rms_px: float = np.inf,
) -> Adjustment:
    """Fit the rig and all board poses to the observations.

    Parameters
    ----------
    observations : one per board pose
    start : starting values
    options : estimated parameters and corrections; None: the defaults
    most_rms_px : largest allowed RMS, px, of all residuals after the first of the `TURNS` least
        squares solutions

    Raises
    ------
    InputError : the poses do not determine the free parameters, the adjustment diverges, or the RMS
        exceeds `most_rms_px`
    """
    chosen = options or AdjustOptions()
    problem = _Problem(observations, start, chosen)
    vector = np.append(admissible(chosen.freedom, pack(start)), np.zeros(DEFOCUS))
    for turn in range(TURNS):
        problem.measure(vector)
        if turn:  # the first turn only brings the rig near the solution
            problem.weigh(vector)
        vector = problem.solve(vector)
        if turn == 0 and not problem.rms_px(vector) <= most_rms_px:
            raise _diverges()
    problem.measure(vector)
    return problem.result(vector)


class _Problem:
    """The least squares problem: reprojection residuals as a function of the free parameters.

    A parameter vector is that of `pack`, followed by the two coefficients of the defocus.
    """

    def __init__(
        self, observations: Sequence[Observation], start: RigEstimate, options: AdjustOptions
    ) -> None:
        self._observations, self._devices = observations, (start.camera, start.projector)
        self._correct = options.correct_dot_bias
        size = len(pack(start))
        self._freedom = _freedom(options.freedom, size)
        released = replace(options.freedom, camera_pixel_ratio=None, projector_pixel_ratio=None)
        self._released = _freedom(released, size)
        self._defocus = [
            np.zeros((len(observation.ids), 4, DEFOCUS)) for observation in observations
        ]
        self._targets = [
            np.hstack([observation.camera_px, observation.projector_px])
            for observation in observations
        ]
        self._spread = np.ones(2)
        self._used = [np.ones(len(observation.ids), dtype=np.bool_) for observation in observations]

    def measure(self, vector: FloatArray) -> None:
        """Correct the measured dot centres for perspective bias, and update the defocus slopes.

        The detected centre of an ellipse is replaced by the image of the dot's centre.
        """
        rig = self._rig(vector)
        middle_mm = float(np.median(rig.T_cam_from_board[:, 2, 3]))
        for k, (observation, T) in enumerate(
            zip(self._observations, rig.T_cam_from_board, strict=True)
        ):
            inside = observation.points_mm @ T[:3, :3].T + T[:3, 3]
            shift = defocus_slopes_px(rig.camera, inside, T[:3, 2], middle_mm)
            self._defocus[k] = np.hstack([shift, PHASE_SHARE * observation.slopes @ shift])
            if not self._correct:
                continue
            bias = centre_bias_px(rig.camera, inside, observation.radii_mm, T[:3, :3])
            along = np.einsum("nij,nj->ni", observation.slopes, bias)
            self._targets[k] = np.hstack(
                [observation.camera_px - bias, observation.projector_px - along]
            )

    def _rig(self, vector: FloatArray) -> RigEstimate:
        try:
            rig = unpack(vector[:-DEFOCUS], *self._devices)
        except InputError as error:  # focal lengths impossible for any device
            raise _diverges() from error
        for observation, T in zip(self._observations, rig.T_cam_from_board, strict=True):
            if (observation.points_mm @ T[2, :3] + T[2, 3]).min() <= 0.0:
                raise _diverges()
        return rig

    def weigh(self, vector: FloatArray) -> None:
        """Estimate the standard deviations of the residuals robustly, and exclude outliers."""
        residuals = self._independent(vector)
        stacked = np.concatenate(residuals)
        for device in range(2):
            own = stacked[:, 2 * device : 2 * device + 2]
            spread = MAD_TO_SIGMA * np.median(np.abs(own - np.median(own, axis=0)))
            self._spread[device] = max(float(spread), MIN_SPREAD_PX)
        limit = np.maximum(OUTLIER_SPREADS * np.repeat(self._spread, 2), MIN_OUTLIER_PX)
        self._used = [
            np.asarray(np.all(np.abs(residual) < limit, axis=1)) for residual in residuals
        ]
        self._require_enough()

    def _require_enough(self) -> None:
        for observation, used in zip(self._observations, self._used, strict=True):
            if used.sum() < 6:
                raise InputError(
                    f"{observation.name}: only {used.sum()} of {len(used)} features fit the common "
                    "rig; remove this pose, or check that the board did not move during it"
                )

    def reprojection(self, vector: FloatArray) -> list[FloatArray]:
        """Return measured minus projected pixels for each pose, (n, 4) px."""
        return [
            target - project_pose(vector, k, observation.points_mm)[0]
            for k, (observation, target) in enumerate(
                zip(self._observations, self._sharp(vector), strict=True)
            )
        ]

    def _sharp(self, vector: FloatArray) -> list[FloatArray]:
        """Return the measured pixels corrected for defocus, for each pose (n, 4) px."""
        coefficients = vector[-DEFOCUS:]
        return [
            target - slopes @ coefficients
            for target, slopes in zip(self._targets, self._defocus, strict=True)
        ]

    def _independent(self, vector: FloatArray) -> list[FloatArray]:
        """Return the independent residuals for each pose, (n, 4) px.

        The part that the camera's residuals cause is subtracted from the projector's residuals.
        """
        residuals = self.reprojection(vector)
        for pose_residuals, observation in zip(residuals, self._observations, strict=True):
            pose_residuals[:, 2:] -= np.einsum(
                "nij,nj->ni", observation.slopes, pose_residuals[:, :2]
            )
        return residuals

    def _weights(self) -> FloatArray:
        return 1.0 / np.repeat(self._spread, 2)

    def _residuals(self, free: FloatArray, vector: FloatArray) -> FloatArray:
        residuals = self._independent(vector + self._freedom @ free)
        used_residuals = [residual[u] for residual, u in zip(residuals, self._used, strict=True)]
        return (np.concatenate(used_residuals) * self._weights()).ravel()

    def _jacobian(self, free: FloatArray, vector: FloatArray) -> FloatArray:
        return self._slopes(vector + self._freedom @ free) @ self._freedom

    def _slopes(self, now: FloatArray) -> FloatArray:
        """Return the derivatives of the weighted residuals by all parameters, at `now`."""
        weights, blocks = self._weights(), []
        for k, (observation, used) in enumerate(zip(self._observations, self._used, strict=True)):
            slopes = project_pose(now, k, observation.points_mm[used])[1]
            slopes[..., -DEFOCUS:] = self._defocus[k][used]
            slopes[:, 2:] -= observation.slopes[used] @ slopes[:, :2]
            blocks.append((-weights[:, np.newaxis] * slopes).reshape(-1, len(now)))
        return np.concatenate(blocks)

    def rms_px(self, vector: FloatArray) -> float:
        """Return the RMS of the reprojection residuals over all features and both devices, px."""
        return float(np.sqrt(np.mean(np.concatenate(self.reprojection(vector)) ** 2)))

    def solve(self, vector: FloatArray) -> FloatArray:
        solution = least_squares(
            self._residuals,
            np.zeros(self._freedom.shape[1]),
            self._jacobian,
            method="lm",  # trf takes most of its time for singular value decompositions
            x_scale="jac",
            xtol=1e-12,
            ftol=1e-12,
            gtol=1e-12,
            max_nfev=100,
            args=(vector,),
        )
        if not np.all(np.isfinite(solution.x)):
            raise _diverges()
        moved = np.asarray(vector + self._freedom @ solution.x)
        if solution.status == 0 and not self._has_lenses(moved):  # the iteration would not end
            raise _diverges()
        return moved

    def _has_lenses(self, vector: FloatArray) -> bool:
        rig = self._rig(vector)
        lenses = (*lens_checks("camera", rig.camera), *lens_checks("projector", rig.projector))
        return not implausible(lenses)

    def result(self, vector: FloatArray) -> Adjustment:
        zeros = np.zeros(self._freedom.shape[1])
        slopes, residuals = self._slopes(vector), self._residuals(zeros, vector)
        degrees = len(residuals) - len(zeros)
        variance = float(residuals @ residuals) / degrees
        alone = inverse_normal(slopes @ self._freedom) * variance
        robust = robust_covariance(self._pose_blocks(slopes, residuals), alone, variance)
        alone, covariance = (self._freedom @ c @ self._freedom.T for c in (alone, robust))
        independent = self._independent(vector)
        return Adjustment(
            rig=self._rig(vector),
            vector=vector[:-DEFOCUS],
            covariance=covariance[:-DEFOCUS, :-DEFOCUS],
            independent_covariance=alone[:-DEFOCUS, :-DEFOCUS],
            pupil_mm2=float(vector[-DEFOCUS]),
            pupil_sigma_mm2=float(np.sqrt(alone[-DEFOCUS, -DEFOCUS])),
            measured_px=tuple(self._sharp(vector)),
            residuals_px=tuple(self.reprojection(vector)),
            used=tuple(self._used),
            spread_px=_spreads(independent, self._used, degrees / len(residuals)),
            degrees_of_freedom=degrees,
            pixel_ratios=_pixel_ratios(vector, slopes, residuals, self._released),
        )

    def _pose_blocks(self, slopes: FloatArray, residuals: FloatArray) -> list[PoseBlock]:
        """Return the rows of each pose, with the columns of the free parameters."""
        ends = np.cumsum([4 * int(used.sum()) for used in self._used])[:-1]
        rows = zip(np.split(slopes @ self._freedom, ends), np.split(residuals, ends), strict=True)
        return [
            PoseBlock(block, residual, np.flatnonzero(self._freedom[pose_slice(k)].any(axis=0)))
            for k, (block, residual) in enumerate(rows)
        ]


def _diverges() -> InputError:
    return InputError(DIVERGES)


def _freedom(freedom: Freedom, size: int) -> FloatArray:
    """Return the matrix that maps changes of the free parameters to those of all parameters.

    All parameters are those of the rig, `size` numbers, and the two coefficients of the defocus.
    """
    rig = freedom_matrix(freedom, size)
    free = DEFOCUS if freedom.camera_defocus else 0
    whole = np.zeros((size + DEFOCUS, rig.shape[1] + free))
    whole[:size, : rig.shape[1]] = rig
    whole[size : size + free, rig.shape[1] :] = np.eye(free)
    return whole


def _pixel_ratios(
    vector: FloatArray, slopes: FloatArray, residuals: FloatArray, released: FloatArray
) -> tuple[PixelRatio, PixelRatio]:
    """Return fy / fx of camera and projector after one Gauss-Newton step with both ratios free."""
    jacobian = slopes @ released
    try:
        inverse = inverse_normal(jacobian)
    except InputError:
        camera, projector = (vector[d.start + 1] / vector[d.start] for d in (CAMERA, PROJECTOR))
        return PixelRatio(float(camera), np.inf), PixelRatio(float(projector), np.inf)
    step = -inverse @ (jacobian.T @ residuals)
    residual = residuals + jacobian @ step
    variance = float(residual @ residual) / max(len(residual) - len(step), 1)
    covariance = released @ inverse @ released.T * variance
    change = released @ step
    camera, projector = (
        _pixel_ratio(vector, change, covariance, slice(d.start, d.start + 2))
        for d in (CAMERA, PROJECTOR)
    )
    return camera, projector


def _pixel_ratio(
    vector: FloatArray, change: FloatArray, covariance: FloatArray, focal: slice
) -> PixelRatio:
    """Return fy / fx, and its standard uncertainty, after a change of the parameters.

    The change is applied to the logarithm of the ratio, so that the ratio remains positive.
    `focal` is the slice of fx and fy in the parameter vector.
    """
    fx, fy = vector[focal]
    slope = np.array([-1.0 / fx, 1.0 / fy])
    with np.errstate(over="ignore"):
        ratio = float(fy / fx * np.exp(slope @ change[focal]))
    return PixelRatio(ratio, ratio * float(np.sqrt(slope @ covariance[focal, focal] @ slope)))


def _spreads(
    residuals: Sequence[FloatArray], used: Sequence[BoolImage], share: float
) -> tuple[float, float]:
    """Return the standard deviation of the residuals of camera and projector, px.

    `share` is degrees of freedom / number of residuals, a correction for the free parameters.
    """
    used_residuals = np.concatenate(
        [residual[u] for residual, u in zip(residuals, used, strict=True)]
    )
    camera, projector = (
        float(np.sqrt(np.mean(used_residuals[:, i : i + 2] ** 2) / share)) for i in (0, 2)
    )
    return camera, projector
