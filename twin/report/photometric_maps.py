"""Maps of photometric stereo in mm on the coat: image, slopes, heights and errors by decoder.

The image is a regular grid on the coat: x grows to the right, y upwards, the middle is the origin.
"""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import MultipleLocator
from numpy.typing import NDArray

from twin.report.canvas import (
    INK,
    add_colorbar,
    axes_at,
    diverging,
    drawing,
    height_scale,
    round_up,
    symmetric_limit,
)
from twin.report.relief import shaded
from twin.report.world_map import WorldMap
from twin.results.decoders import MAP_ORDER, DecodedImage
from twin.results.record import Measurement
from twin.results.score import wanted_pixels

MAP_NAMES = {"polynomial": "polynomial", "table": "look-up table"}
INTEGRATION_NAMES = {"corrected": "corrected", "sdk_2025": "vendor 2025", "sdk_2024": "vendor 2024"}
DIFFERENCE_GAIN = 2

_WIDTH_IN, _LEFT_IN, _TOP_IN, _GAP_IN, _BELOW_IN = 10.0, 0.5, 0.32, 0.14, 0.65
_BETWEEN_IN = 0.25  # tick labels of the upper line
_RELIEF_SHARE, _TICKS_MM = 0.2, 4.0
_Masked = Any


def decoder_name(one: DecodedImage) -> str:
    """Name a decoder as figures and tables do."""
    return f"{MAP_NAMES[one.colour_map]}, {INTEGRATION_NAMES[one.integration]}"


def extent_mm(seen: Measurement) -> tuple[float, float, float, float]:
    """Outline of the image on the coat: left, right, bottom, top."""
    rows, cols = seen.picture.shape[:2]
    half_x, half_y = (
        cols * seen.colours.calibration.pitch_mm / 2,
        rows * seen.colours.calibration.pitch_mm / 2,
    )
    return (-half_x, half_x, -half_y, half_y)


def true_heights_mm(seen: Measurement) -> _Masked:
    """World z of the true coat behind each pixel, (row, col) masked."""
    z_mm = seen.truth.points_world_mm[..., 2].astype(np.float64)
    return np.ma.masked_array(z_mm, ~seen.truth.measured)


def error_um(seen: Measurement, one: DecodedImage) -> _Masked:
    """Measured minus true world z in the evaluated field, (row, col) masked."""
    scored = wanted_pixels(seen.experiment, seen.truth) & one.heights.valid
    difference = one.heights.height_mm - true_heights_mm(seen).data
    return np.ma.masked_array(1e3 * difference, ~scored)


def true_slopes(seen: Measurement) -> NDArray[np.float64]:
    """Slopes of the true coat behind each pixel, (2, row, col), down and to the right."""
    normals = seen.truth.normals_world.astype(np.float64)
    upward = np.where(np.abs(normals[..., 2]) > 1e-6, normals[..., 2], 1.0)
    # World y points up, rows count down.
    return np.stack([normals[..., 1] / upward, -normals[..., 0] / upward])


def difference_levels(seen: Measurement) -> NDArray[np.uint8]:
    """Image minus background, enlarged, about mid-grey."""
    change = seen.picture - seen.colours.calibration.background.astype(np.float64)
    return np.rint(np.clip(128 + DIFFERENCE_GAIN * change, 0, 255)).astype(np.uint8)


def draw_images(path: Path, seen: Measurement) -> None:
    """Draw tactile image, background and their difference, as PNG.

    Raises
    ------
    InputError
        `path` cannot be written.
    """
    background = np.rint(seen.colours.calibration.background).astype(np.uint8)
    pictures = {
        "tactile image": seen.picture,
        "untouched gel (background)": background,
        f"difference × {DIFFERENCE_GAIN}, grey is none": difference_levels(seen),
    }
    panel_in, height_in = _panel(seen, 3)
    with drawing(path, _WIDTH_IN, _TOP_IN + height_in + 0.5) as figure:
        for number, (title, picture) in enumerate(pictures.items()):
            axes = _axes(figure, number, _TOP_IN, panel_in, height_in)
            axes.imshow(picture, extent=extent_mm(seen))
            axes.set(title=title, xlabel="x (mm)", ylabel="" if number else "y (mm)")
            _mark_field(axes, seen)


def draw_slopes(path: Path, seen: Measurement) -> None:
    """Draw measured and true slopes and their difference, both directions, as PNG.

    Raises
    ------
    InputError
        `path` cannot be written.
    """
    measured, true = seen.colours.own.heights.slopes.astype(np.float64), true_slopes(seen)
    limit = symmetric_limit(true, 99.5)
    error_limit = symmetric_limit(measured - true, 99.0)
    panel_in, height_in = _panel(seen, 3)
    line_in = _TOP_IN + height_in + _BETWEEN_IN
    with drawing(path, _WIDTH_IN, 2 * line_in + _BELOW_IN) as figure:
        for line, (name, at) in enumerate((("to the right", 1), ("downwards", 0))):
            shown = (
                (f"measured, {name}", measured[at], limit),
                (f"true, {name}", true[at], limit),
                ("measured − true", measured[at] - true[at], error_limit),
            )
            for number, (title, values, end) in enumerate(shown):
                axes = _axes(figure, number, line * line_in + _TOP_IN, panel_in, height_in)
                mapped = _map(axes, seen, values, end)
                axes.set(title=title)
                if line:
                    add_colorbar(axes, mapped, "slope (mm/mm)", extend="both", side="below")


