"""The renderer's truth as netCDF-4, and radiance images as EXR."""

from pathlib import Path

import h5netcdf
import numpy as np
from numpy.typing import NDArray

from reconstruction.errors import InputError
from reconstruction.machine import write_exr_channels, writing_netcdf
from twin.optics.stack import Truth

_VARIABLES = {
    "x_mm": ("mm", "world x of the surface point behind the pixel centre"),
    "y_mm": ("mm", "world y of the surface point behind the pixel centre"),
    "z_mm": ("mm", "world z of the surface point behind the pixel centre"),
    "normal_x": ("1", "world x of the surface normal there"),
    "normal_y": ("1", "world y of the surface normal there"),
    "normal_z": ("1", "world z of the surface normal there"),
    "depth_mm": ("mm", "distance from the camera along its optical axis"),
    "column_px": ("px", "projector column of that point"),
    "row_px": ("px", "projector row of that point"),
    "lit": ("1", "1 where camera and projector both see the point"),
    "measured": ("1", "1 on the coat or the specimen, 0 on the stage and where nothing is"),
}


def write_truth(path: Path, truth: Truth) -> None:
    """Write the truth as netCDF-4, one (row, col) variable each."""
    maps = (
        *np.moveaxis(truth.points_world_mm, -1, 0),
        *np.moveaxis(truth.normals_world, -1, 0),
        truth.depth_mm,
        truth.column_px,
        truth.row_px,
        truth.lit.astype(np.uint8),
        truth.measured.astype(np.uint8),
    )
    with writing_netcdf(path) as file:
        file.attrs["frame"] = "world: z = 0 is the undeformed coated face, z up; row 0 at the top"
        file.dimensions = dict(zip(("row", "col"), truth.lit.shape, strict=True))
        for (name, (units, long_name)), values in zip(_VARIABLES.items(), maps, strict=True):
            variable = file.create_variable(
                name, ("row", "col"), data=values, compression="gzip", compression_opts=1
            )
            variable.attrs["units"] = units
            variable.attrs["long_name"] = long_name


def read_truth(path: Path) -> Truth:
    """Read what `write_truth` wrote.

    Raises
    ------
    InputError
        The file is missing, damaged or something else.
    """
    try:
        with h5netcdf.File(path, "r") as file:
            maps = [file[name][...] for name in _VARIABLES]
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; render or measure first") from None
    except (OSError, KeyError) as error:
        raise InputError(f"{path}: damaged or no truth file ({error}); render again") from None
    points, normals = np.stack(maps[:3], axis=-1), np.stack(maps[3:6], axis=-1)
    depth_mm, column_px, row_px, lit, measured = maps[6:]
    masks = lit.astype(bool), measured.astype(bool)
    return Truth(points, normals, depth_mm, column_px, row_px, *masks)


def write_exr(path: Path, image: NDArray[np.float32]) -> None:
    """Write a (row, col) float32 image as a one-channel EXR."""
    write_exr_channels(path, {"Y": image})
