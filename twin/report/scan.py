"""Report of a scan: fused map, seams, drift over the path, poses with standard deviations."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.scan.registration import AXES, Overlap
from twin.pipeline.progress import ProgressCallback, no_progress
from twin.pipeline.scan_record import ScanRecord, read_scan
from twin.report.canvas import FIT, MEASURED, axes_at, chart, draw_map, drawing, legend_above
from twin.report.page import REPORT_FILE, STAGE, Block, Figure, Page, Section, write_page
from twin.report.table import Column, Row, Table

_SIDE_IN = 6.2


def write_scan_page(
    folder: Path, watch: ProgressCallback = no_progress, into: Path | None = None
) -> Path:
    """Write `report.html` and its figures of a finished scan; return the page's path.

    Parameters
    ----------
    folder : result folder of the scan
    into : existing folder of the page; None: that of the scan

    Raises
    ------
    InputError : the scan cannot be read, or the page cannot be written
    """
    watch(STAGE, 0.0)
    return write_page((into or folder) / REPORT_FILE, _page(read_scan(folder)), watch)


def _page(done: ScanRecord) -> Page:
    figures, axes = done.figures, sorted({free.axis for free in done.registration.free})
    warnings = [
        f"the overlaps determine {axis} of patches "
        f"{', '.join(str(k + 1) for k in _patches_with(done, axis))} less well than the stage: its "
        "standard deviation is that of the stage"
        for axis in axes
    ]
    return Page(
        kind="scan",
        title=done.plan.name,
        lead=f"{figures['patches']} patches with {figures['overlaps']} overlaps, fused on a "
        f"grid of {figures['pitch_mm']:.3g} mm: {figures['cells']} heights.",
        sections=[_map_section(done), _seam_section(done), _pose_section(done)],
        warned="Directions that the stage determines" if warnings else "",
        warnings=warnings,
        wide=True,
    )


def _patches_with(done: ScanRecord, axis: str) -> list[int]:
    return sorted({free.patch for free in done.registration.free if free.axis == axis})


def _map_section(done: ScanRecord) -> Section:
    rows = tuple(
        {"name": name.replace("_", " "), "value": value} for name, value in done.figures.items()
    )
    blocks: tuple[Block, ...] = (
        Figure(
            "scan_map",
            "Height, standard deviation, patches",
            "Fused height, its standard deviation by noise and poses, and number of patches of "
            "each cell; gray: no height.",
            "Three maps of the part, one above another.",
            partial(_draw_maps, done),
        ),
        Table("figures", "", "", (Column("name", "figure"), Column("value", "value", 4)), rows),
    )
    return Section("map", "Map", blocks)


def _draw_maps(done: ScanRecord, path: Path) -> None:
    fused, half = done.fused, 0.5 * done.fused.pitch_mm
    extent = (
        float(fused.x_mm[0] - half),
        float(fused.x_mm[-1] + half),
        float(fused.y_mm[-1] - half),
        float(fused.y_mm[0] + half),
    )
    tall = _SIDE_IN * (extent[3] - extent[2]) / (extent[1] - extent[0])
    maps = (
        ("height", "z (mm)", fused.z_mm),
        ("standard deviation of z", "um", 1e3 * fused.sigma_mm),
        ("patches", "number", fused.patches.astype(np.float64)),
    )
    with drawing(path, _SIDE_IN + 2.0, 3 * (tall + 0.8)) as figure:
        for number, (title, label, values) in enumerate(maps):
            axes = axes_at(figure, 0.7, 0.35 + number * (tall + 0.8), _SIDE_IN, tall)
            shown = np.where(fused.valid, values, np.nan)
            # A few edge cells of large uncertainty must not determine the scale.
            ends = tuple(map(float, np.nanpercentile(shown, (0.5, 99.5))))
            draw_map(axes, shown[::-1], extent, title, label, ends=(ends[0], ends[1]))


def _seam_section(done: ScanRecord) -> Section:
    columns = (
        Column("pair", "patches"),
        Column("elements", "compared elements"),
        Column("left_out", "left out"),
        Column("median_um", "median distance", 3, "µm"),
        Column("rms_um", "RMS distance", 3, "µm"),
    )
    rows = tuple(_seam_row(overlap) for overlap in done.registration.overlaps)
    note = (
        "Distances along the normal of the surface elements of one patch from the surface of the "
        "other, after the registration; left out: above 5 standard deviations."
    )
    return Section("seams", "Seams", (Table("seams", "", "", columns, rows, (note,)),))


def _seam_row(overlap: Overlap) -> Row:
    return {
        "pair": f"{overlap.first + 1} and {overlap.second + 1}",
        "elements": overlap.elements,
        "left_out": overlap.left_out,
        "median_um": 1e3 * overlap.median_mm,
        "rms_um": 1e3 * overlap.rms_mm,
    }


def _scaled(values: Sequence[Any]) -> FloatArray:
    """Return mm and rad as um and mrad."""
    return 1e3 * np.asarray(values, np.float64)


def _pose_section(done: ScanRecord) -> Section:
    drift, sigma = _scaled(done.registration.drift_mm), _scaled(done.registration.drift_sigma_mm)
    text = (
        f"Drift over the path: {drift[0]:.1f} ± {sigma[0]:.1f} µm along x, {drift[1]:.1f} ± "
        f"{sigma[1]:.1f} µm along y (one standard deviation)."
    )
    known = done.registration.true_motion is not None
    figure = Figure(
        "scan_poses",
        "Poses over the path",
        "Estimated error of the stage at each patch, with one standard deviation"
        + (", and the true error of the twin." if known else "."),
        "Curves of the errors along x and y and of the rotation over the patches.",
        partial(_draw_poses, done),
    )
    return Section("poses", "Drift and poses", (text, figure, _pose_table(done)))


def _draw_poses(done: ScanRecord, path: Path) -> None:
    moves, sigma = _scaled(done.registration.motion), _scaled(done.registration.sigma)
    moving = [k for k in range(6) if sigma[:, k].any()]
    number = np.arange(1, len(moves) + 1)
    true_motion = done.registration.true_motion
    with drawing(path, _SIDE_IN + 1.2, 1.9 * len(moving) + 0.3) as figure:
        for at, k in enumerate(moving):
            axes = axes_at(figure, 0.8, 0.4 + 1.9 * at, _SIDE_IN, 1.2)
            label = "µm" if k < 3 else "mrad"
            axes.errorbar(
                number, moves[:, k], sigma[:, k], fmt="o", color=MEASURED, label="estimated"
            )
            if true_motion is not None:
                axes.plot(number, _scaled(true_motion)[:, k], "x", color=FIT, label="true")
            chart(axes, "", "patch" if at == len(moving) - 1 else "", f"{AXES[k]} ({label})")
            axes.set_xticks(number)
            if at == 0:
                legend_above(axes, 2)


def _pose_table(done: ScanRecord) -> Table:
    moves, sigma = _scaled(done.registration.motion), _scaled(done.registration.sigma)
    columns = [
        Column("patch", "patch"),
        Column("x", "x", 3, "mm"),
        Column("y", "y", 3, "mm"),
        Column("rotation", "turned", 2, "°"),
    ]
    moving = [k for k in range(6) if sigma[:, k].any()]
    columns += [
        Column(f"move_{k}", AXES[k], 2, "µm" if k < 3 else "mrad", "number") for k in moving
    ]

    def row(k: int) -> Row:
        at = done.plan.positions[k]
        cells = {f"move_{a}": _with_sigma(moves[k], sigma[k], a) for a in moving}
        return {
            "patch": k + 1,
            "x": at.x_mm,
            "y": at.y_mm,
            "rotation": at.rotation_deg,
            **cells,
        }

    rows = tuple(row(k) for k in range(len(moves)))
    return Table("poses", "", "", tuple(columns), rows, ("Estimated error of the stage ± sigma.",))


def _with_sigma(moves: FloatArray, sigma: FloatArray, axis: int) -> str:
    return f"{moves[axis]:.2f} ± {sigma[axis]:.2f}"
