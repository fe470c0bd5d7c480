"""Pictures of a comparison: one small panel each, and the overview laid out as in the paper."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from matplotlib.axes import Axes

from twin.modalities.comparison import Method
from twin.report.camera_view import (
    fringe_frame,
    show_error,
    show_frame,
    show_measured,
    white_frame,
)
from twin.report.canvas import FAINT, INK, axes_at, drawing
from twin.report.result_folder import Measured

METHOD_NAMES: dict[Method, str] = {"direct_fpp": "direct FPP", "contact_fpp": "contact-FPP"}
METHOD_WORDS: dict[Method, str] = {
    "direct_fpp": "fringes on the bare specimen",
    "contact_fpp": "fringes on the coat pressed onto it",
}

_SIDE_IN, _WIDTH_IN, _BAR_IN, _ABOVE_IN = 0.02, 3.0, 0.95, 0.02
_CELL_IN, _CELL_SHARE, _GAP_IN, _LABEL_IN, _HEAD_IN = 1.75, 0.75, 0.06, 0.35, 0.3


@dataclass(frozen=True)
class Panel:
    """One small picture of a measurement; `bar` leaves room for a colour bar below it."""

    name: str
    caption: str
    bar: bool
    show: Callable[[Axes, Measured], None]


PANELS = (
    Panel("white", "white frame", False, lambda axes, m: _frame(axes, m, white=True)),
    Panel("fringes", "fringes", False, lambda axes, m: _frame(axes, m, white=False)),
    Panel("heights", "measured heights, white: no point", True, show_measured),
    Panel("error", "error against the true surface, gray: no point", True, show_error),
)


def draw_panel(path: Path, panel: Panel, measured: Measured) -> None:
    """Draw one panel as PNG.

    Raises
    ------
    InputError
        `path` cannot be written.
    """
    inside_in = _WIDTH_IN - 2 * _SIDE_IN
    height_in = inside_in * _height_share(measured)
    below_in = _BAR_IN if panel.bar else _ABOVE_IN
    with drawing(path, _WIDTH_IN, _ABOVE_IN + height_in + below_in) as figure:
        panel.show(axes_at(figure, _SIDE_IN, _ABOVE_IN, inside_in, height_in), measured)


@contextmanager
def overview(
    path: Path, methods: Sequence[Method], names: Sequence[str]
) -> Iterator[Callable[[str, Method, Measured | None], None]]:
    """Draw fringes and measured heights: a row per method, two columns per specimen, as PNG.

    Yields the function that fills the place of one specimen and method: one measurement after the
    other, because a stack at full size takes 600 MB. None says that there is no measurement.

    Raises
    ------
    InputError
        `path` cannot be written.
    """
    height_in, pair_in = _CELL_IN * _CELL_SHARE, 2 * _CELL_IN + 3 * _GAP_IN
    down_in = _HEAD_IN + len(methods) * (height_in + _GAP_IN)
    with drawing(path, _LABEL_IN + pair_in * len(names), down_in) as figure:

        def fill(name: str, method: Method, measured: Measured | None) -> None:
            row, column = methods.index(method), names.index(name)
            left_in = _LABEL_IN + column * pair_in
            top_in = _HEAD_IN + row * (height_in + _GAP_IN)
            left, right = (
                axes_at(figure, left_in + k * (_CELL_IN + _GAP_IN), top_in, _CELL_IN, height_in)
                for k in range(2)
            )
            if column == 0:
                left.set_ylabel(METHOD_NAMES[method], fontsize=9.0, labelpad=6.0)
            if row == 0:
                left.set_title(name.replace("_", " "))
            _pair(left, right, measured)

        yield fill


def _pair(left: Axes, right: Axes, cell: Measured | None) -> None:
    for axes in (left, right):
        axes.set(xticks=[], yticks=[])
    if cell is None:
        left.text(0.5, 0.5, "not measured", color=FAINT, ha="center", transform=left.transAxes)
        return
    _frame(left, cell, white=False)
    show_measured(right, cell, bar=False)
    for spine in right.spines.values():
        spine.set_color(INK)


def _frame(axes: Axes, measured: Measured, white: bool) -> None:
    capture = measured.capture
    show_frame(axes, capture, white_frame(capture) if white else fringe_frame(capture))


def _height_share(measured: Measured) -> float:
    rows, cols = measured.truth.lit.shape
    return float(rows / cols)
