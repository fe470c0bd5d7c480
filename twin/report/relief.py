"""Draw surfaces over a grid with Matplotlib: shaded, in top view or in an oblique view.

Points are averaged on square cells, so that maps are in mm for every camera pose. Coordinates are
in the world frame, mm. Row 0 of a grid is at the top and has the largest y.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import QuadMesh
from matplotlib.colors import LightSource, Normalize
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.proj3d import proj_transform  # type: ignore[import-untyped]
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from reconstruction.arrays import FloatArray, Levels
from reconstruction.cells import CellMeans, SquareCells, box_of
from twin.optics.view import Numbers, SceneSurface, SceneView
from twin.report.canvas import draw_map, round_up, sequential

# Smallest width of a cell, in camera pixels. Smaller cells of an oblique camera could be empty.
_PIXELS_PER_CELL = 2.0
# Direction of the light, clockwise from the top of the map: maps have light from the upper left, as
# usual for maps; oblique views have light from the side of the eye.
MAP_LIGHT_DEG, VIEW_LIGHT_DEG = 315.0, 225.0
_LIGHT_HEIGHT_DEG = 40.0
_AMBIENT, _LAMP = 0.45, 0.7
# Height of an enlarged relief as a share of its width.
_RELIEF_SHARE = 0.2
# Painted pixels per pixel of a picture along each axis; averages have smooth edges.
FINER = 2


def average_on_grid(
    points_world_mm: NDArray[Any], values: NDArray[Any], pixel_mm: float, most_cells: int
) -> CellMeans:
    """Return the means of `values` (n,) at points (n, xyz), world mm, on square cells in xy.

    At least one point is required.

    Parameters
    ----------
    pixel_mm : size of a camera pixel; a cell is at least two pixels wide
    most_cells : largest number of cells along the longer side
    """
    points_mm = points_world_mm[:, :2].astype(float)
    low_mm, high_mm = box_of(points_mm)
    pitch_mm = max(_PIXELS_PER_CELL * pixel_mm, float((high_mm - low_mm).max()) / most_cells)
    corner_mm = float(low_mm[0]), float(low_mm[1])
    return SquareCells.of(points_mm, pitch_mm, corner_mm).means(values.astype(float))


def masked(cells: CellMeans) -> Any:
    """Return the means as a masked array (row, col); cells without a point are masked."""
    return np.ma.masked_array(cells.mean, ~cells.valid)


def draw_cells(axes: Axes, cells: CellMeans, title: str, label: str, **options: Any) -> None:
    """Draw the map of means over world x and y; `options` are those of `draw_map`."""
    draw_map(axes, masked(cells)[::-1], cells.extent_mm, title, label, **options)


def trimmed(cells: CellMeans) -> CellMeans:
    """Return cells without border rows and columns that are filled by less than 50 %.

    In perspective images, the border of the measured surface is irregular.
    """
    rows = np.flatnonzero(cells.valid.mean(axis=1) >= 0.5)
    cols = np.flatnonzero(cells.valid.mean(axis=0) >= 0.5)
    if not rows.size or not cols.size:
        return cells
    down, across = slice(rows[0], rows[-1] + 1), slice(cols[0], cols[-1] + 1)
    mean, valid = cells.mean[down, across], cells.valid[down, across]
    return CellMeans(cells.x_mm[across], cells.y_mm[down], mean, valid, cells.pitch_mm)


def enlargement(width_mm: float, height_mm: float, share: float = _RELIEF_SHARE) -> float:
    """Return the factor on z with which a relief is as high as `share` times its width.

    The factor is rounded up to a round number, and is at least 1.
    """
    return max(1.0, round_up(share * width_mm / max(height_mm, 1e-9)))


def height_scale_of(low_mm: float, high_mm: float) -> ScalarMappable:
    """Return the colour map of heights from `low_mm` to `high_mm`."""
    return ScalarMappable(Normalize(low_mm, high_mm), sequential())


def height_surface(
    name: str, cells: CellMeans, scale: ScalarMappable, values: NDArray[Any] | None = None
) -> SceneSurface:
    """Return the surface of mean heights, coloured by height or by `values` (row, col)."""
    x_mm, y_mm = np.meshgrid(cells.x_mm, cells.y_mm)
    z_mm = np.where(cells.valid, cells.mean, np.nan)
    points_mm = np.stack([x_mm, y_mm, z_mm], axis=-1)
    return SceneSurface.of_grid(name, points_mm, z_mm if values is None else values, scale)


def shaded(
    surface: SceneSurface,
    enlarged: float,
    light_deg: float = MAP_LIGHT_DEG,
    *,
    stretched: bool = True,
) -> FloatArray:
    """Return the surface's colours times the hill shading, (row, col, rgba); holes are white.

    Parameters
    ----------
    surface : surface over a grid that is nearly regular in x and y
    enlarged : factor on z before shading
    light_deg : direction to the lamp, clockwise from the top of the map
    stretched : True: the shading is scaled so that its smallest value on the surface is 0 and its
        largest 1. False: the shading is the cosine of the angle between normal and lamp, which does
        not depend on other points
    """
    points_mm = surface.grid_mm
    rgba = np.ones((*points_mm.shape[:2], 4))
    holes = np.isnan(points_mm[..., 2])
    if holes.all():
        return rgba
    # Holes have the nearest height; otherwise, their edges would be shaded as steep slopes.
    nearest = distance_transform_edt(holes, return_distances=False, return_indices=True)
    normals = _normals(points_mm[..., 2][tuple(nearest)] * enlarged, _pitch_mm(points_mm))
    lamp = LightSource(light_deg, _LIGHT_HEIGHT_DEG)
    light = lamp.shade_normals(normals) if stretched else np.clip(normals @ lamp.direction, 0, 1)
    # Shading only darkens or brightens colours: another blend would change the hues of the scale.
    rgb = surface.rgb.reshape(rgba[..., :3].shape)
    lit = np.clip(rgb * (_AMBIENT + _LAMP * light[..., np.newaxis]), 0.0, 1.0)
    rgba[..., :3] = np.where(holes[..., np.newaxis], 1.0, lit)
    return rgba


def _normals(z_mm: Numbers, pitch_mm: float) -> Numbers:
    """Return unit normals of heights on square cells, row 0 at the top, (row, col, xyz)."""
    down, across = np.gradient(z_mm, -pitch_mm, pitch_mm)
    normals = np.stack([-across, -down, np.ones_like(z_mm)], axis=-1)
    return np.asarray(normals / np.linalg.norm(normals, axis=-1, keepdims=True))


def _pitch_mm(points_mm: Numbers) -> float:
    """Return the median distance of neighbouring grid points along x, mm."""
    return float(np.nanmedian(np.abs(np.diff(points_mm[..., 0], axis=1))))


class ReliefArtist(QuadMesh):
    """A surface over a grid in an oblique view, drawn by Matplotlib as one artist.

    One polygon per cell would take ten times as long. Cells are painted from the farthest to the
    nearest. In 3D axes, Matplotlib calls `do_3d_projection` before it draws. In 2D axes, call
    `project` to compute the pixel positions of the corners of the cells.
    """

    def __init__(self, surface: SceneSurface, view: SceneView, rgba: FloatArray) -> None:
        points_mm, cells = surface.grid_mm, surface.cells
        assert cells is not None
        # A cell has the colour of its corner at the smallest x and y.
        colours = np.where(cells[..., np.newaxis], rgba[1:, :-1], 0.0)
        steps = [_far_to_near(points_mm, axis, view) for axis in (0, 1)]
        order = np.s_[:: steps[0], :: steps[1]]
        self._points_mm = np.nan_to_num(points_mm[order])
        super().__init__(np.zeros((*points_mm.shape[:2], 2)), antialiased=False, clip_on=False)
        painted: Any = colours[order].reshape(-1, 4)
        self.set_facecolor(painted)

    def project(self, view: SceneView) -> None:
        """Set the corners of the cells to their pixel positions in a view, with z enlarged."""
        self._coordinates = view.project(self._points_mm * (1.0, 1.0, view.enlarged))

    def do_3d_projection(self) -> float:
        """Set the corners of the cells to their positions in 3D axes; Matplotlib calls this method.

        Returns 0 as depth, from which Matplotlib determines the drawing order of several artists.
        """
        axes: Any = self.axes
        x, y, _ = proj_transform(*self._points_mm.reshape(-1, 3).T, axes.get_proj())
        self._coordinates = np.stack([x, y], axis=-1).reshape(*self._points_mm.shape[:2], 2)
        return 0.0


def _far_to_near(points_mm: Numbers, axis: int, view: SceneView) -> int:
    """Return 1 if grid points approach the eye with increasing index along an axis, else -1."""
    step_mm = np.nanmean(np.diff(points_mm[..., :2], axis=axis), axis=(0, 1))
    return 1 if step_mm @ view.towards_eye[:2] >= 0 else -1


def relief_picture(
    surface: SceneSurface, view: SceneView, light_deg: float = MAP_LIGHT_DEG
) -> Levels:
    """Return a picture of a surface in an oblique view, (row, col, 3) uint8, on white."""
    rows, cols = view.height_px, view.width_px
    fine = replace(view, height_px=FINER * rows, width_px=FINER * cols)
    canvas = FigureCanvasAgg(Figure((fine.width_px / 100, fine.height_px / 100), dpi=100))
    axes: Axes = canvas.figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(-0.5, fine.width_px - 0.5), ylim=(fine.height_px - 0.5, -0.5))
    axes.axis("off")
    relief = ReliefArtist(surface, view, shaded(surface, view.enlarged, light_deg, stretched=False))
    relief.project(fine)
    axes.add_collection(relief, autolim=False)
    canvas.draw()  # type: ignore[no-untyped-call]
    buffer: Any = canvas.buffer_rgba()  # type: ignore[no-untyped-call]
    painted = np.asarray(buffer, np.float64)[..., :3]
    blocks = painted.reshape(rows, FINER, cols, FINER, 3)
    return np.asarray(np.rint(blocks.mean(axis=(1, 3))), np.uint8)
