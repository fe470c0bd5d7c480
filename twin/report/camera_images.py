"""What the camera recorded and what was made of it, in camera pixels; row 0 is the top.

All panels of a measurement show the same pixels at the same place, so that a gap in the heights
can be looked up in the frame beside it.
"""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap, Normalize
from matplotlib.patches import Patch
from numpy.typing import NDArray

from reconstruction.capture.folder import Capture
from reconstruction.decoding.decode import AxisDecode
from reconstruction.mask import Reason
from reconstruction.patterns import AXES, Axis, PatternFrame, PatternSet
from reconstruction.pipeline import Reconstruction
from twin.report.canvas import (
    FAINT,
    FIT,
    GAP,
    INK,
    MEASURED,
    TRUE_FACE,
    add_colorbar,
    axes_at,
    cyclic,
    diverging,
    drawing,
    height_scale,
    legend_above,
    no_ticks,
    plain_spines,
    round_up,
    sequential,
)
from twin.report.page import Figure
from twin.report.surfaces import WorldMap, shaded
from twin.results.record import Measurement
from twin.results.score import wanted_pixels

_COLUMNS = 5
_THUMB_PX = 260
_WIDTH_IN, _SIDE_IN, _TITLE_IN, _PROFILE_IN = 10.0, 0.05, 0.27, 2.6


def frames_figure(measured: Measurement) -> Figure:
    """Return the contact sheet of the capture."""
    return Figure(
        "frames",
        "Camera frames",
        "Pixel values in digital numbers (DN), all on one scale: black is 0, white is saturation. "
        "Look for fringes without breaks, for Gray-code edges that are sharp against a period, and "
        "for peaks that stay below the dashed saturation line.",
        "camera frames and one image row of them",
        lambda path: draw_frames(path, measured.fringes.capture),
    )


def decoding_figure(measured: Measurement) -> Figure:
    """Return the maps of the decoder."""
    return Figure(
        "decoding",
        "Phase, fringe order, modulation and masked pixels",
        "Axes in camera pixels; pale gray has no value. Phase runs once through the cyclic "
        "scale per period; the order must step by one exactly where the phase wraps; masked "
        "pixels should occur at edges and in shadows only.",
        "maps of phase, fringe order, modulation and reasons",
        lambda path: draw_decoding(
            path, measured.fringes.reconstruction, measured.fringes.capture.patterns
        ),
    )


def draw_frames(path: Path, capture: Capture) -> None:
    """Draw white, black, phase and Gray frames of both directions, and one image row, as PNG.

    Raises
    ------
    InputError
        `path` cannot be written.
    """
    rows = _sheet(capture)
    _, height, width = capture.stack.shape
    thumb_in = (_WIDTH_IN - 2 * _SIDE_IN) / _COLUMNS * 0.95
    line_in = thumb_in * height / width + _TITLE_IN
    height_in = line_in * len(rows) + _PROFILE_IN
    with drawing(path, _WIDTH_IN, height_in) as figure:
        for r, row in enumerate(rows):
            for c, frame in enumerate(row):
                place = (_SIDE_IN + c * thumb_in / 0.95, r * line_in + _TITLE_IN)
                thumb = axes_at(figure, *place, thumb_in, line_in - _TITLE_IN)
                _thumb(thumb, capture, frame)
        top_in = line_in * len(rows) + 0.5
        profile = axes_at(figure, 0.65, top_in, _WIDTH_IN - 0.75, _PROFILE_IN - 1.05)
        _profile(profile, capture)


def _sheet(capture: Capture) -> list[list[PatternFrame]]:
    """Rows of frames: uniform + phase, then the finest Gray bits; columns first."""
    patterns = capture.patterns
    by_name = {frame.name: frame for frame in patterns.frames}
    return [
        [by_name["white"], *_phases(capture, "column")],
        [by_name["black"], *_phases(capture, "row")],
        *(_finest_gray(capture, axis) for axis in AXES),
    ]


def _phases(capture: Capture, axis: Axis) -> list[PatternFrame]:
    """Frames about a quarter of a period apart."""
    patterns = capture.patterns
    frames = patterns.frames[patterns.index("phase", axis)]
    chosen = sorted({round(k * patterns.steps / 4) for k in range(4)})
    return [frames[n] for n in chosen if n < len(frames)]


def _finest_gray(capture: Capture, axis: Axis) -> list[PatternFrame]:
    return list(capture.patterns.frames[capture.patterns.index("gray", axis)][-_COLUMNS:])


