"""Pictures of a comparison: small panels of one measurement, and the overview of all."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

from twin.config.methods import TRAITS, Method
from twin.report.camera_images import (
    NO_POINT,
    fringe_frame,
    show_error,
    show_frame,
    show_measured,
    white_frame,
)
from twin.report.canvas import (
    FAINT,
    INK,
    add_colorbar,
    axes_at,
    diverging,
    drawing,
    height_scale,
    sequential,
)
from twin.report.photometric_figures import (
    DIFFERENCE_GAIN,
    decoder_error_um,
    difference_levels,
    extent_mm,
    measured_heights_mm,
    show_heights,
    true_heights_mm,
)
from twin.results.record import Colours, Measurement


@dataclass(frozen=True)
class Panel:
    """One small picture of a measurement; `bar` leaves room for a colour bar below it."""

    name: str
    caption: str
    bar: bool
    show: Callable[[Axes], None]


def panels_of(measured: Measurement) -> tuple[Panel, ...]:
    """Return what the camera saw, twice, then heights and error."""
    if isinstance(measured.images, Colours):
        return _of_colours(measured)
    return _of_fringes(measured)


def show_seen(axes: Axes, measured: Measurement) -> None:
    """Show the image that says most of what the method had to work with."""
    if isinstance(measured.images, Colours):
        _show_image(axes, measured)
    else:
        _show_frame(axes, measured, white=False)


def show_result(axes: Axes, measured: Measurement) -> None:
    """Show the measured heights without a colour bar."""
    if isinstance(measured.images, Colours):
        _show_heights(axes, measured, bar=False)
    else:
        show_measured(axes, measured, bar=False)


def _of_fringes(measured: Measurement) -> tuple[Panel, ...]:
    return (
        Panel("white", "white frame", False, partial(_show_frame, measured=measured, white=True)),
        Panel(
            "fringes", "fringe image", False, partial(_show_frame, measured=measured, white=False)
        ),
        Panel(
            "heights",
            "measured heights; white: no measurement",
            True,
            partial(show_measured, measured=measured),
        ),
        Panel(
            "error",
            "error against the true surface; gray: no measurement",
            True,
            partial(show_error, scored=measured),
        ),
    )


def _of_colours(seen: Measurement) -> tuple[Panel, ...]:
    gain = f"difference from the untouched gel, × {DIFFERENCE_GAIN}"
    return (
        Panel("image", "tactile image", False, partial(_show_image, seen=seen)),
        Panel("difference", gain, False, partial(_show_difference, seen=seen)),
        Panel(
            "heights",
            "measured heights; white: no measurement",
            True,
            partial(_show_heights, seen=seen),
        ),
        Panel(
            "error",
            "error against the true coat; gray: no measurement or not evaluated",
            True,
            partial(_show_error, seen=seen),
        ),
    )


def _show_frame(axes: Axes, measured: Measurement, white: bool) -> None:
    capture = measured.fringes.capture
    show_frame(axes, capture, white_frame(capture) if white else fringe_frame(capture))


def _show_image(axes: Axes, seen: Measurement) -> None:
    axes.imshow(seen.picture, extent=extent_mm(seen))
    axes.set(xticks=[], yticks=[])


def _show_difference(axes: Axes, seen: Measurement) -> None:
    axes.imshow(difference_levels(seen), extent=extent_mm(seen))
    axes.set(xticks=[], yticks=[])


def _show_heights(axes: Axes, seen: Measurement, bar: bool = True) -> None:
    norm = Normalize(*height_scale(true_heights_mm(seen).compressed()))
    show_heights(axes, seen, measured_heights_mm(seen.colours.own), norm)
    axes.set(xticks=[], yticks=[])
    if bar:
        shown = ScalarMappable(norm, sequential())
        add_colorbar(axes, shown, "z (mm)", extend="both", side="below")


def _show_error(axes: Axes, seen: Measurement) -> None:
    limit_um = seen.experiment.score.good_within_um
    colours = diverging().with_extremes(bad=NO_POINT)
    shown = axes.imshow(
        decoder_error_um(seen, seen.colours.own), cmap=colours, vmin=-limit_um, vmax=limit_um
    )
    axes.set(xticks=[], yticks=[])
    add_colorbar(axes, shown, "z error (µm), clipped at the ends", extend="both", side="below")


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
