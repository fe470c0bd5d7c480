"""How much of a specimen a method shows, in pixels of its camera.

A point counts when its height errs by no more than `score.good_within_um`. Against the relief, the
coat over the contact region is asked for, and the truth is the coat. Against the specimen, every
pixel within its outline seen from above is asked for, and the truth is its upper face: a contact
method reads it off the coat, as if the sheet lay on it with its own thickness everywhere. Seen
directly, the truth is what the pixel shows of the specimen.
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
    """Shares of the pixels asked for.

    Attributes
    ----------
    contact : of the contact region, against the coat; None where nothing is pressed, or where the
        camera sees nothing of it, as for all shares
    contact_points : points there, right or wrong; None likewise
    specimen : of the specimen, against its own face
    specimen_points : points there, right or wrong
    limit_um : what a good point's height may err
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
    """Return what share of specimen and contact region was measured.

    Parameters
    ----------
    experiment : Experiment
    truth : what every pixel shows
    points_mm : (row, col, xyz) float, world; measured points
    valid : (row, col) bool
    pressed : None where the bare specimen is seen
    """
    limit_um = experiment.score.good_within_um
    true = truth.points_world_mm.astype(np.float64)
    if pressed is None:
        asked = truth.measured
        good = _good(points_mm[..., 2], true[..., 2], limit_um) & valid
        return Completeness(None, None, _share(good, asked), _share(valid, asked), limit_um)
    region = truth.measured & in_contact(pressed, true)
    on_coat = _good(points_mm[..., 2], true[..., 2], limit_um) & valid
    z_mm = specimen_height_mm(experiment, pressed.depth_mm, true)
    asked = truth.measured & np.isfinite(z_mm)
    on_face = _good(points_mm[..., 2], z_mm, limit_um) & valid
    return Completeness(
        _share(on_coat, region),
        _share(valid, region),
        _share(on_face, asked),
        _share(valid, asked),
        limit_um,
    )


def in_contact(pressed: PressedElastomer, points_mm: FloatArray) -> Mask:
    """Tell which points, (..., xyz) world, lie over cells that touch the specimen."""
    col = _nearest(pressed.x_mm, points_mm[..., 0])
    row = _nearest(pressed.y_mm, points_mm[..., 1])
    return np.asarray(pressed.contact[row, col])


def specimen_height_mm(
    experiment: Experiment, depth_mm: float, points_mm: FloatArray
) -> FloatArray:
    """Return the specimen's upper face under points, (...), raised by the sheet it lies under.

    World z of a sheet that lies on the specimen with its own thickness; -inf beside the outline.
    """
    shape = shape_of(experiment.specimen)
    x_low, x_high, y_low, y_high = shape.bounds_mm()
    x_mm, y_mm = np.arange(x_low, x_high, _GRID_MM), np.arange(y_low, y_high, _GRID_MM)
    fall = shape.height_above_lowest(x_mm, y_mm)
    x, y = points_mm[..., 0], points_mm[..., 1]
    found = depth_mm - fall[_nearest(y_mm, y), _nearest(x_mm, x)]
    beside = (x < x_low) | (x > x_high) | (y < y_low) | (y > y_high)
    return np.where(beside, -np.inf, found)


def _nearest(grid_mm: FloatArray, values: FloatArray) -> NDArray[np.int64]:
    step = grid_mm[1] - grid_mm[0]
    number = np.rint((values - grid_mm[0]) / step).astype(np.int64)
    clipped: NDArray[np.int64] = np.clip(number, 0, grid_mm.size - 1)
    return clipped


def _good(found_mm: FloatArray, true_mm: FloatArray, limit_um: float) -> Mask:
    return np.asarray(np.abs(found_mm - true_mm) <= 1e-3 * limit_um)


def _share(of: Mask, asked: Mask) -> float | None:
    return share_of(int((of & asked).sum()), int(asked.sum()))


def files_for_figures(done: Measurement) -> Callable[[Path], None]:
    """Make completeness and panel data, which figures show of a measurement: returns their writer.

    Arrays of the measurement are nobody's input.
    """
    panels, completeness = panel_data_of(done), asdict(counted(done))

    def write(folder: Path) -> None:
        write_json(folder / COMPLETENESS_FILE, completeness)
        write_panel_data(folder / PANELS_FOLDER, panels)

    return write


def shares_of(seen: Measurement) -> dict[str, Any]:
    """Return the completeness of a measurement as further figures of it."""
    return {f"share_{name}": value for name, value in asdict(counted(seen)).items()}


def counted(seen: Measurement) -> Completeness:
    """Return the completeness of a measurement by any method."""
    points = seen.points
    points_mm = points.world_mm.astype(np.float64)
    return completeness_of(seen.experiment, seen.truth, points_mm, points.valid, seen.pressed)


def completeness_table(cases: Path) -> Table:
    """Return one row per case in a folder of cases, NAME/METHOD."""
    rows: list[dict[str, Cell]] = []
    for file in sorted(cases.glob(f"*/*/{COMPLETENESS_FILE}")):
        found = read_json(file)
        row: dict[str, Cell] = {key: found[key] for key in _KEYS}
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
            "Direct FPP is judged against the specimen's own surface. Contact methods are judged "
            "against the coat over the contact region, and against the specimen as if the sheet "
            "lay on it with its own thickness everywhere: what is missing there is not touched or "
            "not carried through the sheet.",
        ),
    )
