"""What the result table means, in sentences that follow from this run's numbers."""

import numpy as np
from scipy.optimize import brentq

from twin.mechanics import opposite_transfer
from twin.report.fields import number
from twin.report.paper import CONTACT_FPP, PaperRow, paper_row
from twin.report.verdict import MOST_SPREAD_OVER_SIGMA
from twin.results.record import Measurement
from twin.results.score import SphereScore

# Residuals of fit and truth closer than this are one and the same form.
_SAME_FORM = 0.2


def discussion(scored: Measurement) -> list[str]:
    """Return the paragraphs, most important first."""
    if not scored.score.against_truth.points:
        return ["No pixel carries a point; the map of the masked pixels says why."]
    paragraphs = [_measurement(scored)]
    if scored.score.spheres:
        paragraphs += [_radius(scored), _elastomer(scored), _residuals(scored)]
    numbers = [ball.number for ball in scored.score.spheres]
    papers = [paper_row(scored.experiment, CONTACT_FPP, number) for number in numbers]
    published = [row for row in papers if row is not None]
    return [*paragraphs, _paper(scored, published)] if published else paragraphs


def pitch_kept_mm(share: float, thickness_mm: float) -> float:
    """Pitch whose relief the coated face keeps to `share`, from T(q), q = 2 pi h / pitch."""

    def excess(q: float) -> float:
        return float(opposite_transfer(np.array([q]))[0]) - share

    return float(2 * np.pi * thickness_mm / brentq(excess, 1e-3, 40.0))


def _measurement(scored: Measurement) -> str:
    figures = scored.figures
    bias_um, spread = _signed(figures["z_bias_um"], 2), figures["error_over_sigma"]
    cause = "a single point has no spread"
    if spread is not None:
        cause = (
            "camera noise explains the errors"
            if spread <= MOST_SPREAD_OVER_SIGMA
            else "something systematic adds to the camera noise"
        )
    return (
        f"Measured against the true coated face: {figures['z_rmse_um']:.2f} µm RMS in z, mean "
        f"{bias_um} µm. The spread is {number(spread, '.2f')} times what the camera's noise "
        f"predicts (median σ {figures['sigma_z_median_um']:.2f} µm): {cause}."
    )


def _radius(scored: Measurement) -> str:
    parts = [_radius_of(ball) for ball in scored.score.spheres]
    return (
        "The fitted radius is the coated face's, not the ball's: the camera never sees the ball. "
        + " ".join(parts)
    )


def _radius_of(ball: SphereScore) -> str:
    nominal, true, measured = ball.nominal.radius_mm, ball.true_face.radius_mm, ball.measured
    return (
        f"Ball {ball.number}: of the difference of {_signed(measured.radius_mm - nominal)} mm to "
        f"the ball's {nominal:g} mm, the elastomer accounts for {_signed(true - nominal)} mm and "
        f"the measurement for {_signed(measured.radius_mm - true)} mm."
    )


def _signed(value: float, digits: int = 3) -> str:
    """Write a number with its sign, with the minus of print."""
    return f"{value:+.{digits}f}".replace("-", "−")


def _elastomer(scored: Measurement) -> str:
    return _sheet(scored) if scored.figures["mechanics_model"] == "sheet" else _slab(scored)


def _sheet(scored: Measurement) -> str:
    sheet, figures = scored.experiment.elastomer, scored.figures
    return (
        f"The sheet of {sheet.thickness_mm:g} mm wraps the specimen as far as pressure, tack and "
        "stretch press it on: there the coat lies one local thickness over it, and a ball of "
        "radius R shows R and that thickness. Beyond, the sheet is a tent, and what is fitted to "
        f"it says little of the ball. Here it is stretched up to {figures['largest_stretch']:.2f} "
        f"times, {figures['thinnest_mm']:.3f} mm thick where it is thinnest and up to "
        f"{figures['steepest_deg']:.0f}° steep."
    )


def _slab(scored: Measurement) -> str:
    slab, figures = scored.experiment.elastomer, scored.figures
    half, tenth = (pitch_kept_mm(share, slab.thickness_mm) for share in (0.5, 0.1))
    lifted = figures["relief_peak_mm"] / figures["depth_mm"]
    return (
        f"Two effects of the slab shape that radius. It is a low-pass filter: T(q) = (sinh q + q "
        f"cosh q) / (sinh q cosh q + q), q = 2π · thickness / pitch; with {slab.thickness_mm:g} mm "
        f"it keeps half the contrast at a pitch of {half:.2f} mm and a tenth at {tenth:.2f} mm, "
        f"whatever the hardness. And it bends over its free span of {slab.length_x_mm:g} × "
        f"{slab.length_y_mm:g} mm: the coated face rises by {figures['relief_peak_mm']:.3f} mm, "
        f"{lifted:.0%} of the press depth."
    )


def _residuals(scored: Measurement) -> str:
    ratios = [
        ball.measured.stats.rmse_mm / max(ball.true_face.stats.rmse_mm, 1e-12)
        for ball in scored.score.spheres
    ]
    ours = (
        "Here measured and true face leave nearly the same RMSE, so the residuals are the form of "
        "the face and the noise hardly adds to them."
        if max(ratios) < 1 + _SAME_FORM
        else f"Here the measured RMSE is up to {max(ratios):.1f} times that of the true face: "
        "noise and systematic errors of the measurement add to the form of the face."
    )
    return (
        "RMSE, MAE and P95 are radial distances from the fitted sphere. Small ones say that the "
        f"face is round, not that its radius is the ball's. {ours}"
    )


def _paper(scored: Measurement, published: list[PaperRow]) -> str:
    slab, ball = scored.experiment.elastomer, scored.score.spheres[0].nominal.radius_mm
    papers = " and ".join(f"{row.radius_mm:.3f}" for row in published)
    return (
        f"The paper reports {papers} mm, below the ball's {ball:g} mm. A low-pass filter flattens "
        f"and enlarges radii, and a skin of {slab.thickness_mm:g} mm draped closely over the ball "
        f"would show {ball + slab.thickness_mm:g} mm. {_origin(scored)} Scale of the calibration, "
        f"region of the fit{_beyond(scored)} remain as causes; the paper does not give the data to "
        "decide, and the twin is not tuned to meet it."
    )


def _beyond(scored: Measurement) -> str:
    linear = scored.figures["mechanics_model"] == "spectral"
    return " and strains beyond the linear slab" if linear else " and texture of the coat"


def _origin(scored: Measurement) -> str:
    enlarged = all(b.true_face.radius_mm >= b.nominal.radius_mm for b in scored.score.spheres)
    return (
        "So the paper's value cannot come from the elastomer as modelled here."
        if enlarged
        else "In this run the true face does come out below the ball's radius: within the region "
        "of the fit, bending shapes it as much as the ball does."
    )
