"""Figures of a press: relief, pressure, section, derivatives, contact transfer function."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas

from reconstruction.errors import counted
from twin.config.models import Experiment
from twin.mechanics import ContactTransfer, PressedElastomer, ShearFields, SheetFields, face_normals
from twin.mechanics.models import model_of
from twin.report.canvas import (
    FIT,
    INK,
    MEASURED,
    NOMINAL,
    axes_at,
    chart,
    contour_levels,
    diverging,
    draw_map,
    drawing,
    height_scale,
    legend_above,
    plain_log,
    round_up,
)
from twin.report.page import Figure, Verdict
from twin.report.section import (
    Trace,
    face_profile,
    slab_span,
    specimen_profile,
    touched_profile,
    trace_through_apexes,
)
from twin.report.words import label_of
from twin.results.press_derivatives import PressDerivative
from twin.results.record import Measurement

_SAMPLES = 801
# The pressure at edges is many times the pressure on faces. If the largest pressure exceeds the
# given percentile by this factor, the colour scale ends at the percentile.
_EDGE_PEAK, _MOST_PERCENT = 2.0, 90.0
_SHEET_MAPS = (
    " Bottom row: local thickness of the sheet (mm), its larger principal stretch, and the slope "
    "of the coat (degrees). In the contact the distance from coat to specimen along the coat's "
    "normal is the local thickness."
)
_SHEAR_MAPS = (
    " Bottom row: magnitude of the traction of the specimen along the coat after its slide "
    "(kPa), magnitude of its slip over the coat (mm), and the cells that stick (1) or slip (0)."
)
_SILICONE, _STEEL = "#cfe3f1", "#d9cdb8"


def press_figure(measured: Measurement) -> Figure:
    """Return the figure of the pressed elastomer: relief, contact pressure and sections."""
    pressed = measured.press
    return Figure(
        "press",
        "Pressed elastomer",
        "Results of the press model: relief of the coated face (mm), contact pressure (kPa), and "
        "the section along the dashed line, to scale and with z enlarged. The closer the coated "
        "face follows the dashed outline of the specimen, the more of its shape is measurable."
        + ("" if pressed.sheet is None else _SHEET_MAPS)
        + ("" if pressed.shear is None else _SHEAR_MAPS),
        "relief, pressure and sections of the pressed elastomer",
        lambda path: draw_press(path, measured.experiment, pressed),
    )


def judge_press(measured: Measurement) -> Verdict:
    """Return the judgement of the press model: estimated height error, and warnings."""
    warnings = measured.warnings
    left_out = model_of(str(measured.metrics["mechanics_model"])).leaves_out
    known = measured.figures.known
    error_um, peak_um = 1e3 * known("height_error_estimate_mm"), 1e3 * known("relief_peak_mm")
    return Verdict(
        question="Can the press model be trusted?",
        headline=f"estimated height error ± {error_um:.3g} µm",
        grade="check" if warnings else "good",
        reasons=(
            f"the model neglects {left_out}; estimated height error "
            f"{error_um / max(peak_um, 1e-9):.1%} of the relief",
            counted(len(warnings), "warning") + (", listed below" if warnings else " of the press"),
        ),
    )


def draw_press(path: Path, experiment: Experiment, pressed: PressedElastomer) -> None:
    """Draw relief, contact pressure and the section through the apexes as PNG.

    For a thin sheet, also draw maps of thickness, stretch and slope; after a slide, maps of
    traction, slip and sticking cells.
    """
    trace = trace_through_apexes(experiment)
    without_maps = pressed.sheet is None and pressed.shear is None
    with drawing(path, 10.0, 8.6 if without_maps else 11.6) as figure:
        relief = axes_at(figure, 0.65, 0.35, 3.45, 2.7)
        pressure = axes_at(figure, 5.75, 0.35, 3.45, 2.7)
        _relief(relief, pressed)
        _pressure(pressure, pressed)
        for axes in (relief, pressure):
            _mark_trace(axes, experiment, trace)
        draw_section(axes_at(figure, 0.65, 4.05, 9.2, 1.85), experiment, pressed, trace)
        _coated_face(axes_at(figure, 0.65, 6.65, 9.2, 1.45), experiment, pressed, trace)
        if pressed.sheet is not None:
            _sheet_maps(figure, pressed, pressed.sheet)
        if pressed.shear is not None:
            _shear_maps(figure, pressed, pressed.shear)


def draw_derivatives(
    path: Path, pressed: PressedElastomer, derivatives: Sequence[PressDerivative]
) -> None:
    """Draw a map of the derivative of the coated face's z by each parameter, as PNG."""
    x_mm, y_mm = pressed.face_x_mm, pressed.face_y_mm
    extent_mm = (float(x_mm[0]), float(x_mm[-1]), float(y_mm[0]), float(y_mm[-1]))
    cols, rows = min(len(derivatives), 2), -(-len(derivatives) // 2)
    with drawing(path, 0.3 + 4.9 * cols, 3.8 * rows) as figure:
        for number, derivative in enumerate(derivatives):
            row, col = divmod(number, 2)
            axes = axes_at(figure, 0.65 + 4.9 * col, 0.35 + 3.8 * row, 3.3, 2.9)
            most = float(np.abs(derivative.face_z).max()) or 1.0
            name, unit = label_of(derivative.path.rpartition(".")[2])
            label = f"dz (mm) per {unit or 'unit'}"
            title = f"{derivative.path.partition('.')[0]}: {name}"
            ends, cmap = (-most, most), diverging()
            draw_map(axes, derivative.face_z, extent_mm, title, label, cmap=cmap, ends=ends)


def draw_section(
    axes: Axes, experiment: Experiment, pressed: PressedElastomer, trace: Trace
) -> None:
    """Draw specimen and slab in the vertical plane of the section `trace`, to scale."""
    low, high = slab_span(experiment, trace)
    s_mm = np.linspace(low, high, _SAMPLES)
    coated = face_profile(pressed, trace, s_mm)
    touched = touched_profile(experiment, pressed, trace, s_mm)
    on_window = experiment.elastomer.layout == "contact_face"
    far = np.full_like(s_mm, experiment.elastomer.thickness_mm) if on_window else coated
    body = specimen_profile(experiment, pressed, trace, s_mm)
    present = np.isfinite(body)
    base = float(body[present].min()) if present.any() else float(touched.min())
    axes.fill_between(s_mm, base, np.where(present, body, base), where=present, color=_STEEL)
    axes.fill_between(s_mm, touched, far, color=_SILICONE)
    axes.plot(s_mm, np.where(present, body, np.nan), color=NOMINAL, lw=1.0, label="specimen")
    name = "window" if on_window else "clear face"
    axes.plot(s_mm, far if on_window else touched, color=INK, lw=0.8, label=name)
    axes.plot(s_mm, coated, color=MEASURED, lw=1.5, label="coated face")
    chart(axes, "", f"{trace.axis} (mm), to scale", "z (mm)", xlim=(low, high), aspect="equal")
    legend_above(axes, 3)


def _coated_face(
    axes: Axes, experiment: Experiment, pressed: PressedElastomer, trace: Trace
) -> None:
    """Draw the profile of the coated face with z enlarged, and the specimen shifted to its peak."""
    low, high = slab_span(experiment, trace)
    s_mm = np.linspace(low, high, _SAMPLES)
    coated = face_profile(pressed, trace, s_mm)
    body = specimen_profile(experiment, pressed, trace, s_mm)
    lift = float(coated[np.argmax(body)]) - float(body.max())
    floor = min(0.0, float(coated.min()))
    shown = np.where(body + lift >= floor, body + lift, np.nan)
    axes.plot(s_mm, shown, color=NOMINAL, lw=1.0, ls="--", label="specimen, moved to the same peak")
    axes.plot(s_mm, coated, color=MEASURED, lw=1.6, label="coated face")
    chart(
        axes,
        "Coated face, z enlarged",
        f"{trace.axis} (mm)",
        "z (mm)",
        xlim=(low, high),
    )
    legend_above(axes, 2)


def _sheet_maps(figure: Canvas, pressed: PressedElastomer, sheet: SheetFields) -> None:
    """Draw thickness, stretch and slope of a thin sheet as maps on the coated face."""
    slope_deg = np.rad2deg(np.arccos(np.clip(face_normals(pressed)[..., 2], -1.0, 1.0)))
    maps = (
        ("Local thickness (mm)", sheet.thickness_mm),
        ("Larger principal stretch", sheet.stretch[..., 0]),
        ("Slope of the coated face (degrees)", slope_deg),
    )
    for column, (title, values) in enumerate(maps):
        axes = axes_at(figure, 0.65 + 3.2 * column, 9.1, 2.3, 1.9)
        draw_map(axes, values, _extent(pressed), title, "")
        axes.tick_params(labelleft=column == 0)
        if column:
            axes.set_ylabel("")


def _shear_maps(figure: Canvas, pressed: PressedElastomer, shear: ShearFields) -> None:
    """Draw traction, slip and sticking cells of a contact with friction as maps."""
    maps = (
        ("Traction along the coat (kPa)", np.hypot(shear.traction_x_kpa, shear.traction_y_kpa)),
        ("Slip (mm)", np.hypot(shear.slip_x_mm, shear.slip_y_mm)),
        ("Sticking cells", shear.sticking.astype(np.float64)),
    )
    for column, (title, values) in enumerate(maps):
        axes = axes_at(figure, 0.65 + 3.2 * column, 9.1, 2.3, 1.9)
        inside = np.ma.masked_where(~pressed.contact, values)
        top = round_up(float(values.max())) if values.any() else 1.0
        draw_map(axes, inside, _cell_extent(pressed), title, "", ends=(0, top))
        _zoom_to_contact(axes, pressed)
        axes.tick_params(labelleft=column == 0)
        if column:
            axes.set_ylabel("")


def _cell_extent(pressed: PressedElastomer) -> tuple[float, float, float, float]:
    x, y = pressed.x_mm, pressed.y_mm
    half = float(x[1] - x[0]) / 2
    return float(x[0]) - half, float(x[-1]) + half, float(y[0]) - half, float(y[-1]) + half


def _extent(pressed: PressedElastomer) -> tuple[float, float, float, float]:
    x, y = pressed.face_x_mm, pressed.face_y_mm
    return float(x[0]), float(x[-1]), float(y[0]), float(y[-1])


def _relief(axes: Axes, pressed: PressedElastomer) -> None:
    bottom, top = height_scale(pressed.face_z_mm)
    levels = contour_levels(bottom, float(pressed.face_z_mm.max()))
    step = levels[-1] - levels[-2] if len(levels) > 1 else levels[0]
    title = f"Relief of the coated face, contours every {step:g} mm"
    draw_map(axes, pressed.face_z_mm, _extent(pressed), title, "z (mm)", ends=(bottom, top))
    axes.contour(
        pressed.face_x_mm,
        pressed.face_y_mm,
        pressed.face_z_mm,
        levels=levels,
        colors="white",
        linewidths=0.4,
        alpha=0.7,
    )


def _pressure(axes: Axes, pressed: PressedElastomer) -> None:
    top, beyond = _pressure_scale(pressed)
    draw_map(
        axes,
        np.ma.masked_where(~pressed.contact, pressed.pressure_kpa),
        _cell_extent(pressed),
        "Contact pressure",
        "pressure (kPa)",
        ends=(0, top),
        extend="max" if beyond else "neither",
    )
    _zoom_to_contact(axes, pressed)


def _pressure_scale(pressed: PressedElastomer) -> tuple[float, bool]:
    """Return the upper end (kPa) of the pressure scale, and True if pressures exceed this end."""
    peak = float(pressed.pressure_kpa.max())
    touching = pressed.pressure_kpa[pressed.contact]
    most = float(np.percentile(touching, _MOST_PERCENT)) if touching.size else peak
    beyond = peak > _EDGE_PEAK * most
    return round_up(most if beyond else peak), beyond


def _zoom_to_contact(axes: Axes, pressed: PressedElastomer) -> None:
    """Set the limits of the map to the contact plus a margin, in the aspect ratio of the slab."""
    rows, cols = np.nonzero(pressed.contact)
    if not rows.size:
        return
    x, y = pressed.x_mm, pressed.y_mm
    spans = (float(x[-1] - x[0]), float(y[-1] - y[0]))
    needed = (float(np.ptp(x[cols])), float(np.ptp(y[rows])))
    share = min(1.0, 1.3 * max(n / span for n, span in zip(needed, spans, strict=True)) + 0.05)
    for set_limits, span, touching in (
        (axes.set_xlim, spans[0], x[cols]),
        (axes.set_ylim, spans[1], y[rows]),
    ):
        middle = (float(touching.min()) + float(touching.max())) / 2
        set_limits(middle - share * span / 2, middle + share * span / 2)


def _mark_trace(axes: Axes, experiment: Experiment, trace: Trace) -> None:
    ends = trace.points(np.array(slab_span(experiment, trace)))
    axes.plot(ends[:, 0], ends[:, 1], color="white", lw=1.4, alpha=0.6)
    axes.plot(ends[:, 0], ends[:, 1], color=INK, lw=0.7, ls=(0, (6, 4)))


def draw_transfer(path: Path, transfer: ContactTransfer) -> None:
    """Draw the share of the relief that the coat shows, over the pitch of the grooves, as PNG.

    A line is the closed form, points are results of the solver.
    """
    with drawing(path, 7.0, 3.6) as figure:
        axes = axes_at(figure, 0.7, 0.55, 6.0, 2.6)
        closed, solved, layer = _labels(transfer)
        axes.semilogx(transfer.pitch_mm, transfer.closed_form, color=MEASURED, label=closed)
        axes.semilogx(transfer.pitch_mm, transfer.computed, ".", color=FIT, label=solved)
        for share, pitch in ((0.5, transfer.half_pitch_mm), (0.1, transfer.tenth_pitch_mm)):
            if pitch > 0:
                axes.plot([pitch], [share], "o", color="black", markersize=4)
                axes.annotate(
                    f" {share:.0%} at {pitch:.2f} mm", (pitch, share), va="top", fontsize=8
                )
        axes.set_xlabel(f"pitch of the groove (mm), {layer} {transfer.thickness_mm:g} mm thick")
        axes.set_ylabel("share of the relief on the coat")
        axes.set_ylim(0.0, 1.05)
        plain_log(axes.xaxis)
        axes.grid(visible=True)
        legend_above(axes, 2)


def _labels(transfer: ContactTransfer) -> tuple[str, str, str]:
    """Return the label of the curve, the label of the points, and the name of the layer."""
    if transfer.ridge_mm is None:
        return "closed form", "computed by the solver", "slab"
    under = f"ridges of {1e3 * transfer.ridge_mm:g} µm under {transfer.pressure_kpa:g} kPa"
    return "in contact with the whole ridge", under, "sheet"
