"""Figure of a photometric-stereo sensor: lamps from above, layers and lamps from the side."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon, Rectangle

from twin.config.lamps import Lamp
from twin.config.models import Experiment
from twin.pipeline.colour_images import image_pinhole
from twin.report.canvas import FAINT, INK, MEASURED, axes_at, drawing, plain_spines

LAMP_COLOURS = {"red": "#c0392b", "green": "#2b8a57", "blue": "#1f5fb2"}
_ARROW_MM = 3.5
_LAYER_COLOURS = ("#cfe3f1", "#e3eef6")


def draw_sensor(path: Path, experiment: Experiment) -> None:
    """Draw the sensor from above and from the side, to scale, as PNG.

    Raises
    ------
    InputError
        `path` cannot be written.
    """
    with drawing(path, 5.0, 5.95) as figure:
        _above(axes_at(figure, 0.6, 0.35, 4.1, 3.3), experiment)
        _side(axes_at(figure, 0.6, 4.25, 4.1, 1.35), experiment)


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
    axes.set(title="From above: lamps and their aims", xlabel="x (mm)", ylabel="y (mm)")
    axes.set(xlim=(-half[0] - 4, half[0] + 4), ylim=(-half[1] - 4, half[1] + 4), aspect="equal")
    plain_spines(axes)


def _lamp_above(axes: Axes, lamp: Lamp) -> None:
    along = np.deg2rad(lamp.along_deg)
    place = (np.arange(lamp.emitters) + 0.5) / lamp.emitters - 0.5
    x_mm = lamp.x_mm + place * lamp.length_mm * np.cos(along)
    y_mm = lamp.y_mm + place * lamp.length_mm * np.sin(along)
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
        middle_mm = layer.bottom_mm + layer.thickness_mm / 2
        axes.text(-half + 0.4, middle_mm, f"{name}, n = {layer.ior:g}", va="center", fontsize=7.5)
        top_mm = max(top_mm, layer.bottom_mm + layer.thickness_mm)
    axes.plot([-half, half], [0, 0], color=INK, lw=1.6)
    for lamp in experiment.lamps.values():
        axes.plot([lamp.x_mm], [lamp.height_mm], "o", ms=5, color=LAMP_COLOURS[lamp.channel])
    standoff_mm = experiment.camera.pose.standoff_mm
    seen_mm = image_pinhole(experiment).width_px / image_pinhole(experiment).fx_px / 2
    reach_mm = top_mm + 3.0
    # Air above the window: what is drawn of the fan ends where refraction would bend it.
    ends = [seen_mm * (standoff_mm - z_mm) for z_mm in (top_mm, reach_mm)]
    fan = [(-ends[0], top_mm), (ends[0], top_mm), (ends[1], reach_mm), (-ends[1], reach_mm)]
    axes.add_patch(Polygon(fan, facecolor=MEASURED, alpha=0.15, edgecolor="none"))
    axes.text(0, top_mm + 0.4, f"to the camera, {standoff_mm:g} mm above the coat", ha="center",
              fontsize=7.5, color=MEASURED)  # fmt: skip
    axes.set(title="From the side: coat, layers and lamps", xlabel="x (mm)", ylabel="z (mm)")
    axes.set(xlim=(-half - 4, half + 4), ylim=(-0.8, reach_mm), aspect="equal")
    plain_spines(axes)
