"""Sphere fits in a report: table, one figure per ball, and influence of the fit region."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from reconstruction.arrays import BoolImage, FloatArray
from reconstruction.errors import FitError
from reconstruction.evaluate.fit import SphereFit, fit_sphere
from twin.report.canvas import (
    FIT,
    MEASURED,
    MEASURED_FILL,
    NOMINAL,
    TRUE_FACE,
    axes_at,
    chart,
    diverging,
    drawing,
    symmetric_limit,
)
from twin.report.page import Figure, Section
from twin.report.relief import average_on_grid, draw_cells
from twin.report.section import Trace, trace_through_apexes
from twin.report.table import Cell, Column, Table
from twin.results.balls import SphereScore, region_of
from twin.results.decoders import decoder_name
from twin.results.object_points import is_covered
from twin.results.record import Colours, Measurement
from twin.results.score import wanted_pixels

_MAP_CELLS, _BINS, _CURVE_POINTS = 200, 81, 201
# Radii of the fit regions, as shares of the ball's radius; largest number of points for a fit.
_REGIONS = np.linspace(0.125, 1.0, 8)
_MOST_POINTS = 10_000

_FITS = (
    Column("ball", "ball"),
    Column("surface", "surface"),
    Column("radius", "radius", 3, "mm"),
    Column("error", "|error|", 3, "mm"),
    Column("rmse", "RMSE", 4, "mm"),
    Column("mae", "MAE", 4, "mm"),
    Column("p95", "P95", 4, "mm"),
)


def fit_table(measured: Measurement, decoders: bool = True) -> Table | None:
    """Return the table of sphere fits, mm; None if no ball could be fitted.

    Parameters
    ----------
    decoders : True: include fits by the other decoders of photometric stereo, which the experiment
        does not select
    """
    fits = [row for ball in measured.score.spheres for row in _fits(measured, ball, decoders)]
    if not fits:
        return None
    coat = "coat" if measured.experiment.method.presses else "surface"
    covered = is_covered(measured.experiment)
    apparent = " These are apparent radii of the coat; the object's are above." if covered else ""
    return Table(
        "sphere_fits",
        "Sphere fits of the coat, apparent radii" if covered else "Sphere fits",
        "",
        _FITS,
        tuple(row for row, _ in fits),
        (
            "Radius of the least-squares sphere over the points within "
            f"{measured.experiment.score.roi_radius_mm:g} mm (lateral) of each apex. |error|: "
            "difference to the nominal radius of the ball. RMSE, MAE, P95: root mean square, mean "
            f"and 95th percentile of the absolute radial residuals. The true {coat} is fitted over "
            f"the same pixels.{apparent}",
        ),
        kinds=tuple(kind for _, kind in fits),
        group="ball",
    )


def fit_tables(measured: Measurement) -> list[Table]:
    """Return the table of sphere fits in a list, which is empty if no ball could be fitted."""
    table = fit_table(measured)
    return [table] if table else []


def _fits(
    measured: Measurement, ball: SphereScore, decoders: bool
) -> Iterator[tuple[dict[str, Cell], str]]:
    """Yield table rows with their style: fits of a ball to the measured and the true surface."""
    coat = "true coat" if measured.experiment.method.presses else "true surface"
    images, nominal_mm = measured.images, ball.nominal.radius_mm
    label = _measured_label(measured) if decoders else _surface_label(measured)
    yield _row(ball.number, label, ball.measured, nominal_mm), "measured"
    if decoders and isinstance(images, Colours):
        for decoder in images.decoded:
            for fit in decoder.score.spheres:
                if decoder is not images.own and fit.number == ball.number:
                    yield _row(ball.number, decoder_name(decoder), fit.measured, nominal_mm), ""
    yield _row(ball.number, coat, ball.true_face, nominal_mm), ""


def _row(ball: int, surface: str, fit: SphereFit, nominal_mm: float) -> dict[str, Cell]:
    return {
        "ball": f"ball {ball}",
        "surface": surface,
        "radius": fit.radius_mm,
        "error": abs(fit.radius_mm - nominal_mm),
        "rmse": fit.stats.rmse_mm,
        "mae": fit.stats.mae_mm,
        "p95": fit.stats.p95_mm,
    }


def _measured_label(measured: Measurement) -> str:
    images = measured.images
    surface = _surface_label(measured)
    return f"{surface}: {decoder_name(images.own)}" if isinstance(images, Colours) else surface


def _surface_label(measured: Measurement) -> str:
    return "measured coat" if is_covered(measured.experiment) else "measured"


@dataclass(frozen=True, eq=False)
class BallView:
    """Data of the figure of one ball.

    Attributes
    ----------
    ball : sphere fits of the ball
    measured_mm, true_mm : (n, xyz) float, world
        Measured points of the fit region, and the true face at the same pixels.
    trace : line of the sections
    pixel_mm : size of a camera pixel on the coat
    limit_um : limit of the residual scale, which is symmetric about 0
    """

    ball: SphereScore
    measured_mm: FloatArray
    true_mm: FloatArray
    trace: Trace
    pixel_mm: float
    limit_um: float


def ball_views(scored: Measurement) -> list[BallView]:
    """Return the figure data of every ball, with a common residual scale."""
    balls, points = scored.score.spheres, scored.points.world_mm
    limits = [symmetric_limit(1e3 * ball.measured.residuals_mm, 99.5) for ball in balls]
    return [
        BallView(
            ball=ball,
            measured_mm=points[ball.roi].astype(np.float64),
            true_mm=scored.truth.points_world_mm[ball.roi].astype(np.float64),
            trace=trace_through_apexes(scored.experiment),
            pixel_mm=scored.pixel_mm,
            limit_um=max(limits),
        )
        for ball in balls
    ]


def ball_sections(measured: Measurement) -> list[Section]:
    """Return the section with the figures of the balls, in a list; empty without balls."""
    figures = [_ball_figure(measured, view) for view in ball_views(measured)]
    if not figures:
        return []
    return [Section("balls", "Sphere fits", (*figures, _regions_figure(measured)))]


def _ball_figure(measured: Measurement, view: BallView) -> Figure:
    number, radius_mm = view.ball.number, measured.experiment.score.roi_radius_mm
    return Figure(
        f"ball_{number}",
        f"Ball {number}",
        f"Points within {radius_mm:g} mm (lateral) of the apex; "
        f"{_measured_label(measured)}. Radial residuals (µm) on a scale of ± {view.limit_um:g} "
        "µm, the same for all balls. A pattern in the map is the form of the face. The blue "
        "measured points should follow the green line, the true face. Dashed line: the ball, "
        "shifted to the same peak.",
        f"residual map, histogram and sections of ball {number}",
        lambda path: draw_ball(path, view),
    )


def draw_ball(path: Path, view: BallView) -> None:
    """Draw residual map, histogram, section, and height above the fitted sphere, as PNG."""
    with drawing(path, 10.0, 6.8) as figure:
        _residual_map(axes_at(figure, 0.65, 0.35, 3.6, 2.7), view)
        _residual_histogram(axes_at(figure, 5.75, 0.35, 4.1, 2.7), view)
        _section(axes_at(figure, 0.65, 3.85, 4.1, 2.5), view)
        _departure(axes_at(figure, 5.75, 3.85, 4.1, 2.5), view)


def fitted_height(fit: SphereFit, xy_mm: NDArray[Any]) -> FloatArray:
    """Return world z (mm) of the upper side of a fitted sphere at points (n, xy), mm."""
    across2 = np.sum((xy_mm - fit.centre_mm[:2]) ** 2, axis=1)
    return np.asarray(fit.centre_mm[2] + np.sqrt(np.maximum(fit.radius_mm**2 - across2, 0.0)))


def _residual_map(axes: Axes, view: BallView) -> None:
    residuals_um = 1e3 * view.ball.measured.residuals_mm
    cells = average_on_grid(view.measured_mm, residuals_um, view.pixel_mm, _MAP_CELLS)
    ends = (-view.limit_um, view.limit_um)
    labels = "Residual from the fitted sphere", "radial residual (µm)"
    draw_cells(axes, cells, *labels, cmap=diverging(), ends=ends, extend="both")


def _residual_histogram(axes: Axes, view: BallView) -> None:
    edges = np.linspace(-view.limit_um, view.limit_um, _BINS + 1).tolist()
    measured_um = 1e3 * view.ball.measured.residuals_mm
    true_um = 1e3 * view.ball.true_face.residuals_mm
    bars: Any = {"density": True, "histtype": "stepfilled", "color": MEASURED_FILL}
    axes.hist(measured_um, edges, label="measured", **bars)
    axes.hist(
        true_um,
        edges,
        density=True,
        histtype="step",
        color=TRUE_FACE,
        lw=1.4,
        label="true face, its own fit",
    )
    chart(
        axes,
        "Residuals",
        "radial residual (µm)",
        "density (1/µm)",
        xlim=(-view.limit_um, view.limit_um),
    )
    axes.legend(loc="upper left")


def _strip(points: NDArray[Any], view: BallView) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return positions s and points within one pixel of the section, sorted by s."""
    near = points[np.abs(view.trace.offset(points[:, 0], points[:, 1])) <= view.pixel_mm]
    s_mm = np.asarray(view.trace.position(near[:, 0], near[:, 1]))
    order = np.argsort(s_mm, kind="stable")
    return s_mm[order], near[order]


