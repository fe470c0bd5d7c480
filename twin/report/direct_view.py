"""Figures of a measurement of the bare specimen."""

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.patches import Patch

from reconstruction.arrays import Reason
from twin.report.camera_view import (
    fringe_frame,
    shading_enlargement,
    show_error,
    show_frame,
    show_measured,
    show_reasons,
    show_true,
    white_frame,
)
from twin.report.canvas import axes_at, drawing
from twin.report.decoding import REASON_COLOURS
from twin.report.direct import REASON_WORDS, missing_shares, percent
from twin.report.figures import images
from twin.report.html import Plate
from twin.results.record import Measurement

_PANEL_IN, _ACROSS_IN, _TOP_IN = 3.1, 3.4, 0.3
# Room for a colour bar below the upper line, and for all reasons below the lower one.
_BELOW_UPPER_IN, _BELOW_LOWER_IN = 0.85, 1.4


def direct_plates(measured: Measurement) -> list[Plate]:
    """Return the figures of the report, in its order."""
    enlarged = shading_enlargement(measured)
    shading = "" if enlarged == 1 else f" (shading enlarges z {enlarged:g} times)"
    limit_um = measured.experiment.score.good_within_um
    seen = Plate(
        "seen",
        lambda path: draw_seen(path, measured),
        "frames, true and measured heights, error and reasons in camera pixels",
        "The same camera pixels in all panels. Frames in digital numbers, black is 0 and white is "
        "saturation. Heights are lit from the upper left, on the scale of the true ones"
        f"{shading}; white has no point. Errors and reasons are those of the specimen, the rest is "
        f"gray. The error scale ends at ± {limit_um:g} µm and is clipped there: its end colours "
        "are points that are not good.",
    )
    return [seen, *images(measured)]


def draw_seen(path: Path, measured: Measurement) -> None:
    """Draw white, fringes and true heights over measured heights, error and reasons, as PNG.

    Raises
    ------
    InputError
        `path` cannot be written.
    """
    rows, cols = measured.truth.lit.shape
    height_in = _PANEL_IN * rows / cols
    line_in = _TOP_IN + height_in + _BELOW_UPPER_IN
    with drawing(path, 10.0, line_in + _TOP_IN + height_in + _BELOW_LOWER_IN) as figure:
        upper, lower = (
            [
                axes_at(figure, 0.05 + k * _ACROSS_IN, top_in + _TOP_IN, _PANEL_IN, height_in)
                for k in range(3)
            ]
            for top_in in (0.0, line_in)
        )
        _frames(upper[0], upper[1], measured)
        upper[2].set_title("true heights")
        show_true(upper[2], measured)
        lower[0].set_title("measured heights")
        show_measured(lower[0], measured)
        lower[1].set_title("z error, measured − true")
        show_error(lower[1], measured)
        lower[2].set_title("why is there no point")
        show_reasons(lower[2], measured)
        _reason_legend(lower[2], measured)


def _frames(white: Axes, fringes: Axes, measured: Measurement) -> None:
    for axes, frame in (
        (white, white_frame(measured.fringes.capture)),
        (fringes, fringe_frame(measured.fringes.capture)),
    ):
        axes.set_title(frame.name.replace("_", " "))
        show_frame(axes, measured.fringes.capture, frame)


def _reason_legend(axes: Axes, scored: Measurement) -> None:
    missing = missing_shares(scored)
    valid = Patch(
        color=REASON_COLOURS[Reason.VALID],
        label=f"a point {percent(scored.figures['completeness'])}",
    )
    others = [
        Patch(color=REASON_COLOURS[r], label=f"{REASON_WORDS[r]} {percent(share)}")
        for r, share in missing.items()
    ]
    axes.legend(
        handles=[valid, *others],
        loc="upper left",
        bbox_to_anchor=(-0.02, -0.01),
        fontsize=7.5,
        handlelength=1.0,
        labelspacing=0.25,
    )
