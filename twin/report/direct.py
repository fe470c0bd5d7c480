"""What a measurement of the bare specimen says: how much of it was measured, and why not the rest.

Shares count the pixels that show the specimen: its visible area, as the camera sees it.
"""

import numpy as np

from reconstruction.arrays import Reason
from twin.report.appendix import Figure
from twin.report.decoding import reason_shares
from twin.report.fields import NONE, number
from twin.report.verdict import Grade, Verdict
from twin.results.record import Measurement
from twin.results.score import wanted_pixels, why_absent

GOOD_SHARE, POOR_SHARE = 0.95, 0.5

REASON_WORDS = {
    Reason.DARK: "no projector light comes back",
    Reason.LOW_MODULATION: "fringes too weak",
    Reason.SATURATED: "saturated",
    Reason.ORDER_UNCERTAIN: "fringe order uncertain",
    Reason.OUTSIDE_PROJECTOR: "decoded to outside the projector image",
    Reason.EDGE: "at the edge of the light",
    Reason.EPIPOLAR_MISMATCH: "column and row contradict each other",
    Reason.NO_POINT: "rays do not meet",
}


def verdict_in_words(scored: Measurement) -> str:
    """Return the result in one sentence."""
    surface = "lit coat" if scored.experiment.method.presses else "specimen's visible area"
    if scored.figures["good_share"] is None:
        return f"The camera sees nothing of the {surface}."
    return (
        f"{percent(scored.figures['good_share'])} of the {surface} has a point within "
        f"{scored.experiment.score.good_within_um:g} µm."
    )


def percent(share: float | None) -> str:
    """Write a share; next to none and next to all are not rounded away."""
    if share is None:
        return NONE
    if 0 < share < 1e-4:
        return "< 0.01 %"
    if 1 - 1e-4 < share < 1:
        return "> 99.99 %"
    digits = 2 if 0 < share < 0.01 or 0.99 < share < 1 else 0
    return f"{100 * share:.{digits}f} %"


def sentences(scored: Measurement) -> list[str]:
    """Return the result for a terminal, at most 100 columns wide, in ASCII."""
    figures = scored.figures
    rms, mean, p95 = (
        number(figures[name], ".2f") for name in ("z_rmse_um", "z_bias_um", "z_p95_um")
    )
    absent = why_absent(figures)
    return [
        verdict_in_words(scored).replace("µ", "u"),
        f"points on {number(figures['completeness'], '.1%', '-')} of it, "
        f"{number(figures['wrong_order_pixels'], 'd', '-')} wrong fringe orders, "
        f"{figures['saturated_share']:.2%} of all pixel values saturated",
        f"z error: none, {absent}"
        if absent
        else f"z error of these points: {rms} um RMS, mean {mean} um, {p95} um P95",
    ]


def shares(scored: Measurement) -> list[Figure]:
    """Return the figures of the specimen's visible area."""
    figures, limit_um = scored.figures, scored.experiment.score.good_within_um
    why = why_absent(figures)
    unit = f"({why})" if why else "µm"
    return [
        Figure("pixels that show it", str(figures["lit_pixels"])),
        Figure("with a point", percent(figures["completeness"])),
        Figure(f"with a point within {limit_um:g} µm", percent(figures["good_share"])),
        Figure("z error, RMS", number(figures["z_rmse_um"], ".2f"), unit),
        Figure("z error, mean", number(figures["z_bias_um"], ".2f"), unit),
        Figure("z error, P95 of its size", number(figures["z_p95_um"], ".2f"), unit),
        Figure("wrong fringe orders", number(figures["wrong_order_pixels"], "d")),
        Figure("saturated pixel values, whole image", f"{figures['saturated_share']:.2%}"),
    ]


def verdicts(scored: Measurement) -> list[Verdict]:
    """Judge how much is measured, and say what keeps the rest from it."""
    return [_coverage(scored), _missing(scored)]


def discussion(scored: Measurement) -> list[str]:
    """Return the paragraphs of the result."""
    if not scored.score.against_truth.points:
        return ["No pixel of the specimen carries a point; the map above says why."]
    figures = scored.figures
    wrong_points = figures["completeness"] - figures["good_share"]
    return [
        f"{verdict_in_words(scored)} {percent(wrong_points)} of it carries a point that is off by "
        "more: a decoder that masks by contrast and consistency cannot tell light that came by way "
        "of another surface from light that came straight.",
    ]


def missing_shares(scored: Measurement) -> dict[Reason, float]:
    """Return the share of the wanted pixels without a point by reason, largest first."""
    wanted = wanted_pixels(scored.experiment, scored.truth)
    reasons = scored.fringes.reconstruction.point_map.mask_reason[wanted]
    found = reason_shares(reasons) if reasons.size else {}
    found.pop(Reason.VALID, None)
    return dict(sorted(found.items(), key=lambda entry: -entry[1]))


def _coverage(scored: Measurement) -> Verdict:
    figures, limit_um = scored.figures, scored.experiment.score.good_within_um
    share, absent = figures["good_share"] or 0.0, why_absent(figures)
    measured: Grade = "good" if share >= GOOD_SHARE else "check"
    return Verdict(
        question="How much of the specimen is measured?",
        headline=f"{percent(figures['good_share'])} within {limit_um:g}\N{NO-BREAK SPACE}µm",
        grade="poor" if share < POOR_SHARE else measured,
        reasons=(
            f"{verdict_in_words(scored)} Good from {GOOD_SHARE:.0%}, poor below {POOR_SHARE:.0%}",
            f"a point, right or wrong, on {percent(figures['completeness'])}",
            absent or f"{figures['z_rmse_um']:.2f} µm RMS over these points",
            f"{number(figures['wrong_order_pixels'], 'd')} wrong fringe orders",
        ),
    )


def _missing(scored: Measurement) -> Verdict:
    missing = missing_shares(scored)
    lost = float(np.sum(list(missing.values())))
    first = next(iter(missing), None)
    measured: Grade = "good" if lost <= 1 - GOOD_SHARE else "check"
    return Verdict(
        question="Why is there no point on the rest?",
        headline=REASON_WORDS[first] if first else "there is no rest",
        grade="poor" if lost > 1 - POOR_SHARE else measured,
        reasons=tuple(f"{REASON_WORDS[r]}: {percent(share)}" for r, share in missing.items())
        or ("every pixel that shows the specimen has a point",),
    )
