"""Presentation of the object behind a coat: one line, a table with maps, labelled arrays."""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.netcdf import Labelled, LabelledArrays

if TYPE_CHECKING:
    import xarray

    from reconstruction.cells import CellMeans
    from reconstruction.compensation.parts import Compensated
    from reconstruction.drawing import Drawing

LayerMaps = dict[str, tuple[NDArray[Any], str, str]]
"""Maps (row, col) on the relief's cells by name, each with unit and long name."""


class PresentedObject:
    """Repr, notebook table, figure and labelled arrays of every kind of `Compensated`."""

    @property
    def layer_maps(self) -> LayerMaps:
        """Maps that only this kind of layer has."""
        return {}

    def __repr__(self: "Compensated") -> str:
        rows, cols = self.contact.shape
        shown = ", ".join(f"{name} {value}" for name, value in in_short(self).items())
        cells = f"{rows} x {cols} cells of {self.relief.pitch_mm[0]:.3g} mm"
        return f"<{type(self).__name__}: {cells}, {shown}>"

    def _repr_html_(self: "Compensated") -> str:
        from reconstruction.drawing import as_html

        return as_html("object behind the coat", in_short(self), object_drawing(self))

    def plot(self: "Compensated") -> "Drawing":
        """Draw coat, contact pressure, and a section of coat and object: a Matplotlib figure.

        Raises
        ------
        InputError : no cell was measured
        """
        return object_drawing(self)

    def to_xarray(self: "Compensated") -> "xarray.Dataset":
        """Return contact, pressure and both faces over world x and y (mm), as contact.nc."""
        return contact_arrays(self).to_xarray()


def in_short(rigid: "Compensated") -> dict[str, str]:
    """Return the main figures of a contact as texts, by name."""
    return {
        "contact": f"{rigid.area_mm2:.3g} mm^2",
        "force": f"{rigid.force_n:.3g} N (standard uncertainty {rigid.force_sigma_n:.2g} N)",
        "highest pressure": f"{rigid.pressure_kpa.max():.3g} kPa",
    }


def object_drawing(rigid: "Compensated") -> "Drawing":
    """Return the measured coat, the pressure, and the section at y = 0 with the object.

    Raises
    ------
    InputError : no cell was measured
    """
    from reconstruction.drawing import Drawing, draw_cells, draw_section
    from reconstruction.errors import InputError

    relief = rigid.relief
    if not relief.measured.any():
        raise InputError("plot: found no measured cell of the coat")
    coat = _cells(rigid, relief.heights_mm, relief.measured)
    drawing = Drawing(3)
    panels = drawing.subplots(1, 3)
    draw_cells(panels[0], coat, "coat", "z (mm)")
    pressure = _cells(rigid, rigid.pressure_kpa, relief.inside)
    draw_cells(panels[1], pressure, "contact pressure", "pressure (kPa)")
    touched = _cells(rigid, rigid.object_mm[..., 2], rigid.contact)
    draw_section(panels[2], {"coat": coat, "object, in contact": touched})
    return drawing


def _cells(rigid: "Compensated", values: NDArray[Any], valid: NDArray[Any]) -> "CellMeans":
    """Return a map of the relief as cells of a picture, row 0 at the top."""
    from reconstruction.cells import CellMeans

    relief = rigid.relief
    y_mm = relief.y_mm[::-1]
    return CellMeans(relief.x_mm, y_mm, values[::-1], valid[::-1], relief.pitch_mm[0])


def contact_arrays(rigid: "Compensated") -> LabelledArrays:
    """Return contact, pressure, thickness and the clear face over world x and y."""
    clear = rigid.object_mm
    maps: LayerMaps = {
        "contact": (rigid.contact.astype(np.uint8), "1", "1 where the object carries the sheet"),
        "measured": (rigid.relief.measured.astype(np.uint8), "1", "1 where the coat was measured"),
        "coat_z_mm": (rigid.relief.heights_mm, "mm", "world z of the coat, gaps filled in"),
        "clear_x_mm": (clear[..., 0], "mm", "world x of the clear face, or the object"),
        "clear_y_mm": (clear[..., 1], "mm", "world y of the clear face, or the object"),
        "clear_z_mm": (clear[..., 2], "mm", "world z of the clear face, or the object"),
        "pressure_kpa": (rigid.pressure_kpa, "kPa", "of the contact, blurred at its edge"),
    }
    axes: dict[str, Labelled] = {
        name: (name, values, {"units": "mm", "long_name": f"world {name} of the cell's middle"})
        for name, values in (("x", rigid.relief.x_mm), ("y", rigid.relief.y_mm))
    }
    labelled: dict[str, Labelled] = {
        name: (("y", "x"), values, {"units": units, "long_name": long_name})
        for name, (values, units, long_name) in (maps | rigid.layer_maps).items()
    }
    attributes = {"Conventions": "CF-1.11", "force_n": rigid.force_n}
    return LabelledArrays(labelled, axes, attributes)