def _section(axes: Axes, view: BallView) -> None:
    (s_measured, measured), (s_true, true) = (
        _strip(view.measured_mm, view),
        _strip(view.true_mm, view),
    )
    low, high = float(view.true_mm[:, 2].min()), float(view.true_mm[:, 2].max())
    reach = view.trace.position(view.true_mm[:, 0], view.true_mm[:, 1])
    along = np.linspace(float(reach.min()), float(reach.max()), _CURVE_POINTS)
    fitted = fitted_height(view.ball.measured, view.trace.points(along))
    cap = _nominal_cap(view, along, high)
    axes.plot(along, cap, color=NOMINAL, lw=1.0, ls="--", label="the ball, moved to the peak")
    axes.plot(s_measured, measured[:, 2], ".", color=MEASURED, ms=3, label="measured")
    axes.plot(s_true, true[:, 2], color=TRUE_FACE, lw=1.2, label="true coated face")
    axes.plot(along, fitted, color=FIT, lw=1.0, ls=":", label="fitted sphere")
    room = max(high - low, 0.02)
    chart(
        axes,
        "Section through the apex, z enlarged",
        f"{view.trace.axis} (mm)",
        "z (mm)",
        ylim=(low - 0.9 * room, high + 0.15 * room),
    )
    axes.legend(loc="lower center", ncols=2, frameon=True, framealpha=0.9, edgecolor="none")


