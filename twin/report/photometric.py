"""What a measurement by photometric stereo says: judgements, tables and sentences."""

from dataclasses import astuple, dataclass

from twin.report.appendix import Figure
from twin.report.direct import percent
from twin.report.fields import NONE, coating_phrase, number, phrase
from twin.report.paper import CONTACT_FPP, GELSIGHT, paper_row
from twin.report.photometric_maps import decoder_name
from twin.report.table import MEASURED_LABEL, Row, fit_values
from twin.report.verdict import Grade, Verdict, judge_press
from twin.results.decoders import DecodedImage
from twin.results.record import Measurement
from twin.results.score import SphereScore

GOOD_SCALE_ERROR, POOR_SCALE_ERROR = 0.05, 0.2
GOOD_SHARE, POOR_SHARE = 0.95, 0.5
DECODER_HEADINGS = ("height scale", "z RMS (µm)", "z mean (µm)", "z P95 (µm)", "good points")


@dataclass(frozen=True)
class DecoderRow:
    """One decoder in the table; cells in the order of DECODER_HEADINGS."""

    name: str
    own: bool
    cells: tuple[str, ...]


def verdict_in_words(seen: Measurement) -> str:
    """Return the result in one sentence."""
    limit_um = seen.experiment.score.good_within_um
    share = percent(seen.figures["good_share"])
    return f"{share} of the coat in the evaluated field has a point within {limit_um:g} µm."


def verdicts(seen: Measurement) -> list[Verdict]:
    """Judge heights, their scale and the press, in this order."""
    return [_heights(seen), _scale(seen), judge_press(seen.figures)]


def decoder_rows(seen: Measurement) -> list[DecoderRow]:
    """Return the figures of every decoder of this image."""
    return [
        DecoderRow(
            decoder_name(one),
            one is seen.colours.own,
            (
                number(one.errors.height_scale, ".3f"),
                *(f"{v:.1f}" for v in (one.errors.z_rmse_um, one.errors.z_bias_um)),
                f"{one.errors.z_p95_um:.1f}",
                percent(one.errors.good_share),
            ),
        )
        for one in seen.colours.decoded
    ]


def ball_rows(seen: Measurement, number: int) -> list[Row]:
    """Return one ball by the experiment's decoder, the others, the true coat and the paper."""
    rows = [_own_row(seen, number)]
    for one in seen.colours.decoded:
        ball = _ball(one, number)
        if one is not seen.colours.own and ball is not None:
            rows.append(_row(number, decoder_name(one), ball))
    true = _ball(seen.colours.own, number)
    assert true is not None  # this number is that of a fitted ball
    rows.append(Row(number, "true coat", fit_values(true.true_face, true.nominal.radius_mm)))
    for method in (GELSIGHT, CONTACT_FPP):
        published = paper_row(seen.experiment, method, number)
        if published is not None:
            rows.append(Row(number, f"paper, {method}", astuple(published)))
    return rows


def discussion(seen: Measurement) -> list[str]:
    """Return the paragraphs of the result."""
    own = seen.score.against_truth
    mean = f"{own.z_bias_um:+.1f}".replace("-", "−")
    found = [
        f"{verdict_in_words(seen)} Heights against the true coat: {own.z_rmse_um:.1f} µm RMS, mean "
        f"{mean} µm. Photometric stereo measures slopes; false ones too small to see in any pixel "
        "add up to a bow over the field when they are integrated.",
        _on_the_scale(seen),
    ]
    if seen.score.spheres:
        found.append(
            "A sphere fit with a free radius does not see a wrong height scale: a flattened cap is "
            "nearly a sphere too, of a larger radius. Read its RMSE together with the radius, and "
            "with the height error of the table above."
        )
    return found


def glance(seen: Measurement) -> list[tuple[str, str]]:
    """Return the experiment as (part, description) pairs."""
    experiment, figures = seen.experiment, seen.figures
    specimen = experiment.specimen.model_dump(exclude={"kind", "material"})
    told = phrase({name: value for name, value in specimen.items() if value})
    plan, size = experiment.photometric.presses, experiment.photometric
    return [
        ("specimen", f"{experiment.specimen.kind.replace('_', ' ')}: {told}"),
        (
            "press",
            f"{experiment.press.control} controlled: {figures['depth_mm']:.3g} mm deep with "
            f"{figures['force_n']:.3g} N; relief peak {figures['relief_peak_mm']:.3g} mm",
        ),
        (
            "gel",
            f"{phrase(experiment.elastomer.model_dump())}; Young's modulus "
            f"{figures['young_modulus_kpa']:.3g} kPa",
        ),
        ("coating", coating_phrase(experiment.coating)),
        (
            "image",
            f"{size.width_px} × {size.height_px} px of {1e3 * seen.pixel_mm:.1f} µm on "
            f"the coat, 8-bit RGB, gamma {size.gamma:g}; evaluated field {size.field_x_mm:g} × "
            f"{size.field_y_mm:g} mm",
        ),
        (
            "calibration",
            f"{plan.count} rendered presses of balls of {plan.smallest_diameter_mm:g} to "
            f"{plan.largest_diameter_mm:g} mm, {plan.backgrounds} images of the untouched gel",
        ),
        ("decoding", decoder_name(seen.colours.own)),
        ("digest", seen.digest),
    ]


