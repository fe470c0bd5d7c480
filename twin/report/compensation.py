"""Report page of `twin compensate`: the object and its parts, the contact, the assumed layer."""

from collections.abc import Iterator
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from reconstruction.compensation import (
    Compensated,
    CompensatedSheet,
    CompensatedSlab,
    ObjectPart,
    parts_of,
)
from twin.config.quantities import outside_sources
from twin.pipeline.compensation import CompensationResult
from twin.pipeline.progress import ProgressCallback, no_progress
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
from twin.report.page import REPORT_FILE, Block, Figure, Note, Page, Section, write_page
from twin.report.table import Column, Row, Table

COMPENSATION_PICTURE = "compensation"
# The pressure at edges is many times the pressure on faces: the scale ends at the 99th percentile.
_MOST_PERCENT = 99.0


def write_compensation_page(
    folder: Path, result: CompensationResult, name: str, watch: ProgressCallback = no_progress
) -> Path:
    """Write `report.html` and its figure into the folder of a compensation; return the page's path.

    Parameters
    ----------
    name : name of the measurement that was compensated

    Raises
    ------
    InputError : the page cannot be written
    """
    used = "The nominal shape of the specimen is not used, except for the edge radius of bars."
    if isinstance(result.compensated, CompensatedSlab):
        used = "The form of the specimen and its dimensions that are not fitted are assumed."
        first = _numbers_section(result, result.compensated)
    else:
        first = _object_section(result, parts_of(result.compensated))
    page = Page(
        kind="compensation",
        title=name.replace("_", " "),
        lead=f"Shape of the rigid object behind the measured coat of {name}, computed from the "
        f"coat, the elastomer and the load. {used}",
        sections=[first, _contact_section(result), _layer_section(result)],
        warned="Values outside the range of their source",
        warnings=outside_sources(result.layer),
    )
    return write_page(folder / REPORT_FILE, page, watch)


def _object_section(result: CompensationResult, parts: list[ObjectPart]) -> Section:
    rows: list[Row] = [
        {
            "part": number,
            "form": part.form,
            "x": part.middle_mm[0],
            "y": part.middle_mm[1],
            "highest": part.highest_mm,
            "radius": None if part.form == "flat" else part.radius_mm,
            "sigma": None if part.form == "flat" else 1e3 * part.sigma_mm,
            "residual": part.residual_um,
            "pressure": part.pressure_kpa,
        }
        for number, part in enumerate(parts, 1)
    ]
    columns = (
        Column("part", "part", 0),
        Column("form", "fitted as"),
        Column("x", "x, mm", 2),
        Column("y", "y, mm", 2),
        Column("highest", "highest, mm", 3),
        Column("radius", "radius, mm", 3),
        Column("sigma", "u of the radius, µm", 1),
        Column("residual", "RMS from the form, µm", 1),
        Column("pressure", "mean pressure, kPa", 2),
    )
    blocks: list[Block] = [_picture(result)]
    if rows:
        blocks.append(Table("parts", "", "", columns, tuple(rows)))
    else:
        blocks.append(Note("No part of the contact is wide enough to be fitted."))
    blocks += _bars(result)
    blocks.append(
        Note(
            "u: standard uncertainty from noise and texture and from the uncertainty of the layer."
        )
    )
    return Section("object", "The object", tuple(blocks))


def _picture(result: CompensationResult) -> Figure:
    return Figure(
        COMPENSATION_PICTURE,
        "Coat, contact, and a section of the object",
        "Maps over world x and y (mm): height z of the measured coat (mm), contact pressure (kPa), "
        "and local thickness (mm) or contact. The section shows the object only where the "
        "elastomer touches it; elsewhere the touched face is free.",
        "Maps of coat, contact pressure and local thickness; section of coat and object.",
        partial(draw_compensation, compensated=result.compensated),
    )


