"""Convert a pressed elastomer to labelled arrays: variables, dimensions and units of press.nc."""

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.netcdf import Labelled, LabelledArrays

if TYPE_CHECKING:
    from twin.mechanics.press import PressedElastomer, SheetFields

SCHEMA = "fringe-twin press 3"
AXES = ("x_mm", "y_mm", "face_x_mm", "face_y_mm")
VALIDITY = "validity_"
FACE = ("face_y", "face_x")

# field: (dimensions, units, long name)
VARIABLES: dict[str, tuple[tuple[str, ...], str, str]] = {
    "x_mm": (("x",), "mm", "world x of the solver cell centres"),
    "y_mm": (("y",), "mm", "world y of the solver cell centres"),
    "pressure_kpa": (("y", "x"), "kPa", "pressure on the touched face: force over area in plan"),
    "contact": (("y", "x"), "1", "1 where the specimen touches"),
    "touched_face_mm": (("y", "x"), "mm", "world z of the touched face"),
    "face_x_mm": (("face_x",), "mm", "world x of the coated face's nodes"),
    "face_y_mm": (("face_y",), "mm", "world y of the coated face's nodes"),
    "face_z_mm": (FACE, "mm", "world z of the coated face"),
    "force_n": ((), "N", "contact force"),
    "depth_mm": ((), "mm", "travel after first touch"),
    "young_modulus_kpa": ((), "kPa", "Young's modulus of the elastomer"),
    "iterations": ((), "1", "passes of the contact solver"),
    "converged": ((), "1", "1 when the contact solver converged"),
    "texture_mm": (FACE, "mm", "height of the coat's texture, included in face_z_mm"),
    "initial_force_n": ((), "N", "contact force at the end of the press"),
    "relief_change_um": (
        (),
        "um",
        "largest change of the coated face's heights since the end of the press",
    ),
}
OPTIONAL = {"texture_mm", "initial_force_n", "relief_change_um"}

# field of ShearFields: (dimensions, units, long name); stored after a slide only
SHEAR_VARIABLES: dict[str, tuple[tuple[str, ...], str, str]] = {
    "traction_x_kpa": (("y", "x"), "kPa", "tangential force along x over area, on the elastomer"),
    "traction_y_kpa": (("y", "x"), "kPa", "tangential force along y over area, on the elastomer"),
    "slip_x_mm": (("y", "x"), "mm", "travel of the specimen over the face along x"),
    "slip_y_mm": (("y", "x"), "mm", "travel of the specimen over the face along y"),
    "sticking": (("y", "x"), "1", "1 where the specimen sticks at the end of the slide"),
    "force_x_n": ((), "N", "tangential force along x on the elastomer"),
    "force_y_n": ((), "N", "tangential force along y on the elastomer"),
}

# field of SheetFields: units, long name; stored for sheets only, at the coated face's nodes
SHEET_VARIABLES: dict[str, tuple[str, str]] = {
    "thickness_mm": ("mm", "local thickness, along the coated face's normal"),
    "stretch_1": ("1", "larger principal stretch"),
    "stretch_2": ("1", "smaller principal stretch"),
    "material_x_mm": ("mm", "x on the mounted sheet of the material point at this node"),
    "material_y_mm": ("mm", "y on the mounted sheet of the material point at this node"),
}


def press_arrays(pressed: "PressedElastomer") -> LabelledArrays:
    """Return all fields of a press as labelled arrays.

    Coordinates are x and y (centres of the solver's cells) and face_x and face_y (nodes of the
    coated face), mm. The numbers of `Validity` are stored as attributes.
    """
    variables = {
        name: labelled(np.asarray(getattr(pressed, name)), *figures)
        for name, figures in VARIABLES.items()
        if name not in OPTIONAL or getattr(pressed, name) is not None
    }
    for name, data in _sheet_arrays(pressed.sheet).items():
        variables[f"sheet_{name}"] = labelled(data, FACE, *SHEET_VARIABLES[name])
    if pressed.shear is not None:
        for name, figures in SHEAR_VARIABLES.items():
            data = np.asarray(getattr(pressed.shear, name))
            variables[f"shear_{name}"] = labelled(data, *figures)
    axes = {name.removesuffix("_mm"): variables.pop(name) for name in AXES}
    validity = asdict(pressed.validity) | {"warnings": "\n".join(pressed.validity.warnings)}
    validity_figures = {VALIDITY + name: value for name, value in validity.items()}
    attributes = {"Conventions": "CF-1.11", "schema": SCHEMA, "model": pressed.model}
    return LabelledArrays(variables, axes, attributes | validity_figures)


def labelled(
    data: NDArray[Any], dimensions: tuple[str, ...], units: str, long_name: str
) -> Labelled:
    """Return an array with its dimensions, units and long name.

    A bool array is converted to int8, because netCDF-4 has no bool type.
    """
    stored = data.astype(np.int8) if data.dtype == bool else data
    return dimensions, stored, {"units": units, "long_name": long_name}


def _sheet_arrays(sheet: "SheetFields | None") -> dict[str, Any]:
    if sheet is None:
        return {}
    return {
        "thickness_mm": sheet.thickness_mm,
        "stretch_1": sheet.stretch[..., 0],
        "stretch_2": sheet.stretch[..., 1],
        "material_x_mm": sheet.material_x_mm,
        "material_y_mm": sheet.material_y_mm,
    }
