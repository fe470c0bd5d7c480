"""Completeness: share of the pixels of a specimen with a good point.

A point is good if the error of its height is at most `score.good_within_um`. Two sets of required
pixels are evaluated. Contact: pixels of the contact region; the true height is that of the coat.
Specimen: pixels within its outline in the top view; the true height is its upper face raised by the
sheet's nominal thickness. Without contact (direct FPP) the true height is that of the specimen's
surface at the pixel.
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
    """Shares of the required pixels; None if no such pixel is in the camera's view.

    Attributes
    ----------
    contact : good points on the contact region, against the coat; None without contact
    contact_points : good or bad points there; None without contact
    specimen : good points on the specimen, against its own face
    specimen_points : good or bad points there
    limit_um : largest error of a good point's height
    """

    contact: float | None
    contact_points: float | None
    specimen: float | None
    specimen_points: float | None
    limit_um: float

    @property
    def missing(self) -> float | None:
        """Share of the specimen without any point."""
        return None if self.specimen_points is None else 1.0 - self.specimen_points


def completeness_of(
    experiment: Experiment,
    truth: Truth,
    points_mm: FloatArray,
    valid: Mask,
    pressed: PressedElastomer | None,
) -> Completeness:
    """Return the measured shares of specimen and contact region.

    Parameters
    ----------
    experiment : Experiment
    truth : true surface at every pixel
    points_mm : (row, col, xyz) float, world; measured points
    valid : (row, col) bool
    pressed : None without contact (direct FPP)
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
    """Return a mask of the points, (..., xyz) world, over cells that touch the specimen."""
    col = _nearest(pressed.x_mm, points_mm[..., 0])
    row = _nearest(pressed.y_mm, points_mm[..., 1])
    return np.asarray(pressed.contact[row, col])


def specimen_height_mm(
    experiment: Experiment, depth_mm: float, points_mm: FloatArray
) -> FloatArray:
    """Return the height of the specimen's upper face at points, (...), plus sheet thickness.

    World z, mm, of a sheet of nominal thickness on the specimen; -inf outside the outline.
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

    No other case reads these files.
    """
    panels, completeness = panel_data_of(done), asdict(counted(done))

    def write(folder: Path) -> None:
        write_json(folder / COMPLETENESS_FILE, completeness)
        write_panel_data(folder / PANELS_FOLDER, panels)

    return write


def shares_of(measured: Measurement) -> dict[str, Any]:
    """Return the completeness of a measurement as further figures of it."""
    return {f"share_{name}": value for name, value in asdict(counted(measured)).items()}


def counted(measured: Measurement) -> Completeness:
    """Return the completeness of a measurement by any method."""
    points = measured.points
    points_mm = points.world_mm.astype(np.float64)
    return completeness_of(
        measured.experiment, measured.truth, points_mm, points.valid, measured.pressed
    )


def completeness_table(cases: Path) -> Table:
    """Return one row per case in a folder of cases, NAME/METHOD."""
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
