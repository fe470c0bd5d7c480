"""Report of an adopted rig: known and assumed fields, and captured compared with rendered frames.

An adopted rig is the model of a real rig, estimated from captures of this rig. The twin renders the
measured surface with the adopted rig. It then records and decodes the rendered
frames in the same way as the captured frames. The twin is valid where images, histograms, noise,
modulation and sigma agree.
"""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from reconstruction.arrays import BoolImage, FloatArray, FloatImage
from reconstruction.capture.folder import Capture
from reconstruction.pipeline import Reconstruction
from twin.adoption.adopt import Adopted, Given, coat_sparkle
from twin.adoption.findings import rows_of
from twin.adoption.rendered import Rendered, Scene, render_again
from twin.pipeline.progress import ProgressCallback, no_progress
from twin.report.canvas import (
    FAINT,
    FIT,
    MEASURED,
    TRUE_FACE,
    add_colorbar,
    axes_at,
    chart,
    drawing,
    legend_above,
    no_ticks,
    round_up,
    sequential,
)
from twin.report.page import REPORT_FILE, STAGE, Block, Figure, Note, Page, Section, write_page
from twin.report.table import Column, Row, Table

_HISTOGRAM_BINS = 80
_REAL, _TWIN = "captured", "rendered"


def write_adopted_page(
    folder: Path, adopted: Adopted, given: Given, watch: ProgressCallback = no_progress
) -> Path:
    """Render the captured scene with the adopted rig; write the page and its figures.

    Returns the path of the page.

    Raises
    ------
    MissingBackend : no usable Dr.Jit backend
    InputError : the page cannot be written
    """
    watch(STAGE, 0.0)
    scene = Scene(adopted.capture, adopted.points, adopted.placed.origin_mm)
    twin = render_again(adopted.experiment, scene)
    return write_page(folder / REPORT_FILE, _page(adopted, twin, given), watch)


def _page(adopted: Adopted, twin: Rendered, given: Given) -> Page:
    names = ", ".join(path.name for path in given.captures)
    return Page(
        kind="adopted rig",
        title=given.captures[0].name.replace("_", " "),
        lead=f"Twin of the rig that recorded {names}. Values that these captures do not determine "
        f"are those of {given.model}.",
        sections=[_frames_section(adopted, twin), _noise(adopted), _fields(adopted)],
        warned="Remarks" if adopted.notes else "",
        warnings=adopted.notes,
        wide=True,
    )


def _frames_section(adopted: Adopted, twin: Rendered) -> Section:
    rows = tuple(_ratio_row(*entry) for entry in ratios(adopted, twin))
    columns = (
        Column("what", "over the image (medians)"),
        Column("real", _REAL, 4, kind="number"),
        Column("twin", _TWIN, 4, kind="number"),
        Column("ratio", f"{_TWIN} / {_REAL}", 3, kind="number"),
    )
    blocks: list[Block] = [
        Table("beside", "", "", columns, rows),
        Figure(
            "images",
            "White and a phase frame",
            "Digital numbers (DN) of the captured and of the rendered frames on the same scale. "
            "Right: share of the pixels (%) at each level.",
            "Captured and rendered images in pairs, and their histograms.",
            partial(_draw_images, adopted.capture, twin.capture),
        ),
        Figure(
            "maps",
            "Modulation and sigma",
            "Fringe amplitude (DN) and predicted standard deviation of the decoded projector "
            "column (px), from the captured and the rendered frames on the same scale; gray: no "
            "value.",
            "Maps of modulation and sigma in pairs.",
            partial(_draw_maps, adopted.points, twin.points),
        ),
    ]
    return Section("beside", "Captured and rendered frames", tuple(blocks))


