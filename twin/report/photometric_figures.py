"""Figures of photometric stereo: sensor, tactile image, slopes, heights, errors, section.

The image is a regular grid on the coat, in mm: x points right, y up, the origin is the middle.
"""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.patches import Polygon, Rectangle
from matplotlib.ticker import MultipleLocator
from scipy.interpolate import RegularGridInterpolator

from reconstruction.arrays import FloatArray, Levels
from reconstruction.colour_maps import maps_in_order
from reconstruction.integration_schemes import schemes_in_order
from twin.config.lamps import Lamp
from twin.config.models import Experiment
from twin.optics.lamps import emitters_of
from twin.pipeline.colour_images import image_pinhole
from twin.report.canvas import (
    FAINT,
    FIT,
    INK,
    MEASURED,
    NOMINAL,
    TRUE_FACE,
    add_colorbar,
    axes_at,
    chart,
    diverging,
    drawing,
    plain_spines,
    round_up,
    symmetric_limit,
)
from twin.report.pixel_panels import Masked, show_z, true_scale, width_mm
from twin.report.section import Trace, face_profile, trace_through_apexes
from twin.results.decoders import DecodedImage, decoder_name
from twin.results.record import Measurement
from twin.results.score import wanted_pixels

DIFFERENCE_GAIN = 2

_WIDTH_IN, _LEFT_IN, _TOP_IN, _GAP_IN, _BELOW_IN = 10.0, 0.5, 0.32, 0.14, 0.65
_BETWEEN_IN = 0.25  # tick labels of the upper line
_TICKS_MM = 4.0


def extent_mm(measured: Measurement) -> tuple[float, float, float, float]:
    """Return the borders of the image on the coat, mm: left, right, bottom, top."""
    rows, cols = measured.picture.shape[:2]
    half_x, half_y = (
        cols * measured.colours.calibration.pitch_mm / 2,
        rows * measured.colours.calibration.pitch_mm / 2,
    )
    return (-half_x, half_x, -half_y, half_y)


def true_heights_mm(measured: Measurement) -> Masked:
    """Return world z (mm) of the true coat at each pixel, (row, col); masked outside the coat."""
    z_mm = measured.truth.points_world_mm[..., 2].astype(np.float64)
    return np.ma.masked_array(z_mm, ~measured.truth.measured)


def decoder_error_um(measured: Measurement, decoder: DecodedImage) -> Masked:
    """Return measured minus true world z, um, (row, col); masked outside the evaluated field."""
    scored = wanted_pixels(measured.experiment, measured.truth) & decoder.heights.valid
    difference = decoder.heights.height_mm - true_heights_mm(measured).data
    return np.ma.masked_array(1e3 * difference, ~scored)


def true_slopes(measured: Measurement) -> FloatArray:
    """Return the slopes (mm/mm) of the true coat at each pixel, (2, row, col): down and right."""
    normals = measured.truth.normals_world.astype(np.float64)
    upward = np.where(np.abs(normals[..., 2]) > 1e-6, normals[..., 2], 1.0)
    # World y points up, rows count down.
    return np.stack([normals[..., 1] / upward, -normals[..., 0] / upward])


def difference_levels(measured: Measurement) -> Levels:
    """Return the difference of image and background, times `DIFFERENCE_GAIN`; 128 is no difference.

    The background is the image without contact.
    """
    change = measured.picture - measured.colours.calibration.background.astype(np.float64)
    return np.rint(np.clip(128 + DIFFERENCE_GAIN * change, 0, 255)).astype(np.uint8)


def draw_images(path: Path, measured: Measurement) -> None:
    """Draw tactile image, background (image without contact) and their difference as PNG."""
    background = np.rint(measured.colours.calibration.background).astype(np.uint8)
    pictures = {
        "tactile image": measured.picture,
        "untouched gel (background)": background,
        f"difference × {DIFFERENCE_GAIN}, grey is none": difference_levels(measured),
    }
    panel_in, height_in = _panel(measured, 3)
    with drawing(path, _WIDTH_IN, _TOP_IN + height_in + 0.5) as figure:
        for number, (title, picture) in enumerate(pictures.items()):
            axes = _axes(figure, number, _TOP_IN, panel_in, height_in)
            axes.imshow(picture, extent=extent_mm(measured))
            axes.set(title=title, xlabel="x (mm)", ylabel="" if number else "y (mm)")
            _mark_field(axes, measured)


