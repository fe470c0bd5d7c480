"""Score heights of photometric stereo in millimetres, by the rules for fringe projection.

World frame. The decoder knows a pixel's place only by the pitch, and heights from where the gel is
untouched; both belong to the method, so nothing is registered before comparing.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import BoolImage, Doubles, FloatImage
from reconstruction.errors import FitError
from reconstruction.photometric import HeightMap
from reconstruction.photometric.contact_circle import ContactCircle
from twin.config.models import Experiment
from twin.optics.stack import Truth
from twin.pipeline.score import (
    SphereScore,
    p95_of_size,
    rms,
    score_sphere,
    sphere_metrics,
)
from twin.specimens import shape_of

# Of the contact radius: where caps are measured.
CAP_SHARE = 0.8


@dataclass(frozen=True, eq=False)
class WorldHeights:
    """Points (row, col, xyz) float, mm, and which of them are measured."""

    points_mm: Doubles
    valid: BoolImage


@dataclass(frozen=True, eq=False)
class PhotometricScore:
    """Errors of world z against the true coat at the pixel centres, and the balls' fits.

    Only pixels within the stated field count. `completeness` and `good_share` as for fringes.
    `height_scale` is the slope of measured over true z, by least squares with a free zero; 1 where
    heights are neither flattened nor stretched, and None on a flat truth, which has no scale.
    """

    points: int
    wanted_pixels: int
    completeness: float
    good_share: float
    z_rmse_um: float
    z_bias_um: float
    z_p95_um: float
    height_scale: float | None
    spheres: tuple[SphereScore, ...]
    unfitted: tuple[str, ...]


def in_world(heights: HeightMap) -> WorldHeights:
    """Place a height map in the world: the middle of the image looks at the origin."""
    rows, cols = heights.height_mm.shape
    col, row = np.meshgrid(np.arange(cols), np.arange(rows))
    x_mm = (col - 0.5 * (cols - 1)) * heights.pitch_mm
    y_mm = (0.5 * (rows - 1) - row) * heights.pitch_mm
    points = np.stack([x_mm, y_mm, heights.height_mm.astype(np.float64)], axis=-1)
    return WorldHeights(points, heights.valid)


def wanted_of(experiment: Experiment, truth: Truth) -> NDArray[np.bool_]:
    """Pixels that ought to give a point: the coat within the stated field, (row, col)."""
    size, points = experiment.photometric, truth.points_world_mm
    inside = np.abs(points[..., 0]) <= size.field_x_mm / 2
    inside &= np.abs(points[..., 1]) <= size.field_y_mm / 2
    return np.asarray(inside & truth.measured)


def score_heights(experiment: Experiment, found: WorldHeights, truth: Truth) -> PhotometricScore:
    """Score heights against the truth of the same pixels.

    Raises
    ------
    FitError
        No pixel of the field carries a height.
    """
    wanted = wanted_of(experiment, truth)
    both = wanted & found.valid
    if not both.any():
        raise FitError("no pixel within photometric.field carries a height")
    error_um = 1e3 * (found.points_mm[both][:, 2] - truth.points_world_mm[both][:, 2])
    good = np.abs(error_um) <= experiment.score.good_within_um
    fitted, unfitted = _spheres(experiment, found, truth, both)
    count, asked = int(both.sum()), int(wanted.sum())
    return PhotometricScore(
        points=count,
        wanted_pixels=asked,
        completeness=count / asked,
        good_share=float(good.sum()) / asked,
        z_rmse_um=rms(error_um),
        z_bias_um=float(np.mean(error_um)),
        z_p95_um=p95_of_size(error_um),
        height_scale=_scale(found.points_mm[both][:, 2], truth.points_world_mm[both][:, 2]),
        spheres=tuple(fitted),
        unfitted=tuple(unfitted),
    )


def _scale(found_mm: Doubles, true_mm: FloatImage) -> float | None:
    true = true_mm.astype(np.float64) - true_mm.mean(dtype=np.float64)
    if not np.ptp(true_mm):
        return None
    return float(true @ (found_mm - found_mm.mean()) / float(true @ true))


def _spheres(
    experiment: Experiment, found: WorldHeights, truth: Truth, usable: BoolImage
) -> tuple[list[SphereScore], list[str]]:
    """Fit over the points within the lateral region about each apex, as `score.region_of` does."""
    fitted, unfitted = [], []
    for number, ball in enumerate(shape_of(experiment.specimen).spheres(), start=1):
        x_mm, y_mm = found.points_mm[..., 0] - ball.x_mm, found.points_mm[..., 1] - ball.y_mm
        roi = (np.hypot(x_mm, y_mm) <= experiment.score.roi_radius_mm) & usable
        try:
            fitted.append(score_sphere(number, ball, roi, found.points_mm, truth.points_world_mm))
        except FitError as error:
            unfitted.append(f"ball {number}: {error}")
    return fitted, unfitted


def cap_height_ratio(
    height_mm: Doubles | FloatImage, circle: ContactCircle, ball_radius_mm: float, pitch_mm: float
) -> float:
    """Return the height of a ball's cap, centre to 0.8 contact radii, over the true one.

    The figure that was published for presses of known balls: independent of the zero level, and
    clear of the rim of the contact.
    """
    rows, cols = height_mm.shape
    row, col = np.ogrid[:rows, :cols]
    radii_px = np.hypot(row - circle.row_px, col - circle.col_px)
    ring_px = CAP_SHARE * circle.radius_px
    ring, centre = np.abs(radii_px - ring_px) < 0.7, radii_px < 1.5
    sagitta_mm = ball_radius_mm - np.sqrt(ball_radius_mm**2 - (ring_px * pitch_mm) ** 2)
    return float((height_mm[centre].mean() - height_mm[ring].mean()) / sagitta_mm)


def photometric_metrics(scored: PhotometricScore) -> dict[str, Any]:
    """Flatten a score to names with units, for result.json."""
    names = (
        "points", "wanted_pixels", "completeness", "good_share", "z_rmse_um", "z_bias_um",
        "z_p95_um", "height_scale",
    )  # fmt: skip
    figures: dict[str, Any] = {name: getattr(scored, name) for name in names}
    figures["unfitted_balls"] = list(scored.unfitted)
    return figures | sphere_metrics(scored.spheres, scored.unfitted)