def field_figures(seen: Measurement) -> list[Figure]:
    """Return the figures of the evaluated field."""
    figures, limit_um = seen.figures, seen.experiment.score.good_within_um
    return [
        Figure("pixels of the coat in the evaluated field", str(figures["wanted_pixels"])),
        Figure("with a point", percent(figures["completeness"])),
        Figure(f"with a point within {limit_um:g} µm", percent(figures["good_share"])),
    ]


def sentences(seen: Measurement) -> list[str]:
    """Return the result for a terminal, at most 100 columns wide, in ASCII."""
    figures = seen.figures
    return [
        f"z error against the true coat: {figures['z_rmse_um']:.2f} um RMS, mean "
        f"{figures['z_bias_um']:.2f} um, {figures['z_p95_um']:.2f} um P95",
        f"height scale {number(figures['height_scale'], '.3f', '-')}; points on "
        f"{figures['completeness']:.1%} of the field; force "
        f"{figures['force_n']:.3g} N at {figures['depth_mm']:.3g} mm",
        *(
            f"{decoder_name(one)}: {one.errors.z_rmse_um:.1f} um RMS, scale "
            f"{number(one.errors.height_scale, '.3f', '-')}"
            for one in seen.colours.decoded
            if one is not seen.colours.own
        ),
    ]


def _heights(seen: Measurement) -> Verdict:
    figures, limit_um = seen.figures, seen.experiment.score.good_within_um
    share = figures["good_share"]
    measured: Grade = "good" if share >= GOOD_SHARE else "check"
    return Verdict(
        question="Does the sensor see the coat?",
        headline=f"{figures['z_rmse_um']:.1f}\N{NO-BREAK SPACE}µm RMS in z",
        grade="poor" if share < POOR_SHARE else measured,
        reasons=(
            f"{percent(share)} of the field within {limit_um:g} µm (good from {GOOD_SHARE:.0%}, "
            f"poor below {POOR_SHARE:.0%})",
            f"a point on {percent(figures['completeness'])}",
            f"by the decoder {decoder_name(seen.colours.own)}",
        ),
    )


def _scale(seen: Measurement) -> Verdict:
    scale, question = seen.figures["height_scale"], "Are heights neither flattened nor stretched?"
    if scale is None:
        return Verdict(question, NONE, "check", ("the true coat is flat: it has no scale",))
    worst = abs(scale - 1)
    measured: Grade = "good" if worst <= GOOD_SCALE_ERROR else "check"
    others = [
        (decoder_name(one), number(one.errors.height_scale, ".3f")) for one in seen.colours.decoded
    ]
    return Verdict(
        question=question,
        headline=f"{scale:.3f} of the true height",
        grade="poor" if worst > POOR_SCALE_ERROR else measured,
        reasons=(
            f"good within {GOOD_SCALE_ERROR:.0%} of 1, poor beyond {POOR_SCALE_ERROR:.0%}",
            *(f"{name}: {text}" for name, text in others),
        ),
    )


def _on_the_scale(seen: Measurement) -> str:
    scales = {
        one.integration: number(one.errors.height_scale, ".2f")
        for one in seen.colours.decoded
        if one.colour_map == seen.colours.own.colour_map
    }
    return (
        "The vendor's programs integrate with a wrong scale that depends on the width of the shape "
        "and on their version: from the same slopes the heights of this specimen come out "
        f"{scales['sdk_2025']} (2025) and {scales['sdk_2024']} (2024) of the true ones, "
        f"and {scales['corrected']} with the textbook's eigenvalues."
    )


def _own_row(seen: Measurement, number: int) -> Row:
    ball = _ball(seen.colours.own, number)
    assert ball is not None
    return _row(number, f"{MEASURED_LABEL}: {decoder_name(seen.colours.own)}", ball)


def _row(number: int, label: str, ball: SphereScore) -> Row:
    return Row(number, label, fit_values(ball.measured, ball.nominal.radius_mm))


def _ball(one: DecodedImage, number: int) -> SphereScore | None:
    return next((ball for ball in one.score.spheres if ball.number == number), None)
