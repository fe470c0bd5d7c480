"""Figures of the camera frames and of the decoder's maps; row 0 is the top."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch, Rectangle
from numpy.typing import NDArray

from reconstruction.arrays import FloatImage, Levels, Reason
from reconstruction.capture.folder import Capture
from reconstruction.decoding.decode import AxisDecode
from reconstruction.patterns import AXES, Axis, PatternFrame, PatternSet
from reconstruction.pipeline import Reconstruction
from twin.report.canvas import (
    FAINT,
    FIT,
    INK,
    MEASURED,
    TRUE_FACE,
    add_colorbar,
    axes_at,
    chart,
    cyclic,
    drawing,
    legend_above,
    no_ticks,
    round_up,
    sequential,
)
from twin.report.page import Figure, Section
from twin.report.pixel_panels import REASON_COLOURS, show_codes, thinned
from twin.results.record import Measurement

_COLUMNS = 5
_THUMB_PX = 260
_WIDTH_IN, _SIDE_IN, _TITLE_IN, _PROFILE_IN = 10.0, 0.05, 0.27, 2.6


def recorded_section(measured: Measurement) -> Section:
    """Return the section of the recorded fringe frames and of the decoded maps."""
    title = "Camera frames and decoded maps"
    return Section("recorded", title, (frames_figure(measured), decoding_figure(measured)))


def frames_figure(measured: Measurement) -> Figure:
    """Return the figure with small images of the camera frames, and one image row of them."""
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
    """Return the figure with the decoder's maps: phase, fringe order, modulation, masked pixels."""
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
    """Draw small images of the frames as PNG, and the values of one image row.

    Frames are white, black, and phase and Gray-code frames of both projector axes.
    """
    rows = _sheet(capture)
    _, height, width = capture.stack.shape
    thumb_in = (_WIDTH_IN - 2 * _SIDE_IN) / _COLUMNS * 0.95
    line_in = thumb_in * height / width + _TITLE_IN
    height_in = line_in * len(rows) + _PROFILE_IN
    with drawing(path, _WIDTH_IN, height_in) as figure:
        sheet = axes_at(figure, 0.0, 0.0, _WIDTH_IN, line_in * len(rows))
        for r, row in enumerate(rows):
            for c, frame in enumerate(row):
                left_in, top_in = _SIDE_IN + c * thumb_in / 0.95, r * line_in + _TITLE_IN
                bottom_in = (r + 1) * line_in
                extent_in = (left_in, left_in + thumb_in, bottom_in, top_in)
                _thumb(sheet, capture, frame, extent_in)
        sheet.set(xlim=(0.0, _WIDTH_IN), ylim=(line_in * len(rows), 0.0))
        sheet.set_axis_off()
        top_in = line_in * len(rows) + 0.5
        profile = axes_at(figure, 0.65, top_in, _WIDTH_IN - 0.75, _PROFILE_IN - 1.05)
        _profile(profile, capture)


def _sheet(capture: Capture) -> list[list[PatternFrame]]:
    """Return the rows of frames in the figure: uniform and phase frames, then finest Gray bits.

    In each group, frames of the column patterns are before frames of the row patterns.
    """
    patterns = capture.patterns
    uniform = [[frame] for frame in patterns.frames if frame.axis is None] or [[], []]
    phases = [_phases(capture, axis) for axis in AXES]
    bits = [list(patterns.frames[patterns.index("gray", axis)][-_COLUMNS:]) for axis in AXES]
    rows = [*(first + rest for first, rest in zip(uniform, phases, strict=True)), *bits]
    return [row for row in rows if row]


def _phases(capture: Capture, axis: Axis) -> list[PatternFrame]:
    """Return up to four phase frames of one axis, with steps of about a quarter of a period."""
    patterns = capture.patterns
    frames = [frame for frame in patterns.frames if (frame.kind, frame.axis) == ("phase", axis)]
    chosen = sorted({round(k * patterns.steps / 4) for k in range(4)})
    return [frames[n] for n in chosen if n < len(frames)]


