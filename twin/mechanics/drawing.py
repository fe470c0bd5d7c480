"""Draw a pressed elastomer: height of the coat, pressure, and a section with both faces."""

from typing import TYPE_CHECKING

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.cells import CellMeans
from reconstruction.drawing import Drawing, draw_cells, draw_section

if TYPE_CHECKING:
    from twin.mechanics.press import PressedElastomer


def press_drawing(pressed: "PressedElastomer") -> Drawing:
    """Draw maps of the coated face and of the touched face's pressure, and the section at y = 0."""
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
    """Return values (row, col) on a regular grid as cells of a picture.

    Rows of `values` are in ascending order of y; the first row of the picture has the largest y.
    """
    everywhere = np.ones(values.shape, dtype=bool)
    return CellMeans(x_mm, y_mm[::-1], values[::-1], everywhere, float(x_mm[1] - x_mm[0]))
