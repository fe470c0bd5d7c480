"""Completeness of a measurement: the share of required pixels at which a good point was measured.

A point is good if the error of its height is at most `score.good_within_um`. Two sets of required
pixels are evaluated:

- contact: pixels of the contact region. The true height is the height of the coat.
- specimen: pixels within the outline of the specimen in the top view. The true height is the height
  of its upper face plus the nominal thickness of the sheet. Without contact (direct fringe
  projection), the true height is the height of the specimen's surface at the pixel.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import FloatArray
from reconstruction.reading import read_json
from twin.config import Experiment
from twin.mechanics import PressedElastomer
from twin.optics.stack import Truth
from twin.output import write_json
from twin.paper.panels import PANELS_FOLDER, panel_data_of, write_panel_data
from twin.report.table import Cell, Column, Table
from twin.results.record import Measurement
from twin.results.score import share_of
from twin.specimens import shape_of

COMPLETENESS_FILE = "completeness.json"
_KEYS = ("contact", "contact_points", "specimen", "specimen_points", "limit_um")
_GRID_MM = 0.02

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Completeness:
    """Shares (0 to 1) of the required pixels; None if no required pixel is in the camera's view.

    Attributes
    ----------
    contact : share of the contact region's pixels with a good point, compared with the coat; None
        without contact
    contact_points : share of the contact region's pixels with any point; None without contact
    specimen : share of the specimen's pixels with a good point, compared with its upper face
    specimen_points : share of the specimen's pixels with any point
    limit_um : largest height error of a good point
    """

    contact: float | None
    contact_points: float | None
    specimen: float | None
    specimen_points: float | None
    limit_um: float

    @property
    def missing(self) -> float | None:
        """Share of the specimen's pixels without a point; None if none is in the camera's view."""
        return None if self.specimen_points is None else 1.0 - self.specimen_points


def completeness_of(
    experiment: Experiment,
    truth: Truth,
    points_mm: FloatArray,
    valid: Mask,
    pressed: PressedElastomer | None,
) -> Completeness:
    """Return the completeness of measured points, on the contact region and on the specimen.

    Parameters
    ----------
    experiment : Experiment
    truth : true surface at every pixel
    points_mm : (row, col, xyz) float, world; measured points
    valid : (row, col) bool; True where a point was measured
    pressed : result of the press; None without contact (direct fringe projection)
    """
    limit_um = experiment.score.good_within_um
    true = truth.points_world_mm.astype(np.float64)
    if pressed is None:
        required = truth.measured
        good = _good(points_mm[..., 2], true[..., 2], limit_um) & valid
        return Completeness(None, None, _share(good, required), _share(valid, required), limit_um)
    region = truth.measured & in_contact(pressed, true)
    on_coat = _good(points_mm[..., 2], true[..., 2], limit_um) & valid
    z_mm = specimen_height_mm(experiment, pressed.depth_mm, true)
    required = truth.measured & np.isfinite(z_mm)
    on_face = _good(points_mm[..., 2], z_mm, limit_um) & valid
    return Completeness(
        _share(on_coat, region),
        _share(valid, region),
        _share(on_face, required),
        _share(valid, required),
        limit_um,
    )


def in_contact(pressed: PressedElastomer, points_mm: FloatArray) -> Mask:
    """Return True for points (..., xyz), world mm, if the nearest cell touches the specimen."""
    col = _nearest(pressed.x_mm, points_mm[..., 0])
    row = _nearest(pressed.y_mm, points_mm[..., 1])
    return np.asarray(pressed.contact[row, col])


def specimen_height_mm(
    experiment: Experiment, depth_mm: float, points_mm: FloatArray
) -> FloatArray:
    """Return the height of the specimen's upper face plus the nominal sheet thickness at points.

    Parameters
    ----------
    depth_mm : travel of the press after first contact
    points_mm : (..., xyz), world; only x and y are used

    Returns
    -------
    (...) world z, mm; -inf outside the outline of the specimen
    """
    shape = shape_of(experiment.specimen)
    x_low, x_high, y_low, y_high = shape.bounds_mm()
    x_mm, y_mm = np.arange(x_low, x_high, _GRID_MM), np.arange(y_low, y_high, _GRID_MM)
    fall = shape.height_above_lowest(x_mm, y_mm)
    x, y = points_mm[..., 0], points_mm[..., 1]
    raised_mm = depth_mm - fall[_nearest(y_mm, y), _nearest(x_mm, x)]
    outside = (x < x_low) | (x > x_high) | (y < y_low) | (y > y_high)
    return np.where(outside, -np.inf, raised_mm)


def _nearest(grid_mm: FloatArray, values: FloatArray) -> NDArray[np.int64]:
    step = grid_mm[1] - grid_mm[0]
    number = np.rint((values - grid_mm[0]) / step).astype(np.int64)
    clipped: NDArray[np.int64] = np.clip(number, 0, grid_mm.size - 1)
    return clipped


def _good(measured_mm: FloatArray, true_mm: FloatArray, limit_um: float) -> Mask:
    return np.asarray(np.abs(measured_mm - true_mm) <= 1e-3 * limit_um)


def _share(good: Mask, required: Mask) -> float | None:
    return share_of(int((good & required).sum()), int(required.sum()))


def files_for_figures(done: Measurement) -> Callable[[Path], None]:
    """Compute completeness and panel data of a measurement; return a function that writes them.

    The function writes into a given folder. Measurements of other cases do not read these files.
    """
    panels, completeness = panel_data_of(done), asdict(counted(done))

    def write(folder: Path) -> None:
        write_json(folder / COMPLETENESS_FILE, completeness)
        write_panel_data(folder / PANELS_FOLDER, panels)

    return write


def shares_of(measured: Measurement) -> dict[str, Any]:
    """Return the completeness of a measurement as values with names "share_..."."""
    return {f"share_{name}": value for name, value in asdict(counted(measured)).items()}


def counted(measured: Measurement) -> Completeness:
    """Return the completeness of a measurement by any method."""
    points = measured.points
    points_mm = points.world_mm.astype(np.float64)
    return completeness_of(
        measured.experiment, measured.truth, points_mm, points.valid, measured.pressed
    )


def completeness_table(cases: Path) -> Table:
    """Return the completeness table, with one row per folder NAME/METHOD in `cases`."""
    rows: list[dict[str, Cell]] = []
    for file in sorted(cases.glob(f"*/*/{COMPLETENESS_FILE}")):
        content = read_json(file)
        row: dict[str, Cell] = {key: content[key] for key in _KEYS}
        name, method = file.parent.parent.name, file.parent.name
        rows.append({"specimen_name": name, "method": method, **row})
    return Table(
        "completeness",
        "Share of the specimen with good points",
        "Figure: direct FPP and contact-FPP",
        (
            Column("specimen_name", "specimen"),
            Column("method", "method"),
            Column("specimen", "of the specimen, good"),
            Column("specimen_points", "of the specimen, any point"),
            Column("contact", "of the contact region, good"),
            Column("contact_points", "of the contact region, any point"),
            Column("limit_um", "good within, um", 0),
        ),
        tuple(rows),
        (
            "Direct FPP is compared with the specimen's own surface. Contact methods are compared "
            "with the coat over the contact region, and with the specimen's surface raised by the "
            "nominal sheet thickness: pixels missing there are not touched, or their shape is not "
            "transferred through the sheet.",
        ),
    )
