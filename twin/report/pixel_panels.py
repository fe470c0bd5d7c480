"""Panels over camera pixels, for all methods: image, heights, z error, reasons for missing points.

All panels of a measurement show the same pixels at the same position, so that a gap in the heights
can be compared with the image next to it. Row 0 is the top, as in the image.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from numpy.typing import NDArray

from reconstruction.arrays import BoolImage, Levels, Reason
from reconstruction.cells import CellMeans
from twin.report.canvas import (
    GAP,
    add_colorbar,
    axes_at,
    diverging,
    drawing,
    height_scale,
    no_ticks,
)
from twin.report.relief import enlargement, height_scale_of, height_surface, shaded
from twin.results.record import Measurement
from twin.results.score import wanted_pixels

Masked = Any
"""Masked array (row, col); numpy has no useful type for it."""
NO_POINT = "#c3cbd4"
"""Colour of missing points in error maps. It is darker than `GAP`, because an error of 0 is white
and must differ clearly from a missing point."""
REASON_COLOURS = {
    Reason.VALID: "#d5e8da",
    Reason.DARK: "#2f3640",
    Reason.LOW_MODULATION: "#7f8c9b",
    Reason.SATURATED: "#d7263d",
    Reason.ORDER_UNCERTAIN: "#f2a541",
    Reason.OUTSIDE_PROJECTOR: "#8e6bbf",
    Reason.EDGE: "#5fa8d3",
    Reason.EPIPOLAR_MISMATCH: "#e36bae",
    Reason.NO_POINT: "#8a5a00",
    Reason.MOTION: "#1b9e77",
}
_SHOWN_PX = 480
_SIDE_IN, _WIDTH_IN, _BAR_IN = 0.02, 3.0, 0.95


@dataclass(frozen=True)
class ZScale:
    """Colour scale and shading that compared height maps have in common.

    Attributes
    ----------
    ends_mm : heights at the ends of the colour scale, round numbers
    enlarged : factor on z for the shading: a round number, at least 1
    """

    ends_mm: tuple[float, float]
    enlarged: float

    @classmethod
    def of(cls, z_mm: NDArray[Any], width_mm: float) -> "ZScale":
        """Return the scale for heights (n,), mm, in an image of width `width_mm` on the coat."""
        low, high = height_scale(z_mm) if z_mm.size else (0.0, 1.0)
        return cls((low, high), enlargement(width_mm, high - low))


def draw_small(path: Path, show: Callable[[Axes], None], shape: tuple[int, int], bar: bool) -> None:
    """Draw one panel as a small PNG.

    Parameters
    ----------
    show : function that draws the panel on axes
    shape : (row, col) of the image
    bar : True: add space for a colour bar below the panel
    """
    inside_in = _WIDTH_IN - 2 * _SIDE_IN
    height_in, below_in = inside_in * shape[0] / shape[1], _BAR_IN if bar else _SIDE_IN
    with drawing(path, _WIDTH_IN, _SIDE_IN + height_in + below_in) as figure:
        show(axes_at(figure, _SIDE_IN, _SIDE_IN, inside_in, height_in))


def show_picture(axes: Axes, image: Levels) -> None:
    """Draw an 8-bit image, either in colours or in gray (0 is black, 255 is white)."""
    axes.imshow(image, cmap="gray", vmin=0, vmax=255)
    no_ticks(axes)


def show_z(
    axes: Axes,
    z_mm: Masked,
    width_mm: float,
    scale: ZScale,
    *,
    bar: bool = True,
    extent: tuple[float, float, float, float] | None = None,
) -> None:
    """Draw heights (row, col), mm, coloured and shaded; masked pixels are white.

    Parameters
    ----------
    width_mm : width of the image on the coat
    bar : True: draw a colour bar below the map
    extent : left, right, bottom, top of the image in the coordinates of the axes; None: pixels
    """
    colours, (rows, cols) = height_scale_of(*scale.ends_mm), z_mm.shape
    pitch_mm = width_mm / cols
    x_mm, y_mm = pitch_mm * np.arange(cols), -pitch_mm * np.arange(rows)
    pixels = CellMeans(x_mm, y_mm, z_mm.data, ~np.ma.getmaskarray(z_mm), pitch_mm)
    surface = height_surface("heights", pixels, colours)
    axes.imshow(shaded(surface, scale.enlarged), extent=extent)
    if bar:
        add_colorbar(axes, colours, "z (mm)", extend="both", side="below")


def show_z_error(axes: Axes, error_um: Masked, limit_um: float, bar: bool = True) -> None:
    """Draw z errors (row, col), um, on a colour scale from -limit to limit.

    Errors beyond the ends have the colours of the ends.
    """
    colours = diverging().with_extremes(bad=NO_POINT)
    shown = axes.imshow(error_um, cmap=colours, vmin=-limit_um, vmax=limit_um)
    no_ticks(axes)
    if bar:
        add_colorbar(axes, shown, "z error (µm), clipped at the ends", extend="both", side="below")


def show_codes(axes: Axes, reason: Masked, **options: Any) -> None:
    """Draw reason codes (row, col) in the colours `REASON_COLOURS`; masked pixels are pale gray."""
    colours = ListedColormap([REASON_COLOURS[r] for r in Reason]).with_extremes(bad=GAP)
    norm = BoundaryNorm(np.arange(len(Reason) + 1) - 0.5, len(Reason))
    axes.imshow(reason, cmap=colours, norm=norm, **options)


def scored_pixels(measured: Measurement) -> BoolImage:
    """Return True for the scored pixels, which should have a point, (row, col)."""
    return wanted_pixels(measured.experiment, measured.truth)


def error_um(measured: Measurement) -> Masked:
    """Return measured minus true world z, um, (row, col).

    Pixels that are not scored or have no point are masked.
    """
    points, true_mm = measured.points, measured.truth.points_world_mm
    difference = (points.world_mm[..., 2] - true_mm[..., 2]).astype(np.float64)
    return np.ma.masked_array(1e3 * difference, mask=~(points.valid & scored_pixels(measured)))


def true_scale(measured: Measurement) -> ZScale:
    """Return the height scale for the true heights in view, which wrong points do not change."""
    truth = measured.truth
    return ZScale.of(truth.points_world_mm[truth.depth_mm > 0][:, 2], width_mm(measured))


def shading_words(measured: Measurement) -> str:
    """Return the words, in brackets, on the enlargement of z by the shading; empty if it is 1."""
    enlarged = true_scale(measured).enlarged
    return "" if enlarged == 1 else f" (shading enlarges z {enlarged:g} times)"


def width_mm(measured: Measurement) -> float:
    """Return the width, mm, of the image on the flat coat."""
    return float(measured.pixel_mm * measured.truth.lit.shape[1])


def show_measured(axes: Axes, measured: Measurement, bar: bool = True) -> None:
    """Draw the map of measured heights, on the colour scale of the true heights."""
    points = measured.points
    _show(axes, measured, points.world_mm[..., 2], points.valid, bar)


def show_true(axes: Axes, measured: Measurement) -> None:
    """Draw the map of true heights, on the same colour scale as the measured heights."""
    truth = measured.truth
    _show(axes, measured, truth.points_world_mm[..., 2], truth.depth_mm > 0, bar=True)


def show_error(axes: Axes, measured: Measurement) -> None:
    """Draw the map of the z error; the scale ends at the largest error of a good point."""
    show_z_error(axes, thinned(error_um(measured)), measured.experiment.score.good_within_um)


def show_reasons(axes: Axes, measured: Measurement) -> None:
    """Draw the map of reasons why scored pixels have no point; other pixels are pale gray."""
    show_codes(axes, thinned(np.ma.masked_array(measured.points.reason, ~scored_pixels(measured))))
    no_ticks(axes)


def thinned(values: Any, most_px: int = _SHOWN_PX) -> Any:
    """Return every nth row and column, so that no side is longer than `most_px` pixels.

    Pixels are not averaged, because a mean across an edge is no valid height or code.
    """
    step = -(-max(values.shape[:2]) // most_px)
    return values[::step, ::step]


def _show(
    axes: Axes, measured: Measurement, z_mm: NDArray[Any], there: BoolImage, bar: bool
) -> None:
    shown = thinned(np.ma.masked_array(z_mm.astype(np.float64), ~there))
    show_z(axes, shown, width_mm(measured), true_scale(measured), bar=bar)
    no_ticks(axes)
