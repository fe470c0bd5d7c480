"""A pressed elastomer in pictures: the coat, the pressure, a section with both faces."""

from typing import TYPE_CHECKING

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.cells import CellMeans
from reconstruction.drawing import Drawing, draw_cells, draw_section

if TYPE_CHECKING:
    from twin.mechanics.press import PressedElastomer


def press_drawing(pressed: "PressedElastomer") -> Drawing:
    """Return the coated face, the pressure on the touched one, and the section at y = 0."""
    drawing = Drawing(3)
    panels = drawing.subplots(1, 3)
    coat = _on_nodes(pressed.face_x_mm, pressed.face_y_mm, pressed.face_z_mm)
    cells = pressed.x_mm, pressed.y_mm
    draw_cells(panels[0], coat, "coated face", "z (mm)")
    draw_cells(panels[1], _on_nodes(*cells, pressed.pressure_kpa), "pressure", "kPa")
    touched = _on_nodes(*cells, pressed.touched_face_mm)
    draw_section(panels[2], {"coated face": coat, "touched face": touched})
    return drawing


def _on_nodes(x_mm: FloatArray, y_mm: FloatArray, values: FloatArray) -> CellMeans:
    """Return values on a regular grid, (row along y ascending, col), as cells of a picture."""
    everywhere = np.ones(values.shape, dtype=bool)
    return CellMeans(x_mm, y_mm[::-1], values[::-1], everywhere, float(x_mm[1] - x_mm[0]))
