"""A short bar that sheet and solid elements both press: neither round nor in plane strain.

2 x 5 mm with edges of 0.5 mm under a clamped sheet of 10 x 10 mm. Frame of the sheet; mm.
"""

from dataclasses import dataclass

import numpy as np

from tests.mechanics.sheets import FINE, finer_at_the_rim, laws, line
from twin.mechanics.sheet.energy import Bodies, Sheet, SheetState
from twin.mechanics.sheet.equilibrium import Accuracy, settle
from twin.mechanics.sheet.grid import Frame, sheet_grid
from twin.mechanics.sheet.path import Loads, follow, refined
from twin.mechanics.sheet.splines import SplineLine
from twin.specimens.distance import BoxDistance

FRAME_MM, POISSON_RATIO, EDGE_MM = 10.0, 0.499, 0.5
HALF_MM = (1.0, 2.5, 1.5)
SEEN_MM = 0.2


@dataclass(frozen=True)
class SpaceCase:
    """A thickness, its travels, and the allowed differences of sheet and solids."""

    name: str
    thickness_mm: float
    travels_mm: tuple[float, ...]
    #: upper face at each travel, um, and force, relative
    limits_um: tuple[float, ...]
    force_limit: float


CASES = (
    SpaceCase("bar_h0.2", 0.2, (0.5, 1.0), (3.0, 8.0), 0.01),
    SpaceCase("bar_h0.5", 0.5, (0.5, 1.0), (12.0, 25.0), 0.04),
)


def bar() -> Bodies:
    """Return the bodies that touch at travel 0."""
    middle = np.array([0.0, 0.0, -HALF_MM[2]])
    return Bodies((BoxDistance(middle, np.eye(3), np.array(HALF_MM), EDGE_MM),))


def seen_at() -> tuple[np.ndarray, np.ndarray]:
    """Return the points (row, col) of one quarter where faces are compared."""
    along = np.arange(0, FRAME_MM / 2 - 1e-9, SEEN_MM)
    x, y = np.meshgrid(along, along)
    return x, y


def wrapped(case: SpaceCase, travel_mm: float, cell_mm: float) -> tuple[Sheet, SheetState]:
    """Press the sheet as the product does, coarse cells first."""
    half = FRAME_MM / 2
    coarse = _sheet(case, line(half, 3.2, 0.4))
    there = follow(coarse, Loads(travel_mm), Accuracy(step_mm=1e-3, residual_kpa=0.1))
    fine = _sheet(case, finer_at_the_rim(line(half, 3.2, cell_mm), cell_mm))
    return fine, settle(fine, refined(coarse, fine, there), FINE)


def _sheet(case: SpaceCase, places: SplineLine) -> Sheet:
    law = laws(case.thickness_mm)
    grid = sheet_grid(Frame(FRAME_MM, FRAME_MM), places, places)
    return Sheet(grid, law, bar(), -law.thickness_mm / 2)
