"""Draw measured surfaces as shaded pictures in an oblique view; missing points are holes.

Neighbouring points are joined except across jumps, as in the mesh files. Heights are enlarged about
z = 0 by a stated factor; colours show the heights without enlargement.
"""

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from reconstruction.evaluate.surface import CUT_OVER_TYPICAL
from twin.optics.view import SceneSurface, SceneView
from twin.paper.panels import PanelData, Picture
from twin.report.canvas import FAINT, add_colorbar, no_ticks
from twin.report.relief import enlargement, height_scale_of, relief_picture

# The light is on the left, slightly behind.
_LIGHT_DEG = 287.0
_LIFT_RAD = float(np.arctan2(0.66, 0.75))
_MARGIN_MM = 3.0


@dataclass(frozen=True)
class ReliefView:
    """View and colour scale that compared surfaces have in common.

    Attributes
    ----------
    scale_mm : heights at the ends of the colour scale
    centre_mm, half_mm : centre (world xy) and half width of the square region that is shown
    gain : factor of enlargement of z
    """

    scale_mm: tuple[float, float]
    centre_mm: tuple[float, float]
    half_mm: float
    gain: float


def stage_for(*shown: PanelData) -> ReliefView:
    """Return the common view and colour scale for the surfaces of several measurements."""
    low = min(data.numbers.scale_mm[0] for data in shown)
    high = max(data.numbers.scale_mm[1] for data in shown)
    outlines = np.array([data.numbers.outline_mm for data in shown])
    x_low, y_low = (float(v) for v in outlines[:, ::2].min(axis=0))
    x_high, y_high = (float(v) for v in outlines[:, 1::2].max(axis=0))
    needed_mm = max(x_high - x_low, y_high - y_low) / 2 + _MARGIN_MM
    half = min(needed_mm, max(data.numbers.half_field_mm[0] for data in shown))
    gain = enlargement(2 * half, high - low)
    return ReliefView((low, high), ((x_low + x_high) / 2, (y_low + y_high) / 2), half, gain)


def draw_relief(
    data: PanelData, stage: ReliefView, width_px: int = 480, height_px: int = 360
) -> Picture:
    """Return a picture of the measured surface, (row, col, 3) uint8; white outside the surface."""
    return relief_picture(_surface(data, stage), _view(stage, width_px, height_px), _LIGHT_DEG)


def show_relief(axes: Axes, data: PanelData, stage: ReliefView, bar: bool = False) -> None:
    """Draw the measured surface and the enlargement of its z; with `bar`, also a colour bar."""
    axes.imshow(draw_relief(data, stage))
    no_ticks(axes)
    axes.spines[:].set_visible(False)
    shown = f"z × {stage.gain:g}"
    axes.text(
        0.99, 0.98, shown, transform=axes.transAxes, ha="right", va="top", color=FAINT, fontsize=6
    )
    if bar:
        show_scale(axes, stage)


def show_scale(axes: Axes, stage: ReliefView) -> None:
    """Add the colour bar of heights (mm) below a picture."""
    add_colorbar(axes, height_scale_of(*stage.scale_mm), "z (mm)", extend="both", side="below")


def _surface(data: PanelData, stage: ReliefView) -> SceneSurface:
    """Return the measured points in the shown region as a surface over camera pixels.

    Points far outside the height scale are omitted.
    """
    points = data.points_mm
    away = np.abs(points[..., :2] - np.array(stage.centre_mm)).max(axis=-1)
    # Outliers would conceal all other points; keep a margin of 50 % of the height range.
    low, high = stage.scale_mm
    room = (high - low) / 2
    z = points[..., 2]
    shown_points = data.valid & (away <= stage.half_mm) & (z >= low - room) & (z <= high + room)
    shown = np.where(shown_points[..., np.newaxis], points, np.nan)
    scale = height_scale_of(low, high)
    return SceneSurface.of_grid("heights", shown, shown[..., 2], scale, cut=CUT_OVER_TYPICAL)


def _view(stage: ReliefView, width_px: int, height_px: int) -> SceneView:
    (x, y), low, high = stage.centre_mm, *stage.scale_mm
    return SceneView.around(
        (x, y, stage.gain * (low + high) / 2),
        2.25 * stage.half_mm,
        0.0,
        _LIFT_RAD,
        8.0 * stage.half_mm,  # nearly parallel: lengths in front and behind compare
        width_px=width_px,
        height_px=height_px,
        enlarged=stage.gain,
    )