def _numbers_section(result: CompensationResult, slab: CompensatedSlab) -> Section:
    """Return the section on an object under a slab: picture and table of the fitted numbers."""
    fitted = slab.fitted
    rows: list[Row] = [
        {
            "what": unknown.name,
            "begun": unknown.start,
            "value": fitted.value(unknown.name),
            "sigma": fitted.sigma(unknown.name),
        }
        for unknown in fitted.unknowns
    ]
    columns = (
        Column("what", "number"),
        Column("begun", "start value", 4),
        Column("value", "fitted", 4),
        Column("sigma", "u", 4),
    )
    note = Note(
        "u: standard uncertainty from noise, uncertain layer parameters, the grid of the contact, "
        "and large strain, which the linear slab model neglects. "
        f"Misfit of the coat {1e3 * fitted.misfit_mm:.2f} µm RMS, chi-square per degree of freedom "
        f"{fitted.chi_square:.2f}."
    )
    blocks = (_picture(result), Table("numbers", "", "", columns, tuple(rows)), note)
    return Section("object", "The object", blocks)


def _bars(result: CompensationResult) -> Iterator[Block]:
    """Yield the table of bar widths, and notes on widths that were not measured.

    A bar is listed if the compensation has the value `compensated_bar_N_width_mm`. Without bars,
    no block is yielded.
    """
    figures, rows, notes = result.figures, [], []
    for number in count(1):
        name = f"compensated_bar_{number}"
        if f"{name}_width_mm" not in figures:
            break
        width, sigma = figures[f"{name}_width_mm"], figures[f"{name}_width_sigma_um"]
        turn = figures.get(f"{name}_turn_deg")
        rows.append({"bar": number, "width": width, "sigma": sigma, "turn": turn})
        if width is None:
            notes.append(Note(f"Bar {number}: {figures[f'{name}_width_why']}."))
    columns = (
        Column("bar", "bar", 0),
        Column("width", "width between its walls, mm", 3),
        Column("sigma", "u of the width, µm", 1),
        Column("turn", "turn of the sheet at its edges, degrees", 0),
    )
    if rows:
        yield Table("bars", "", "", columns, tuple(rows))
        yield from notes


_CONTACT = {
    "compensated_force_n": ("force", "N", "compensated_force_sigma_n"),
    "compensated_contact_area_mm2": ("area of contact", "mm²", ""),
    "compensated_thickness_mm": ("mean thickness in contact", "mm", ""),
    "pressure_sigma_kpa": ("u of the contact pressure", "kPa", ""),
    "free_span_modulus_kpa": ("modulus by the free span", "kPa", "free_span_modulus_scatter_kpa"),
    "force_modulus_kpa": ("modulus by the gauge's force", "kPa", "force_modulus_sigma_kpa"),
    "misfit_um": ("misfit of the relief", "µm", ""),
    "calibrated_thickness_mm": ("thickness by the ball", "mm", ""),
    "calibrated_modulus_kpa": ("modulus by the ball", "kPa", "calibrated_modulus_sigma_kpa"),
    "calibrated_rim_compliance_mm2_per_n": (
        "compliance of the rim by the ball",
        "mm²/N",
        "calibrated_rim_compliance_sigma_mm2_per_n",
    ),
    "radius_before_calibration_mm": ("radius of the ball before", "mm", ""),
}


def _contact_section(result: CompensationResult) -> Section:
    rows: list[Row] = [
        {"what": name, "value": result.figures[key], "u": result.figures.get(spread), "unit": unit}
        for key, (name, unit, spread) in _CONTACT.items()
        if result.figures.get(key) is not None
    ]
    columns = (
        Column("what", "figure"),
        Column("value", "value", 4),
        Column("u", "u", 4),
        Column("unit", "unit"),
    )
    table = Table("contact", "", "", columns, tuple(rows))
    return Section("contact", "The contact", (table,))


def _layer_section(result: CompensationResult) -> Section:
    rows = tuple(_layer_rows(result))
    columns = [Column("what", "field"), Column("value", "value"), Column("u", "u", 4)]
    if any(row["source"] for row in rows):
        columns.append(Column("source", "source"))
    table = Table("layer", "", "", tuple(columns), rows)
    note = Note(
        "u: standard uncertainty; values without u are assumed exact. `layer.toml` in this folder "
        "contains the same values; docs/compensation.md states the limits of the method."
    )
    return Section("layer", "Elastomer and load that were assumed", (table, note))


