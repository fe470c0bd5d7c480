"""Take what the figures show out of a measurement, whatever the method."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import FloatImage
from reconstruction.errors import FitError
from twin.config import Experiment
from twin.config.artefacts import Rods
from twin.paper.panel_data import (
    MOST_BALL_POINTS,
    Numbers,
    PanelBall,
    PanelData,
    Picture,
    Width,
    thinned,
)
from twin.paper.photographs import photograph_of
from twin.report.canvas import height_scale
from twin.report.frames import block_mean
from twin.results.record import Measurement
from twin.results.rods import SECTION_LENGTH_MM, Section, middle_of, section_of
from twin.results.score import SphereScore, wanted_pixels
from twin.specimens import shape_of

_PICTURE_PX = 500


def panel_data_of(seen: Measurement) -> PanelData:
    """Thin a measurement to what the figures show of it.

    Raises
    ------
    MissingBackend
        No usable Dr.Jit backend for the specimen's photograph.
    """
    experiment, truth, method = seen.experiment, seen.truth, seen.experiment.method
    true_mm, shown, points = truth.points_world_mm, truth.depth_mm > 0, seen.points
    wanted = wanted_pixels(experiment, truth)
    lit = points.valid & (truth.lit if method.fringes and method.presses else shown)
    section, true_section = (
        _section(experiment, points[lit].astype(np.float64))
        for points in (points.world_mm, true_mm)
    )
    return PanelData(
        numbers=_numbers(seen, true_mm[shown], section),
        picture=_small(seen.picture),
        photograph=photograph_of(experiment),
        points_mm=thinned(points.world_mm).astype(np.float32),
        valid=thinned(points.valid),
        true_z_mm=thinned(true_mm[..., 2]).astype(np.float32),
        wanted=thinned(wanted),
        reason=thinned(points.reason),
        ball_points=_ball_points(points.world_mm, seen.score.spheres),
        section=_columns(section),
        true_section=_columns(true_section),
    )


def _numbers(seen: Measurement, true_mm: NDArray[Any], section: Section | None) -> Numbers:
    experiment, heights = seen.experiment, true_mm[:, 2]
    return Numbers(
        name=experiment.name,
        description=experiment.description,
        method=experiment.modality,
        **{name: seen.figures[name] for name in ("completeness", "good_share", "z_rmse_um")},
        good_within_um=experiment.score.good_within_um,
        outline_mm=shape_of(experiment.specimen).bounds_mm(),
        scale_mm=height_scale(heights) if heights.size else (0.0, 1.0),
        half_field_mm=_half_field(true_mm),
        balls=tuple(_fit(ball) for ball in seen.score.spheres),
        width=_width(experiment, section),
    )


def _half_field(seen_mm: NDArray[Any]) -> tuple[float, float]:
    if not len(seen_mm):
        return 1.0, 1.0
    x, y = np.abs(seen_mm[:, :2]).max(axis=0)
    return float(x), float(y)


def _small(image: Picture) -> Picture:
    step = max(1, -(-max(image.shape) // _PICTURE_PX))
    return image if step == 1 else np.asarray(np.rint(block_mean(image, step)), np.uint8)


def _fit(ball: SphereScore) -> PanelBall:
    stats = ball.measured.stats
    return PanelBall(
        ball.number,
        ball.nominal.radius_mm,
        ball.measured.radius_mm,
        stats.rmse_mm,
        stats.mae_mm,
        stats.p95_mm,
    )


def _ball_points(points_mm: NDArray[Any], balls: Sequence[SphereScore]) -> FloatImage:
    parts = [np.zeros((0, 4), np.float32)]
    for ball in balls:
        xy, residuals = points_mm[ball.roi][:, :2], ball.measured.residuals_mm
        step = -(-len(xy) // MOST_BALL_POINTS)
        number = np.full(len(xy), ball.number)
        parts.append(np.column_stack([number, xy, residuals]).astype(np.float32)[::step])
    return np.concatenate(parts)


def _section(experiment: Experiment, points_mm: NDArray[np.float64]) -> Section | None:
    """Cross-section of a single rod."""
    specimen = experiment.specimen
    if not isinstance(specimen, Rods) or len(specimen.diameters_mm) != 1 or not len(points_mm):
        return None
    return section_of(points_mm, SECTION_LENGTH_MM, middle_of(shape_of(specimen)))


def _columns(section: Section | None) -> FloatImage:
    if section is None:
        return np.zeros((0, 2), np.float32)
    return np.column_stack([section.s_mm, section.z_mm]).astype(np.float32)


def _width(experiment: Experiment, section: Section | None) -> Width | None:
    if section is None or not isinstance(experiment.specimen, Rods):
        return None
    try:
        bar = section.width()
    except FitError:
        return None
    nominal_mm = experiment.specimen.diameters_mm[0]
    return Width(bar.width_mm, bar.height_mm, bar.left_mm, bar.right_mm, nominal_mm)
