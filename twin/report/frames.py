"""Contact sheet of a capture: the frames by which exposure and code are judged."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from reconstruction.capture.folder import Capture
from reconstruction.patterns import AXES, Axis, PatternFrame
from twin.report.canvas import (
    FAINT,
    FIT,
    INK,
    MEASURED,
    TRUE_FACE,
    axes_at,
    drawing,
    legend_above,
    plain_spines,
)

_COLUMNS = 5
_THUMB_PX = 260
_WIDTH_IN, _SIDE_IN, _TITLE_IN, _PROFILE_IN = 10.0, 0.05, 0.27, 2.6


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
