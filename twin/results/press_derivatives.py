"""Derivatives of a press with respect to fields of the experiment: maps, files and figures."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.netcdf import Labelled, LabelledArrays, write_arrays
from twin.mechanics import PressedElastomer


@dataclass(frozen=True, eq=False)
class PressDerivative:
    """Derivatives of a press with respect to one field, per unit of the field.

    Attributes
    ----------
    path : dotted path of the field
    face_z : (row, col) derivative of the height of the smooth coated face, mm, at fixed world x
        and y
    figures : derivatives of the numerical figures of the press, by name
    """

    path: str
    face_z: FloatArray
    figures: dict[str, float]


def derivative_metrics(derivatives: Sequence[PressDerivative]) -> dict[str, float]:
    """Return the derivatives of a press's figures, named NAME_by_PATH, per unit of the field."""
    return {
        f"{name}_by_{derivative.path}": value
        for derivative in derivatives
        for name, value in derivative.figures.items()
    }


def write_derivatives(
    path: Path, pressed: PressedElastomer, derivatives: Sequence[PressDerivative]
) -> None:
    """Write the derivatives of the smooth coated face's height at its nodes as netCDF-4."""
    maps: dict[str, Labelled] = {
        f"face_z_by_{derivative.path}": (
            ("face_y", "face_x"),
            derivative.face_z.astype(np.float32),
            {
                "units": f"mm per unit of {derivative.path}",
                "long_name": f"derivative of the coated face's height by {derivative.path}",
            },
        )
        for derivative in derivatives
    }
    nodes: dict[str, Labelled] = {
        f"face_{axis}": (
            f"face_{axis}",
            values,
            {"units": "mm", "long_name": f"world {axis} of the coated face's nodes"},
        )
        for axis, values in (("x", pressed.face_x_mm), ("y", pressed.face_y_mm))
    }
    write_arrays(path, LabelledArrays(maps, nodes, {"Conventions": "CF-1.11"}))
