"""Report of a measurement of the pressed coat by fringes: judgements, discussion, sections."""

import numpy as np
from scipy.optimize import brentq

from twin.mechanics import opposite_transfer
from twin.mechanics.models import model_of
from twin.report.bound import bound_section
from twin.report.camera_images import recorded_section
from twin.report.experiment import glance
from twin.report.film import film_sections
from twin.report.page import JudgedTarget, Section, TwoColumns, Verdict, judged, target
from twin.report.press import judge_press, press_figure
from twin.report.rig_view import rig_figure
from twin.report.spheres import ball_sections, fit_tables
from twin.report.surfaces import error_figure, height_map_figure, relief_figure
from twin.report.words import number, signed
from twin.results.balls import SphereScore
from twin.results.figures import Figures, why_absent
from twin.results.record import Measurement

METHOD = "contact-FPP"
WARNED = "Warnings: the press or a value is outside its range, or a fit failed"
MOST_SPREAD_OVER_SIGMA = 1.15
LEAST_COMPLETENESS = 0.95
MOST_SATURATED_SHARE = 1e-3
MOST_FILTER_BIAS_SHARE = 0.1


def verdicts(scored: Measurement) -> list[Verdict]:
    """Return judgements of the measured coat and of the press."""
    return [_sensor(scored), judge_press(scored)]


def _sensor(scored: Measurement) -> Verdict:
    figures = scored.figures
    if not scored.score.against_truth.points:
        return Verdict(
            question="How accurately is the coated face measured?",
            headline=why_absent(figures),
            grade="poor",
            reasons=(
                f"{figures['saturated_share']:.1%} of all pixel values saturated",
                "the map of masked pixels below shows the reason for each pixel",
            ),
        )
    wrong, share = figures["wrong_order_pixels"], figures.known("completeness")
    spread, saturated = figures["error_over_sigma"], figures.known("saturated_share")
    targets = [
        target(f"{wrong} wrong fringe orders (target: 0)", not wrong, "poor"),
        target(
            f"{share:.1%} of the lit pixels have a point (target: at least "
            f"{LEAST_COMPLETENESS:.0%})",
            share >= LEAST_COMPLETENESS,
        ),
        target(
            f"normalised error (error / predicted sigma) {number(spread, '.2f')} (target: "
            f"at most {MOST_SPREAD_OVER_SIGMA:g})",
            spread is not None and spread <= MOST_SPREAD_OVER_SIGMA,
        ),
        target(
            f"{saturated:.2%} of all pixel values saturated (target: at most "
            f"{MOST_SATURATED_SHARE:.1%})",
            saturated <= MOST_SATURATED_SHARE,
        ),
        *_filter_target(figures),
    ]
    headline = f"z error {figures['z_rmse_um']:.2f}\N{NO-BREAK SPACE}µm RMS"
    return judged("How accurately is the coated face measured?", headline, targets)


def _filter_target(figures: Figures) -> list[JudgedTarget]:
    """Return the target for the bias of the phase filter; empty if it is met or unknown."""
    share = figures["filter_bias_share"]
    if share is None or share <= MOST_FILTER_BIAS_SHARE:
        return []
    words = (
        f"on {share:.0%} of the points the phase filter may bias the height by more than the noise "
        f"(target: at most {MOST_FILTER_BIAS_SHARE:.0%}; bias {figures['filter_bias_um']:.2f} µm "
        "RMS, included in sigma): lower decode.filter_sigma_px"
    )
    return [target(words, met=False)]


# Relative difference of measured and true RMSE below which both faces have the same form.
_SAME_FORM = 0.2


def discussion(scored: Measurement) -> list[str]:
    """Return the paragraphs that explain the result, the most important paragraph first."""
    if not scored.score.against_truth.points:
        return ["No pixel has a point; the map of masked pixels shows the reason for each pixel."]
    paragraphs = [_measurement(scored)]
    if scored.score.spheres:
        paragraphs += [_radius(scored), _elastomer(scored), _residuals(scored)]
    return paragraphs


def _elastomer(scored: Measurement) -> str:
    """Return a paragraph on how elastomer and layout change the radius of a ball."""
    if model_of(str(scored.metrics["mechanics_model"])).wraps:
        return _sheet(scored)
    return _on_window() if scored.experiment.elastomer.layout == "contact_face" else _slab(scored)


def sentences(measured: Measurement) -> list[str]:
    """Return the result as lines of text for a terminal, at most 100 columns wide, in ASCII."""
    figures = measured.figures
    absent = why_absent(figures)
    rms, p95, spread = (
        number(figures[name], ".2f", "-") for name in ("z_rmse_um", "z_p95_um", "error_over_sigma")
    )
    words = f"{rms} um RMS, {p95} um P95; normalised error {spread}"
    return [
        f"z error against the true coat: {f'none, {absent}' if absent else words}",
        f"points on {number(figures['completeness'], '.1%', '-')} of the lit pixels, "
        f"{number(figures['wrong_order_pixels'], 'd', '-')} wrong fringe orders; "
        f"force {figures['force_n']:.3g} N at {figures['depth_mm']:.3g} mm",
    ]


