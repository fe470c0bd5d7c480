"""Sheets that the tests press without the product's path: one grid, few cells.

The sheet's frame: z = 0 midway between the undeformed faces; mm, kPa.
"""

from dataclasses import replace

import numpy as np

from twin.config.models import Elastomer, Mechanics, Press, Specimen
from twin.mechanics import PressedElastomer
from twin.mechanics.sheet.energy import Bodies, Sheet
from twin.mechanics.sheet.equilibrium import Accuracy
from twin.mechanics.sheet.grid import Frame, sheet_grid
from twin.mechanics.sheet.laws import Laws
from twin.mechanics.sheet.press import press_sheet
from twin.mechanics.sheet.splines import SplineLine, graded_line
from twin.specimens.distance import BallDistance, BoxDistance, CylinderDistance, plate

YOUNG_KPA = 300.0
# Rounding causes some 1e-4 kPa on cells of 0.05 mm.
EXACT = Accuracy(step_mm=1e-7, residual_kpa=1e-3)
FINE = Accuracy(residual_kpa=2e-3)
NOTHING = Bodies((plate(-50.0),))


def build_sheet(**changes: object) -> Elastomer:
    """Return a sheet of 0.3 mm and 300 kPa in a frame of 20 x 20 mm."""
    values: dict[str, object] = {
        "thickness_mm": 0.3,
        "length_x_mm": 20.0,
        "length_y_mm": 20.0,
        "young_modulus_kpa": YOUNG_KPA,
        "poisson_ratio": 0.49,
    }
    return Elastomer.model_validate(values | changes)


def pressed(
    specimen: Specimen, elastomer: Elastomer, support: str | None = None, **load: object
) -> PressedElastomer:
    """Press by depth, or by force if there is one; relief and cells coarse unless given."""
    control = "force" if "force_n" in load else "depth"
    values = {"control": control, "relief_pitch_mm": 0.05, "cell_mm": 0.3} | load
    mechanics = Mechanics.model_validate({"model": "sheet", "support": support})
    return press_sheet(specimen, elastomer, Press.model_validate(values), mechanics)


def laws(thickness_mm: float, **changes: float) -> Laws:
    """Return the model's laws: contact compresses half a thickness, friction shears a whole one."""
    h, e = thickness_mm, YOUNG_KPA
    made = Laws(h, e / 3, e / 0.75 / (0.25 * h), e / 3 / (0.5 * h), 0.0, 0.08, 0.0, 0.0)
    return made._replace(**changes)


def round_sheet(
    law: Laws,
    bodies: Bodies,
    line: SplineLine,
    sticks: bool = False,
    **frame: object,
) -> Sheet:
    """Return a round sheet with `line` as both parameter lines."""
    diameter = float(line.edges[-1] - line.edges[0])
    held = Frame(diameter, diameter, "round", **frame)
    return Sheet(sheet_grid(held, line, line), law, bodies, -law.thickness_mm / 2, sticks)


def strip(
    law: Laws,
    bodies: Bodies,
    line: SplineLine,
    sticks: bool = False,
    rim: str = "clamped",
) -> Sheet:
    """Return a sheet in plane strain: free to move along x and z only, vastly long along y."""
    span = float(line.edges[-1] - line.edges[0])
    frame = Frame(span, 3000.0, "rectangular", rim)
    grid = sheet_grid(frame, line, SplineLine(np.linspace(-1500.0, 1500.0, 4)))
    free = np.zeros_like(grid.free)
    free[:, 1:-1, 0] = True
    ends = 2 if rim == "clamped" else 1
    free[:, ends:-ends, 2] = True
    held = replace(grid, free=free)
    return Sheet(held, law, bodies, -law.thickness_mm / 2, sticks)


def ball(radius_mm: float = 4.0) -> Bodies:
    """Return a ball that touches at travel 0."""
    return Bodies((BallDistance((0.0, 0.0, -radius_mm), radius_mm),))


def bar(width_mm: float, edge_mm: float, height_mm: float = 3.0) -> Bodies:
    """Return a bar along y, beyond the ends of the strip, that touches at travel 0."""
    half = np.array([width_mm / 2, 2000.0, height_mm / 2])
    return Bodies((BoxDistance(np.array([0.0, 0.0, -height_mm / 2]), np.eye(3), half, edge_mm),))


def rod(radius_mm: float) -> Bodies:
    """Return a rod along y, beyond the ends of the strip, that touches at travel 0."""
    middle, along = np.array([0.0, 0.0, -radius_mm]), np.array([0.0, 1.0, 0.0])
    return Bodies((CylinderDistance(middle, along, radius_mm, 2000.0, 0.1),))


def line(half_mm: float, fine_mm: float, pitch_mm: float) -> SplineLine:
    """Return the product's cells: of `pitch_mm` up to `fine_mm`, wider beyond."""
    return graded_line((-half_mm, half_mm), (-fine_mm, fine_mm), pitch_mm, pitch_mm / 3, 1.0)


def finer_at_the_rim(places: SplineLine, pitch_mm: float) -> SplineLine:
    """Halve the last cells until they are no wider than `pitch_mm`: steep there under pressure."""
    edges = places.edges
    while edges[1] - edges[0] > pitch_mm:
        middles = (edges[:2].mean(), edges[-2:].mean())
        edges = np.concatenate((edges[:1], middles[:1], edges[1:-1], middles[1:], edges[-1:]))
    return SplineLine(edges)
