"""Score the points of any method against the truth; figures of balls are those of `balls`.

Points are not registered to the truth before the comparison: an error of their position is part of
the error of the method.
"""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import BoolImage, FloatArray, FloatImage, Reason, at_pixels
from reconstruction.errors import FitError
from reconstruction.evaluate.fit import (
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
from twin.results.balls import SphereScore, score_balls, sphere_metrics
from twin.results.nuts import nut_figures
from twin.results.rods import rod_figures, single_section


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
    spheres = score_balls(experiment, points.points_world_mm, truth, usable)
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
    return Scores(against_truth, *score_balls(experiment, measured_mm, truth, both), shown=shown)


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
    if heights.rest is not None:
        return heights.rest.points_at(heights.height_mm)
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


def empty_warnings(
    experiment: Experiment, reconstruction: Reconstruction, truth: Truth
) -> list[str]:
    """Return a one-line warning with the most frequent reason if no target pixel has a point."""
    wanted = wanted_pixels(experiment, truth)
    reasons = reconstruction.point_map.mask_reason[wanted]
    if not reasons.size:
        return ["no pixel shows the lit surface: turn or move camera and projector (twin layout)"]
    if (reasons == Reason.VALID).any():
        return []
    counts = np.bincount(reasons)
    main = Reason(int(counts.argmax()))
    share = counts[main] / reasons.size
    name = main.name.lower().replace("_", " ")
    return [f"no point was measured, {share:.0%} of the pixels: {name}; {_ADVICE[main]}"]


_LONGER = "set camera.exposure_ms = 'auto' or a longer one, or use more light (projector.flux_mw)"
_CODE = "use fewer fringes or more phase steps (patterns.period_px, patterns.steps)"
_GEOMETRY = "turn or move camera and projector (twin layout)"
_ADVICE = dict.fromkeys(Reason, _GEOMETRY) | {
    Reason.DARK: _LONGER,
    Reason.LOW_MODULATION: _LONGER,
    Reason.SATURATED: "set camera.exposure_ms = 'auto' or a shorter one",
    Reason.ORDER_UNCERTAIN: _CODE,
    Reason.MOTION: "let the specimen rest, or raise decode.max_residual_sigmas",
}


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
    if not wrong.any() or wrong.all():
        return []
    measured_mm, true_mm = (
        at_pixels(surface, both)[:, 2]
        for surface in (points.points_world_mm, truth.points_world_mm)
    )
    error_um = 1e3 * (measured_mm - true_mm).astype(np.float64)
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


def metrics(scored: Scores[TruthScore]) -> dict[str, Any]:
    """Return all scores by name for `result.json`; names end with the unit."""
    figures = asdict(scored.against_truth) | {"unfitted_balls": list(scored.unfitted)}
    spheres = sphere_metrics(scored.spheres, scored.unfitted)
    return figures | spheres | dict(scored.regions) | dict(scored.shown)
