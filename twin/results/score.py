"""Score the points of any method against the truth and against fitted spheres.

Sphere metrics follow the paper: a least-squares sphere is fitted to the points of each ball's
region. RMSE, MAE and 95th percentile are those of the absolute radial residuals. Two fits are made
over every requested region: the sum of squared residuals is that of radial distances (geometric)
or of squared distances (algebraic). The same fits to the true coated face at the same pixels
separate the error of the elastomer from that of the measurement.

Points are not registered to the truth before the comparison: an error of their position is part of
the error of the method.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import BoolImage, FloatArray, FloatImage, at_pixels
from reconstruction.errors import FitError
from reconstruction.evaluate.fit import (
    SphereFit,
    fit_sphere_both_ways,
    mean,
    median,
    p95_of_size,
    rms,
    spread,
)
from reconstruction.photometric import HeightMap
from reconstruction.pipeline import Reconstruction, filter_bias
from twin.config.models import Experiment
from twin.config.nominal import NominalHexNut
from twin.optics.light import pattern_set
from twin.optics.stack import Truth
from twin.results.nuts import nut_figures
from twin.results.rods import rod_figures, single_section
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


@dataclass(frozen=True)
class TruthScore:
    """Errors of world z against the true surface at the pixel centres.

    Errors are taken at target pixels with a valid point; see `wanted_pixels`.

    `completeness` is the share of the target pixels that have a point. `good_share` is the share
    of the target pixels with an error of at most `score.good_within_um`. A figure is None if there
    is no point for an error or no pixel for a share. It is not 0, because 0 would be the best
    possible error. `why_absent` gives the reason.
    """

    points: int
    completeness: float | None
    good_share: float | None
    z_rmse_um: float | None
    z_bias_um: float | None
    z_p95_um: float | None


@dataclass(frozen=True)
class FringeScore(TruthScore):
    """Errors of world z against the truth, with further figures of fringe projection.

    `filter_bias_um` and `filter_bias_share` are computed without the truth, see `filter_bias`.
    `error_over_sigma` is a robust standard deviation of error / predicted sigma. It is 1 if the
    predicted sigma is right, and larger if systematic errors exceed the noise. It is None for
    fewer than two points.
    """

    lit_pixels: int
    wrong_order_pixels: int | None
    sigma_z_median_um: float | None
    filter_bias_um: float | None
    filter_bias_share: float | None
    error_over_sigma: float | None


@dataclass(frozen=True)
class HeightScore(TruthScore):
    """Errors of world z against the truth, with further figures of photometric stereo.

    Only pixels within the field of the sensor are target pixels.

    `height_scale` is the slope of the least-squares line of measured over true z. It is 1 if
    heights are neither flattened nor stretched. It is None if the true surface is flat.
    """

    wanted_pixels: int
    height_scale: float | None


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


Against = TypeVar("Against", bound=TruthScore, covariant=True)


@dataclass(frozen=True, eq=False)
class Scores(Generic[Against]):
    """All scores of one measurement.

    Attributes
    ----------
    against_truth : `FringeScore` or `HeightScore`, depending on the method
    spheres : sphere fits of the balls that could be fitted
    unfitted : for each ball that could not be fitted, a text with the reason; the measurement is
        still valid
    regions : figures of the balls over the further regions of `score.regions_mm`, by name
    shown : figures, by name, of a single rod (width, height) or a nut (hole depth, hexagon share),
        measured and of the true face; empty for other specimens
    """

    against_truth: Against
    spheres: tuple[SphereScore, ...]
    unfitted: tuple[str, ...] = ()
    regions: Mapping[str, Any] = field(default_factory=dict)
    shown: Mapping[str, Any] = field(default_factory=dict)


def score(
    experiment: Experiment, reconstruction: Reconstruction, truth: Truth
) -> Scores[FringeScore]:
    """Score a reconstruction by fringes against the truth at the same camera pixels."""
    points = reconstruction.point_map
    usable = points.valid & truth.lit
    spheres = _balls(experiment, points.points_world_mm, truth, usable)
    shown = _shown(experiment, points.points_world_mm, truth, usable)
    return Scores(score_truth(experiment, reconstruction, truth), *spheres, shown=shown)


def score_heights(experiment: Experiment, heights: HeightMap, truth: Truth) -> Scores[HeightScore]:
    """Score heights by photometric stereo against the truth at the same pixels.

    Raises
    ------
    FitError : no pixel within `photometric.field` has a height
    """
    measured_mm, target = in_world(heights), wanted_pixels(experiment, truth)
    both = target & heights.valid
    if not both.any():
        raise FitError("no pixel within photometric.field carries a height")
    measured, true = (
        at_pixels(measured_mm, both)[:, 2],
        at_pixels(truth.points_world_mm, both)[:, 2],
    )
    against_truth = HeightScore(
        **_errors(experiment, 1e3 * (measured - true), int(target.sum())),
        wanted_pixels=int(target.sum()),
        height_scale=_scale(measured, true),
    )
    shown = _shown(experiment, measured_mm, truth, both)
    return Scores(against_truth, *_balls(experiment, measured_mm, truth, both), shown=shown)


def score_truth(
    experiment: Experiment, reconstruction: Reconstruction, truth: Truth
) -> FringeScore:
    """Compare the measured world z of each pixel with the true z at the pixel centre."""
    target = wanted_pixels(experiment, truth)
    both = reconstruction.point_map.valid & target
    measured_mm = at_pixels(reconstruction.point_map.points_world_mm, both)[:, 2]
    true_mm = at_pixels(truth.points_world_mm, both)[:, 2]
    # float32, as the points: with float64, medians would take 1.5 x the time.
    error_um = np.float32(1e3) * (measured_mm - true_mm)
    sigma_mm = at_pixels(reconstruction.point_map.sigma_z_mm, both)
    sigma_um = np.float32(1e3) * sigma_mm
    bias_um, bias_share = None, None
    if both.any():
        bias_um, bias_share = filter_bias(reconstruction, experiment.decode.use, both, sigma_mm)
    return FringeScore(
        **_errors(experiment, error_um, int(target.sum())),
        lit_pixels=int(target.sum()),
        wrong_order_pixels=wrong_orders(experiment, reconstruction, truth),
        sigma_z_median_um=figure_of(sigma_um, median),
        filter_bias_um=bias_um,
        filter_bias_share=bias_share,
        error_over_sigma=figure_of(
            error_um / np.maximum(sigma_um, np.float32(1e-9)), spread, least=2
        ),
    )


def _errors(experiment: Experiment, error_um: NDArray[np.floating], target: int) -> dict[str, Any]:
    """Return the figures of `TruthScore`, from errors (n,), um, of the target pixels with a point.

    `target` is the number of target pixels.
    """
    good = np.abs(error_um) <= experiment.score.good_within_um
    return {
        "points": len(error_um),
        "completeness": share_of(len(error_um), target),
        "good_share": share_of(int(good.sum()), target),
        "z_rmse_um": figure_of(error_um, rms),
        "z_bias_um": figure_of(error_um, mean),
        "z_p95_um": figure_of(error_um, p95_of_size),
    }


def share_of(count: int, whole: int) -> float | None:
    """Return count / whole; None if `whole` is 0."""
    return count / whole if whole else None


def figure_of(
    values: NDArray[np.floating],
    figure: Callable[[NDArray[np.floating]], float],
    least: int = 1,
) -> float | None:
    """Return the function `figure` of values (n,); None if there are fewer than `least` values."""
    return float(figure(values)) if len(values) >= least else None


def wanted_pixels(experiment: Experiment, truth: Truth) -> NDArray[np.bool_]:
    """Return the mask (row, col) of the target pixels: those that should have a point.

    With fringes on a coat, target pixels are those that show a point visible for camera and
    projector. On a bare specimen, all pixels that show it are target pixels, because shadows and
    invisible flanks are part of the result. With photometric stereo, target pixels show the coat
    within the field of the sensor.
    """
    if experiment.method.fringes:
        return truth.lit if experiment.method.presses else truth.measured
    size, points = experiment.photometric, truth.points_world_mm
    inside = np.abs(points[..., 0]) <= size.field_x_mm / 2
    inside &= np.abs(points[..., 1]) <= size.field_y_mm / 2
    return np.asarray(inside & truth.measured)


def in_world(heights: HeightMap) -> FloatArray:
    """Return the points (row, col, xyz), mm, of a height map in the world frame.

    The middle of the image is at world x = y = 0.
    """
    rows, cols = heights.height_mm.shape
    col, row = np.meshgrid(np.arange(cols), np.arange(rows))
    x_mm = (col - 0.5 * (cols - 1)) * heights.pitch_mm
    y_mm = (0.5 * (rows - 1) - row) * heights.pitch_mm
    return np.stack([x_mm, y_mm, heights.height_mm.astype(np.float64)], axis=-1)


def wrong_orders(
    experiment: Experiment, reconstruction: Reconstruction, truth: Truth
) -> int | None:
    """Return the number of decoded target pixels with a wrong fringe order.

    Their projector column or row has an error of at least half a period. Without phase steps, the
    limit is one period.

    None if no pixel was decoded, because a count of 0 would be misleading.
    """
    both = reconstruction.decoded.valid & wanted_pixels(experiment, truth)
    wrong = _of_another_period(experiment, reconstruction, truth)
    return int((wrong & both).sum()) if both.any() else None


def _of_another_period(
    experiment: Experiment, reconstruction: Reconstruction, truth: Truth
) -> BoolImage:
    """Return a mask (row, col) of pixels with a wrong fringe order, see `wrong_orders`."""
    patterns = pattern_set(experiment.projector, experiment.patterns)
    wrong: BoolImage = np.zeros(truth.column_px.shape, np.bool_)
    for axis in reconstruction.decoded.axes:
        decoded = getattr(reconstruction.decoded, axis).coordinate_px
        true_px = truth.row_px if axis == "row" else truth.column_px
        # A code without phase steps has errors of one whole period at the borders of code words.
        limit_px = patterns.period_along(axis) / (2 if patterns.steps else 1)
        wrong |= np.abs(decoded - true_px) >= limit_px
    return wrong


def order_warnings(
    experiment: Experiment, reconstruction: Reconstruction, truth: Truth
) -> list[str]:
    """Return a one-line warning if points of a wrong fringe order cause most of the z error.

    The list is empty otherwise. A few such points pass the checks of the decoder, because column
    and row are consistent by chance. The errors of their z are some centimetres.
    """
    points = reconstruction.point_map
    both = points.valid & wanted_pixels(experiment, truth)
    wrong = at_pixels(_of_another_period(experiment, reconstruction, truth), both)
    measured_mm, true_mm = (
        at_pixels(surface, both)[:, 2]
        for surface in (points.points_world_mm, truth.points_world_mm)
    )
    error_um = 1e3 * (measured_mm - true_mm).astype(np.float64)
    if not wrong.any() or wrong.all():
        return []
    all_um, others_um = rms(error_um), rms(error_um[~wrong])
    if all_um < _DOMINATED * others_um:
        return []
    cause = "" if experiment.method.presses else _BY_ANOTHER_SURFACE
    return [
        f"{wrong.sum()} of {len(wrong)} points have a wrong fringe order and make most of the z "
        f"error: {all_um:.4g} um RMS, {others_um:.4g} without them{cause}"
    ]


# Wrong fringe orders dominate if the RMS error is larger than this multiple of the RMS error
# without them.
_DOMINATED = 2.0
_BY_ANOTHER_SURFACE = (
    "; there the light that stage and specimen throw on each other is stronger than the "
    "projector's own: use a darker stage (stage.albedo), a matte specimen, or contact_fpp"
)


def region_of(
    ball: Sphere, points_mm: NDArray[np.floating], usable: BoolImage, roi_radius_mm: float
) -> NDArray[np.bool_]:
    """Return a mask (row, col) of usable pixels within a lateral distance of a ball's apex."""
    x_mm, y_mm = points_mm[..., 0] - ball.x_mm, points_mm[..., 1] - ball.y_mm
    inside: BoolImage = (np.abs(x_mm) <= roi_radius_mm) & (np.abs(y_mm) <= roi_radius_mm) & usable
    inside[inside] = np.hypot(x_mm[inside], y_mm[inside]) <= roi_radius_mm
    return inside


