"""The picture of `twin compensate`: coat, contact pressure, thickness, a section of the object."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from reconstruction.compensation import Compensated, CompensatedSheet
from twin.report.canvas import (
    FIT,
    MEASURED,
    axes_at,
    chart,
    draw_map,
    drawing,
    height_scale,
    legend_above,
    round_up,
)

COMPENSATION_PICTURE = "compensation.png"
# Edges press many times harder than faces: the scale ends where 99 % of the contact lies below.
_MOST_PERCENT = 99.0


def draw_compensation(path: Path, found: Compensated) -> None:
    """Draw maps of coat, contact pressure and local thickness or contact, and a section, as PNG.

    Raises
    ------
    InputError : `path` cannot be written
    """
    relief, contact = found.relief, found.contact
    z = relief.heights_mm
    with drawing(path, 10.0, 6.4) as figure:
        places = [axes_at(figure, 0.65 + 3.25 * column, 0.35, 1.9, 2.0) for column in range(3)]
        draw_map(places[0], z, _extent(found), "Measured coat", "z (mm)", ends=height_scale(z))
        pressed = found.pressure_kpa[contact]
        top = round_up(float(np.percentile(pressed, _MOST_PERCENT))) if pressed.size else 1.0
        shown = np.ma.masked_where(~contact, found.pressure_kpa)
        draw_map(
            places[1], shown, _extent(found), "Contact pressure", "kPa", ends=(0, top), extend="max"
        )
        if isinstance(found, CompensatedSheet):
            last = "Local thickness", found.layer.thickness_mm * found.thinning, "mm"
        else:
            last = "Contact", contact.astype(np.float64), "1: touches"
        draw_map(places[2], last[1], _extent(found), last[0], last[2])
        for axes in places[1:]:
            axes.set_ylabel("")
        row = _row_of_section(found)
        for axes in places:
            axes.axhline(relief.y_mm[row], color="black", lw=0.7, ls=(0, (6, 4)))
        _draw_section(axes_at(figure, 0.65, 3.55, 9.0, 2.3), found, row)


def _row_of_section(found: Compensated) -> int:
    """Return the row with the longest contact, the middle one of several."""
    lengths = found.contact.sum(axis=1)
    longest = np.flatnonzero(lengths >= 0.98 * lengths.max())
    return int(longest[len(longest) // 2])


def _draw_section(axes: Axes, found: Compensated, row: int) -> None:
    relief, clear = found.relief, found.object_mm[row]
    axes.plot(relief.x_mm, relief.heights_mm[row], color=MEASURED, lw=1.0, label="measured coat")
    axes.plot(clear[:, 0], clear[:, 2], color="0.6", lw=0.8, label="touched face, free")
    touching = np.where(found.contact[row], clear[:, 2], np.nan)
    axes.plot(clear[:, 0], touching, color=FIT, lw=2.0, label="object")
    title = f"Section at y = {relief.y_mm[row]:.2f} mm, along the dashed line"
    chart(axes, title, "x (mm)", "z (mm)")
    legend_above(axes, 3)


def _extent(found: Compensated) -> tuple[float, float, float, float]:
    (step_x, step_y), relief = found.relief.pitch_mm, found.relief
    return (
        float(relief.x_mm[0]) - step_x / 2,
        float(relief.x_mm[-1]) + step_x / 2,
        float(relief.y_mm[0]) - step_y / 2,
        float(relief.y_mm[-1]) + step_y / 2,
    )
