"""Derivatives of a press by numbers of the experiment: as data, as a file, as figures."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.netcdf import Labelled, LabelledArrays, write_arrays
from twin.mechanics import PressedElastomer


@dataclass(frozen=True, eq=False)
class PressDerivative:
    """Derivatives by one number, per unit of it.

    Attributes
    ----------
    path : of the number, dotted
    face_z : (row, col) of the smooth coated face's height, mm, at fixed world x and y
    figures : of those figures of the press that are numbers
    """

    path: str
    face_z: FloatArray
    figures: dict[str, float]


def derivative_metrics(derivatives: Sequence[PressDerivative]) -> dict[str, float]:
    """Return the derivatives of a press's figures as NAME_by_PATH, per unit of each number."""
    return {
        f"{name}_by_{derivative.path}": value
        for derivative in derivatives
        for name, value in derivative.figures.items()
    }


def write_derivatives(
    path: Path, pressed: PressedElastomer, derivatives: Sequence[PressDerivative]
) -> None:
    """Write how the smooth coated face moves with each number, over its nodes, as netCDF-4."""
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
