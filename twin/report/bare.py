"""Report of a measurement of the bare specimen: measured share, and reasons for missing points.

All shares refer to the camera pixels that show the specimen (its visible area).
"""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from reconstruction.arrays import Reason
from twin.report.camera_images import (
    fringe_frame,
    reason_shares,
    recorded_section,
    show_frame,
    white_frame,
)
from twin.report.canvas import axes_at, drawing
from twin.report.experiment import GOOD_SHARE, POOR_SHARE, glance, grade_of_share, result_in_words
from twin.report.film import film_sections
from twin.report.page import Block, Figure, JudgedTarget, Section, Verdict, judged
from twin.report.pixel_panels import (
    REASON_COLOURS,
    shading_words,
    show_error,
    show_measured,
    show_reasons,
    show_true,
)
from twin.report.spheres import fit_tables
from twin.report.table import Table, pairs
from twin.report.words import number, percent
from twin.results.figures import why_absent
from twin.results.record import Measurement
from twin.results.score import wanted_pixels

METHOD, WARNED = "direct FPP", "Not everything could be fitted"

REASON_WORDS = {
    Reason.DARK: "too dark: no projector light reaches the camera",
    Reason.LOW_MODULATION: "fringes too weak",
    Reason.SATURATED: "saturated",
    Reason.ORDER_UNCERTAIN: "fringe order uncertain",
    Reason.OUTSIDE_PROJECTOR: "decoded to outside the projector image",
    Reason.EDGE: "at the edge of the light",
    Reason.EPIPOLAR_MISMATCH: "column and row contradict each other",
    Reason.NO_POINT: "rays do not meet",
    Reason.MOTION: "moved during the sequence",
}


def sentences(scored: Measurement) -> list[str]:
    """Return the result as lines of text for a terminal, at most 100 columns wide, in ASCII."""
    figures = scored.figures
    rms, mean, p95 = (
        number(figures[name], ".2f") for name in ("z_rmse_um", "z_bias_um", "z_p95_um")
    )
    absent = why_absent(figures)
    return [
        result_in_words(scored).replace("µ", "u"),
        f"points on {number(figures['completeness'], '.1%', '-')} of it, "
        f"{number(figures['wrong_order_pixels'], 'd', '-')} wrong fringe orders, "
        f"{figures['saturated_share']:.2%} of all pixel values saturated",
        f"z error: none, {absent}"
        if absent
        else f"z error of these points: {rms} um RMS, mean {mean} um, {p95} um P95",
    ]


def shares(scored: Measurement) -> Table:
    """Return the table of pixel shares and z errors in the specimen's visible area."""
    figures, limit_um = scored.figures, scored.experiment.score.good_within_um
    why = why_absent(figures)
    unit = f"({why})" if why else "µm"
    rows = [
        ("camera pixels that show the specimen", str(figures["lit_pixels"]), ""),
        ("of these with a point", percent(figures["completeness"]), ""),
        (f"with a point within {limit_um:g} µm", percent(figures["good_share"]), ""),
        ("z error, RMS", number(figures["z_rmse_um"], ".2f"), unit),
        ("z error, mean", number(figures["z_bias_um"], ".2f"), unit),
        ("z error, 95th percentile of its size", number(figures["z_p95_um"], ".2f"), unit),
        ("pixels with a wrong fringe order", number(figures["wrong_order_pixels"], "d"), ""),
        ("saturated pixel values, whole image", f"{figures['saturated_share']:.2%}", ""),
    ]
    return pairs("shares", "Points and z errors on the specimen", rows)


def verdicts(scored: Measurement) -> list[Verdict]:
    """Return the judgement of the measured share, and the reasons for missing points."""
    return [_coverage(scored), _missing(scored)]


