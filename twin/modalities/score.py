"""Score a reconstruction in millimetres: against the truth mesh and against fitted spheres.

Sphere metrics follow the paper: least-squares sphere over the points of each ball's region, then
RMSE, MAE and 95th percentile of the absolute radial residuals. The same fit over the true coated
face at the same pixels separates what the elastomer did from what the measurement did.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from reconstruction.fit import SphereFit, fit_sphere
from reconstruction.pipeline import Reconstruction
from twin.config.models import Experiment
from twin.optics.stack import Truth
from twin.specimens import Sphere, shape_of

FloatArray = NDArray[np.float64]

# 1.4826 MAD estimates the standard deviation of a normal distribution.
_MAD_TO_SIGMA = 1.4826


@dataclass(frozen=True)
class TruthScore:
    """Errors of world z against the coated face at the pixel centres, valid pixels only."""

    points: int
    lit_pixels: int
    completeness: float
    wrong_order_pixels: int
    z_rmse_um: float
    z_bias_um: float
    z_p95_um: float
    sigma_z_median_um: float
    error_over_sigma: float


@dataclass(frozen=True, eq=False)
class SphereScore:
    """One ball: the fit to the measured points and the fit to the true face at the same pixels."""

    nominal: Sphere
    roi: NDArray[np.bool_]
    measured: SphereFit
    true_face: SphereFit


@dataclass(frozen=True, eq=False)
class Score:
    """Everything that is scored on one measurement."""

    against_truth: TruthScore
    spheres: tuple[SphereScore, ...]


def score(experiment: Experiment, reconstruction: Reconstruction, truth: Truth) -> Score:
    """Score a reconstruction against the truth of the same camera pixels."""
    balls = shape_of(experiment.specimen).spheres()
    return Score(
        against_truth=score_truth(experiment, reconstruction, truth),
        spheres=tuple(
            score_sphere(ball, reconstruction, truth, experiment.score.roi_radius_mm)
            for ball in balls
        ),
    )


def score_truth(experiment: Experiment, reconstruction: Reconstruction, truth: Truth) -> TruthScore:
    """Compare world z, pixel by pixel, with the truth at the pixel centre.

    `error_over_sigma` is the robust spread of error / predicted sigma: 1 when the predicted sigma
    is the actual one, more when systematic errors exceed the noise.
    """
    both = reconstruction.point_map.valid & truth.lit
    points = reconstruction.point_map.points_world_mm[both]
    error_um = 1e3 * (points[:, 2] - truth.points_world_mm[both][:, 2]).astype(np.float64)
    sigma_um = 1e3 * reconstruction.point_map.sigma_z_mm[both].astype(np.float64)
    lit, count = int(truth.lit.sum()), int(both.sum())
    if not count:
        return TruthScore(0, lit, 0.0, 0, 0.0, 0.0, 0.0, 0.0, 0.0)
    relative = (error_um - np.median(error_um)) / np.maximum(sigma_um, 1e-9)
    return TruthScore(
        points=count,
        lit_pixels=lit,
        completeness=count / lit,
        wrong_order_pixels=wrong_orders(experiment, reconstruction, truth),
        z_rmse_um=float(np.sqrt(np.mean(error_um**2))),
        z_bias_um=float(np.mean(error_um)),
        z_p95_um=float(np.percentile(np.abs(error_um), 95)),
        sigma_z_median_um=float(np.median(sigma_um)),
        error_over_sigma=float(_MAD_TO_SIGMA * np.median(np.abs(relative))),
    )


def wrong_orders(experiment: Experiment, reconstruction: Reconstruction, truth: Truth) -> int:
    """Count valid lit pixels whose projector column or row is off by half a period or more."""
    decoded = reconstruction.decoded
    both = decoded.valid & truth.lit
    half_px = experiment.patterns.period_px / 2
    wrong = (np.abs(decoded.column.coordinate_px - truth.column_px) >= half_px) | (
        np.abs(decoded.row.coordinate_px - truth.row_px) >= half_px
    )
    return int((wrong & both).sum())


def score_sphere(
    ball: Sphere, reconstruction: Reconstruction, truth: Truth, roi_radius_mm: float
) -> SphereScore:
    """Fit a sphere to the points within `roi_radius_mm` (lateral) of a ball's apex.

    Raises
    ------
    FitError
        The region holds too few valid points.
    """
    points = reconstruction.point_map.points_world_mm
    lateral_mm = np.hypot(points[..., 0] - ball.x_mm, points[..., 1] - ball.y_mm)
    roi = (lateral_mm <= roi_radius_mm) & reconstruction.point_map.valid & truth.lit
    return SphereScore(
        nominal=ball,
        roi=roi,
        measured=fit_sphere(points[roi].astype(np.float64)),
        true_face=fit_sphere(truth.points_world_mm[roi].astype(np.float64)),
    )


def metrics(scored: Score) -> dict[str, float | int]:
    """Flatten a score to names with units, for result.json."""
    truth = scored.against_truth
    found: dict[str, float | int] = {
        "points": truth.points,
        "lit_pixels": truth.lit_pixels,
        "completeness": truth.completeness,
        "wrong_order_pixels": truth.wrong_order_pixels,
        "z_rmse_um": truth.z_rmse_um,
        "z_bias_um": truth.z_bias_um,
        "z_p95_um": truth.z_p95_um,
        "sigma_z_median_um": truth.sigma_z_median_um,
        "error_over_sigma": truth.error_over_sigma,
    }
    for number, sphere in enumerate(scored.spheres, start=1):
        found |= sphere_metrics(f"sphere_{number}_", sphere)
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
    }