def _balls(
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
        further |= _sphere_metrics(*spheres, region_name(radius_mm))
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


def _shown(
    experiment: Experiment, measured_mm: NDArray[np.floating], truth: Truth, usable: BoolImage
) -> dict[str, Any]:
    if not (single_section(experiment.specimen) or experiment.specimen.nominal(NominalHexNut)):
        return {}
    figures: dict[str, Any] = {}
    for prefix, every_mm in {"": measured_mm, "true_face_": truth.points_world_mm}.items():
        points_mm = every_mm[usable]
        figures |= rod_figures(experiment, points_mm, prefix)
        figures |= nut_figures(experiment, points_mm, prefix)
    return figures


def _scale(measured_mm: FloatArray, true_mm: FloatImage) -> float | None:
    true = true_mm.astype(np.float64) - true_mm.mean(dtype=np.float64)
    if not np.ptp(true_mm):
        return None
    return float(true @ (measured_mm - measured_mm.mean()) / float(true @ true))


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


def metrics(scored: Scores[TruthScore]) -> dict[str, Any]:
    """Return all scores by name for `result.json`; names end with the unit."""
    figures = asdict(scored.against_truth) | {"unfitted_balls": list(scored.unfitted)}
    spheres = _sphere_metrics(scored.spheres, scored.unfitted)
    return figures | spheres | dict(scored.regions) | dict(scored.shown)


def _sphere_metrics(
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
