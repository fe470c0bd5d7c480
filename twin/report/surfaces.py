"""Measured surfaces in millimetres: 3-D view, height map and error, on a regular world grid.

Camera pixels are averaged on a grid, so that maps are in mm for every camera pose.
Frames: points (n, xyz) world mm; maps (row along y, col along x), row 0 at the smallest y.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import QuadMesh
from matplotlib.colors import LightSource, Normalize
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.axes3d import Axes3D  # type: ignore[import-untyped]
from mpl_toolkits.mplot3d.proj3d import proj_transform  # type: ignore[import-untyped]
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from reconstruction.arrays import FloatArray, at_pixels
from reconstruction.cells import SquareCells, box_of
from reconstruction.pipeline import Reconstruction
from twin.optics.stack import Truth
from twin.report.canvas import (
    FIT,
    MEASURED_FILL,
    add_colorbar,
    axes_at,
    chart,
    contour_levels,
    diverging,
    draw_map,
    drawing,
    height_scale,
    round_up,
    sequential,
    symmetric_limit,
)
from twin.report.page import Figure
from twin.results.record import Measurement, SurfacePoints

# Finer cells would leave gaps between the pixels of an oblique camera.
_PIXELS_PER_CELL = 2.0


@dataclass(frozen=True, eq=False)
class WorldMap:
    """Mean values per cell; cells without a point are masked.

    Attributes
    ----------
    values : (row, col) masked float
    x_mm, y_mm : (col,), (row,) float, cell centres, ascending
    """

    values: "np.ma.MaskedArray[Any, Any]"
    x_mm: FloatArray
    y_mm: FloatArray
    pitch_mm: float

    @property
    def extent_mm(self) -> tuple[float, float, float, float]:
        """Outline for imshow with origin='lower': left, right, bottom, top."""
        half = self.pitch_mm / 2
        return (
            float(self.x_mm[0] - half),
            float(self.x_mm[-1] + half),
            float(self.y_mm[0] - half),
            float(self.y_mm[-1] + half),
        )

    def trimmed(self) -> "WorldMap":
        """Leave out border rows and columns less than half filled: perspective frays the rim."""
        filled = ~np.ma.getmaskarray(self.values)
        rows = np.flatnonzero(filled.mean(axis=1) >= 0.5)
        cols = np.flatnonzero(filled.mean(axis=0) >= 0.5)
        if not rows.size or not cols.size:
            return self
        down, across = slice(rows[0], rows[-1] + 1), slice(cols[0], cols[-1] + 1)
        return WorldMap(
            self.values[down, across], self.x_mm[across], self.y_mm[down], self.pitch_mm
        )


def average_on_grid(
    points_world_mm: NDArray[Any], values: NDArray[Any], pixel_mm: float, most_cells: int
) -> WorldMap:
    """Average `values` (n,) of `points_world_mm` (n, xyz), n > 0, on square cells.

    Parameters
    ----------
    pixel_mm : a cell is at least two camera pixels wide
    most_cells : and at least so wide that the longer side has no more cells than this
    """
    points_mm = points_world_mm[:, :2].astype(float)
    low_mm, high_mm = box_of(points_mm)
    pitch_mm = max(_PIXELS_PER_CELL * pixel_mm, float((high_mm - low_mm).max()) / most_cells)
    corner_mm = float(low_mm[0]), float(low_mm[1])
    cells = SquareCells.of(points_mm, pitch_mm, corner_mm).means(values.astype(float))
    mean = np.ma.masked_array(cells.mean[::-1], mask=~cells.valid[::-1])
    return WorldMap(mean, cells.x_mm, cells.y_mm[::-1], pitch_mm)


_VIEW_CELLS, _MAP_CELLS = 120, 480
# The relief fills about this share of the field's width in the 3-D view.
_VIEW_HEIGHT_SHARE = 0.2
# The map is lit from the upper left, as readers of maps expect; the view from where one stands.
_MAP_LIGHT_DEG, _VIEW_LIGHT_DEG, _LIGHT_HEIGHT_DEG = 315.0, 225.0, 40.0


def z_enlargement(points: SurfacePoints) -> float:
    """Return by how much the 3-D view enlarges z: a round number, at least 1."""
    found = at_pixels(points.world_mm, points.valid)
    if not len(found):
        return 1.0
    width_mm, height_mm = float(np.ptp(found[:, 0])), float(np.ptp(found[:, 2]))
    wanted = _VIEW_HEIGHT_SHARE * width_mm / max(height_mm, 1e-9)
    return max(1.0, round_up(wanted))


def relief_figure(measured: Measurement) -> Figure:
    """Return the 3-D view of the measured surface."""
    points = measured.points
    return Figure(
        "relief",
        "Measured surface",
        f"3-D view {_enlarged(points)}, lengths in mm, colour is z. Spikes, or steps of a constant "
        "height, would be wrong fringe orders or false slopes.",
        "shaded 3-D view of the measured surface",
        lambda path: draw_relief_view(path, points, measured.pixel_mm),
    )


def height_map_figure(measured: Measurement) -> Figure:
    """Return the measured heights in top view."""
    points = measured.points
    return Figure(
        "height_map",
        "Height map",
        f"Measured z in top view, lengths in mm, with contours; shading from the upper left, "
        f"{_enlarged(points)}. Stripes along or across the fringes would be phase errors.",
        "shaded height map of the measured surface",
        lambda path: draw_height_map(path, points, measured.pixel_mm),
    )


def error_figure(measured: Measurement) -> Figure:
    """Return the error of z against the truth."""
    return Figure(
        "truth_error",
        "Error of z",
        "Measured minus true z in µm on a scale symmetric about 0; the standard deviation that is "
        "predicted from camera noise and filter bias; and the distribution of both. A good "
        "measurement looks like noise, without stripes or outlines, and its histogram follows the "
        "red curve.",
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
    relief, enlarged = _relief(points, pixel_mm, _VIEW_CELLS).trimmed(), z_enlargement(points)
    norm = _norm(relief)
    with drawing(path, 10.0, 5.4) as figure:
        axes: Any = figure.add_axes((0.0, 0.02, 0.9, 1.0), projection="3d", computed_zorder=False)
        assert isinstance(axes, Axes3D)
        x_mm, y_mm = np.meshgrid(relief.x_mm, relief.y_mm)
        surface = _Surface(x_mm, y_mm, relief.values)
        surface.colour(shaded(relief, norm, enlarged, _VIEW_LIGHT_DEG))
        axes.add_collection(surface, autolim=False)
        _frame_view(axes, relief, norm, enlarged)
        bar = figure.colorbar(
            ScalarMappable(norm, sequential()), cax=figure.add_axes((0.92, 0.2, 0.013, 0.6))
        )
        bar.set_label("z (mm)")


class _Surface(QuadMesh):
    """A surface over a grid in a 3-D view, as one artist: polygons take ten times the time.

    Seen from +x and -y, as `_frame_view` does, cells are painted from far to near in this order:
    y falling, x growing.

    Parameters
    ----------
    x_mm, y_mm, z_mm : (row, col) float, ascending along col and row; cells that touch a masked z
        are left out
    """

    def __init__(
        self, x_mm: FloatArray, y_mm: FloatArray, z_mm: "np.ma.MaskedArray[Any, Any]"
    ) -> None:
        holes = np.ma.getmaskarray(z_mm)[::-1]
        self._missing = holes[1:, 1:] | holes[1:, :-1] | holes[:-1, 1:] | holes[:-1, :-1]
        self._points_mm = [values[::-1] for values in (x_mm, y_mm, z_mm.filled(0.0))]
        super().__init__(np.zeros((*x_mm.shape, 2)), antialiased=False, clip_on=False)

    def colour(self, rgba: NDArray[Any]) -> None:
        """Colour every cell as the corner at its smallest x and y."""
        cells = rgba[::-1][1:, :-1].copy()
        cells[self._missing] = 0.0
        colours: Any = cells.reshape(-1, 4)
        self.set_facecolor(colours)

    def do_3d_projection(self) -> float:
        """Put the corners where the view shows them, as Matplotlib asks before it draws."""
        axes: Any = self.axes
        flat = (values.ravel() for values in self._points_mm)
        x, y, _ = proj_transform(*flat, axes.get_proj())
        self._coordinates = np.stack([x, y], axis=-1).reshape(*self._points_mm[0].shape, 2)
        return 0.0


def draw_height_map(path: Path, points: SurfacePoints, pixel_mm: float) -> None:
    """Draw the measured heights in top view, shaded, as PNG."""
    relief = _relief(points, pixel_mm, _MAP_CELLS)
    norm = _norm(relief)
    rows, cols = relief.values.shape
    with drawing(path, 10.0, 0.75 + 8.2 * rows / cols) as figure:
        axes = axes_at(figure, 0.65, 0.15, 8.2, 8.2 * rows / cols)
        axes.imshow(
            shaded(relief, norm, z_enlargement(points)),
            origin="lower",
            extent=relief.extent_mm,
        )
        axes.contour(
            relief.x_mm,
            relief.y_mm,
            relief.values,
            levels=contour_levels(float(norm.vmin or 0.0), float(relief.values.max())),
            colors="white",
            linewidths=0.5,
            alpha=0.6,
        )
        axes.set(xlabel="x (mm)", ylabel="y (mm)")
        add_colorbar(axes, ScalarMappable(norm, sequential()), "z (mm)")


def _relief(points: SurfacePoints, pixel_mm: float, cells: int) -> WorldMap:
    found = at_pixels(points.world_mm, points.valid)
    return average_on_grid(found, found[:, 2], pixel_mm, cells)


def _norm(relief: WorldMap) -> Normalize:
    return Normalize(*height_scale(relief.values))


def shaded(
    relief: WorldMap, norm: Normalize, enlarged: float, light_deg: float = _MAP_LIGHT_DEG
) -> NDArray[Any]:
    """Colour by height times hill shading of the enlarged surface, (row, col, rgba); holes white.

    `light_deg` is where the light comes from, clockwise from the top of the map.
    """
    holes = np.ma.getmaskarray(relief.values)
    # Holes take the nearest height, or their edges would be shaded as cliffs.
    nearest = distance_transform_edt(holes, return_distances=False, return_indices=True)
    filled = relief.values.data[tuple(nearest)]
    # Rows grow upwards here; hillshade takes them to grow downwards.
    light = LightSource(light_deg, _LIGHT_HEIGHT_DEG).hillshade(
        filled, vert_exag=enlarged, dx=relief.pitch_mm, dy=-relief.pitch_mm
    )
    shaded = sequential()(norm(filled))
    # Only darkened and brightened: another blend would change the hues of the colour bar.
    shaded[..., :3] = np.clip(shaded[..., :3] * (0.45 + 0.7 * light[..., None]), 0.0, 1.0)
    shaded[holes] = (1.0, 1.0, 1.0, 1.0)
    return np.asarray(shaded)


def _frame_view(axes: Any, relief: WorldMap, norm: Normalize, enlarged: float) -> None:
    left, right, bottom, top = relief.extent_mm
    low, high = min(0.0, float(relief.values.min())), float(relief.values.max())
    axes.set(xlim=(left, right), ylim=(bottom, top), zlim=(low, high))
    axes.set_box_aspect((right - left, top - bottom, (high - low) * enlarged), zoom=1.25)
    axes.view_init(elev=32, azim=-62)
    axes.set(xlabel="x (mm)", ylabel="y (mm)")
    axes.set_zlabel("z (mm)")
    axes.zaxis.set_major_locator(MaxNLocator(3))
    for pane in (axes.xaxis, axes.yaxis, axes.zaxis):
        pane.set_pane_color((0.97, 0.975, 0.98, 1.0))


_BINS, _SIGMAS = 121, 200


def draw_truth_error(
    path: Path, reconstruction: Reconstruction, truth: Truth, pixel_mm: float
) -> None:
    """Draw the error map, the predicted sigma and the histogram of errors as PNG."""
    both = reconstruction.point_map.valid & truth.lit
    points = at_pixels(truth.points_world_mm, both)
    found_mm = at_pixels(reconstruction.point_map.points_world_mm, both)
    error_um = 1e3 * (found_mm[:, 2] - points[:, 2]).astype(float)
    sigma_um = 1e3 * at_pixels(reconstruction.point_map.sigma_z_mm, both).astype(float)
    limit_um = symmetric_limit(error_um, 99.5)
    with drawing(path, 10.0, 6.7) as figure:
        cells = average_on_grid(points, error_um, pixel_mm, _MAP_CELLS)
        draw_map(
            axes_at(figure, 0.65, 0.35, 3.45, 2.65),
            cells.values,
            cells.extent_mm,
            "z error, measured − true face",
            "z error (µm)",
            cmap=diverging(),
            ends=(-limit_um, limit_um),
            extend="both",
        )
        cells = average_on_grid(points, sigma_um, pixel_mm, _MAP_CELLS)
        draw_map(
            axes_at(figure, 5.75, 0.35, 3.45, 2.65),
            cells.values,
            cells.extent_mm,
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
        label="predicted from σ alone (no bias)",
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
    """Density of zero-mean normal errors whose sigma differs from pixel to pixel.

    The mixture is taken over quantiles of sigma: enough of them look like all pixels.
    """
    levels = np.quantile(sigma_um, (np.arange(_SIGMAS) + 0.5) / _SIGMAS)
    levels = np.maximum(levels, 1e-9)
    densities = np.exp(-0.5 * (error_um[:, None] / levels) ** 2) / levels
    return np.asarray(densities.mean(axis=1) / np.sqrt(2.0 * np.pi))
