"""Score a reconstruction in millimetres: against the truth mesh and against fitted spheres.

Sphere metrics follow the paper: least-squares sphere over the points of each ball's region, then
RMSE, MAE and 95th percentile of the absolute radial residuals. The same fit over the true coated
face at the same pixels separates what the elastomer did from what the measurement did.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.errors import FitError
from reconstruction.evaluate.fit import SphereFit, fit_sphere
from reconstruction.pipeline import Reconstruction, filter_bias
from twin.config.models import Experiment
from twin.optics.stack import Truth
from twin.specimens import Sphere, shape_of

FloatArray = NDArray[np.float64]

# 1.4826 MAD estimates the standard deviation of a normal distribution.
_MAD_TO_SIGMA = 1.4826
# Four points fix a sphere exactly: its residuals are 0 whatever the error.
_LEAST_SPHERE_POINTS = 5
_SPHERE_FIGURES = (
    "points",
    "radius_mm",
    "abs_radius_error_mm",
    "rmse_mm",
    "mae_mm",
    "p95_mm",
    "true_face_radius_mm",
    "true_face_rmse_mm",
    "true_face_mae_mm",
    "true_face_p95_mm",
)


@dataclass(frozen=True)
class TruthScore:
    """Errors of world z against the true surface at the pixel centres, valid pixels only.

    `completeness` is the share of the wanted pixels with a point, `good_share` that of those whose
    point is also right within `score.good_within_um`. `filter_bias_um` and `filter_bias_share` need
    no truth, see `filter_bias`. A figure that does not exist (the error of no point, the share of
    no pixel) is None: 0 would beat every measurement. `why_absent` says why.
    """

    points: int
    lit_pixels: int
    completeness: float | None
    good_share: float | None
    wrong_order_pixels: int | None
    z_rmse_um: float | None
    z_bias_um: float | None
    z_p95_um: float | None
    sigma_z_median_um: float | None
    filter_bias_um: float | None
    filter_bias_share: float | None
    error_over_sigma: float | None


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
    measured_mm, fitted, unfitted = reconstruction.point_map.points_world_mm, [], []
    for number, ball in enumerate(shape_of(experiment.specimen).spheres(), start=1):
        roi = region_of(ball, reconstruction, truth, experiment.score.roi_radius_mm)
        try:
            fitted.append(score_sphere(number, ball, roi, measured_mm, truth.points_world_mm))
        except FitError as error:
            unfitted.append(f"ball {number}: {error}")
    against_truth = score_truth(experiment, reconstruction, truth)
    return Score(against_truth, tuple(fitted), tuple(unfitted))


def score_truth(experiment: Experiment, reconstruction: Reconstruction, truth: Truth) -> TruthScore:
    """Compare world z, pixel by pixel, with the truth at the pixel centre.

    `error_over_sigma` is the robust spread of error / predicted sigma: 1 when the predicted sigma
    is the actual one, more when systematic errors exceed the noise. One point has no spread.
    """
    wanted = wanted_pixels(experiment, truth)
    both = reconstruction.point_map.valid & wanted
    points = reconstruction.point_map.points_world_mm[both]
    error_um = 1e3 * (points[:, 2] - truth.points_world_mm[both][:, 2]).astype(np.float64)
    sigma_um = 1e3 * reconstruction.point_map.sigma_z_mm[both].astype(np.float64)
    good = np.abs(error_um) <= experiment.score.good_within_um
    lit, count = int(wanted.sum()), int(both.sum())
    bias_um, bias_share = (
        filter_bias(reconstruction, experiment.decode.use, both) if count else (None, None)
    )
    return TruthScore(
        points=count,
        lit_pixels=lit,
        completeness=share_of(count, lit),
        good_share=share_of(int(good.sum()), lit),
        wrong_order_pixels=wrong_orders(experiment, reconstruction, truth),
        z_rmse_um=figure_of(error_um, rms),
        z_bias_um=figure_of(error_um, np.mean),
        z_p95_um=figure_of(error_um, p95_of_size),
        sigma_z_median_um=figure_of(sigma_um, np.median),
        filter_bias_um=bias_um,
        filter_bias_share=bias_share,
        error_over_sigma=figure_of(error_um / np.maximum(sigma_um, 1e-9), _spread, least=2),
    )


def share_of(count: int, whole: int) -> float | None:
    """Return count / whole; None where there is nothing to have a share of."""
    return count / whole if whole else None


def figure_of(
    values: FloatArray, figure: Callable[[FloatArray], Any], least: int = 1
) -> float | None:
    """Return a figure of values (n,); None where fewer than `least` leave it without a meaning."""
    return float(figure(values)) if len(values) >= least else None


def rms(values: FloatArray) -> float:
    """Return the root mean square of at least one value."""
    return float(np.sqrt(np.mean(values**2)))


def p95_of_size(values: FloatArray) -> float:
    """Return the 95th percentile of the values' sizes."""
    return float(np.percentile(np.abs(values), 95))