def draw_slopes(path: Path, measured: Measurement) -> None:
    """Draw measured slopes, true slopes and their difference, in both directions, as PNG."""
    slopes, true = measured.colours.own.heights.slopes.astype(np.float64), true_slopes(measured)
    limit = symmetric_limit(true, 99.5)
    error_limit = symmetric_limit(slopes - true, 99.0)
    panel_in, height_in = _panel(measured, 3)
    line_in = _TOP_IN + height_in + _BETWEEN_IN
    with drawing(path, _WIDTH_IN, 2 * line_in + _BELOW_IN) as figure:
        for line, (name, at) in enumerate((("to the right", 1), ("downwards", 0))):
            shown = (
                (f"measured, {name}", slopes[at], limit),
                (f"true, {name}", true[at], limit),
                ("measured − true", slopes[at] - true[at], error_limit),
            )
            for number, (title, values, end) in enumerate(shown):
                axes = _axes(figure, number, line * line_in + _TOP_IN, panel_in, height_in)
                mapped = _map(axes, measured, values, end)
                axes.set(title=title)
                if line:
                    add_colorbar(axes, mapped, "slope (mm/mm)", extend="both", side="below")


def draw_heights(path: Path, measured: Measurement) -> None:
    """Draw true heights and the heights of every decoder, shaded, on one scale, as PNG."""
    scale, wide_mm, extent = true_scale(measured), width_mm(measured), extent_mm(measured)
    panel_in, height_in = _panel(measured, 4)
    line_in = _TOP_IN + height_in + _BETWEEN_IN
    lines = _lines(measured)
    with drawing(path, _WIDTH_IN, len(lines) * line_in) as figure:
        for line, decoders in enumerate(lines):
            top_in = line * line_in + _TOP_IN
            if not line:
                axes = _axes(figure, 0, top_in, panel_in, height_in)
                show_z(axes, true_heights_mm(measured), wide_mm, scale, extent=extent)
                axes.set(title="true coat")
            for number, decoder in enumerate(decoders, start=1):
                axes = _axes(figure, number, top_in, panel_in, height_in)
                z_mm = np.ma.masked_array(decoder.heights.height_mm, ~decoder.heights.valid)
                show_z(axes, z_mm.astype(np.float64), wide_mm, scale, bar=False, extent=extent)
                axes.set(title=decoder_name(decoder))


def draw_errors(path: Path, measured: Measurement) -> None:
    """Draw the map of the height error of every decoder, on one scale, as PNG."""
    errors = {
        id(decoder): decoder_error_um(measured, decoder) for decoder in measured.colours.decoded
    }
    limit_um = round_up(
        max(float(np.percentile(np.abs(e.compressed()), 95)) for e in errors.values())
    )
    panel_in, height_in = _panel(measured, 3)
    line_in = _TOP_IN + height_in + _BETWEEN_IN
    lines = _lines(measured)
    with drawing(path, _WIDTH_IN, len(lines) * line_in + _BELOW_IN) as figure:
        for line, decoders in enumerate(lines):
            for number, decoder in enumerate(decoders):
                axes = _axes(figure, number, line * line_in + _TOP_IN, panel_in, height_in)
                shown = _map(axes, measured, errors[id(decoder)], limit_um)
                axes.set(title=f"{decoder_name(decoder)}: {decoder.errors.z_rmse_um:.1f} µm RMS")
                if line == len(lines) - 1:
                    add_colorbar(axes, shown, "z error (µm)", extend="both", side="below")


def _lines(measured: Measurement) -> list[list[DecodedImage]]:
    lines = [
        [decoder for decoder in measured.colours.decoded if decoder.colour_map == kind.name]
        for kind in maps_in_order()
    ]
    return [line for line in lines if line]


def _panel(measured: Measurement, count: int) -> tuple[float, float]:
    """Return width and height, inches, of one of `count` maps next to each other."""
    rows, cols = measured.picture.shape[:2]
    width_in = (_WIDTH_IN - _LEFT_IN - count * _GAP_IN) / count
    return width_in, width_in * rows / cols


def _axes(figure: Canvas, number: int, top_in: float, width_in: float, height_in: float) -> Axes:
    left_in = _LEFT_IN + number * (width_in + _GAP_IN)
    axes = axes_at(figure, left_in, top_in, width_in, height_in)
    axes.tick_params(labelleft=number == 0)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MultipleLocator(_TICKS_MM))
    return axes