def _departure(axes: Axes, view: BallView) -> None:
    s_measured, measured = _strip(view.measured_mm, view)
    s_true, true = _strip(view.true_mm, view)
    measured_um, true_um = _above_fit_um(view, measured), _above_fit_um(view, true)
    axes.plot(s_measured, measured_um, ".", color=MEASURED, ms=3, label="measured")
    axes.plot(s_true, true_um, color=TRUE_FACE, lw=1.2, label="true coated face")
    axes.axhline(0.0, color=FIT, lw=1.0, ls=":", label="fitted sphere")
    chart(
        axes,
        "The same, height above the fitted sphere",
        f"{view.trace.axis} (mm)",
        "height above the fit (µm)",
        ylim=(-1.6 * view.limit_um, 1.6 * view.limit_um),
    )
    axes.legend(loc="lower center", ncols=3)


def _above_fit_um(view: BallView, points: NDArray[Any]) -> FloatArray:
    return np.asarray(1e3 * (points[:, 2] - fitted_height(view.ball.measured, points[:, :2])))


def _nominal_cap(view: BallView, s_mm: NDArray[Any], peak_mm: float) -> FloatArray:
    """Return world z (mm) of the nominal ball, shifted so that its apex is at `peak_mm`."""
    nominal = view.ball.nominal
    across2 = np.sum((view.trace.points(s_mm) - [nominal.x_mm, nominal.y_mm]) ** 2, axis=1)
    fall = nominal.radius_mm - np.sqrt(np.maximum(nominal.radius_mm**2 - across2, 0.0))
    return np.asarray(peak_mm - fall)