def _spread(values: FloatArray) -> float:
    return float(_MAD_TO_SIGMA * np.median(np.abs(values - np.median(values))))


def wanted_pixels(experiment: Experiment, truth: Truth) -> NDArray[np.bool_]:
    """Pixels that ought to give a point, (row, col).

    On the coat those that both devices see. On a bare specimen every pixel that shows it: that the
    method has blind flanks and shadows there is what is to be found out.
    """
    return truth.lit if experiment.method.presses else truth.measured


def wrong_orders(
    experiment: Experiment, reconstruction: Reconstruction, truth: Truth
) -> int | None:
    """Count decoded lit pixels whose projector column or row is off by half a period or more.

    None where no pixel was decoded: none of nothing is no merit.
    """
    decoded = reconstruction.decoded
    both = decoded.valid & wanted_pixels(experiment, truth)
    half_px = experiment.patterns.period_px / 2
    wrong = (np.abs(decoded.column.coordinate_px - truth.column_px) >= half_px) | (
        np.abs(decoded.row.coordinate_px - truth.row_px) >= half_px
    )
    return int((wrong & both).sum()) if both.any() else None


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
    measured_mm: NDArray[np.floating],
    true_mm: NDArray[np.floating],
) -> SphereScore:
    """Fit spheres to the measured and to the true points (row, col, xyz) of one ball's region.

    Raises
    ------
    FitError
        The region holds too few valid points to fix a sphere and leave a residual.
    """
    count = int(roi.sum())
    if count < _LEAST_SPHERE_POINTS:
        raise FitError(f"{count} points leave no residual of a sphere; it takes at least 5")
    return SphereScore(
        number=number,
        nominal=ball,
        roi=roi,
        measured=fit_sphere(measured_mm[roi].astype(np.float64)),
        true_face=fit_sphere(true_mm[roi].astype(np.float64)),
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
    return found | sphere_metrics(scored.spheres, scored.unfitted)


def why_absent(figures: Mapping[str, Any]) -> str:
    """Say why a measurement has no error and no shares; empty where it has."""
    if 0 in (figures.get("lit_pixels"), figures.get("wanted_pixels")):
        return "no pixel that ought to give a point"
    return "no valid point" if figures.get("points") == 0 else ""


def sphere_metrics(fitted: Sequence[SphereScore], unfitted: Sequence[str]) -> dict[str, Any]:
    """Return all balls' figures by name; those of a ball without a fit are None."""
    numbers = range(1, len(fitted) + len(unfitted) + 1)
    names = [f"sphere_{number}_{name}" for number in numbers for name in _SPHERE_FIGURES]
    found: dict[str, Any] = dict.fromkeys(names)
    for sphere in fitted:
        found |= {f"sphere_{sphere.number}_{name}": v for name, v in _ball_figures(sphere).items()}
    return found


def _ball_figures(sphere: SphereScore) -> dict[str, float | int]:
    """One ball's figures under the names of the paper's table."""
    measured, true_face = sphere.measured, sphere.true_face
    values = (
        len(measured.residuals_mm),
        measured.radius_mm,
        abs(measured.radius_mm - sphere.nominal.radius_mm),
        measured.stats.rmse_mm,
        measured.stats.mae_mm,
        measured.stats.p95_mm,
        true_face.radius_mm,
        true_face.stats.rmse_mm,
        true_face.stats.mae_mm,
        true_face.stats.p95_mm,
    )
    return dict(zip(_SPHERE_FIGURES, values, strict=True))
