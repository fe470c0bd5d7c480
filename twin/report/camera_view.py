"""Panels in camera pixels: frame, heights, error and reasons of one measurement, pixel on pixel.

All panels of a measurement show the same pixels at the same place, so that a gap in the heights
can be looked up in the frame beside it. Row 0 is the top, as in the image.
"""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap, Normalize
from numpy.typing import NDArray

from reconstruction.arrays import Reason
from reconstruction.capture.folder import Capture
from reconstruction.patterns import PatternFrame
from twin.report.canvas import GAP, add_colorbar, diverging, height_scale, round_up, sequential
from twin.report.decoding import REASON_COLOURS
from twin.report.frames import block_mean
from twin.report.relief import shaded
from twin.report.world_map import WorldMap, pixel_on_face_mm
from twin.results.record import Measurement
from twin.results.score import wanted_pixels

NO_POINT = "#c3cbd4"
"""Darker than other gaps: no error is white, and must not look like no point."""

_SHOWN_PX = 480
# The relief fills at least this share of the field's width, as in the report's other views.
_RELIEF_SHARE = 0.2


def white_frame(capture: Capture) -> PatternFrame:
    """Return the white frame of a sequence."""
    frames = capture.patterns.frames[capture.patterns.index("white")]
    return frames[0]


def fringe_frame(capture: Capture) -> PatternFrame:
    """Return the first phase frame with vertical fringes."""
    frames = capture.patterns.frames[capture.patterns.index("phase", "column")]
    return frames[0]


def wanted(scored: Measurement) -> NDArray[np.bool_]:
    """Pixels that ought to give a point, (row, col)."""
    return wanted_pixels(scored.experiment, scored.truth)


def error_um(scored: Measurement) -> "np.ma.MaskedArray[Any, Any]":
    """Measured minus true world z, um, (row, col); masked where there is no wanted point."""
    points = scored.fringes.reconstruction.point_map
    difference = points.points_world_mm[..., 2] - scored.truth.points_world_mm[..., 2]
    missing = ~(points.valid & wanted(scored))
    return np.ma.masked_array(1e3 * difference.astype(np.float64), mask=missing)


def true_scale_mm(scored: Measurement) -> tuple[float, float]:
    """Round ends of a scale of the true heights that the camera sees; wrong points do not count."""
    seen = scored.truth.depth_mm > 0
    return height_scale(scored.truth.points_world_mm[seen][:, 2]) if seen.any() else (0.0, 1.0)


def show_frame(axes: Axes, capture: Capture, frame: PatternFrame) -> None:
    """Show a frame's digital numbers: black is 0, white is saturation."""
    image = capture.stack[capture.patterns.frames.index(frame)]
    small = block_mean(image, -(-max(image.shape) // _SHOWN_PX))
    axes.imshow(small, cmap="gray", vmin=0, vmax=capture.sensor.saturation_dn)
    _plain(axes)


def show_measured(axes: Axes, measured: Measurement, bar: bool = True) -> None:
    """Show the measured heights, shaded; pixels without a point stay white."""
    points = measured.fringes.reconstruction.point_map
    z_mm = np.ma.masked_array(points.points_world_mm[..., 2].astype(np.float64), ~points.valid)
    _show_heights(axes, measured, z_mm, bar)


def show_true(axes: Axes, measured: Measurement) -> None:
    """Show the true heights, shaded, on the same scale as the measured ones."""
    truth = measured.truth
    z_mm = np.ma.masked_array(truth.points_world_mm[..., 2].astype(np.float64), truth.depth_mm <= 0)
    _show_heights(axes, measured, z_mm, bar=True)


def shading_enlargement(scored: Measurement) -> float:
    """Return by how much shading enlarges z: a round number, at least 1."""
    low_mm, high_mm = true_scale_mm(scored)
    width_mm = scored.truth.lit.shape[1] * pixel_on_face_mm(scored.experiment)
    return max(1.0, round_up(_RELIEF_SHARE * width_mm / (high_mm - low_mm)))


def show_error(axes: Axes, scored: Measurement) -> None:
    """Show the error of z; beyond the limit of a good point it keeps the colour of the end."""
    limit_um = scored.experiment.score.good_within_um
    colours = diverging().with_extremes(bad=NO_POINT)
    shown = axes.imshow(_every_nth(error_um(scored)), cmap=colours, vmin=-limit_um, vmax=limit_um)
    _plain(axes)
    add_colorbar(axes, shown, "z error (µm), clipped at the ends", extend="both", side="below")


def show_reasons(axes: Axes, scored: Measurement) -> None:
    """Show why wanted pixels have no point; the others are pale gray."""
    reason = scored.fringes.reconstruction.point_map.mask_reason
    colours = ListedColormap([REASON_COLOURS[r] for r in Reason]).with_extremes(bad=GAP)
    norm = BoundaryNorm(np.arange(len(Reason) + 1) - 0.5, len(Reason))
    axes.imshow(_every_nth(np.ma.masked_array(reason, ~wanted(scored))), cmap=colours, norm=norm)
    _plain(axes)


def _show_heights(
    axes: Axes, measured: Measurement, z_mm: "np.ma.MaskedArray[Any, Any]", bar: bool
) -> None:
    norm = Normalize(*true_scale_mm(measured))
    coarse = _every_nth(z_mm)
    if coarse.count():
        axes.imshow(shaded(_upwards(measured, coarse), norm, shading_enlargement(measured))[::-1])
    else:
        axes.imshow(np.ones((*coarse.shape, 3)))
    _plain(axes)
    if bar:
        shown = ScalarMappable(norm, sequential())
        add_colorbar(axes, shown, "z (mm)", extend="both", side="below")


def _upwards(scored: Measurement, z_mm: "np.ma.MaskedArray[Any, Any]") -> WorldMap:
    """Heights in camera pixels as the shading wants them: rows grow upwards, lengths in mm."""
    rows, cols = z_mm.shape
    pitch_mm = pixel_on_face_mm(scored.experiment) * scored.truth.lit.shape[1] / cols
    return WorldMap(z_mm[::-1], pitch_mm * np.arange(cols), pitch_mm * np.arange(rows), pitch_mm)


def _every_nth(values: Any) -> Any:
    """Thin out: heights and codes must not be averaged across edges."""
    step = -(-max(values.shape) // _SHOWN_PX)
    return values[::step, ::step]


def _plain(axes: Axes) -> None:
    axes.set(xticks=[], yticks=[])