# ---- region of the fit ---------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class RegionCurve:
    """Sphere fits of one ball over several regions around the apex.

    Attributes
    ----------
    label : number of the ball, and fitted surface
    region_mm, radius_mm, rmse_um : (n,); radius of the region, fitted radius and RMSE; regions that
        could not be fitted are omitted
    """

    label: str
    region_mm: FloatArray
    radius_mm: FloatArray
    rmse_um: FloatArray


def region_curves(measured: Measurement) -> list[RegionCurve]:
    """Return the sphere fits of every ball to the measured and to the true surface, by fit region.

    The largest region has the radius of the ball.
    """
    points = measured.points
    usable = points.valid & wanted_pixels(measured.experiment, measured.truth)
    surfaces = (
        ("measured", points.world_mm),
        ("true face", measured.truth.points_world_mm),
    )
    return [
        _region_curve(f"ball {ball.number}, {name}", ball, points.world_mm, usable, surface_mm)
        for ball in measured.score.spheres
        for name, surface_mm in surfaces
    ]


def _region_curve(
    label: str,
    ball: SphereScore,
    points_mm: NDArray[np.floating],
    usable: BoolImage,
    surface_mm: NDArray[np.floating],
) -> RegionCurve:
    fits, nominal = [], ball.nominal
    footprint = region_of(nominal, points_mm, usable, nominal.radius_mm * float(_REGIONS[-1]))
    x_mm, y_mm = points_mm[footprint][:, :2].T
    apart_mm = np.hypot(x_mm - nominal.x_mm, y_mm - nominal.y_mm)
    surface_mm = surface_mm[footprint]
    for region_mm in nominal.radius_mm * _REGIONS:
        inside = surface_mm[apart_mm <= region_mm]
        with suppress(FitError):
            fit = fit_sphere(inside[:: 1 + len(inside) // _MOST_POINTS])
            fits.append((region_mm, fit.radius_mm, 1e3 * fit.stats.rmse_mm))
    return RegionCurve(label, *np.array(fits, np.float64).reshape(-1, 3).T)


def _regions_figure(measured: Measurement) -> Figure:
    return Figure(
        "fit_regions",
        "Influence of the fit region",
        "Radial RMSE (µm) and radius (mm) of the sphere fits over the points within a lateral "
        "distance of the apex, up to the radius of the ball. If the region extends beyond the "
        "contact, the true face is not spherical, and RMSE and radius describe its shape, not the "
        "error of the sensor. Vertical line: region of the table above.",
        "RMSE and radius of the sphere fits against the region of the fit",
        lambda path: draw_regions(path, measured),
    )


def draw_regions(path: Path, measured: Measurement) -> None:
    """Draw RMSE and radius of the sphere fits over the radius of the fit region, as PNG."""
    curves, balls = region_curves(measured), len(measured.score.spheres)
    with drawing(path, 10.0, 3.6) as figure:
        rmse, radius = axes_at(figure, 0.65, 0.5, 4.1, 2.5), axes_at(figure, 5.75, 0.5, 4.1, 2.5)
        for number, curve in enumerate(curves):
            true = curve.label.endswith("true face")
            shade = 1.0 if balls == 1 else 1.0 - 0.55 * (number // 2) / (balls - 1)
            style: Any = {
                "color": TRUE_FACE if true else MEASURED,
                "alpha": shade,
                "marker": "" if true else "o",
                "ms": 3,
                "lw": 1.2,
                "label": curve.label,
            }
            rmse.plot(curve.region_mm, curve.rmse_um, **style)
            radius.plot(curve.region_mm, curve.radius_mm, **style)
        for axes in (rmse, radius):
            axes.axvline(measured.experiment.score.roi_radius_mm, color=FIT, lw=1.0, ls=":")
        nominal_mm = sorted({ball.nominal.radius_mm for ball in measured.score.spheres})
        for one_mm in nominal_mm:
            radius.axhline(one_mm, color=NOMINAL, lw=1.0, ls="--")
        label = "region of the fit (mm from the apex)"
        chart(rmse, "RMSE", label, "radial RMSE (µm)", ylim=(0.0, None))
        chart(radius, "Radius; dashed: nominal", label, "fitted radius (mm)")
        rmse.legend(loc="upper left", frameon=True, framealpha=0.9, edgecolor="none")
