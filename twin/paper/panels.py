"""Reduced data of one measurement that the figures need: arrays and a few numbers.

Maps are reduced to at most `MOST_PX` pixels along their longer side. Sphere fits and sections are
computed from all points before this reduction. Positions are in the world frame, mm; row 0 is the
top of an image.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import FloatImage
from reconstruction.errors import FitError, InputError
from reconstruction.reading import read_json
from reconstruction.writing import write_npz
from twin.config import Experiment
from twin.output import write_json
from twin.paper.photographs import photograph_of
from twin.report.camera_images import block_mean
from twin.report.canvas import height_scale
from twin.results.balls import SphereScore
from twin.results.record import Measurement
from twin.results.rods import (
    SECTION_LENGTH_MM,
    RodSection,
    middle_of,
    section_of,
    single_section,
)
from twin.results.score import wanted_pixels
from twin.specimens import shape_of

PANELS_FOLDER = "panels"
ARRAYS_FILE, NUMBERS_FILE = "panels.npz", "panels.json"
MOST_PX = 400
MOST_BALL_POINTS = 20_000

Picture = NDArray[np.uint8]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class PanelBall:
    """Sphere fitted to one ball: radius, and RMSE, MAE and 95th percentile of the residuals, mm."""

    number: int
    radius_mm: float
    rmse_mm: float
    mae_mm: float
    p95_mm: float


@dataclass(frozen=True)
class Width:
    """Width of a rod where its cross-section crosses 50 % of its height.

    `left_mm` and `right_mm` are the positions of the two crossings across the rod.
    """

    width_mm: float
    height_mm: float
    left_mm: float
    right_mm: float
    nominal_mm: float


@dataclass(frozen=True)
class Numbers:
    """Numbers of a measurement that the figures show next to its pictures, or use as scales.

    Attributes
    ----------
    outline_mm : smallest x, largest x, smallest y, largest y of the specimen
    scale_mm : rounded ends of a height scale that covers the true heights
    half_field_mm : largest abs(x) and abs(y) of the true surface in the camera's view
    balls : fitted spheres; empty if the specimen has no balls
    width : width of a rod; None for other specimens, or if it cannot be measured
    """

    name: str
    description: str
    method: str
    completeness: float | None
    good_share: float | None
    good_within_um: float
    z_rmse_um: float | None
    outline_mm: tuple[float, float, float, float]
    scale_mm: tuple[float, float]
    half_field_mm: tuple[float, float]
    balls: tuple[PanelBall, ...] = ()
    width: Width | None = None


@dataclass(frozen=True, eq=False)
class PanelData:
    """Reduced data of one measurement for the figures: pictures, points and numbers.

    Attributes
    ----------
    picture : (row, col) or (row, col, 3) uint8
        Image of the camera: fringes from black to saturation, or colours.
    photograph : (row, col, 3) uint8
        Rendered picture of the specimen without sheet.
    points_mm : (row, col, xyz) float32
        Measured points, world.
    valid : (row, col) bool
        True where a point was measured.
    true_z_mm : (row, col) float32
        World z of the true surface.
    wanted : (row, col) bool
        Scored pixels, at which a point is expected.
    reason : (row, col) uint8
        Reason why a pixel of a fringe measurement has no point, `reconstruction.arrays.Reason`.
    ball_points : (point, 4) float32
        Ball number, x, y and radial residual of each fitted point; lengths in mm.
    section, true_section : (n, 2) float32
        Measured and true cross-section of a rod: position across the rod and height, mm; empty for
        other specimens.
    """

    numbers: Numbers
    picture: Picture
    photograph: Picture
    points_mm: FloatImage
    valid: Mask
    true_z_mm: FloatImage
    wanted: Mask
    reason: NDArray[np.uint8]
    ball_points: FloatImage
    section: FloatImage
    true_section: FloatImage

    @property
    def error_um(self) -> "np.ma.MaskedArray[Any, Any]":
        """Measured minus true z, (row, col), um; masked at pixels not scored or without a point."""
        difference = 1e3 * (self.points_mm[..., 2] - self.true_z_mm).astype(np.float64)
        return np.ma.masked_array(difference, ~(self.valid & self.wanted))

    def ball(self, number: int) -> FloatImage:
        """Return x, y and radial residual of one ball's points, (n, 3) mm."""
        return self.ball_points[self.ball_points[:, 0] == number, 1:]