def _thumb(axes: Axes, capture: Capture, frame: PatternFrame) -> None:
    image = capture.stack[capture.patterns.frames.index(frame)]
    axes.set_title(frame.name.replace("_", " "), fontsize=8.0, pad=3.0)
    axes.set(xticks=[], yticks=[])
    thumb = block_mean(image, -(-image.shape[1] // _THUMB_PX))
    axes.imshow(thumb, cmap="gray", vmin=0, vmax=capture.sensor.saturation_dn)


def block_mean(image: NDArray[Any], side: int) -> NDArray[np.float32]:
    """Average squares of `side` pixels; plain decimation would alias the fringes."""
    rows, cols = (length // side * side for length in image.shape)
    blocks = image[:rows, :cols].reshape(rows // side, side, cols // side, side)
    return np.asarray(blocks.mean(axis=(1, 3), dtype=np.float32))


def _profile(axes: Axes, capture: Capture) -> None:
    """One image row of three frames: shows exposure, contrast and clipping at a glance."""
    middle = capture.stack.shape[1] // 2
    phase = capture.patterns.index("phase", "column").start
    for name, color, index in (
        ("white", FIT, capture.patterns.index("white").start),
        (capture.patterns.frames[phase].name.replace("_", " "), MEASURED, phase),
        ("black", INK, capture.patterns.index("black").start),
    ):
        axes.plot(capture.stack[index, middle], color=color, lw=0.8, label=name)
    axes.axhline(capture.sensor.saturation_dn, color=FAINT, lw=1.0, ls="--", label="saturation")
    axes.axhline(capture.sensor.black_level_dn, color=TRUE_FACE, lw=0.8, ls=":", label="dark level")
    axes.set(
        title=f"Image row {middle}",
        xlabel="camera column (px)",
        ylabel="pixel value (DN)",
        xlim=(0, capture.stack.shape[2] - 1),
        ylim=(0, 1.08 * capture.sensor.saturation_dn),
    )
    legend_above(axes, 5)
    plain_spines(axes)


_SHOWN_PX, _MAP_IN = 480, 2.85
# Reasons for which the decoder has no phase at all.
_NO_PHASE = (Reason.DARK, Reason.LOW_MODULATION, Reason.SATURATED)

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
}


def draw_decoding(path: Path, reconstruction: Reconstruction, patterns: PatternSet) -> None:
    """Draw wrapped phase and order of both directions, modulation and reason mask as PNG.

    Raises
    ------
    InputError
        `path` cannot be written.
    """
    decoded, reason = reconstruction.decoded, reconstruction.point_map.mask_reason
    rows, cols = reason.shape
    height_in = _MAP_IN * rows / cols
    line_in = height_in + 1.25
    with drawing(path, 10.0, 2 * line_in) as figure:
        places = [
            [
                axes_at(figure, 0.4 + 3.3 * at, 0.3 + line * line_in, _MAP_IN, height_in)
                for at in range(3)
            ]
            for line in range(2)
        ]
        for line, (name, axis) in enumerate((("column", decoded.column), ("row", decoded.row))):
            _phase(places[line][0], name, axis, reason)
            _order(places[line][1], name, axis, reconstruction)
        _modulation(places[0][2], decoded.column)
        _reasons(places[1][2], reason)


def _percent(share: float) -> str:
    return "< 0.01%" if share < 1e-4 else f"{share:.2%}"


def reason_shares(reason: NDArray[np.uint8]) -> dict[Reason, float]:
    """Return the share of the image under each reason that occurs."""
    counts = np.bincount(reason.ravel(), minlength=len(Reason))
    return {r: float(counts[r]) / reason.size for r in Reason if counts[r]}


def _map(axes: Axes, values: NDArray[Any], **options: Any) -> Any:
    """Show every n-th pixel: phases and codes must not be averaged."""
    rows, cols = values.shape
    step = -(-max(rows, cols) // _SHOWN_PX)
    extent = (-0.5, cols - 0.5, rows - 0.5, -0.5)
    return axes.imshow(values[::step, ::step], extent=extent, **options)


def _phase(axes: Axes, name: str, axis: AxisDecode, reason: NDArray[np.uint8]) -> None:
    known = np.ma.masked_where(np.isin(reason, _NO_PHASE), axis.phase_rad)
    shown = _map(axes, known, cmap=cyclic(), vmin=0, vmax=2 * np.pi)
    axes.set_title(f"wrapped phase, {name}")
    add_colorbar(axes, shown, "phase (rad), 0 to 2π", side="below")


def _order(axes: Axes, name: str, axis: AxisDecode, reconstruction: Reconstruction) -> None:
    valid = reconstruction.decoded.valid
    orders = axis.order[valid]
    low, high = (int(orders.min()), int(orders.max())) if orders.size else (0, 1)
    shown = _map(
        axes,
        np.ma.masked_where(~valid, axis.order),
        cmap=sequential(),
        vmin=low,
        vmax=max(high, low + 1),
    )
    axes.set_title(f"fringe order, {name}")
    add_colorbar(axes, shown, f"period number, {low} to {high}", side="below")


def _modulation(axes: Axes, axis: AxisDecode) -> None:
    top = round_up(float(axis.modulation_dn.max()))
    shown = _map(axes, axis.modulation_dn, cmap=sequential(), vmin=0, vmax=top)
    axes.set_title("modulation, column")
    add_colorbar(axes, shown, "amplitude (DN)", side="below")


def _reasons(axes: Axes, reason: NDArray[np.uint8]) -> None:
    colours = ListedColormap([REASON_COLOURS[r] for r in Reason])
    norm = BoundaryNorm(np.arange(len(Reason) + 1) - 0.5, len(Reason))
    _map(axes, reason, cmap=colours, norm=norm)
    handles = [
        Patch(
            color=REASON_COLOURS[r], label=f"{r.name.lower().replace('_', ' ')} {_percent(share)}"
        )
        for r, share in reason_shares(reason).items()
    ]
    axes.set_title("masked pixels by reason")
    axes.legend(
        handles=handles,
        loc="upper center",
        bbox_to_anchor=(0.5, -0.1),
        ncols=2,
        fontsize=7.5,
        handlelength=1.0,
    )


NO_POINT = "#c3cbd4"
"""Darker than other gaps: an error of 0 is white, and must not look like a missing point."""

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
    no_ticks(axes)


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
    width_mm = scored.truth.lit.shape[1] * scored.pixel_mm
    return max(1.0, round_up(_RELIEF_SHARE * width_mm / (high_mm - low_mm)))


def show_error(axes: Axes, scored: Measurement) -> None:
    """Show the error of z; beyond the limit of a good point it keeps the colour of the end."""
    limit_um = scored.experiment.score.good_within_um
    colours = diverging().with_extremes(bad=NO_POINT)
    shown = axes.imshow(_every_nth(error_um(scored)), cmap=colours, vmin=-limit_um, vmax=limit_um)
    no_ticks(axes)
    add_colorbar(axes, shown, "z error (µm), clipped at the ends", extend="both", side="below")


def show_reasons(axes: Axes, scored: Measurement) -> None:
    """Show why wanted pixels have no point; the others are pale gray."""
    reason = scored.fringes.reconstruction.point_map.mask_reason
    colours = ListedColormap([REASON_COLOURS[r] for r in Reason]).with_extremes(bad=GAP)
    norm = BoundaryNorm(np.arange(len(Reason) + 1) - 0.5, len(Reason))
    axes.imshow(_every_nth(np.ma.masked_array(reason, ~wanted(scored))), cmap=colours, norm=norm)
    no_ticks(axes)


def _show_heights(
    axes: Axes, measured: Measurement, z_mm: "np.ma.MaskedArray[Any, Any]", bar: bool
) -> None:
    norm = Normalize(*true_scale_mm(measured))
    coarse = _every_nth(z_mm)
    if coarse.count():
        axes.imshow(shaded(_upwards(measured, coarse), norm, shading_enlargement(measured))[::-1])
    else:
        axes.imshow(np.ones((*coarse.shape, 3)))
    no_ticks(axes)
    if bar:
        shown = ScalarMappable(norm, sequential())
        add_colorbar(axes, shown, "z (mm)", extend="both", side="below")


def _upwards(scored: Measurement, z_mm: "np.ma.MaskedArray[Any, Any]") -> WorldMap:
    """Heights in camera pixels as the shading wants them: rows grow upwards, lengths in mm."""
    rows, cols = z_mm.shape
    pitch_mm = scored.pixel_mm * scored.truth.lit.shape[1] / cols
    return WorldMap(z_mm[::-1], pitch_mm * np.arange(cols), pitch_mm * np.arange(rows), pitch_mm)


def _every_nth(values: Any) -> Any:
    """Thin out: heights and codes must not be averaged across edges."""
    step = -(-max(values.shape) // _SHOWN_PX)
    return values[::step, ::step]