def _thumb(
    sheet: Axes,
    capture: Capture,
    frame: PatternFrame,
    extent_in: tuple[float, float, float, float],
) -> None:
    """Draw a small image of a frame, with its name above, on the common axes (inches).

    Separate axes for each frame would take ten times longer.
    """
    image = capture.stack[capture.patterns.frames.index(frame)]
    left, right, bottom, top = extent_in
    sheet.text(left, top - 0.045, frame.name.replace("_", " "), fontsize=8.0, va="bottom")
    thumb = block_mean(image, -(-image.shape[1] // _THUMB_PX))
    shade: Any = {"cmap": "gray", "vmin": 0, "vmax": capture.sensor.saturation_dn}
    sheet.imshow(thumb, extent=extent_in, aspect="auto", **shade)
    outline = Rectangle((left, bottom), right - left, top - bottom, fill=False, ec=FAINT, lw=0.7)
    sheet.add_patch(outline)


def block_mean(image: NDArray[Any], side: int) -> FloatImage:
    """Return the means of squares of `side` x `side` pixels; decimation would alias the fringes."""
    rows, cols = (length // side * side for length in image.shape)
    lines = image[:rows, :cols].reshape(rows // side, side, cols).sum(axis=1, dtype=np.float32)
    total = np.add.reduce([lines[:, first::side] for first in range(side)])
    return np.asarray(total / np.float32(side * side))


def _profile(axes: Axes, capture: Capture) -> None:
    """Draw one image row of white, fringe and black frame: exposure, contrast and clipping."""
    middle = capture.stack.shape[1] // 2
    frames, shown = capture.patterns.frames, [(fringe_frame(capture), MEASURED)]
    if capture.patterns.uniform:
        shown = [(frames[-2], FIT), *shown, (frames[-1], INK)]
    for frame, color in shown:
        line, name = capture.stack[frames.index(frame), middle], frame.name.replace("_", " ")
        axes.plot(line, color=color, lw=0.8, label=name)
    axes.axhline(capture.sensor.saturation_dn, color=FAINT, lw=1.0, ls="--", label="saturation")
    axes.axhline(capture.sensor.black_level_dn, color=TRUE_FACE, lw=0.8, ls=":", label="dark level")
    chart(
        axes,
        f"Image row {middle}",
        "camera column (px)",
        "pixel value (DN)",
        xlim=(0, capture.stack.shape[2] - 1),
        ylim=(0, 1.08 * capture.sensor.saturation_dn),
    )
    legend_above(axes, 5)


_SHOWN_PX, _MAP_IN = 480, 2.85
# Reasons for which the decoder has no phase at all.
_NO_PHASE = (Reason.DARK, Reason.LOW_MODULATION, Reason.SATURATED)


def draw_decoding(path: Path, reconstruction: Reconstruction, patterns: PatternSet) -> None:
    """Draw maps as PNG: phase and fringe order of both axes, modulation, reasons for masking."""
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


def reason_shares(reason: Levels) -> dict[Reason, float]:
    """Return the share of the pixels with each mask reason that occurs in the map `reason`."""
    counts = np.bincount(reason.ravel(), minlength=len(Reason))
    return {r: float(counts[r]) / reason.size for r in Reason if counts[r]}


def _map(axes: Axes, values: NDArray[Any], **options: Any) -> Any:
    """Draw every n-th pixel of a map, because phases and codes must not be averaged."""
    return axes.imshow(thinned(values), extent=_extent(values), **options)


def _extent(values: NDArray[Any]) -> tuple[float, float, float, float]:
    rows, cols = values.shape
    return -0.5, cols - 0.5, rows - 0.5, -0.5


def _phase(axes: Axes, name: str, axis: AxisDecode, reason: Levels) -> None:
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


def _reasons(axes: Axes, reason: Levels) -> None:
    show_codes(axes, thinned(reason), extent=_extent(reason))
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


def white_frame(capture: Capture) -> PatternFrame:
    """Return the white frame of a sequence, or its first frame if it has no uniform frames."""
    return capture.patterns.frames[capture.patterns.exposure_frame or 0]


def fringe_frame(capture: Capture) -> PatternFrame:
    """Return the first frame of a sequence, usually one with vertical fringes."""
    return capture.patterns.frames[0]


def show_frame(axes: Axes, capture: Capture, frame: PatternFrame) -> None:
    """Draw the digital numbers of a frame in gray: black is 0, white is saturation."""
    image = capture.stack[capture.patterns.frames.index(frame)]
    small = block_mean(image, -(-max(image.shape) // _SHOWN_PX))
    axes.imshow(small, cmap="gray", vmin=0, vmax=capture.sensor.saturation_dn)
    no_ticks(axes)