def draw_heights(path: Path, seen: Measurement) -> None:
    """Draw the true heights and those of every decoder, shaded, on one scale, as PNG.

    Raises
    ------
    InputError
        `path` cannot be written.
    """
    norm = Normalize(*height_scale(true_heights_mm(seen).compressed()))
    panel_in, height_in = _panel(seen, 4)
    line_in = _TOP_IN + height_in + _BETWEEN_IN
    lines = _lines(seen)
    with drawing(path, _WIDTH_IN, len(lines) * line_in) as figure:
        for line, decoders in enumerate(lines):
            top_in = line * line_in + _TOP_IN
            if not line:
                axes = _axes(figure, 0, top_in, panel_in, height_in)
                show_heights(axes, seen, true_heights_mm(seen), norm)
                axes.set(title="true coat")
                bar = ScalarMappable(norm, "viridis")
                add_colorbar(axes, bar, "z (mm)", extend="both", side="below")
            for number, one in enumerate(decoders, start=1):
                axes = _axes(figure, number, top_in, panel_in, height_in)
                show_heights(axes, seen, measured_heights_mm(one), norm)
                axes.set(title=decoder_name(one))


def draw_errors(path: Path, seen: Measurement) -> None:
    """Draw the height error of every decoder on one scale, as PNG.

    Raises
    ------
    InputError
        `path` cannot be written.
    """
    errors = {id(one): error_um(seen, one) for one in seen.colours.decoded}
    limit_um = round_up(
        max(float(np.percentile(np.abs(e.compressed()), 95)) for e in errors.values())
    )
    panel_in, height_in = _panel(seen, 3)
    line_in = _TOP_IN + height_in + _BETWEEN_IN
    lines = _lines(seen)
    with drawing(path, _WIDTH_IN, len(lines) * line_in + _BELOW_IN) as figure:
        for line, decoders in enumerate(lines):
            for number, one in enumerate(decoders):
                axes = _axes(figure, number, line * line_in + _TOP_IN, panel_in, height_in)
                shown = _map(axes, seen, errors[id(one)], limit_um)
                axes.set(title=f"{decoder_name(one)}: {one.errors.z_rmse_um:.1f} µm RMS")
                if line == len(lines) - 1:
                    add_colorbar(axes, shown, "z error (µm)", extend="both", side="below")


def measured_heights_mm(one: DecodedImage) -> _Masked:
    """Heights of one decoder, (row, col); masked where they are no measurement."""
    return np.ma.masked_array(one.heights.height_mm.astype(np.float64), ~one.heights.valid)


def show_heights(axes: Axes, seen: Measurement, z_mm: _Masked, norm: Normalize) -> None:
    """Show heights, coloured and shaded; what is masked stays white."""
    rows, cols = z_mm.shape
    pitch_mm = seen.colours.calibration.pitch_mm
    relief = WorldMap(z_mm[::-1], pitch_mm * np.arange(cols), pitch_mm * np.arange(rows), pitch_mm)
    axes.imshow(shaded(relief, norm, enlargement(seen))[::-1], extent=extent_mm(seen))


def enlargement(seen: Measurement) -> float:
    """Return by how much shading enlarges z: a round number, at least 1."""
    low, high = height_scale(true_heights_mm(seen).compressed())
    left, right, *_ = extent_mm(seen)
    return max(1.0, round_up(_RELIEF_SHARE * (right - left) / (high - low)))


def _lines(seen: Measurement) -> list[list[DecodedImage]]:
    lines = [[one for one in seen.colours.decoded if one.colour_map == kind] for kind in MAP_ORDER]
    return [line for line in lines if line]


def _panel(seen: Measurement, count: int) -> tuple[float, float]:
    """Width and height of one of `count` maps side by side, inches."""
    rows, cols = seen.picture.shape[:2]
    width_in = (_WIDTH_IN - _LEFT_IN - count * _GAP_IN) / count
    return width_in, width_in * rows / cols


def _axes(figure: Figure, number: int, top_in: float, width_in: float, height_in: float) -> Axes:
    left_in = _LEFT_IN + number * (width_in + _GAP_IN)
    axes = axes_at(figure, left_in, top_in, width_in, height_in)
    axes.tick_params(labelleft=number == 0)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MultipleLocator(_TICKS_MM))
    return axes


def _map(axes: Axes, seen: Measurement, values: Any, limit: float) -> Any:
    return axes.imshow(values, extent=extent_mm(seen), cmap=diverging(), vmin=-limit, vmax=limit)


def _mark_field(axes: Axes, seen: Measurement) -> None:
    """Outline the part of the coat that is evaluated."""
    size = seen.experiment.photometric
    corner = (-size.field_x_mm / 2, -size.field_y_mm / 2)
    for colour, width, style in (("white", 1.4, "-"), (INK, 0.7, (0, (6, 4)))):
        axes.add_patch(
            Rectangle(
                corner, size.field_x_mm, size.field_y_mm, fill=False, ec=colour, lw=width, ls=style
            )
        )
