"""Present the object behind a coat as one line of text, a table with maps, and labelled arrays."""

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
"""Maps by name; each is an array (row, col) on the relief's cells, its unit and its long name."""


class PresentedObject:
    """Base class that gives every kind of `Compensated` a repr, a table, a figure and arrays."""

    @property
    def layer_maps(self) -> LayerMaps:
        """Further maps, by name, that exist only for this kind of layer; here none."""
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
        """Return a figure with maps of coat and contact pressure and a section of coat and object.

        Raises
        ------
        InputError : no cell was measured
        """
        return object_drawing(self)

    def to_xarray(self: "Compensated") -> "xarray.Dataset":
        """Return contact, pressure and both faces over world x and y, mm, as in file contact.nc."""
        return contact_arrays(self).to_xarray()


def in_short(rigid: "Compensated") -> dict[str, str]:
    """Return area, force and highest pressure of a contact as texts with units, by name."""
    return {
        "contact": f"{rigid.area_mm2:.3g} mm^2",
        "force": f"{rigid.force_n:.3g} N (standard uncertainty {rigid.force_sigma_n:.2g} N)",
        "highest pressure": f"{rigid.pressure_kpa.max():.3g} kPa",
    }


def object_drawing(rigid: "Compensated") -> "Drawing":
    """Return a drawing of the coat, the contact pressure, and a section of coat and object.

    The section is at world y = 0.

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
    """Return values and validity (row, col) of the relief's cells with row 0 at the largest y."""
    from reconstruction.cells import CellMeans

    relief = rigid.relief
    y_mm = relief.y_mm[::-1]
    return CellMeans(relief.x_mm, y_mm, values[::-1], valid[::-1], relief.pitch_mm[0])


def contact_arrays(rigid: "Compensated") -> LabelledArrays:
    """Return contact, contact pressure, coat and touched face as maps over world x and y.

    The maps that exist only for the kind of layer, such as the local thickness, are included.
    """
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
