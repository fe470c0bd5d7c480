"""Present height maps and printed dots as labelled arrays, and heights as pictures in mm."""

from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray, FloatImage, PhotometricReason
from reconstruction.errors import FitError
from reconstruction.markers import DotStatus
from reconstruction.netcdf import PIXELS, Labelled, LabelledArrays, pixel_coordinates

if TYPE_CHECKING:
    from reconstruction.cells import CellMeans
    from reconstruction.drawing import Drawing
    from reconstruction.photometric.height_map import HeightMap
    from reconstruction.photometric.printed_dots import GelMotion, GelMotionField

SLOPES = ("slope_row", "slope_col")


def height_arrays(height_map: "HeightMap") -> LabelledArrays:
    """Return height, mm, slopes, mm/mm, and reason codes as arrays over image row and column."""
    meaning = ("slope of the surface down the rows", "slope of the surface along the columns")
    variables: dict[str, Labelled] = {
        name: (PIXELS, values, {"units": "1", "long_name": long_name})
        for name, values, long_name in zip(SLOPES, height_map.slopes, meaning, strict=True)
    }
    height = {"units": "mm", "long_name": "height above the untouched surface"}
    variables["height_mm"] = (PIXELS, height_map.height_mm, height)
    codes = {
        "units": "1",
        "long_name": "reason why the height is no measurement; 0: it is one",
        "comment": "where it is not 0, slopes are estimates; heights are integrated over them",
        "flag_values": np.array([int(reason) for reason in PhotometricReason], np.uint8),
        "flag_meanings": " ".join(reason.name for reason in PhotometricReason),
    }
    variables["mask_reason"] = (PIXELS, height_map.mask_reason, codes)
    if height_map.rest is not None:
        for name, (values, meaning_of_rest) in height_map.rest.arrays().items():
            unit = "mm" if name.endswith("_mm") else "1"
            variables[name] = (PIXELS, values, {"units": unit, "long_name": meaning_of_rest})
    frame = "row 0 at the top; height is positive towards the camera"
    return LabelledArrays(
        variables,
        coords=pixel_coordinates(*height_map.height_mm.shape),
        attrs={"frame": frame, "pitch_mm": height_map.pitch_mm},
    )


def dot_arrays(motion: "GelMotion") -> LabelledArrays:
    """Return place, displacement, standard uncertainty and status of each printed dot."""
    tracks = motion.tracks
    pixels = {"place": tracks.places_px, "moved": tracks.moved_px, "sigma": tracks.sigma_px}
    lengths = {"place": motion.places_mm, "moved": motion.moved_mm, "sigma": motion.sigma_mm}
    meaning = {
        "place": "centre of the dot without contact",
        "moved": "displacement of the dot by the press; 0 for a dot that is LOST",
        "sigma": "standard uncertainty of the displacement; 0 for a dot that is LOST",
    }
    variables: dict[str, Labelled] = {}
    for name, long_name in meaning.items():
        for k, axis in enumerate(("row", "col")):
            attrs = {"units": "px", "long_name": f"{long_name}, along the image's {axis}s"}
            variables[f"{name}_{axis}_px"] = ("dot", pixels[name][:, k], attrs)
        for k, axis in enumerate("xy"):
            attrs = {"units": "mm", "long_name": f"{long_name}, along {axis}"}
            variables[f"{name}_{axis}_mm"] = ("dot", lengths[name][:, k], attrs)
    codes = {
        "units": "1",
        "long_name": "0: the displacement is a measurement",
        "flag_values": np.array([int(status) for status in DotStatus], np.uint8),
        "flag_meanings": " ".join(status.name for status in DotStatus),
    }
    variables["status"] = ("dot", tracks.status, codes)
    coords: dict[str, Labelled] = {
        "dot": ("dot", np.arange(len(tracks.status)), {"long_name": "number of the dot"})
    }
    with suppress(FitError):  # too few dots for a field
        of_field, places = _field_arrays(motion.field())
        variables, coords = variables | of_field, coords | places
    frame = "row 0 at the top; x right, y up, from the middle of the image"
    return LabelledArrays(variables, coords, {"frame": frame})


def _field_arrays(field: "GelMotionField") -> tuple[dict[str, Labelled], dict[str, Labelled]]:
    """Return the smooth field by name, and the coordinates of its grid."""
    dims = ("field_row", "field_col")
    variables: dict[str, Labelled] = {}
    for k, axis in enumerate("xy"):
        moved = {"units": "mm", "long_name": f"smooth field of the displacement along {axis}"}
        sigma = {"units": "mm", "long_name": f"standard uncertainty of field_{axis}_mm"}
        variables[f"field_{axis}_mm"] = (dims, field.moved_mm[..., k], moved)
        variables[f"field_sigma_{axis}_mm"] = (dims, field.sigma_mm[..., k], sigma)
    coords: dict[str, Labelled] = {
        name: (name, at, {"units": "px"})
        for name, at in zip(dims, (field.rows, field.cols), strict=True)
    }
    return variables, coords


def height_drawing(height_map: "HeightMap") -> "Drawing":
    """Return a drawing of heights, mm, steepness, degrees, and the section of the heights at y = 0.

    The origin of x and y is the middle of the image.

    Raises
    ------
    InputError : no pixel is valid
    """
    from reconstruction.drawing import Drawing, draw_cells, draw_section
    from reconstruction.errors import InputError

    if not height_map.valid.any():
        raise InputError("plot: found no valid pixel; look at the mask's reasons")
    heights = _cells(height_map, height_map.height_mm)
    steepness_deg = np.degrees(np.arctan(np.hypot(*height_map.slopes)))
    drawing = Drawing(3)
    panels = drawing.subplots(1, 3)
    draw_cells(panels[0], heights, "heights", "z (mm)")
    draw_cells(panels[1], _cells(height_map, steepness_deg), "steepness", "slope (deg)")
    draw_section(panels[2], {"measured": heights})
    return drawing


def places_mm(height_map: "HeightMap") -> tuple[FloatArray, FloatArray]:
    """Return x of the columns (col,), increasing, and y of the rows (row,), decreasing; mm.

    The origin is the middle of the image.
    """
    rows, cols = height_map.height_mm.shape
    x_mm = (np.arange(cols) - 0.5 * (cols - 1)) * height_map.pitch_mm
    return x_mm, (0.5 * (rows - 1) - np.arange(rows)) * height_map.pitch_mm


def _cells(height_map: "HeightMap", values: FloatArray | FloatImage) -> "CellMeans":
    from reconstruction.cells import CellMeans

    valid: BoolArray = height_map.valid
    x_mm, y_mm = places_mm(height_map)
    return CellMeans(x_mm, y_mm, values.astype(np.float64), valid, height_map.pitch_mm)
