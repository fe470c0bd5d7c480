"""Figures of measured surfaces on a regular world grid: 3-D view, height map and z error.

Camera pixels are averaged on the grid, so that maps are in mm for every camera pose.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.axes3d import Axes3D  # type: ignore[import-untyped]
from numpy.typing import NDArray

from reconstruction.arrays import FloatArray, at_pixels
from reconstruction.cells import CellMeans
from reconstruction.pipeline import Reconstruction
from twin.optics.stack import Truth
from twin.optics.view import SceneSurface, SceneView
from twin.report.canvas import (
    FIT,
    MEASURED_FILL,
    add_colorbar,
    axes_at,
    chart,
    contour_levels,
    diverging,
    drawing,
    height_scale,
    round_up,
    symmetric_limit,
)
from twin.report.page import Figure
from twin.report.relief import (
    VIEW_LIGHT_DEG,
    ReliefArtist,
    average_on_grid,
    draw_cells,
    enlargement,
    height_scale_of,
    height_surface,
    masked,
    shaded,
    trimmed,
)
from twin.results.record import Measurement, SurfacePoints

_VIEW_CELLS, _MAP_CELLS = 120, 480
_VIEW = SceneView.around((0.0, 0.0, 0.0), 1.0, *np.deg2rad((28.0, 32.0)))


def z_enlargement(points: SurfacePoints) -> float:
    """Return the factor by which the 3-D view enlarges z: a round number, at least 1."""
    box_mm = at_pixels(points.world_mm, points.valid)
    if not len(box_mm):
        return 1.0
    return enlargement(float(np.ptp(box_mm[:, 0])), float(np.ptp(box_mm[:, 2])))


def relief_figure(measured: Measurement) -> Figure:
    """Return the figure with the 3-D view of the measured surface."""
    points = measured.points
    return Figure(
        "relief",
        "Measured surface",
        f"3-D view of the measured points {_enlarged(points)}, lengths in mm, colour: z. Spikes, "
        "or steps of a constant height, indicate wrong fringe orders or false slopes.",
        "shaded 3-D view of the measured surface",
        lambda path: draw_relief_view(path, points, measured.pixel_mm),
    )


def height_map_figure(measured: Measurement) -> Figure:
    """Return the figure with the measured heights in top view."""
    points = measured.points
    return Figure(
        "height_map",
        "Height map",
        f"Measured z in top view, lengths in mm, with contours; shading from the upper left, "
        f"{_enlarged(points)}. Stripes along or across the fringes indicate phase errors.",
        "shaded height map of the measured surface",
        lambda path: draw_height_map(path, points, measured.pixel_mm),
    )


def error_figure(measured: Measurement) -> Figure:
    """Return the figure with maps of z error and predicted sigma, and the error histogram."""
    return Figure(
        "truth_error",
        "Error of z",
        "Left: measured minus true z (µm). Middle: standard deviation of z (µm), predicted from "
        "camera noise and filter bias. Right: histogram of the errors and the density predicted "
        "from σ (red curve). In a good measurement the error map shows noise without stripes or "
        "outlines, and the histogram follows the red curve.",
        "map and histogram of the z error",
        lambda path: draw_truth_error(
            path, measured.fringes.reconstruction, measured.truth, measured.pixel_mm
        ),
    )


def _enlarged(points: SurfacePoints) -> str:
    enlarged = z_enlargement(points)
    return "in true proportion" if enlarged == 1 else f"with z enlarged {enlarged:g} times"


def draw_relief_view(path: Path, points: SurfacePoints, pixel_mm: float) -> None:
    """Draw the measured surface as a shaded 3-D view, as PNG."""
    cells = trimmed(_relief(points, pixel_mm, _VIEW_CELLS))
    surface, view = _surface(cells), replace(_VIEW, enlarged=z_enlargement(points))
    with drawing(path, 10.0, 5.4) as figure:
        axes: Any = figure.add_axes((0.0, 0.02, 0.9, 1.0), projection="3d", computed_zorder=False)
        assert isinstance(axes, Axes3D)
        rgba = shaded(surface, view.enlarged, VIEW_LIGHT_DEG)
        axes.add_collection(ReliefArtist(surface, view, rgba), autolim=False)
        _frame_view(axes, cells, view)
        assert surface.scale is not None
        bar = figure.colorbar(surface.scale, cax=figure.add_axes((0.92, 0.2, 0.013, 0.6)))
        bar.set_label("z (mm)")


def _frame_view(axes: Any, cells: CellMeans, view: SceneView) -> None:
    left, right, bottom, top = cells.extent_mm
    heights = cells.mean[cells.valid]
    low, high = min(0.0, float(heights.min())), float(heights.max())
    turn, lift = np.rad2deg(view.turn_and_lift_rad)
    axes.set(xlim=(left, right), ylim=(bottom, top), zlim=(low, high))
    axes.set_box_aspect((right - left, top - bottom, (high - low) * view.enlarged), zoom=1.25)
    axes.view_init(elev=lift, azim=turn - 90.0)
    axes.set(xlabel="x (mm)", ylabel="y (mm)")
    axes.set_zlabel("z (mm)")
    axes.zaxis.set_major_locator(MaxNLocator(3))
    for pane in (axes.xaxis, axes.yaxis, axes.zaxis):
        pane.set_pane_color((0.97, 0.975, 0.98, 1.0))


def draw_height_map(path: Path, points: SurfacePoints, pixel_mm: float) -> None:
    """Draw the measured heights in top view, shaded, as PNG."""
    cells = _relief(points, pixel_mm, _MAP_CELLS)
    surface, heights = _surface(cells), masked(cells)[::-1]
    rows, cols = heights.shape
    with drawing(path, 10.0, 0.75 + 8.2 * rows / cols) as figure:
        axes = axes_at(figure, 0.65, 0.15, 8.2, 8.2 * rows / cols)
        lit = shaded(surface, z_enlargement(points))
        axes.imshow(lit[::-1], origin="lower", extent=cells.extent_mm)
        assert surface.scale is not None
        axes.contour(
            cells.x_mm,
            cells.y_mm[::-1],
            heights,
            levels=contour_levels(surface.scale.get_clim()[0] or 0.0, float(heights.max())),
            colors="white",
            linewidths=0.5,
            alpha=0.6,
        )
        axes.set(xlabel="x (mm)", ylabel="y (mm)")
        add_colorbar(axes, surface.scale, "z (mm)")


def _relief(points: SurfacePoints, pixel_mm: float, cells: int) -> CellMeans:
    near = at_pixels(points.world_mm, points.valid)
    return average_on_grid(near, near[:, 2], pixel_mm, cells)


def _surface(cells: CellMeans) -> SceneSurface:
    scale = height_scale_of(*height_scale(cells.mean[cells.valid]))
    return height_surface("measured heights", cells, scale)


_BINS, _SIGMAS = 121, 200


def draw_truth_error(
    path: Path, reconstruction: Reconstruction, truth: Truth, pixel_mm: float
) -> None:
    """Draw the error map, the predicted sigma and the histogram of errors as PNG."""
    both = reconstruction.point_map.valid & truth.lit
    points = at_pixels(truth.points_world_mm, both)
    point_mm = at_pixels(reconstruction.point_map.points_world_mm, both)
    error_um = 1e3 * (point_mm[:, 2] - points[:, 2]).astype(float)
    sigma_um = 1e3 * at_pixels(reconstruction.point_map.sigma_z_mm, both).astype(float)
    limit_um = symmetric_limit(error_um, 99.5)
    with drawing(path, 10.0, 6.7) as figure:
        cells = average_on_grid(points, error_um, pixel_mm, _MAP_CELLS)
        draw_cells(
            axes_at(figure, 0.65, 0.35, 3.45, 2.65),
            cells,
            "z error, measured − true face",
            "z error (µm)",
            cmap=diverging(),
            ends=(-limit_um, limit_um),
            extend="both",
        )
        cells = average_on_grid(points, sigma_um, pixel_mm, _MAP_CELLS)
        draw_cells(
            axes_at(figure, 5.75, 0.35, 3.45, 2.65),
            cells,
            "predicted σ of z, from camera noise",
            "σ (µm)",
            ends=(0, round_up(float(np.percentile(sigma_um, 99)))),
            extend="max",
        )
        _histogram(axes_at(figure, 0.65, 3.95, 9.2, 2.2), error_um, sigma_um, limit_um)


def _histogram(axes: Axes, error_um: NDArray[Any], sigma_um: NDArray[Any], limit_um: float) -> None:
    edges = np.linspace(-limit_um, limit_um, _BINS + 1)
    bars: Any = {"density": True, "histtype": "stepfilled", "color": MEASURED_FILL}
    axes.hist(error_um, edges.tolist(), label="actual errors", **bars)
    axes.plot(
        edges,
        predicted_density(edges, sigma_um),
        color=FIT,
        lw=1.6,
        label="predicted from σ (zero mean)",
    )
    chart(
        axes,
        "Errors of all scored pixels",
        "z error (µm)",
        "density (1/µm)",
        xlim=(-limit_um, limit_um),
    )
    axes.legend(loc="upper right")


def predicted_density(error_um: NDArray[Any], sigma_um: NDArray[Any]) -> FloatArray:
    """Return the density (1/um) of zero-mean normal errors with a different sigma in each pixel.

    The density is the mean over 200 quantiles of sigma, which represent all pixels.

    Parameters
    ----------
    error_um : (n,); errors at which the density is evaluated
    sigma_um : standard deviation of every pixel
    """
    levels = np.quantile(sigma_um, (np.arange(_SIGMAS) + 0.5) / _SIGMAS)
    levels = np.maximum(levels, 1e-9)
    densities = np.exp(-0.5 * (error_um[:, None] / levels) ** 2) / levels
    return np.asarray(densities.mean(axis=1) / np.sqrt(2.0 * np.pi))
