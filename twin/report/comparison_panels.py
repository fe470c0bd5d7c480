"""The small pictures of one measurement in a comparison, whatever the method."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

from twin.report.camera_view import (
    NO_POINT,
    fringe_frame,
    show_error,
    show_frame,
    show_measured,
    white_frame,
)
from twin.report.canvas import add_colorbar, diverging, height_scale, sequential
from twin.report.photometric_maps import (
    DIFFERENCE_GAIN,
    difference_levels,
    error_um,
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
        Panel("fringes", "fringes", False, partial(_show_frame, measured=measured, white=False)),
        Panel(
            "heights",
            "measured heights, white: no point",
            True,
            partial(show_measured, measured=measured),
        ),
        Panel(
            "error",
            "error against the true surface, gray: no point",
            True,
            partial(show_error, scored=measured),
        ),
    )


def _of_colours(seen: Measurement) -> tuple[Panel, ...]:
    gain = f"difference to the untouched gel × {DIFFERENCE_GAIN}"
    return (
        Panel("image", "tactile image", False, partial(_show_image, seen=seen)),
        Panel("difference", gain, False, partial(_show_difference, seen=seen)),
        Panel(
            "heights", "measured heights, white: no point", True, partial(_show_heights, seen=seen)
        ),
        Panel(
            "error",
            "error against the true coat, gray: no point or not evaluated",
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
        error_um(seen, seen.colours.own), cmap=colours, vmin=-limit_um, vmax=limit_um
    )
    axes.set(xticks=[], yticks=[])
    add_colorbar(axes, shown, "z error (µm), clipped at the ends", extend="both", side="below")