def discussion(scored: Measurement) -> list[str]:
    """Return paragraphs on the shares of good points and of points with a larger error."""
    if not scored.score.against_truth.points:
        return [
            "No pixel of the specimen has a point; the map above shows the reason for each pixel."
        ]
    figures = scored.figures
    wrong_points = figures.known("completeness") - figures.known("good_share")
    return [
        f"{result_in_words(scored)} {percent(wrong_points)} of it has a point with a larger error: "
        "a decoder that masks by contrast and consistency cannot distinguish light reflected by "
        "another surface from direct light.",
    ]


def missing_shares(scored: Measurement) -> dict[Reason, float]:
    """Return the share of the scored pixels without a point, by reason, largest share first."""
    scored_pixels = wanted_pixels(scored.experiment, scored.truth)
    reasons = scored.fringes.reconstruction.point_map.mask_reason[scored_pixels]
    shares_by_reason = reason_shares(reasons) if reasons.size else {}
    shares_by_reason.pop(Reason.VALID, None)
    return dict(sorted(shares_by_reason.items(), key=lambda entry: -entry[1]))


def _coverage(scored: Measurement) -> Verdict:
    figures, limit_um = scored.figures, scored.experiment.score.good_within_um
    absent = why_absent(figures)
    words = f"{result_in_words(scored)} Good from {GOOD_SHARE:.0%}, poor below {POOR_SHARE:.0%}"
    return judged(
        "How much of the specimen is measured?",
        f"{percent(figures['good_share'])} within {limit_um:g}\N{NO-BREAK SPACE}µm",
        [JudgedTarget(words, grade_of_share(figures["good_share"] or 0.0))],
        (
            f"a point, good or not, on {percent(figures['completeness'])}",
            absent or f"{figures['z_rmse_um']:.2f} µm RMS over these points",
            f"{number(figures['wrong_order_pixels'], 'd')} wrong fringe orders",
        ),
    )


def _missing(scored: Measurement) -> Verdict:
    missing = missing_shares(scored)
    lost = float(np.sum(list(missing.values())))
    first = next(iter(missing), None)
    return Verdict(
        question="Why do pixels of the specimen have no measured point?",
        headline=REASON_WORDS[first] if first else "every pixel has a point",
        grade=grade_of_share(1.0 - lost),
        reasons=tuple(f"{REASON_WORDS[r]}: {percent(share)}" for r, share in missing.items())
        or ("every pixel that shows the specimen has a point",),
    )


_PANEL_IN, _ACROSS_IN, _TOP_IN = 3.1, 3.4, 0.3
# Space for a colour bar below the upper row of panels, and for all reasons below the lower row.
_BELOW_UPPER_IN, _BELOW_LOWER_IN = 0.95, 1.4


def sections(measured: Measurement) -> list[Section]:
    """Return the sections of the page that are specific to direct fringe projection."""
    result: list[Block] = [seen_figure(measured), shares(measured), *fit_tables(measured)]
    result += discussion(measured)
    return [
        Section("glance", "Experiment", (glance(measured),)),
        Section("result", "Result", tuple(result)),
        recorded_section(measured),
        *film_sections(measured),
    ]


def seen_figure(measured: Measurement) -> Figure:
    """Return the figure of frames, heights, z errors and reasons why points are missing.

    All panels show the same camera pixels.
    """
    limit_um = measured.experiment.score.good_within_um
    return Figure(
        "seen",
        "Frames, heights, errors and missing points",
        "All panels show the same camera pixels. Frames: digital numbers, black is 0, white is "
        "saturation. Heights: world z in mm, lit from the upper left, measured and true on the "
        f"same scale{shading_words(measured)}; white: no point. Errors (measured minus true z) and "
        "reasons are shown on the specimen only; all other pixels are gray. The error scale ends "
        f"at ± {limit_um:g} µm, the limit of a good point.",
        "frames, true and measured heights, error and reasons in camera pixels",
        lambda path: draw_seen(path, measured),
    )


def draw_seen(path: Path, measured: Measurement) -> None:
    """Draw six panels as PNG.

    The upper row shows white frame, fringe frame and true heights; the lower row measured heights,
    z error and reasons for missing points.
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
        lower[2].set_title("pixels without a point")
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