def _map(axes: Axes, measured: Measurement, values: Any, limit: float) -> Any:
    return axes.imshow(
        values, extent=extent_mm(measured), cmap=diverging(), vmin=-limit, vmax=limit
    )


def _mark_field(axes: Axes, measured: Measurement) -> None:
    """Draw the outline of the evaluated field."""
    size = measured.experiment.photometric
    corner = (-size.field_x_mm / 2, -size.field_y_mm / 2)
    for colour, width, style in (("white", 1.4, "-"), (INK, 0.7, (0, (6, 4)))):
        axes.add_patch(
            Rectangle(
                corner, size.field_x_mm, size.field_y_mm, fill=False, ec=colour, lw=width, ls=style
            )
        )


_SAMPLES = 601
_COLOURS = (MEASURED, FIT, NOMINAL, "#8c6d31", "#7b4173")
_STYLES = ("-", ":", "--", "-.")


def draw_sections(path: Path, measured: Measurement) -> None:
    """Draw heights and height errors of every decoder along the section, as PNG."""
    trace = trace_through_apexes(measured.experiment)
    left, right, *_ = extent_mm(measured)
    s_mm = np.linspace(left, right, _SAMPLES)
    true_mm = face_profile(measured.press, trace, s_mm)
    with drawing(path, 10.0, 6.9) as figure:
        heights = axes_at(figure, 0.65, 0.35, 9.2, 3.0)
        errors = axes_at(figure, 0.65, 4.0, 9.2, 2.4)
        heights.plot(s_mm, true_mm, color=TRUE_FACE, lw=2.4, alpha=0.6, label="true coat")
        for decoder in measured.colours.decoded:
            height_mm = profile_mm(decoder, measured, trace, s_mm)
            _line(heights, s_mm, height_mm, decoder)
            _line(errors, s_mm, 1e3 * (height_mm - true_mm), decoder)
        heights.set(title="Height along the section, z enlarged", ylabel="z (mm)")
        errors.set(title="Measured − true", ylabel="z error (µm)")
        errors.axhline(0.0, color=TRUE_FACE, lw=2.4, alpha=0.6)
        for axes in (heights, errors):
            axes.set(xlabel=f"{trace.axis} (mm)", xlim=(left, right))
            plain_spines(axes)
        heights.legend(loc="upper right")


def profile_mm(
    decoder: DecodedImage, measured: Measurement, trace: Trace, s_mm: FloatArray
) -> FloatArray:
    """Return the heights (mm) of one decoder at positions s (mm) along a line.

    The heights are NaN outside the image.
    """
    rows, cols = decoder.heights.height_mm.shape
    pitch_mm = decoder.heights.pitch_mm
    x_mm = (np.arange(cols) - (cols - 1) / 2) * pitch_mm
    y_mm = (np.arange(rows) - (rows - 1) / 2) * pitch_mm
    upwards = decoder.heights.height_mm[::-1].astype(np.float64)
    sample = RegularGridInterpolator((y_mm, x_mm), upwards, bounds_error=False)
    return np.asarray(sample(trace.points(s_mm)[:, ::-1]))


def _line(axes: Axes, s_mm: FloatArray, values: FloatArray, decoder: DecodedImage) -> None:
    place = [scheme.name for scheme in schemes_in_order()].index(decoder.integration)
    line = [kind.name for kind in maps_in_order()].index(decoder.colour_map)
    axes.plot(
        s_mm,
        values,
        color=_COLOURS[place % len(_COLOURS)],
        ls=_STYLES[line % len(_STYLES)],
        lw=1.2,
        label=decoder_name(decoder),
    )


LAMP_COLOURS = {"red": "#c0392b", "green": "#2b8a57", "blue": "#1f5fb2"}
_ARROW_MM = 3.5
_LAYER_COLOURS = ("#cfe3f1", "#e3eef6")


def draw_sensor(path: Path, measured: Measurement) -> None:
    """Draw the sensor from above and from the side, to scale, as PNG."""
    experiment = measured.experiment
    with drawing(path, 5.0, 6.25) as figure:
        _above(axes_at(figure, 0.6, 0.35, 4.1, 3.3), experiment)
        _side(axes_at(figure, 0.6, 4.4, 4.1, 1.35), experiment)


