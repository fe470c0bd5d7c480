"""Score a reconstruction in millimetres: against the truth mesh and against fitted spheres.

Sphere metrics follow the paper: least-squares sphere over the points of each ball's region, then
RMSE, MAE and 95th percentile of the absolute radial residuals. The same fit over the true coated
face at the same pixels separates what the elastomer did from what the measurement did.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.errors import FitError
from reconstruction.fit import SphereFit, fit_sphere
from reconstruction.pipeline import Reconstruction, filter_bias
from twin.config.models import Experiment
from twin.optics.stack import Truth
from twin.specimens import Sphere, shape_of

FloatArray = NDArray[np.float64]

# 1.4826 MAD estimates the standard deviation of a normal distribution.
_MAD_TO_SIGMA = 1.4826


@dataclass(frozen=True)
class TruthScore:
    """Errors of world z against the true surface at the pixel centres, valid pixels only.

    `completeness` is the share of the wanted pixels with a point, `good_share` that of those whose
    point is also right within `score.good_within_um`. `filter_bias_um` and `filter_bias_share` need
    no truth, see `filter_bias`.
    """

    points: int
    lit_pixels: int
    completeness: float
    good_share: float
    wrong_order_pixels: int
    z_rmse_um: float
    z_bias_um: float
    z_p95_um: float
    sigma_z_median_um: float
    filter_bias_um: float
    filter_bias_share: float
    error_over_sigma: float


@dataclass(frozen=True, eq=False)
class SphereScore:
    """One ball: the fit to the measured points and the fit to the true face at the same pixels."""

    number: int
    nominal: Sphere
    roi: NDArray[np.bool_]
    measured: SphereFit
    true_face: SphereFit


@dataclass(frozen=True, eq=False)
class Score:
    """Everything that is scored on one measurement.

    Attributes
    ----------
    against_truth : TruthScore
    spheres : tuple of SphereScore
        The balls that could be fitted.
    unfitted : tuple of str
        Why the others could not: a ball without valid points must not sink the measurement.
    """

    against_truth: TruthScore
    spheres: tuple[SphereScore, ...]
    unfitted: tuple[str, ...] = ()


def score(experiment: Experiment, reconstruction: Reconstruction, truth: Truth) -> Score:
    """Score a reconstruction against the truth of the same camera pixels."""
    fitted, unfitted = [], []
    for number, ball in enumerate(shape_of(experiment.specimen).spheres(), start=1):
        roi = region_of(ball, reconstruction, truth, experiment.score.roi_radius_mm)
        try:
            fitted.append(score_sphere(number, ball, roi, reconstruction, truth))
        except FitError as error:
            unfitted.append(f"ball {number}: {error}")
    against_truth = score_truth(experiment, reconstruction, truth)
    return Score(against_truth, tuple(fitted), tuple(unfitted))


def score_truth(experiment: Experiment, reconstruction: Reconstruction, truth: Truth) -> TruthScore:
    """Compare world z, pixel by pixel, with the truth at the pixel centre.

    `error_over_sigma` is the robust spread of error / predicted sigma: 1 when the predicted sigma
    is the actual one, more when systematic errors exceed the noise.
    """
    wanted = wanted_pixels(experiment, truth)
    both = reconstruction.point_map.valid & wanted
    points = reconstruction.point_map.points_world_mm[both]
    error_um = 1e3 * (points[:, 2] - truth.points_world_mm[both][:, 2]).astype(np.float64)
    sigma_um = 1e3 * reconstruction.point_map.sigma_z_mm[both].astype(np.float64)
    lit, count = int(wanted.sum()), int(both.sum())
    if not count:
        return TruthScore(0, lit, 0.0, 0.0, 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    bias_um, bias_share = filter_bias(reconstruction, experiment.decode.use, both)
    good = int((np.abs(error_um) <= experiment.score.good_within_um).sum())
    relative = (error_um - np.median(error_um)) / np.maximum(sigma_um, 1e-9)
    return TruthScore(
        points=count,
        lit_pixels=lit,
        completeness=count / lit,
        good_share=good / lit,
        wrong_order_pixels=wrong_orders(experiment, reconstruction, truth),
        z_rmse_um=float(np.sqrt(np.mean(error_um**2))),
        z_bias_um=float(np.mean(error_um)),
        z_p95_um=float(np.percentile(np.abs(error_um), 95)),
        sigma_z_median_um=float(np.median(sigma_um)),
        filter_bias_um=bias_um,
        filter_bias_share=bias_share,
        error_over_sigma=float(_MAD_TO_SIGMA * np.median(np.abs(relative))),
    )


def wanted_pixels(experiment: Experiment, truth: Truth) -> NDArray[np.bool_]:
    """Pixels that ought to give a point, (row, col).

    On the coat those that both devices see. On a bare specimen every pixel that shows it: that the
    method has blind flanks and shadows there is what is to be found out.
    """
    return truth.measured if experiment.modality == "direct_fpp" else truth.lit


def wrong_orders(experiment: Experiment, reconstruction: Reconstruction, truth: Truth) -> int:
    """Count valid lit pixels whose projector column or row is off by half a period or more."""
    decoded = reconstruction.decoded
    both = decoded.valid & wanted_pixels(experiment, truth)
    half_px = experiment.patterns.period_px / 2
    wrong = (np.abs(decoded.column.coordinate_px - truth.column_px) >= half_px) | (
        np.abs(decoded.row.coordinate_px - truth.row_px) >= half_px
    )
    return int((wrong & both).sum())


def region_of(
    ball: Sphere, reconstruction: Reconstruction, truth: Truth, roi_radius_mm: float
) -> NDArray[np.bool_]:
    """Return the valid lit pixels within `roi_radius_mm` (lateral) of a ball's apex, (row, col)."""
    points = reconstruction.point_map.points_world_mm
    lateral_mm = np.hypot(points[..., 0] - ball.x_mm, points[..., 1] - ball.y_mm)
    region: NDArray[np.bool_] = (lateral_mm <= roi_radius_mm) & truth.lit
    return region & reconstruction.point_map.valid


