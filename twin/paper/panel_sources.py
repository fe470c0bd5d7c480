"""Take what the figures show out of a result folder, whatever the method."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
from numpy.typing import NDArray

from reconstruction.errors import FitError
from reconstruction.mask import Reason
from reconstruction.photometric import read_height_map
from twin.config import Experiment, load_experiment
from twin.config.artefacts import Rods
from twin.modalities.photometric_score import in_world, score_heights
from twin.modalities.score import SphereScore, wanted_pixels
from twin.optics.stack import Truth
from twin.optics.storage import read_truth
from twin.output import EXPERIMENT_FILE, RESULT_FILE, read_json
from twin.paper.panel_data import (
    MOST_BALL_POINTS,
    BallFit,
    Floats,
    Numbers,
    PanelData,
    Picture,
    Width,
    thinned,
)
from twin.paper.photographs import photograph_of
from twin.paper.rods import SECTION_LENGTH_MM, Section, middle_of, section_of
from twin.report.camera_view import fringe_frame
from twin.report.canvas import height_scale
from twin.report.frames import block_mean
from twin.report.result_folder import read_measured
from twin.specimens import shape_of

_PICTURE_PX = 500


def panel_data_of(folder: Path) -> PanelData:
    """Read a complete result folder.

    Raises
    ------
    InputError
        The folder is no finished measurement, or a file is missing or damaged.
    MissingBackend
        No usable Dr.Jit backend for the specimen's photograph.
    """
    experiment = load_experiment(folder / EXPERIMENT_FILE)
    if experiment.modality == "photometric_stereo":
        return _of_colours(folder, experiment)
    return _of_fringes(folder)


def _of_fringes(folder: Path) -> PanelData:
    measured = read_measured(folder)
    points, capture = measured.reconstruction.point_map, measured.capture
    frame = capture.stack[capture.patterns.frames.index(fringe_frame(capture))]
    share = frame / np.float32(capture.sensor.saturation_dn)
    return _data(
        measured.experiment,
        measured.figures,
        picture=_small(np.rint(255.0 * np.clip(share, 0.0, 1.0))),
        points_mm=points.points_world_mm,
        reason=points.mask_reason,
        truth=measured.truth,
        seen=measured.truth.depth_mm > 0,
        wanted=wanted_pixels(measured.experiment, measured.truth),
        balls=measured.score.spheres,
    )


def _of_colours(folder: Path, experiment: Experiment) -> PanelData:
    heights, truth = read_height_map(folder / "height.nc"), read_truth(folder / "truth.nc")
    found = in_world(heights)
    scored = score_heights(experiment, found, truth)
    size, x_mm, y_mm = experiment.photometric, *np.moveaxis(truth.points_world_mm[..., :2], -1, 0)
    inside = (np.abs(x_mm) <= size.field_x_mm / 2) & (np.abs(y_mm) <= size.field_y_mm / 2)
    return _data(
        experiment,
        read_json(folder / RESULT_FILE)["metrics"],
        picture=np.asarray(imageio.imread(folder / "image.png")),
        points_mm=found.points_mm,
        reason=np.where(found.valid, Reason.VALID, Reason.LOW_MODULATION),
        truth=truth,
        seen=truth.measured,
        wanted=truth.measured & inside,
        balls=scored.spheres,
    )


def _data(
    experiment: Experiment,
    figures: dict[str, Any],
    *,
    picture: Picture,
    points_mm: NDArray[Any],
    reason: NDArray[Any],
    truth: Truth,
    seen: NDArray[np.bool_],
    wanted: NDArray[np.bool_],
    balls: Sequence[SphereScore],
) -> PanelData:
    true_mm, valid = truth.points_world_mm, reason == Reason.VALID
    lit = valid & truth.lit if experiment.modality == "contact_fpp" else valid & seen
    section, true_section = (
        _section(experiment, points[lit].astype(np.float64)) for points in (points_mm, true_mm)
    )
    heights = true_mm[seen][:, 2]
    numbers = Numbers(
        name=experiment.name,
        description=experiment.description,
        method=experiment.modality,
        **{name: figures[name] for name in ("completeness", "good_share", "z_rmse_um")},
        good_within_um=experiment.score.good_within_um,
        outline_mm=shape_of(experiment.specimen).bounds_mm(),
        scale_mm=height_scale(heights) if heights.size else (0.0, 1.0),
        half_field_mm=_half_field(true_mm[seen]),
        balls=tuple(_fit(ball) for ball in balls),
        width=_width(experiment, section),
    )
    return PanelData(
        numbers=numbers,
        picture=picture,
        photograph=photograph_of(experiment),
        points_mm=thinned(points_mm).astype(np.float32),
        valid=thinned(valid),
        true_z_mm=thinned(true_mm[..., 2]).astype(np.float32),
        wanted=thinned(wanted),
        reason=thinned(reason).astype(np.uint8),
        ball_points=_ball_points(points_mm, balls),
        section=_columns(section),
        true_section=_columns(true_section),
    )


def _half_field(seen_mm: NDArray[Any]) -> tuple[float, float]:
    if not len(seen_mm):
        return 1.0, 1.0
    x, y = np.abs(seen_mm[:, :2]).max(axis=0)
    return float(x), float(y)


def _small(image: NDArray[Any]) -> Picture:
    mean = block_mean(image, max(1, -(-max(image.shape) // _PICTURE_PX)))
    return np.asarray(np.rint(mean), np.uint8)


def _fit(ball: SphereScore) -> BallFit:
    stats = ball.measured.stats
    return BallFit(
        ball.number,
        ball.nominal.radius_mm,
        ball.measured.radius_mm,
        stats.rmse_mm,
        stats.mae_mm,
        stats.p95_mm,
    )


def _ball_points(points_mm: NDArray[Any], balls: Sequence[SphereScore]) -> Floats:
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


def _columns(section: Section | None) -> Floats:
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