def _above(axes: Axes, experiment: Experiment) -> None:
    slab, size = experiment.elastomer, experiment.photometric
    half = slab.length_x_mm / 2, slab.length_y_mm / 2
    axes.add_patch(Rectangle((-half[0], -half[1]), 2 * half[0], 2 * half[1], fc="#cfe3f1", ec=INK))
    field = size.field_x_mm, size.field_y_mm
    axes.add_patch(
        Rectangle((-field[0] / 2, -field[1] / 2), *field, fill=False, ec=FAINT, ls="--", lw=0.9)
    )
    for lamp in experiment.lamps.values():
        _lamp_above(axes, lamp)
    axes.annotate("evaluated field", (-field[0] / 2, field[1] / 2), xytext=(4, -11),
                  textcoords="offset points", color=FAINT)  # fmt: skip
    chart(axes, "From above: lamps and their aims", "x (mm)", "y (mm)")
    x_mm, y_mm = (_reach_mm(experiment, axis, edge) for axis, edge in enumerate(half))
    axes.set(xlim=(-x_mm, x_mm), ylim=(-y_mm, y_mm), aspect="equal")


def _reach_mm(experiment: Experiment, axis: int, edge_mm: float) -> float:
    """Return half the width, mm, of a drawing along world x or y that contains gel and lamps."""
    lamps_mm = np.abs(emitters_of(experiment.lamps).positions_mm[:, axis]).max(initial=0.0)
    return max(edge_mm + 4.0, float(lamps_mm) + 1.5)


def _lamp_above(axes: Axes, lamp: Lamp) -> None:
    x_mm, y_mm, _ = emitters_of({"one": lamp}).positions_mm.T
    colour, aim = LAMP_COLOURS[lamp.channel], np.deg2rad(lamp.aim_azimuth_deg)
    axes.plot(x_mm, y_mm, "o", ms=4, color=colour)
    axes.arrow(
        lamp.x_mm, lamp.y_mm, _ARROW_MM * np.cos(aim), _ARROW_MM * np.sin(aim),
        width=0.12, head_width=0.7, color=colour,
    )  # fmt: skip


def _side(axes: Axes, experiment: Experiment) -> None:
    half = experiment.elastomer.length_x_mm / 2
    top_mm = 0.0
    for number, (name, layer) in enumerate(experiment.layers.items()):
        colour = _LAYER_COLOURS[number % len(_LAYER_COLOURS)]
        corner = (-half, layer.bottom_mm)
        axes.add_patch(Rectangle(corner, 2 * half, layer.thickness_mm, fc=colour, ec=FAINT, lw=0.6))
        place = -half + 0.4, layer.bottom_mm + 0.3
        axes.text(*place, f"{name}, n = {layer.ior:g}", va="bottom", fontsize=7.5)
        top_mm = max(top_mm, layer.bottom_mm + layer.thickness_mm)
    axes.plot([-half, half], [0, 0], color=INK, lw=1.6)
    for lamp in experiment.lamps.values():
        x_mm, _, z_mm = emitters_of({"one": lamp}).positions_mm.T
        axes.plot(x_mm, z_mm, "o", ms=3, color=LAMP_COLOURS[lamp.channel])
    standoff_mm = experiment.camera.pose.standoff_mm
    seen_mm = image_pinhole(experiment).width_px / image_pinhole(experiment).fx_px / 2
    reach_mm = top_mm + 3.0
    # The fan of rays is drawn in the air above the window, where no layer refracts it.
    ends = [seen_mm * (standoff_mm - z_mm) for z_mm in (top_mm, reach_mm)]
    fan = [(-ends[0], top_mm), (ends[0], top_mm), (ends[1], reach_mm), (-ends[1], reach_mm)]
    axes.add_patch(Polygon(fan, facecolor=MEASURED, alpha=0.15, edgecolor="none"))
    axes.text(0, top_mm + 0.4, f"to the camera, {standoff_mm:g} mm above the coat", ha="center",
              fontsize=7.5, color=MEASURED)  # fmt: skip
    chart(axes, "From the side: coat, layers and lamps", "x (mm)", "z (mm)")
    x_mm = _reach_mm(experiment, 0, half)
    axes.set(xlim=(-x_mm, x_mm), ylim=(-0.8, reach_mm), aspect="equal")