def score_sphere(
    number: int,
    ball: Sphere,
    roi: NDArray[np.bool_],
    reconstruction: Reconstruction,
    truth: Truth,
) -> SphereScore:
    """Fit spheres to the measured and to the true points of one ball's region.

    Raises
    ------
    FitError
        The region holds too few valid points.
    """
    points = reconstruction.point_map.points_world_mm
    return SphereScore(
        number=number,
        nominal=ball,
        roi=roi,
        measured=fit_sphere(points[roi].astype(np.float64)),
        true_face=fit_sphere(truth.points_world_mm[roi].astype(np.float64)),
    )


def metrics(scored: Score) -> dict[str, Any]:
    """Flatten a score to names with units, for result.json."""
    truth = scored.against_truth
    found: dict[str, Any] = {
        "unfitted_balls": list(scored.unfitted),
        "points": truth.points,
        "lit_pixels": truth.lit_pixels,
        "completeness": truth.completeness,
        "good_share": truth.good_share,
        "wrong_order_pixels": truth.wrong_order_pixels,
        "z_rmse_um": truth.z_rmse_um,
        "z_bias_um": truth.z_bias_um,
        "z_p95_um": truth.z_p95_um,
        "sigma_z_median_um": truth.sigma_z_median_um,
        "filter_bias_um": truth.filter_bias_um,
        "filter_bias_share": truth.filter_bias_share,
        "error_over_sigma": truth.error_over_sigma,
    }
    for sphere in scored.spheres:
        found |= sphere_metrics(f"sphere_{sphere.number}_", sphere)
    return found


def sphere_metrics(prefix: str, sphere: SphereScore) -> dict[str, float | int]:
    """Return one ball's figures under the names of the paper's table."""
    measured, nominal_mm = sphere.measured, sphere.nominal.radius_mm
    return {
        f"{prefix}points": len(measured.residuals_mm),
        f"{prefix}radius_mm": measured.radius_mm,
        f"{prefix}abs_radius_error_mm": abs(measured.radius_mm - nominal_mm),
        f"{prefix}rmse_mm": measured.stats.rmse_mm,
        f"{prefix}mae_mm": measured.stats.mae_mm,
        f"{prefix}p95_mm": measured.stats.p95_mm,
        f"{prefix}true_face_radius_mm": sphere.true_face.radius_mm,
        f"{prefix}true_face_rmse_mm": sphere.true_face.stats.rmse_mm,
        f"{prefix}true_face_mae_mm": sphere.true_face.stats.mae_mm,
        f"{prefix}true_face_p95_mm": sphere.true_face.stats.p95_mm,
    }
