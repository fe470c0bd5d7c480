"""Pictures of a comparison: small panels of one measurement, and overview of all measurements."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from matplotlib.axes import Axes

from twin.config.methods import TRAITS, Method
from twin.report.camera_images import fringe_frame, show_frame, white_frame
from twin.report.canvas import FAINT, INK, axes_at, drawing
from twin.report.photometric_figures import DIFFERENCE_GAIN, difference_levels
from twin.report.pixel_panels import show_error, show_measured, show_picture
from twin.results.record import Measurement


@dataclass(frozen=True)
class Panel:
    """One small picture of a measurement; `bar` adds space for a colour bar below it."""

    name: str
    caption: str
    bar: bool
    show: Callable[[Axes], None]


def panels_of(measured: Measurement) -> tuple[Panel, ...]:
    """Return the panels of a measurement: two camera images, measured heights and z error."""
    method = measured.experiment.method
    surface = "coat" if method.presses else "surface"
    heights, error = (partial(show, measured=measured) for show in (show_measured, show_error))
    left_out = "" if method.fringes else " or not evaluated"
    return (
        *(_of_fringes(measured) if method.fringes else _of_colours(measured)),
        Panel("heights", "measured heights z (mm); white: no measured point", True, heights),
        Panel("error", f"z error against the true {surface}; gray: no measurement{left_out}", True,
              error),
    )  # fmt: skip


def _of_fringes(measured: Measurement) -> tuple[Panel, ...]:
    capture = measured.fringes.capture
    white, fringes = (
        partial(show_frame, capture=capture, frame=frame)
        for frame in (white_frame(capture), fringe_frame(capture))
    )
    return Panel("white", "white frame", False, white), Panel(
        "fringes", "fringe image", False, fringes
    )


def _of_colours(measured: Measurement) -> tuple[Panel, ...]:
    gain = f"difference from the image without contact, × {DIFFERENCE_GAIN}"
    return (
        Panel("image", "tactile image", False, partial(show_picture, image=measured.picture)),
        Panel("difference", gain, False, partial(show_picture, image=difference_levels(measured))),
    )


_CELL_IN, _CELL_SHARE, _GAP_IN, _LABEL_IN, _HEAD_IN = 1.75, 0.75, 0.06, 0.35, 0.3


@contextmanager
def overview(
    path: Path, methods: Sequence[Method], names: Sequence[str]
) -> Iterator[Callable[[str, Method, Measurement | None], None]]:
    """Draw camera image and heights as PNG, with one row per method and two columns per specimen.

    Yields a function (specimen, method, measurement) that draws the two panels of one measurement;
    None instead of a measurement marks the panel as not measured. The caller reads and draws one
    measurement at a time, because a stack of frames at full size takes 600 MB.
    """
    height_in, pair_in = _CELL_IN * _CELL_SHARE, 2 * _CELL_IN + 3 * _GAP_IN
    down_in = _HEAD_IN + len(methods) * (height_in + _GAP_IN)
    with drawing(path, _LABEL_IN + pair_in * len(names), down_in) as figure:

        def fill(name: str, method: Method, measured: Measurement | None) -> None:
            row, column = methods.index(method), names.index(name)
            left_in = _LABEL_IN + column * pair_in
            top_in = _HEAD_IN + row * (height_in + _GAP_IN)
            left, right = (
                axes_at(figure, left_in + k * (_CELL_IN + _GAP_IN), top_in, _CELL_IN, height_in)
                for k in range(2)
            )
            if column == 0:
                left.set_ylabel(TRAITS[method].title, fontsize=9.0, labelpad=6.0)
            if row == 0:
                left.set_title(name.replace("_", " "))
            _pair(left, right, measured)

        yield fill


def _pair(left: Axes, right: Axes, cell: Measurement | None) -> None:
    for axes in (left, right):
        axes.set(xticks=[], yticks=[])
    if cell is None:
        left.text(0.5, 0.5, "not measured", color=FAINT, ha="center", transform=left.transAxes)
        return
    if cell.experiment.method.fringes:
        show_frame(left, cell.fringes.capture, fringe_frame(cell.fringes.capture))
    else:
        show_picture(left, cell.picture)
    show_measured(right, cell, bar=False)
    for spine in right.spines.values():
        spine.set_color(INK)
