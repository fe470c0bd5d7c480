"""Pictures of a comparison: one small panel each, and the overview laid out as in the paper."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from matplotlib.axes import Axes

from twin.config.methods import TRAITS, Method
from twin.report.canvas import FAINT, INK, axes_at, drawing
from twin.report.comparison_panels import Panel, show_result, show_seen
from twin.results.record import Measurement

_SIDE_IN, _WIDTH_IN, _BAR_IN, _ABOVE_IN = 0.02, 3.0, 0.95, 0.02
_CELL_IN, _CELL_SHARE, _GAP_IN, _LABEL_IN, _HEAD_IN = 1.75, 0.75, 0.06, 0.35, 0.3


def draw_panel(path: Path, panel: Panel, measured: Measurement) -> None:
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
        panel.show(axes_at(figure, _SIDE_IN, _ABOVE_IN, inside_in, height_in))


@contextmanager
def overview(
    path: Path, methods: Sequence[Method], names: Sequence[str]
) -> Iterator[Callable[[str, Method, Measurement | None], None]]:
    """Draw what was seen and the heights: a row per method, two columns per specimen, as PNG.

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
    show_seen(left, cell)
    show_result(right, cell)
    for spine in right.spines.values():
        spine.set_color(INK)


def _height_share(measured: Measurement) -> float:
    rows, cols = measured.truth.lit.shape
    return float(rows / cols)