def pitch_kept_mm(share: float, thickness_mm: float) -> float:
    """Return the pitch (mm) of a relief at which a slab transmits `share` of its amplitude.

    The transfer T(q) of `opposite_transfer` then equals `share`; q = 2 pi h / pitch, and h is the
    thickness of the slab.
    """

    def excess(q: float) -> float:
        return float(opposite_transfer(np.array([q]))[0]) - share

    return float(2 * np.pi * thickness_mm / brentq(excess, 1e-3, 40.0))


def _measurement(scored: Measurement) -> str:
    figures = scored.figures
    bias_um, spread = signed(figures.known("z_bias_um"), 2), figures["error_over_sigma"]
    cause = "a single point has no spread"
    if spread is not None:
        cause = (
            "noise and filter bias explain the errors"
            if spread <= MOST_SPREAD_OVER_SIGMA
            else "there are further systematic errors"
        )
    return (
        f"Error of z against the true coated face: {figures['z_rmse_um']:.2f} µm RMS, mean "
        f"{bias_um} µm. Predicted from camera noise and the possible bias of the phase filter: "
        f"σ = {figures['sigma_z_median_um']:.2f} µm (median). Normalised error (robust "
        f"spread of error / predicted σ): {number(spread, '.2f')}; {cause}."
    )


def _radius(scored: Measurement) -> str:
    parts = [_radius_of(ball) for ball in scored.score.spheres]
    return (
        "The sphere fits give the apparent radius of the coated face, not that of the ball. "
        + " ".join(parts)
    )


def _radius_of(ball: SphereScore) -> str:
    nominal, true, measured = ball.nominal.radius_mm, ball.true_face.radius_mm, ball.measured
    return (
        f"Ball {ball.number}: of the difference of {signed(measured.radius_mm - nominal)} mm to "
        f"the ball's {nominal:g} mm, the elastomer accounts for {signed(true - nominal)} mm and "
        f"the measurement for {signed(measured.radius_mm - true)} mm."
    )


def _sheet(scored: Measurement) -> str:
    sheet, figures = scored.experiment.elastomer, scored.figures
    return (
        f"Pressure, tack and stretch determine how far the {sheet.thickness_mm:g} mm sheet wraps "
        "the specimen. In the contact the distance from specimen to coat is the local thickness: "
        "the coat over a ball of radius R has the radius R plus this thickness. Outside the "
        "contact the sheet spans freely, and its shape contains little information on the ball. "
        "Here the largest "
        f"stretch is {figures['largest_stretch']:.2f}, the smallest thickness "
        f"{figures['thinnest_mm']:.3f} mm and the largest slope {figures['steepest_deg']:.0f}°."
    )


def _on_window() -> str:
    return (
        "The coat is on the face that touches the ball. In the contact, the coat has the shape of "
        "the ball; gel and load determine the size of the contact. Outside the contact, coat and "
        "ball separate: a fit region that extends there includes the free shape of the gel."
    )


def _slab(scored: Measurement) -> str:
    slab, figures = scored.experiment.elastomer, scored.figures
    half_mm, low_mm = (pitch_kept_mm(share, slab.thickness_mm) for share in (0.5, 0.1))
    lifted = figures.known("relief_peak_mm") / figures.known("depth_mm")
    return (
        "Two effects of the slab change this radius. First, the slab is a low-pass filter: T(q) = "
        "(sinh q + q cosh q) / (sinh q cosh q + q), q = 2π · thickness / pitch. With "
        f"{slab.thickness_mm:g} mm it transmits 50 % of the relief at a pitch of {half_mm:.2f} mm "
        f"and 10 % at {low_mm:.2f} mm, independent of the hardness. Second, the slab bends over "
        f"its free span of {slab.length_x_mm:g} × {slab.length_y_mm:g} mm: the coated face rises "
        f"by {figures['relief_peak_mm']:.3f} mm, {lifted:.0%} of the press depth."
    )


def _residuals(scored: Measurement) -> str:
    ratios = [
        ball.measured.stats.rmse_mm / max(ball.true_face.stats.rmse_mm, 1e-12)
        for ball in scored.score.spheres
    ]
    ours = (
        "Here measured and true face have nearly the same RMSE: the residuals are the form of the "
        "face, and noise contributes little."
        if max(ratios) < 1 + _SAME_FORM
        else f"Here the measured RMSE is up to {max(ratios):.1f} times that of the true face: "
        "noise and systematic errors of the measurement add to the form of the face."
    )
    return (
        "RMSE, MAE and P95 are radial distances from the fitted sphere. Small values mean that the "
        f"face is spherical, not that its radius is that of the ball. {ours}"
    )


def sections(measured: Measurement) -> list[Section]:
    """Return the sections of the page that are specific to a pressed coat with fringes."""
    blocks = [
        Section(
            "glance", "Experiment", (TwoColumns((glance(measured),), (rig_figure(measured),)),)
        ),
        Section("result", "Result", (*fit_tables(measured), *discussion(measured))),
        recorded_section(measured),
        *film_sections(measured),
    ]
    if measured.score.against_truth.points:
        relief = (relief_figure(measured), height_map_figure(measured))
        error = (error_figure(measured),)
        blocks.append(Section("surface", "Measured surface", relief))
        blocks.append(Section("error", "Error against the true coat", error))
    pressed = Section("pressed", "Specimen and elastomer", (press_figure(measured),))
    return [*blocks, *bound_section(measured), *ball_sections(measured), pressed]