def thinned(values: Any) -> Any:
    """Return every nth row and column, so that no side is longer than `MOST_PX` pixels.

    Pixels are not averaged, because a mean across an edge is no valid height or code.
    """
    step = -(-max(values.shape[:2]) // MOST_PX)
    return values[::step, ::step]


def write_panel_data(folder: Path, data: PanelData) -> None:
    """Write the arrays and numbers of the panels into a folder, which is created if necessary."""
    folder.mkdir(exist_ok=True)
    arrays = {f.name: getattr(data, f.name) for f in fields(data) if f.name != "numbers"}
    write_npz(folder / ARRAYS_FILE, arrays)
    write_json(folder / NUMBERS_FILE, json.loads(json.dumps(asdict(data.numbers))))


def read_panel_data(folder: Path) -> PanelData:
    """Return the panel data from a folder written by `write_panel_data`.

    Raises
    ------
    InputError
        A file is missing or damaged.
    """
    numbers = read_json(folder / NUMBERS_FILE)
    try:
        with np.load(folder / ARRAYS_FILE, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        return PanelData(numbers=_read_numbers(numbers), **arrays)
    except (OSError, ValueError, KeyError, TypeError) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{folder}: panels cannot be read ({reason}); measure again") from None


def _read_numbers(tree: Mapping[str, Any]) -> Numbers:
    width = tree["width"]
    pairs = {key: tuple(tree[key]) for key in ("outline_mm", "scale_mm", "half_field_mm")}
    # By name: earlier files also have a nominal radius, which no figure shows.
    names = [field.name for field in fields(PanelBall)]
    balls = tuple(PanelBall(**{name: ball[name] for name in names}) for ball in tree["balls"])
    parts = {"balls": balls, "width": None if width is None else Width(**width)}
    return Numbers(**{**tree, **pairs, **parts})


_PICTURE_PX = 500


def panel_data_of(measured: Measurement) -> PanelData:
    """Return the reduced data of a measurement for the figures.

    Raises
    ------
    MissingBackend
        No usable Dr.Jit backend for the specimen's photograph.
    """
    experiment, truth, method = measured.experiment, measured.truth, measured.experiment.method
    true_mm, shown, points = truth.points_world_mm, truth.depth_mm > 0, measured.points
    wanted = wanted_pixels(experiment, truth)
    lit = points.valid & (truth.lit if method.fringes and method.presses else shown)
    section, true_section = (
        _section(experiment, points[lit].astype(np.float64))
        for points in (points.world_mm, true_mm)
    )
    return PanelData(
        numbers=_numbers(measured, true_mm[shown], section),
        picture=_small(measured.picture),
        photograph=photograph_of(experiment),
        points_mm=thinned(points.world_mm).astype(np.float32),
        valid=thinned(points.valid),
        true_z_mm=thinned(true_mm[..., 2]).astype(np.float32),
        wanted=thinned(wanted),
        reason=thinned(points.reason),
        ball_points=_ball_points(points.world_mm, measured.score.spheres),
        section=_columns(section),
        true_section=_columns(true_section),
    )


def _numbers(measured: Measurement, true_mm: NDArray[Any], section: RodSection | None) -> Numbers:
    experiment, heights = measured.experiment, true_mm[:, 2]
    return Numbers(
        name=experiment.name,
        description=experiment.description,
        method=experiment.modality,
        **{name: measured.figures[name] for name in ("completeness", "good_share", "z_rmse_um")},
        good_within_um=experiment.score.good_within_um,
        outline_mm=shape_of(experiment.specimen).bounds_mm(),
        scale_mm=height_scale(heights) if heights.size else (0.0, 1.0),
        half_field_mm=_half_field(true_mm),
        balls=tuple(_fit(ball) for ball in measured.score.spheres),
        width=_width(experiment, section),
    )


def _half_field(surface_mm: NDArray[Any]) -> tuple[float, float]:
    if not len(surface_mm):
        return 1.0, 1.0
    x, y = np.abs(surface_mm[:, :2]).max(axis=0)
    return float(x), float(y)


def _small(image: Picture) -> Picture:
    step = max(1, -(-max(image.shape) // _PICTURE_PX))
    return image if step == 1 else np.asarray(np.rint(block_mean(image, step)), np.uint8)


def _fit(ball: SphereScore) -> PanelBall:
    stats = ball.measured.stats
    return PanelBall(
        ball.number,
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


def _section(experiment: Experiment, points_mm: NDArray[np.float64]) -> RodSection | None:
    """Return the cross-section of a single rod, round or rectangular; None for other specimens."""
    if single_section(experiment.specimen) is None or not len(points_mm):
        return None
    return section_of(points_mm, SECTION_LENGTH_MM, middle_of(shape_of(experiment.specimen)))


def _columns(section: RodSection | None) -> FloatImage:
    if section is None:
        return np.zeros((0, 2), np.float32)
    return np.column_stack([section.s_mm, section.z_mm]).astype(np.float32)


def _width(experiment: Experiment, section: RodSection | None) -> Width | None:
    nominal = single_section(experiment.specimen)
    if section is None or nominal is None:
        return None
    try:
        bar = section.width()
    except FitError:
        return None
    return Width(bar.width_mm, bar.height_mm, bar.left_mm, bar.right_mm, nominal.width_mm)
