"""Figures of the measured relief: shaded 3-D view, and shaded height map in top view."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LightSource, Normalize
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.axes3d import Axes3D  # type: ignore[import-untyped]
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from twin.report.canvas import (
    add_colorbar,
    axes_at,
    contour_levels,
    drawing,
    height_scale,
    round_up,
    sequential,
)
from twin.report.world_map import WorldMap, average_on_grid
from twin.results.record import SurfacePoints

_VIEW_CELLS, _MAP_CELLS = 120, 480
# The relief fills about this share of the field's width in the 3-D view.
_VIEW_HEIGHT_SHARE = 0.2
# The map is lit from the upper left, as readers of maps expect; the view from where one stands.
_MAP_LIGHT_DEG, _VIEW_LIGHT_DEG, _LIGHT_HEIGHT_DEG = 315.0, 225.0, 40.0


def z_enlargement(points: SurfacePoints) -> float:
    """Return by how much the 3-D view enlarges z: a round number, at least 1."""
    found = points.world_mm[points.valid]
    if not len(found):
        return 1.0
    width_mm, height_mm = float(np.ptp(found[:, 0])), float(np.ptp(found[:, 2]))
    wanted = _VIEW_HEIGHT_SHARE * width_mm / max(height_mm, 1e-9)
    return max(1.0, round_up(wanted))


def draw_relief_view(path: Path, points: SurfacePoints, pixel_mm: float) -> None:
    """Draw the measured surface as a shaded 3-D view, as PNG.

    Raises
    ------
    InputError
        `path` cannot be written.
    """
    relief, enlarged = _relief(points, pixel_mm, _VIEW_CELLS).trimmed(), z_enlargement(points)
    norm = _norm(relief)
    with drawing(path, 10.0, 5.4) as figure:
        axes: Any = figure.add_axes((0.0, 0.02, 0.9, 1.0), projection="3d", computed_zorder=False)
        assert isinstance(axes, Axes3D)
        x_mm, y_mm = np.meshgrid(relief.x_mm, relief.y_mm)
        axes.plot_surface(
            x_mm,
            y_mm,
            relief.values.filled(np.nan),
            rcount=_VIEW_CELLS,
            ccount=_VIEW_CELLS,
            facecolors=shaded(relief, norm, enlarged, _VIEW_LIGHT_DEG),
            linewidth=0,
            antialiased=False,
            shade=False,
            clip_on=False,
        )
        _frame_view(axes, relief, norm, enlarged)
        bar = figure.colorbar(
            ScalarMappable(norm, sequential()), cax=figure.add_axes((0.92, 0.2, 0.013, 0.6))
        )
        bar.set_label("z (mm)")


def draw_height_map(path: Path, points: SurfacePoints, pixel_mm: float) -> None:
    """Draw the measured heights in top view, shaded, as PNG.

    Raises
    ------
    InputError
        `path` cannot be written.
    """
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
    found = points.world_mm[points.valid]
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
