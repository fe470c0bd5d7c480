"""Calibrations that must be refused, and intervals of calibrated parameters that cover.

The last line of the output is one JSON object:

calibrations_refused_rightly: share of inputs with the right end. Wrong inputs (pixels twice as wide
    as high taken for square, a wrong number of rows, mirrored or exchanged axes, coordinates
    without relation to the board, one pose of another board) must end with an error; right ones
    (square pixels, half the columns with their pixel ratio, columns of a diamond chip as the
    captures state it) must be calibrated with every focal length within five standard
    uncertainties.
interval_coverage: share of the rig's parameters that agree within two standard uncertainties
    between disjoint sets of poses. The errors of the features are correlated over a third of the
    board; camera and board have errors that the model does not describe: k2, and a bend.
interval_coverage_sigma: standard uncertainty of this share, from its scatter over the pairs.
independent_coverage: the same by the covariance of independent errors, for comparison.
real_coverage: the same on the public captures in ../shared/cases, if present; as they have five
    poses, sets of three poses with one common pose are compared.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks._harness import print_figures, quick_parser
from reconstruction.arrays import FloatArray
from reconstruction.calibration import (
    Adjustment,
    AdjustOptions,
    Chessboard,
    Freedom,
    Observation,
    adjust,
    calibrate,
    observe,
    read_board_capture,
)
from reconstruction.calibration.initial import starting_rig
from reconstruction.calibration.observation import pose_folders
from reconstruction.calibration.parameters import POSES
from reconstruction.errors import InputError
from reconstruction.rig.pinhole import Pinhole

CAMERA = Pinhole(1000, 800, 1400.0, 1400.0, 510.0, 390.0, (-0.05, 0.3, 0.0, 0.0, 0.0))
PROJECTOR = Pinhole(1280, 720, 1800.0, 1800.0, 640.0, 719.0)
DISTANCE_MM, ANGLE_DEG, TILT_DEG = 600.0, 22.0, 22.0
BOARD = Chessboard(9, 7, 18.0)
# Errors of the features, px: without correlation, and correlated over this share of the board.
WHITE_PX, SMOOTH_PX, REACH = 0.05, 0.1, 0.3
# Height of the board's ends above its middle, mm.
BEND_MM = 0.1
PAIRS, QUICK_PAIRS, POSES_PER_SET = 160, 6, 5
# The estimator was chosen by sets of another seed.
SEED = 20261127
CASE = Path(__file__).parents[2] / "shared" / "cases" / "06_lightcrafter_912x1140"
# Sets of real poses of this size; a rig needs three.
REAL_SET = 3


@dataclass(frozen=True)
class Errors:
    """Standard deviations of the features' errors, px, and height of the bent board's ends, mm."""

    white_px: float = WHITE_PX
    smooth_px: float = SMOOTH_PX
    bend_mm: float = BEND_MM


def poses(
    rng: np.random.Generator, count: int, errors: Errors, camera: Pinhole = CAMERA
) -> list[Observation]:
    """Return corners of a board in `count` random poses, with correlated errors in each pose."""
    return [_pose(f"pose_{k}", _motion(rng, k), rng, errors, camera) for k in range(count)]


def _motion(rng: np.random.Generator, number: int) -> FloatArray:
    azimuth, spin = rng.uniform(0.0, 360.0), rng.uniform(-180.0, 180.0)
    tilt = TILT_DEG * rng.uniform(0.6, 1.0) if number else 0.0
    turned = Rotation.from_euler("ZYZ", (azimuth, tilt, spin - azimuth), degrees=True)
    motion = np.eye(4)
    motion[:3, :3] = np.diag([1.0, -1.0, -1.0]) @ turned.as_matrix()
    motion[:3, 3] = (*rng.uniform(-15.0, 15.0, 2), DISTANCE_MM + rng.uniform(-40.0, 40.0))
    return motion


def _pose(
    name: str, motion: FloatArray, rng: np.random.Generator, errors: Errors, camera: Pinhole
) -> Observation:
    points = BOARD.points_mm
    bent = points.copy()
    bent[:, 2] = errors.bend_mm * (2.0 * points[:, 0] / np.ptp(points[:, 0])) ** 2
    seen = _seen(bent, motion, camera)
    steps = [_seen(bent + 1e-3 * axis, motion, camera) - seen for axis in np.eye(3)[:2]]
    by_board = np.stack(steps, axis=-1)
    slopes = by_board[:, 2:] @ np.linalg.inv(by_board[:, :2])
    camera_error, own_error = (_errors(points, rng, errors) for _ in range(2))
    along = np.einsum("nij,nj->ni", slopes, camera_error)
    return Observation(
        name,
        points,
        np.zeros(len(points)),
        seen[:, :2] + camera_error,
        seen[:, 2:] + along + own_error,
        slopes,
        np.arange(len(points)),
        (camera.width_px, camera.height_px),
        (PROJECTOR.width_px, PROJECTOR.height_px),
    )


def _seen(points_mm: FloatArray, motion: FloatArray, camera: Pinhole) -> FloatArray:
    """Return camera x, y, projector column, row (n, 4), px, of points of the board."""
    inside = points_mm @ motion[:3, :3].T + motion[:3, 3]
    turn = Rotation.from_euler("Y", ANGLE_DEG, degrees=True).as_matrix()
    # The middle of the projector's image, not its axis, shows the board.
    down = (PROJECTOR.cy_px - PROJECTOR.height_px / 2) / PROJECTOR.fy_px
    shift = np.array([0.0, -down, 1.0]) * DISTANCE_MM
    lit = (inside - (0.0, 0.0, DISTANCE_MM)) @ turn.T + shift
    return np.hstack([camera.project(inside), PROJECTOR.project(lit)])


def _errors(points_mm: FloatArray, rng: np.random.Generator, errors: Errors) -> FloatArray:
    apart = np.linalg.norm(points_mm[:, np.newaxis] - points_mm, axis=-1)
    correlation = np.exp(-0.5 * (apart / (REACH * np.ptp(points_mm[:, 0]))) ** 2)
    root = np.linalg.cholesky(correlation + 1e-9 * np.eye(len(points_mm)))
    white, smooth = rng.standard_normal((2, len(points_mm), 2))
    return np.asarray(errors.white_px * white + errors.smooth_px * (root @ smooth))


def scores(first: Adjustment, second: Adjustment, name: str = "covariance") -> FloatArray:
    """Return the differences of the rig's free parameters over their standard uncertainty.

    Parameters
    ----------
    name : field of `Adjustment` with the covariance
    """
    variance = sum(np.diag(getattr(fit, name))[:POSES] for fit in (first, second))
    free = variance > 0.0
    difference = first.vector[:POSES] - second.vector[:POSES]
    return np.asarray(np.abs(difference[free]) / np.sqrt(variance[free]))


def _fit(observed: Sequence[Observation], freedom: Freedom | None = None) -> Adjustment:
    options = AdjustOptions(freedom or Freedom())
    return adjust(observed, starting_rig(observed, options.freedom), options)


def pairs(count: int, errors: Errors | None = None) -> list[tuple[Adjustment, Adjustment]]:
    """Return the adjustments of `count` pairs of disjoint sets of simulated poses."""
    rng, adjusted = np.random.default_rng(SEED), []
    for _ in range(count):
        observed = poses(rng, 2 * POSES_PER_SET, errors or Errors())
        adjusted.append((_fit(observed[:POSES_PER_SET]), _fit(observed[POSES_PER_SET:])))
    return adjusted


def coverage(fits: Sequence[tuple[Adjustment, Adjustment]], name: str = "covariance") -> float:
    """Return the share of `scores` of all pairs up to 2."""
    return float(np.mean(np.concatenate([scores(*pair, name) for pair in fits]) <= 2.0))


def coverage_sigma(fits: Sequence[tuple[Adjustment, Adjustment]]) -> float:
    """Return the standard uncertainty of `coverage`, from the scatter of the pairs' own shares.

    The parameters of one pair are correlated, so that a binomial interval of all scores would be
    too narrow.
    """
    shares = [coverage([pair]) for pair in fits]
    return float(np.std(shares, ddof=1) / np.sqrt(len(shares)))


def real_pairs(folder: Path) -> list[tuple[Adjustment, Adjustment]]:
    """Return adjustments of pairs of three real poses each, with as few common poses as possible.

    The pixels of the projector are twice as wide as high.
    """
    from twin.config.board import load_board

    board = load_board(folder / "board.toml").board()
    observed = [
        observe(read_board_capture(path), board, path.name)
        for path in pose_folders(folder / "captures")
    ]
    free = Freedom(projector_pixel_ratio=2.0, camera_defocus=False)
    fits = {
        chosen: _fit([observed[k] for k in chosen], free)
        for chosen in combinations(range(len(observed)), REAL_SET)
    }
    most_common = max(0, 2 * REAL_SET - len(observed))
    return [(fits[a], fits[b]) for a, b in combinations(fits, 2) if len({*a} & {*b}) <= most_common]


Change = Callable[[list[Observation]], list[Observation]]


def _columns_by(factor: float, stated: float = 1.0) -> Change:
    """Return a change to `factor` times as many columns; the captures state a pixel ratio."""
    width, height = PROJECTOR.width_px, PROJECTOR.height_px

    def changed(view: Observation) -> Observation:
        return replace(
            view,
            projector_px=view.projector_px * (factor, 1.0),
            slopes=view.slopes * np.array([[factor], [1.0]]),
            projector_size_px=(round(factor * width), height),
            projector_pixel_ratio=stated,
        )

    return lambda observed: [changed(view) for view in observed]


def _mirrored(observed: list[Observation]) -> list[Observation]:
    last, sign = PROJECTOR.width_px - 1, np.array([-1.0, 1.0])
    return [
        replace(
            view,
            projector_px=view.projector_px * sign + (last, 0.0),
            slopes=view.slopes * sign[:, np.newaxis],
        )
        for view in observed
    ]


def _exchanged(observed: list[Observation]) -> list[Observation]:
    return [
        replace(
            view,
            projector_px=view.projector_px[:, ::-1].copy(),
            slopes=view.slopes[:, ::-1].copy(),
            projector_size_px=view.projector_size_px[::-1],
        )
        for view in observed
    ]


def _unrelated(observed: list[Observation]) -> list[Observation]:
    rng = np.random.default_rng(3)
    size = (PROJECTOR.width_px, PROJECTOR.height_px)
    return [
        replace(view, projector_px=rng.uniform(0.0, size, view.projector_px.shape))
        for view in observed
    ]


def _other_board(observed: list[Observation]) -> list[Observation]:
    wrong = replace(observed[2], points_mm=1.05 * observed[2].points_mm)
    return [*observed[:2], wrong, *observed[3:]]


WRONG: dict[str, Change] = {
    "half the columns": _columns_by(0.5),
    "720 rows counted as 768": _columns_by(720.0 / 768.0),
    "mirrored": _mirrored,
    "axes exchanged": _exchanged,
    "coordinates without relation": _unrelated,
    "another board in one pose": _other_board,
}
RIGHT: dict[str, Change] = {
    "square": lambda observed: observed,
    "half the columns, stated": _columns_by(0.5, 2.0),
    "half the rows, stated": _columns_by(2.0, 0.5),
}


def is_refused(observed: Sequence[Observation]) -> bool:
    """Return True if the calibration ends with an error of one line."""
    try:
        calibrate(observed)
    except InputError as error:
        return "\n" not in str(error)
    return False


def is_right(observed: Sequence[Observation]) -> bool:
    """Return True if both focal lengths are found within five standard uncertainties."""
    columns = observed[0].projector_size_px[0] / PROJECTOR.width_px
    wanted = {
        "camera_fx_px": CAMERA.fx_px,
        "projector_fx_px": columns * PROJECTOR.fx_px,
        "projector_fy_px": PROJECTOR.fy_px,
    }
    try:
        calibrated = {p.name: p for p in calibrate(observed).parameters}
    except InputError:
        return False
    return all(
        abs(calibrated[name].value - f) <= 5.0 * calibrated[name].sigma
        for name, f in wanted.items()
    )


def refused_rightly() -> float:
    """Return the share of wrong and right inputs with the right end."""
    observed = poses(np.random.default_rng(2), POSES_PER_SET, Errors(WHITE_PX, 0.0, 0.0))
    wrong = [is_refused(change(observed)) for change in WRONG.values()]
    return float(np.mean([*wrong, *(is_right(change(observed)) for change in RIGHT.values())]))


def reality_intervals(quick: bool) -> dict[str, float]:
    """Return the figures of this benchmark by name; see the docstring of the module."""
    fits = pairs(QUICK_PAIRS if quick else PAIRS)
    figures = {
        "calibrations_refused_rightly": refused_rightly(),
        "interval_coverage": coverage(fits),
        "interval_coverage_sigma": coverage_sigma(fits),
        "independent_coverage": coverage(fits, "independent_covariance"),
    }
    if CASE.is_dir():
        figures["real_coverage"] = coverage(real_pairs(CASE))
    return figures


if __name__ == "__main__":
    parser = quick_parser(__doc__, "fewer sets of poses")
    print_figures(reality_intervals(parser.parse_args().quick))