def _layer_rows(result: CompensationResult) -> Iterator[Row]:
    layer = result.layer
    for table in ("elastomer", "press"):
        values: dict[str, Any] = getattr(layer, table).model_dump(mode="json", exclude_none=True)
        for key, value in values.items():
            path = f"{table}.{key}"
            origin = layer.provenance.get(path)
            yield {
                "what": path,
                "value": f"{value:g}" if isinstance(value, float) else str(value),
                "u": getattr(layer.sigma, key, None) or None,
                "source": "" if origin is None else origin.source,
            }


def draw_compensation(path: Path, compensated: Compensated) -> None:
    """Draw maps of the coat, contact pressure and local thickness as PNG, and a section.

    For a slab, the map of the contact replaces the map of the local thickness.

    Raises
    ------
    InputError : `path` cannot be written
    """
    relief, contact = compensated.relief, compensated.contact
    z = relief.heights_mm
    with drawing(path, 10.0, 6.4) as figure:
        places = [axes_at(figure, 0.65 + 3.25 * column, 0.35, 1.9, 2.0) for column in range(3)]
        draw_map(
            places[0], z, _extent(compensated), "Measured coat", "z (mm)", ends=height_scale(z)
        )
        pressed = compensated.pressure_kpa[contact]
        top = round_up(float(np.percentile(pressed, _MOST_PERCENT))) if pressed.size else 1.0
        shown = np.ma.masked_where(~contact, compensated.pressure_kpa)
        draw_map(
            places[1],
            shown,
            _extent(compensated),
            "Contact pressure",
            "kPa",
            ends=(0, top),
            extend="max",
        )
        if isinstance(compensated, CompensatedSheet):
            last = "Local thickness", compensated.layer.thickness_mm * compensated.thinning, "mm"
        else:
            last = "Contact", contact.astype(np.float64), "1: touches"
        draw_map(places[2], last[1], _extent(compensated), last[0], last[2])
        for axes in places[1:]:
            axes.set_ylabel("")
        row = _row_of_section(compensated)
        for axes in places:
            axes.axhline(relief.y_mm[row], color="black", lw=0.7, ls=(0, (6, 4)))
        _draw_section(axes_at(figure, 0.65, 3.55, 9.0, 2.3), compensated, row)


def _row_of_section(compensated: Compensated) -> int:
    """Return the grid row with the longest contact; of several such rows, the middle row."""
    lengths = compensated.contact.sum(axis=1)
    longest = np.flatnonzero(lengths >= 0.98 * lengths.max())
    return int(longest[len(longest) // 2])


def _draw_section(axes: Axes, compensated: Compensated, row: int) -> None:
    relief, clear = compensated.relief, compensated.object_mm[row]
    axes.plot(relief.x_mm, relief.heights_mm[row], color=MEASURED, lw=1.0, label="measured coat")
    axes.plot(clear[:, 0], clear[:, 2], color="0.6", lw=0.8, label="touched face, free")
    touching = np.where(compensated.contact[row], clear[:, 2], np.nan)
    axes.plot(clear[:, 0], touching, color=FIT, lw=2.0, label="object")
    title = f"Section at y = {relief.y_mm[row]:.2f} mm, along the dashed line"
    chart(axes, title, "x (mm)", "z (mm)")
    legend_above(axes, 3)


def _extent(compensated: Compensated) -> tuple[float, float, float, float]:
    (step_x, step_y), relief = compensated.relief.pitch_mm, compensated.relief
    return (
        float(relief.x_mm[0]) - step_x / 2,
        float(relief.x_mm[-1]) + step_x / 2,
        float(relief.y_mm[0]) - step_y / 2,
        float(relief.y_mm[-1]) + step_y / 2,
    )