def ratios(adopted: Adopted, twin: Rendered) -> list[tuple[str, float, float]]:
    """Return name, captured median and rendered median of each compared quantity.

    The medians are taken over pixels that are valid in both; the name contains the unit.
    """
    inside = adopted.points.point_map.valid & twin.points.point_map.valid
    real, made = adopted.points, twin.points
    compared: list[tuple[str, NDArray[Any], NDArray[Any]]] = []
    if adopted.capture.patterns.uniform:
        compared += [
            (f"{kind} frame, DN", _frame(adopted.capture, kind), _frame(twin.capture, kind))
            for kind in ("white", "black")
        ]
    for name, field in (
        ("modulation, DN", "modulation_dn"),
        ("residual of the phase fit, DN", "residual_dn"),
        ("sigma of the column, px", "sigma_px"),
    ):
        own = getattr(real.decoded.column, field), getattr(made.decoded.column, field)
        compared.append((name, own[0], own[1]))
    compared.append(
        ("sigma of z, um", 1e3 * real.point_map.sigma_z_mm, 1e3 * made.point_map.sigma_z_mm)
    )
    if not inside.any():
        return []
    medians = [
        (name, float(np.median(captured[inside])), float(np.median(rendered[inside])))
        for name, captured, rendered in compared
    ]
    return medians + _sparkle_ratios(adopted, twin)


def _sparkle_ratios(adopted: Adopted, twin: Rendered) -> list[tuple[str, float, float]]:
    """Return the coat's contrast from pixel to pixel, %, captured and rendered.

    The list is empty if one of the two values is unknown.
    """
    own, made = adopted.sparkle, coat_sparkle(twin.capture, twin.points)
    if own is None or made is None:
        return []
    name = "contrast of the coat from pixel to pixel, %"
    return [(name, 100.0 * own.contrast, 100.0 * made.contrast)]


def _frame(capture: Capture, kind: str) -> FloatArray:
    number = capture.patterns.index("white" if kind == "white" else "black").start
    return np.asarray(capture.stack[number], dtype=np.float64)


def _ratio_row(name: str, real: float, twin: float) -> Row:
    ratio = twin / real if real else None
    return {"what": name, "real": real, "twin": twin, "ratio": ratio}


def _noise(adopted: Adopted) -> Section:
    if adopted.noise is None:
        return Section(
            "noise", "Noise", ("The camera's noise cannot be determined from these captures.",)
        )
    gain = adopted.noise.gain_dn_per_e
    figure = Figure(
        "noise",
        "Photon transfer",
        f"Variance of a pixel (DN²) over its mean (DN), {adopted.noise_from}; bars: one standard "
        f"uncertainty. Line: gain {gain.value:.4g} +- {gain.uncertainty:.2g} DN per electron, "
        f"chi-square {adopted.noise.chi2_per_bin:.3g} per bin. Dashed: as stated in capture.toml.",
        "Variance over mean with a straight line.",
        partial(_draw_noise, adopted),
    )
    chi2 = adopted.two_period_chi2
    remark = (
        "The predicted sigma is not checked: this needs a second capture of the scene with another "
        "fringe period."
        if chi2 is None
        else "Captures with two fringe periods: squared difference over the predicted variance "
        f"{chi2:.3g} (1: the predicted sigma is right)."
    )
    return Section("noise", "Noise", (figure, Note(remark)))


def _fields(adopted: Adopted) -> Section:
    columns = (
        Column("field", "field"),
        Column("value", "value"),
        Column("range", "95 % interval"),
        Column("source", "source"),
    )
    entries = list(rows_of(adopted.tables))
    rows = tuple(_field_row(*entry) for entry in entries)
    kinds = tuple("assumed" if entry[3].startswith("assumed") else "" for entry in entries)
    note = (
        "Shaded: assumed value, which no capture determines; its interval is the model's plausible "
        "range. rig.toml contains the same values."
    )
    table = Table("fields", "", "", columns, rows, (note,), kinds)
    return Section("fields", "Every field and its source", (table,))


def _field_row(path: str, value: object, limits: object, source: str) -> Row:
    return {"field": path, "value": _text(value), "range": _text(limits), "source": source}


def _text(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, (list, tuple)):
        return ", ".join(_text(entry) for entry in value)
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def _shown_frames(capture: Capture) -> list[tuple[str, FloatArray]]:
    """Return name and digital numbers of the white frame and of the first phase frame.

    The phase frame is that of the first pattern axis. Without uniform frames, there is no white
    frame.
    """
    axis = capture.patterns.axes[0]
    names: list[tuple[int, str]] = []
    if capture.patterns.uniform:
        names.append((capture.patterns.index("white").start, "white"))
    names.append((capture.patterns.index("phase", axis).start, f"phase frame 0, {axis}s"))
    return [(name, np.asarray(capture.stack[k], dtype=np.float64)) for k, name in names]


