"""Measured surfaces as shaded pictures seen obliquely; a missing point is a hole.

Neighbouring points are joined to triangles except across jumps, as in the mesh files. Height is
enlarged about z = 0 by a stated factor; colour is the true height's scale.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from numpy.typing import NDArray

from reconstruction.arrays import Reason
from reconstruction.errors import InputError
from reconstruction.evaluate.surface import SurfaceMesh, surface_mesh
from reconstruction.triangulation import PointMap
from twin.optics.view import ViewCamera, VisibleSurface, visible_surface
from twin.paper.panels import PanelData, Picture
from twin.report.canvas import FAINT, add_colorbar, no_ticks, round_up, sequential

# Rays per pixel along each axis: edges without stairs.
_FINER = 2
_TOWARDS_LAMP = (-0.8, 0.25, 0.9)
_EYE = (0.0, -0.75, 0.66)
_AMBIENT, _LAMP, _SHADOW = 0.42, 0.68, 0.3
_RELIEF_SHARE = 0.2
_MARGIN_MM = 3.0


@dataclass(frozen=True)
class ReliefView:
    """How reliefs that are compared are shown alike.

    Attributes
    ----------
    scale_mm : ends of the colour scale
    centre_mm, half_mm : middle of what is shown, world xy, and half of its width
    gain : enlargement of z
    """

    scale_mm: tuple[float, float]
    centre_mm: tuple[float, float]
    half_mm: float
    gain: float


def stage_for(*shown: PanelData) -> ReliefView:
    """Return one way of showing several measurements."""
    low = min(one.numbers.scale_mm[0] for one in shown)
    high = max(one.numbers.scale_mm[1] for one in shown)
    outlines = np.array([one.numbers.outline_mm for one in shown])
    x_low, y_low = (float(v) for v in outlines[:, ::2].min(axis=0))
    x_high, y_high = (float(v) for v in outlines[:, 1::2].max(axis=0))
    wanted = max(x_high - x_low, y_high - y_low) / 2 + _MARGIN_MM
    half = min(wanted, max(one.numbers.half_field_mm[0] for one in shown))
    gain = max(1.0, round_up(_RELIEF_SHARE * 2 * half / max(high - low, 1e-6)))
    return ReliefView((low, high), ((x_low + x_high) / 2, (y_low + y_high) / 2), half, gain)


def relief_picture(
    data: PanelData, stage: ReliefView, width_px: int = 480, height_px: int = 360
) -> Picture:
    """Return the measured surface as (row, col, 3) uint8; white where there is none.

    Raises
    ------
    MissingBackend
        No usable Dr.Jit backend.
    """
    mesh = _mesh(data, stage)
    if mesh is None:
        return np.full((height_px, width_px, 3), 255, np.uint8)
    observer = _view_camera(stage, width_px * _FINER, height_px * _FINER)
    enlarged = mesh.vertices_mm * np.array([1.0, 1.0, stage.gain], np.float32)
    colours = _colours(visible_surface(enlarged, mesh.triangles, observer, _TOWARDS_LAMP), stage)
    blocks = colours.reshape(height_px, _FINER, width_px, _FINER, 3)
    return np.asarray(np.rint(255.0 * blocks.mean(axis=(1, 3))), np.uint8)


def show_relief(axes: Axes, data: PanelData, stage: ReliefView, bar: bool = False) -> None:
    """Show the measured surface with its enlargement, and a colour bar when asked for."""
    axes.imshow(relief_picture(data, stage))
    no_ticks(axes)
    axes.spines[:].set_visible(False)
    shown = f"z × {stage.gain:g}"
    axes.text(
        0.99, 0.98, shown, transform=axes.transAxes, ha="right", va="top", color=FAINT, fontsize=6
    )
    if bar:
        show_scale(axes, stage)


def show_scale(axes: Axes, stage: ReliefView) -> None:
    """Put the colour bar of heights below a picture."""
    shown = ScalarMappable(Normalize(*stage.scale_mm), sequential())
    add_colorbar(axes, shown, "z (mm)", extend="both", side="below")


def _mesh(data: PanelData, stage: ReliefView) -> SurfaceMesh | None:
    points = data.points_mm
    away = np.abs(points[..., :2] - np.array(stage.centre_mm)).max(axis=-1)
    # Wildly wrong points would hide all others; half the height range beyond it is room enough.
    low, high = stage.scale_mm
    room = (high - low) / 2
    z = points[..., 2]
    kept = data.valid & (away <= stage.half_mm) & (z >= low - room) & (z <= high + room)
    codes = np.where(kept, Reason.VALID, Reason.DARK).astype(np.uint8)
    try:
        return surface_mesh(PointMap(points, np.zeros_like(points), codes, np.eye(4)))
    except InputError:  # no three neighbours
        return None


def _view_camera(stage: ReliefView, width_px: int, height_px: int) -> ViewCamera:
    (x, y), low, high = stage.centre_mm, *stage.scale_mm
    middle = (x, y, stage.gain * (low + high) / 2)
    distance = 8.0 * stage.half_mm  # nearly parallel: lengths in front and behind compare
    across, aside, up = (m + distance * e for m, e in zip(middle, _EYE, strict=True))
    eye = (across, aside, up)
    return ViewCamera(eye, middle, 2.25 * stage.half_mm, width_px, height_px)


def _colours(seen: VisibleSurface, stage: ReliefView) -> NDArray[np.float64]:
    """Colour by height times the light of sky and lamp, (row, col, rgb); white where nothing is."""
    z_mm = seen.points_mm[..., 2] / stage.gain
    lamp = np.array(_TOWARDS_LAMP) / np.linalg.norm(_TOWARDS_LAMP)
    cosine = np.clip(seen.normals @ lamp, 0.0, 1.0)
    light = _AMBIENT + _LAMP * cosine * np.where(seen.sunlit, 1.0, _SHADOW)
    colours: Any = sequential()(Normalize(*stage.scale_mm)(z_mm))[..., :3]
    shaded = np.clip(colours * light[..., None], 0.0, 1.0)
    return np.asarray(np.where(seen.hit[..., None], shaded, 1.0))
