"""The three questions a designer asks first, each with a number and a judgement."""

from dataclasses import dataclass
from typing import Any, Literal

from twin.report.fields import number
from twin.results.record import Measurement
from twin.results.score import why_absent

Grade = Literal["good", "check", "poor"]

MOST_SPREAD_OVER_SIGMA = 1.15
LEAST_COMPLETENESS = 0.95
MOST_SATURATED_SHARE = 1e-3
MOST_FILTER_BIAS_SHARE = 0.1
GOOD_RADIUS_SHARE, POOR_RADIUS_SHARE = 0.05, 0.25


@dataclass(frozen=True)
class Verdict:
    """One card at the head of the report."""

    question: str
    headline: str
    grade: Grade
    reasons: tuple[str, ...]


def verdicts(scored: Measurement) -> list[Verdict]:
    """Judge measurement, shape transfer and press, in this order."""
    shape = [_shape(scored)] if scored.score.spheres else []
    return [_sensor(scored), *shape, judge_press(scored.figures)]


def _sensor(scored: Measurement) -> Verdict:
    figures = scored.figures
    if not scored.score.against_truth.points:
        return Verdict(
            question="Does the sensor see the coated face?",
            headline=why_absent(figures),
            grade="poor",
            reasons=(
                f"{figures['saturated_share']:.1%} of all pixel values saturated",
                "the mask map below says why each pixel was left out",
            ),
        )
    wrong, share = figures["wrong_order_pixels"], figures["completeness"]
    spread, saturated = figures["error_over_sigma"], figures["saturated_share"]
    held = (
        share >= LEAST_COMPLETENESS
        and spread is not None
        and spread <= MOST_SPREAD_OVER_SIGMA
        and saturated <= MOST_SATURATED_SHARE
    )
    return Verdict(
        question="Does the sensor see the coated face?",
        headline=f"{figures['z_rmse_um']:.2f}\N{NO-BREAK SPACE}µm RMS in z",
        grade="poor" if wrong else ("good" if held else "check"),
        reasons=(
            f"{wrong} wrong fringe orders (0 wanted)",
            f"points on {share:.1%} of the lit pixels (at least {LEAST_COMPLETENESS:.0%})",
            f"spread {number(spread, '.2f')} times the noise predicted (at most "
            f"{MOST_SPREAD_OVER_SIGMA:g})",
            f"{saturated:.2%} of all pixel values saturated (at most {MOST_SATURATED_SHARE:.1%})",
            *_filter_hint(figures),
        ),
    )


def _filter_hint(figures: dict[str, Any]) -> list[str]:
    share = figures["filter_bias_share"]
    if share is None or share <= MOST_FILTER_BIAS_SHARE:
        return []
    return [
        f"on {share:.0%} of the points the filter may take more from the relief than noise is left "
        f"(at most {MOST_FILTER_BIAS_SHARE:.0%}; {figures['filter_bias_um']:.2f} µm RMS, in sigma):"
        " lower decode.filter_sigma_px"
    ]


def _shape(scored: Measurement) -> Verdict:
    spheres = scored.score.spheres
    ratios = [s.true_face.radius_mm / s.nominal.radius_mm for s in spheres]
    farthest = max(ratios, key=lambda ratio: abs(ratio - 1))
    worst = abs(farthest - 1)
    grade: Grade = "check" if worst <= POOR_RADIUS_SHARE else "poor"
    radii = dict.fromkeys(f"{s.true_face.radius_mm:.2f}" for s in spheres)
    return Verdict(
        question="Does the coated face show the ball?",
        headline=f"radius {' and '.join(radii)}\N{NO-BREAK SPACE}mm, "
        f"ball\N{NO-BREAK SPACE}{spheres[0].nominal.radius_mm:g}\N{NO-BREAK SPACE}mm",
        grade="good" if worst <= GOOD_RADIUS_SHARE else grade,
        reasons=(
            f"the true face's radius is {farthest:.2f} times the ball's "
            f"(good within {GOOD_RADIUS_SHARE:.0%}, poor beyond {POOR_RADIUS_SHARE:.0%})",
            "a property of elastomer and press, not of the optics",
        ),
    )


def judge_press(figures: dict[str, Any]) -> Verdict:
    """Judge the press by its figures in result.json."""
    warnings = figures["warnings"]
    error_um, peak_um = 1e3 * figures["height_error_estimate_mm"], 1e3 * figures["relief_peak_mm"]
    return Verdict(
        question="Can the press model be trusted?",
        headline=f"± {error_um:.3g} µm estimated",
        grade="check" if warnings else "good",
        reasons=(
            f"error of leaving out {_left_out(figures)}, "
            f"{error_um / max(peak_um, 1e-9):.1%} of the relief",
            f"{len(warnings)} warning{'' if len(warnings) == 1 else 's'} of the press"
            + (", listed below" if warnings else ""),
        ),
    )


def _left_out(figures: dict[str, Any]) -> str:
    sheet = figures.get("mechanics_model") == "sheet"
    return "shear through the thickness" if sheet else "large strain"