def _draw_images(real: Capture, twin: Capture, path: Path) -> None:
    pairs = list(zip(_shown_frames(real), _shown_frames(twin), strict=False))
    with drawing(path, 11.0, 0.3 + 3.0 * len(pairs)) as figure:
        for row, ((name, captured), (_, rendered)) in enumerate(pairs):
            top = 0.4 + 3.0 * row
            limit = round_up(float(np.percentile(captured, 99.8)))
            for left, title, image in ((0.2, _REAL, captured), (3.5, _TWIN, rendered)):
                axes = axes_at(figure, left, top, 3.1, 2.3)
                shown = axes.imshow(image, cmap="gray", vmin=0.0, vmax=limit)
                axes.set_title(f"{name}, {title}")
                no_ticks(axes)
            add_colorbar(axes, shown, "DN")
            axes = axes_at(figure, 7.9, top, 2.9, 2.1)
            _draw_histograms(axes, captured, rendered, limit)


def _draw_histograms(axes: Axes, captured: FloatArray, rendered: FloatArray, limit: float) -> None:
    edges = np.linspace(0.0, limit, _HISTOGRAM_BINS + 1)
    for image, colour, label in ((captured, MEASURED, _REAL), (rendered, FIT, _TWIN)):
        share = np.histogram(image, edges)[0] / image.size
        axes.stairs(100.0 * share, edges, color=colour, label=label)
    chart(axes, "", "level (DN)", "pixels (%)")
    legend_above(axes, 2)


def _draw_maps(real: Reconstruction, twin: Reconstruction, path: Path) -> None:
    kinds = (("modulation_dn", "modulation", "DN"), ("sigma_px", "sigma of the column", "px"))
    with drawing(path, 8.4, 6.2) as figure:
        for row, (field, name, unit) in enumerate(kinds):
            maps = [_masked(reconstruction, field) for reconstruction in (real, twin)]
            limit = round_up(float(np.nanpercentile(np.ma.filled(maps[0], np.nan), 99)))
            for k, (title, image) in enumerate(zip((_REAL, _TWIN), maps, strict=True)):
                axes = axes_at(figure, 0.2 + 3.8 * k, 0.4 + 3.0 * row, 3.2, 2.4)
                shown = axes.imshow(image, cmap=sequential(), vmin=0.0, vmax=limit)
                axes.set_title(f"{name}, {title}")
                no_ticks(axes)
            add_colorbar(axes, shown, unit)


def _masked(reconstruction: Reconstruction, field: str) -> Any:
    """Return a map of the decoder for the projector columns, masked at pixels without valid value.

    `field` is the name of the map, for example `modulation_dn`.
    """
    values: FloatImage = getattr(reconstruction.decoded.column, field)
    hidden: BoolImage = ~reconstruction.decoded.valid
    return np.ma.MaskedArray(values, hidden)


def _draw_noise(adopted: Adopted, path: Path) -> None:
    noise = adopted.noise
    assert noise is not None
    with drawing(path, 7.2, 3.8) as figure:
        axes = axes_at(figure, 0.8, 0.4, 6.0, 2.8)
        axes.errorbar(
            noise.mean_dn,
            noise.variance_dn2,
            noise.variance_uncertainty_dn2,
            fmt="o",
            markersize=3.5,
            color=MEASURED,
            label="captured",
        )
        line = np.linspace(noise.black_level_dn, float(noise.mean_dn.max()), 50)
        axes.plot(line, noise.variance_at(line), color=TRUE_FACE, label="adopted")
        stated = adopted.stated.variance_dn2(line)
        axes.plot(line, stated, "--", color=FAINT, label="stated")
        chart(axes, "", "mean (DN)", "variance (DN²)")
        axes.set_ylim(0.0, 1.3 * float(noise.variance_dn2.max()))
        legend_above(axes, 3)
