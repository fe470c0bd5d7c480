"""Score balls: spheres fitted to the measured points of each ball's region, mm.

Sphere metrics follow the paper: a least-squares sphere is fitted to the points of each ball's
region. RMSE, MAE and 95th percentile are those of the absolute radial residuals. Two fits are made
over every requested region: the sum of squared residuals is that of radial distances (geometric)
or of squared distances (algebraic). The same fits to the true coated face at the same pixels
separate the error of the elastomer from that of the measurement.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import BoolImage, at_pixels
from reconstruction.errors import FitError
from reconstruction.evaluate.fit import SphereFit, fit_sphere_both_ways
from twin.config.models import Experiment
from twin.optics.stack import Truth
from twin.shape import Sphere
from twin.specimens import shape_of

# Four points determine a sphere exactly, so that the residuals would be 0 for any error.
_LEAST_SPHERE_POINTS = 5
_FIT_FIGURES = ("radius_mm", "rmse_mm", "mae_mm", "p95_mm")
_KINDS = ("", "true_face_", "algebraic_", "true_face_algebraic_")
_SPHERE_FIGURES = (
    "points",
    "abs_radius_error_mm",
    *(f"{kind}{name}" for kind in _KINDS for name in _FIT_FIGURES),
)


@dataclass(frozen=True, eq=False)
class SphereScore:
    """Sphere fits of one ball over one region, to the measured points and to the true face.

    `roi` is the mask (row, col) of the region.
    """

    number: int
    nominal: Sphere
    roi: NDArray[np.bool_]
    measured: SphereFit
    true_face: SphereFit
    measured_algebraic: SphereFit
    true_face_algebraic: SphereFit


def region_of(
    ball: Sphere, points_mm: NDArray[np.floating], usable: BoolImage, roi_radius_mm: float
) -> NDArray[np.bool_]:
    """Return a mask (row, col) of usable pixels within a lateral distance of a ball's apex."""
    x_mm, y_mm = points_mm[..., 0] - ball.x_mm, points_mm[..., 1] - ball.y_mm
    inside: BoolImage = (np.abs(x_mm) <= roi_radius_mm) & (np.abs(y_mm) <= roi_radius_mm) & usable
    inside[inside] = np.hypot(x_mm[inside], y_mm[inside]) <= roi_radius_mm
    return inside


def score_balls(
    experiment: Experiment, measured_mm: NDArray[np.floating], truth: Truth, usable: BoolImage
) -> tuple[tuple[SphereScore, ...], tuple[str, ...], dict[str, Any]]:
    """Return sphere fits, reasons for balls without a fit, and figures of further regions."""
    if not shape_of(experiment.specimen).spheres():
        return (), (), {}
    further: dict[str, Any] = {}
    # x and y are made contiguous in memory, because each ball and region reads all of them.
    planes = np.ascontiguousarray(np.moveaxis(measured_mm[..., :2], -1, 0))
    pixels = usable, np.moveaxis(planes, 0, -1)
    for radius_mm in experiment.score.regions_mm:
        spheres = _spheres(experiment, measured_mm, truth, pixels, radius_mm)
        further |= sphere_metrics(*spheres, region_name(radius_mm))
    scored_mm = experiment.score.roi_radius_mm
    return *_spheres(experiment, measured_mm, truth, pixels, scored_mm), further


def region_name(radius_mm: float) -> str:
    """Return the part of a figure's name that states a region: within_1p2_ for 1.2 mm."""
    return f"within_{radius_mm:g}_".replace(".", "p")


def _spheres(
    experiment: Experiment,
    measured_mm: NDArray[np.floating],
    truth: Truth,
    pixels: tuple[BoolImage, NDArray[np.floating]],
    roi_radius_mm: float,
) -> tuple[tuple[SphereScore, ...], tuple[str, ...]]:
    """Return sphere fits of the balls over a region, and reasons for balls without a fit.

    Parameters
    ----------
    pixels : mask of usable pixels (row, col), and x and y, mm, of all pixels (row, col, xy)
    """
    (usable, lateral_mm), fitted, unfitted = pixels, [], []
    for number, ball in enumerate(shape_of(experiment.specimen).spheres(), start=1):
        roi = region_of(ball, lateral_mm, usable, roi_radius_mm)
        try:
            fitted.append(score_sphere(number, ball, roi, measured_mm, truth.points_world_mm))
        except FitError as error:
            unfitted.append(f"ball {number}: {error}")
    return tuple(fitted), tuple(unfitted)


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
    FitError : the region has fewer than 5 points, too few for a sphere with residuals
    """
    count = int(roi.sum())
    if count < _LEAST_SPHERE_POINTS:
        raise FitError(f"{count} points leave no residual of a sphere; it takes at least 5")
    geometric, algebraic = fit_sphere_both_ways(at_pixels(measured_mm, roi))
    true, true_algebraic = fit_sphere_both_ways(at_pixels(true_mm, roi))
    return SphereScore(
        number=number,
        nominal=ball,
        roi=roi,
        measured=geometric,
        true_face=true,
        measured_algebraic=algebraic,
        true_face_algebraic=true_algebraic,
    )


def sphere_metrics(
    fitted: Sequence[SphereScore], unfitted: Sequence[str], region: str = ""
) -> dict[str, Any]:
    """Return the figures of all balls by name; None for a ball without a fit."""
    figures: dict[str, Any] = dict.fromkeys(sphere_names(len(fitted) + len(unfitted), region))
    for ball in fitted:
        ours = _ball_figures(ball).items()
        figures |= {f"sphere_{ball.number}_{region}{name}": value for name, value in ours}
    return figures


def sphere_names(balls: int, region: str = "") -> list[str]:
    """Return the names of the sphere figures of balls 1 to `balls`, such as `sphere_1_points`.

    `region` is a further region of the fit, for example `within_1p2_` for 1.2 mm; empty: the main
    region.
    """
    numbers = range(1, balls + 1)
    return [f"sphere_{n}_{region}{figure}" for n in numbers for figure in _SPHERE_FIGURES]


def _ball_figures(sphere: SphereScore) -> dict[str, float | int]:
    """Return the figures of one ball, with the names of the paper's table."""
    measured = sphere.measured
    fits = (measured, sphere.true_face, sphere.measured_algebraic, sphere.true_face_algebraic)
    values = [figure for fit in fits for figure in _fit_figures(fit)]
    error_mm = abs(measured.radius_mm - sphere.nominal.radius_mm)
    return dict(zip(_SPHERE_FIGURES, (len(measured.residuals_mm), error_mm, *values), strict=True))


def _fit_figures(fit: SphereFit) -> tuple[float, float, float, float]:
    stats = fit.stats
    return fit.radius_mm, stats.rmse_mm, stats.mae_mm, stats.p95_mm
