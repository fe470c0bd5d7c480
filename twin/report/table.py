"""The result table: sphere fits per ball beside the paper's, as rows and as plain text."""

from dataclasses import astuple, dataclass, replace
from typing import Any

from reconstruction.evaluate.fit import SphereFit
from twin.pipeline.comparison import Outcome
from twin.report import direct
from twin.report.fields import number
from twin.report.paper import CONTACT_FPP, GELSIGHT, PaperRow, paper_row
from twin.results.record import Measurement
from twin.results.score import SphereScore, why_absent

HEADINGS = ("radius", "|error|", "RMSE", "MAE", "P95")
MEASURED_LABEL = "measured"
_WIDTH = 10


@dataclass(frozen=True)
class Row:
    """One line of the table; values in mm, in the order of HEADINGS."""

    ball: int
    label: str
    values_mm: tuple[float, ...]

    @property
    def cells(self) -> tuple[str, ...]:
        """Values as text: radii to 1 um, residuals to 0.1 um."""
        radius, error, *residuals = self.values_mm
        return (f"{radius:.3f}", f"{error:.3f}", *(f"{value:.4f}" for value in residuals))


def fringe_table(scored: Measurement) -> str:
    """Return the result of a measurement with fringes as plain text; see `summary_table`."""
    title = f"{scored.experiment.name}, sphere fits (mm)"
    lines = [line_of(title, HEADINGS)] if scored.score.spheres else []
    for ball in scored.score.spheres:
        for row in ball_rows(scored, ball, methods=(CONTACT_FPP,)):
            first = row.label == MEASURED_LABEL
            lines.append(
                line_of(f"{f'ball {ball.number}' if first else '':<8}{row.label}", row.cells)
            )
    return "\n".join([*lines, *scored.score.unfitted, *_sentences(scored)])


def comparison_table(outcomes: list[Outcome]) -> str:
    """Return the result of a comparison as a short plain-text table, at most 100 columns."""
    heads = ("points", "good", "RMS um", "P95 um", "orders")
    lines = [line_of("specimen, method", heads)]
    for outcome in outcomes:
        label = f"{outcome.name[:16]:<17}{outcome.method}"
        lines.append(line_of(label, _compared(outcome.figures or {})))
    failed = [f"{one.name}, {one.method}: {one.failure}" for one in outcomes if one.failure]
    return "\n".join([*lines, *failed])


def _compared(figures: dict[str, Any]) -> tuple[str, ...]:
    if not figures:
        return ("failed",)
    return (
        *(number(figures[name], ".1%", "-") for name in ("completeness", "good_share")),
        *(number(figures[name], ".2f", "-") for name in ("z_rmse_um", "z_p95_um")),
        number(figures.get("wrong_order_pixels"), "d", "-"),
    )


def ball_rows(
    scored: Measurement, sphere: SphereScore, methods: tuple[str, ...] = (CONTACT_FPP, GELSIGHT)
) -> list[Row]:
    """Return measured, true face and, for the coat, the paper's rows of one ball."""
    number = sphere.number
    nominal_mm = sphere.nominal.radius_mm
    rows = [
        Row(number, MEASURED_LABEL, fit_values(sphere.measured, nominal_mm)),
        Row(number, "true coated face", fit_values(sphere.true_face, nominal_mm)),
    ]
    if not scored.experiment.method.presses:
        return [rows[0], replace(rows[1], label="true surface")]
    for method in methods:
        published: PaperRow | None = paper_row(scored.experiment, method, number)
        if published is not None:
            rows.append(Row(number, f"paper, {method}", astuple(published)))
    return rows


def fit_values(fit: SphereFit, nominal_mm: float) -> tuple[float, ...]:
    """Return one fit as a row of the table, in the order of HEADINGS."""
    stats = fit.stats
    error_mm = abs(fit.radius_mm - nominal_mm)
    return (fit.radius_mm, error_mm, stats.rmse_mm, stats.mae_mm, stats.p95_mm)


def line_of(label: str, cells: tuple[str, ...]) -> str:
    """Return one line of a plain-text table."""
    return f"{label:<36}" + "".join(f"{cell:>{_WIDTH}}" for cell in cells)


def _sentences(scored: Measurement) -> list[str]:
    figures = scored.figures
    if not scored.experiment.method.presses:
        return direct.sentences(scored)
    warnings, absent = figures["warnings"], why_absent(figures)
    rms, p95, spread = (
        number(figures[name], ".2f", "-") for name in ("z_rmse_um", "z_p95_um", "error_over_sigma")
    )
    told = f"{rms} um RMS, {p95} um P95; spread {spread} x predicted"
    lines = [
        f"z error against the true face: {f'none, {absent}' if absent else told}",
        f"points on {number(figures['completeness'], '.1%', '-')} of the lit pixels, "
        f"{number(figures['wrong_order_pixels'], 'd', '-')} wrong fringe orders; "
        f"force {figures['force_n']:.3g} N at {figures['depth_mm']:.3g} mm",
    ]
    if warnings:
        noun = "warning" if len(warnings) == 1 else "warnings"
        lines.append(f"{len(warnings)} {noun} of the press, see the report")
    return lines
