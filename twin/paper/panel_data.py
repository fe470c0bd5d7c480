"""What the figures show of one measurement, small enough to keep: arrays and a few numbers.

Maps are thinned to at most `MOST_PX` pixels along their longer side; balls and sections are taken
from all points before. World frame, mm; row 0 is the top.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import FloatImage
from reconstruction.errors import InputError
from twin.output import read_json, write_json

PANELS_FOLDER = "panels"
ARRAYS_FILE, NUMBERS_FILE = "panels.npz", "panels.json"
MOST_PX = 400
MOST_BALL_POINTS = 20_000

Picture = NDArray[np.uint8]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class PanelBall:
    """Sphere fitted to one ball, as the paper's table has it; mm."""

    number: int
    nominal_radius_mm: float
    radius_mm: float
    rmse_mm: float
    mae_mm: float
    p95_mm: float


@dataclass(frozen=True)
class Width:
    """A rod's width where the section crosses half of its height."""

    width_mm: float
    height_mm: float
    left_mm: float
    right_mm: float
    nominal_mm: float


@dataclass(frozen=True)
class Numbers:
    """What is said beside the pictures.

    Attributes
    ----------
    outline_mm : x low, x high, y low, y high of the specimen
    scale_mm : round ends of a scale of the true heights
    half_field_mm : half the width and height of the camera's field on the face
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
    """One measurement as pictures and points.

    Attributes
    ----------
    picture : (row, col) or (row, col, 3) uint8
        What the camera saw: fringes from black to saturation, or colours.
    photograph : (row, col, 3) uint8
        The specimen alone.
    points_mm : (row, col, xyz) float32
    valid : (row, col) bool
        Points that were measured.
    true_z_mm : (row, col) float32
    wanted : (row, col) bool
        Pixels that ought to give a point.
    reason : (row, col) uint8
        Why a pixel of a fringe measurement has no point, `reconstruction.arrays.Reason`.
    ball_points : (point, ball number, x, y, radial residual) float32, mm
    section, true_section : (n, 2) float32
        Position across a rod and height, mm; empty for everything else.
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
        """Measured minus true z, (row, col); masked where there is no wanted point."""
        difference = 1e3 * (self.points_mm[..., 2] - self.true_z_mm).astype(np.float64)
        return np.ma.masked_array(difference, ~(self.valid & self.wanted))

    def ball(self, number: int) -> FloatImage:
        """Return x, y and radial residual of one ball's points, (n, 3) mm."""
        return self.ball_points[self.ball_points[:, 0] == number, 1:]


def thinned(values: Any) -> Any:
    """Keep every nth row and column: heights and codes must not be averaged across edges."""
    step = -(-max(values.shape[:2]) // MOST_PX)
    return values[::step, ::step]


def write_panel_data(folder: Path, data: PanelData) -> None:
    """Write arrays and numbers into a folder, which is made."""
    folder.mkdir(exist_ok=True)
    arrays = {f.name: getattr(data, f.name) for f in fields(data) if f.name != "numbers"}
    np.savez_compressed(folder / ARRAYS_FILE, **arrays)
    write_json(folder / NUMBERS_FILE, json.loads(json.dumps(asdict(data.numbers))))


def read_panel_data(folder: Path) -> PanelData:
    """Read what `write_panel_data` wrote.

    Raises
    ------
    InputError
        A file is missing or damaged.
    """
    numbers = read_json(folder / NUMBERS_FILE)
    try:
        with np.load(folder / ARRAYS_FILE, allow_pickle=False) as kept:
            arrays = {name: kept[name] for name in kept.files}
        return PanelData(numbers=_numbers(numbers), **arrays)
    except (OSError, ValueError, KeyError, TypeError) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{folder}: panels cannot be read ({reason}); measure again") from None


def _numbers(tree: Mapping[str, Any]) -> Numbers:
    width = tree["width"]
    pairs = {key: tuple(tree[key]) for key in ("outline_mm", "scale_mm", "half_field_mm")}
    balls = tuple(PanelBall(**ball) for ball in tree["balls"])
    parts = {"balls": balls, "width": None if width is None else Width(**width)}
    return Numbers(**{**tree, **pairs, **parts})
