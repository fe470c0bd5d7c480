"""Report of a measurement by photometric stereo: judgements, tables, sentences, sections."""

from collections.abc import Callable
from pathlib import Path

from reconstruction.colour_maps import COLOUR_MAPS
from twin.report.experiment import GOOD_SHARE, POOR_SHARE, glance, grade_of_share, result_in_words
from twin.report.page import (
    Figure,
    Grade,
    JudgedTarget,
    Note,
    Section,
    TwoColumns,
    Verdict,
    judged,
    target,
)
from twin.report.photometric_figures import (
    draw_errors,
    draw_heights,
    draw_images,
    draw_sections,
    draw_sensor,
    draw_slopes,
)
from twin.report.pixel_panels import shading_words
from twin.report.press import judge_press, press_figure
from twin.report.printed_dots import rendered_dots_section
from twin.report.spheres import ball_sections, fit_tables
from twin.report.surfaces import relief_figure
from twin.report.table import Column, Table, pairs
from twin.report.words import NONE, number, percent, signed
from twin.results.decoders import decoder_name
from twin.results.record import Measurement

METHOD = "photometric stereo"
WARNED = "Warnings: the press or a value is outside its range, or a fit failed"
GOOD_SCALE_ERROR, POOR_SCALE_ERROR = 0.05, 0.2
_DECODERS = (
    Column("name", "colour map, integration"),
    Column("scale", "height scale", 3),
    Column("rms", "z error, RMS", 1, "µm"),
    Column("mean", "z error, mean", 1, "µm"),
    Column("p95", "z error, P95", 1, "µm"),
    Column("good", "good points", kind="number"),
)


def sections(measured: Measurement) -> list[Section]:
    """Return the sections of the page that are specific to photometric stereo."""
    own, tables = (
        measured.colours.own,
        (field_table(measured), decoder_table(measured), *fit_tables(measured)),
    )
    seen_in = (
        _figure(measured, "images"),
        _figure(measured, "slopes", colour_map=COLOUR_MAPS[own.colour_map].title),
    )
    by_decoder = (
        relief_figure(measured),
        Note(f"Decoded by: {decoder_name(own)}."),
        _figure(measured, "heights", shading=shading_words(measured)),
        _figure(measured, "sections"),
    )
    return [
        Section(
            "glance",
            "Experiment",
            (TwoColumns((glance(measured),), (_figure(measured, "sensor"),)),),
        ),
        Section("result", "Result", (*tables, *discussion(measured))),
        Section("recorded", "Camera image and slopes", seen_in),
        Section("surface", "Heights by decoder", by_decoder),
        Section("error", "Error against the true coat", (_figure(measured, "errors"),)),
        *rendered_dots_section(measured),
        *ball_sections(measured),
        Section("pressed", "Specimen and gel", (press_figure(measured),)),
    ]


def verdicts(measured: Measurement) -> list[Verdict]:
    """Return judgements of the heights, of the height scale and of the press, in this order."""
    return [_of_heights(measured), _of_scale(measured), judge_press(measured)]


def decoder_table(measured: Measurement) -> Table:
    """Return the table of height scale and z errors, one row per decoder of this image."""
    decoded = measured.colours.decoded
    return Table(
        "decoders",
        "Heights by decoder",
        "",
        _DECODERS,
        tuple(
            {
                "name": decoder_name(decoder),
                "scale": decoder.errors.height_scale,
                "rms": decoder.errors.z_rmse_um,
                "mean": decoder.errors.z_bias_um,
                "p95": decoder.errors.z_p95_um,
                "good": percent(decoder.errors.good_share),
            }
            for decoder in decoded
        ),
        (
            "All decoders have the same image and the same reference presses; bold: the decoder of "
            "the experiment. Height scale: slope of the regression of measured on true height. "
            "Look-up table: binned colours, empty bins filled from their neighbours. Vendor 2025 "
            "and 2024: integration as in the published kits, with their scale error; corrected: "
            "with the exact eigenvalues. P95: 95th percentile of the absolute error.",
        ),
        kinds=tuple("measured" if decoder is measured.colours.own else "" for decoder in decoded),
    )


def field_table(measured: Measurement) -> Table:
    """Return the table of pixel count and shares of points in the evaluated field."""
    figures, limit_um = measured.figures, measured.experiment.score.good_within_um
    rows = [
        ("pixels of the coat in the evaluated field", str(figures["wanted_pixels"]), ""),
        ("of these with a point", percent(figures["completeness"]), ""),
        (f"with a point within {limit_um:g} µm", percent(figures["good_share"]), ""),
    ]
    return pairs("field", "Points in the evaluated field", rows)


def discussion(measured: Measurement) -> list[str]:
    """Return the paragraphs that explain the result: z error, height scale, sphere fit."""
    own = measured.score.against_truth
    mean = NONE if own.z_bias_um is None else signed(own.z_bias_um, 1)
    paragraphs = [
        f"{result_in_words(measured)} Error of z against the true coat: "
        f"{number(own.z_rmse_um, '.1f')} µm RMS, mean {mean} µm. Photometric stereo measures "
        "slopes; their integration accumulates slope errors that are small in each pixel, which "
        "bends the surface over the whole field.",
        _on_the_scale(measured),
    ]
    if measured.score.spheres:
        paragraphs.append(
            "A sphere fit with a free radius does not detect a wrong height scale: a flattened cap "
            "is nearly a sphere of a larger radius. Compare its RMSE together with the radius and "
            "with the z error of the table above."
        )
    return paragraphs


def sentences(measured: Measurement) -> list[str]:
    """Return the result as lines of text for a terminal, at most 100 columns wide, in ASCII."""
    figures = measured.figures
    return [
        f"z error against the true coat: {figures['z_rmse_um']:.2f} um RMS, mean "
        f"{figures['z_bias_um']:.2f} um, {figures['z_p95_um']:.2f} um P95",
        f"height scale {number(figures['height_scale'], '.3f', '-')}; points on "
        f"{figures['completeness']:.1%} of the field; force "
        f"{figures['force_n']:.3g} N at {figures['depth_mm']:.3g} mm",
        *(
            f"{decoder_name(decoder)}: {decoder.errors.z_rmse_um:.1f} um RMS, scale "
            f"{number(decoder.errors.height_scale, '.3f', '-')}"
            for decoder in measured.colours.decoded
            if decoder is not measured.colours.own
        ),
        *_of_dots(measured),
    ]


def _of_dots(measured: Measurement) -> list[str]:
    """Return the line on printed dots; empty without a measured displacement."""
    figures = measured.figures
    if figures.get("dots_displacement_error_rms_um") is None:
        return []
    return [
        f"printed dots: {figures['dots_tracked']} of {figures['dots_in_image']} tracked, "
        f"{figures['dots_true_displacement_rms_um']:.1f} um RMS displacement, "
        f"{figures['dots_displacement_error_rms_um']:.1f} um RMS error"
    ]


def _of_heights(measured: Measurement) -> Verdict:
    figures, limit_um = measured.figures, measured.experiment.score.good_within_um
    share = figures.known("good_share")
    words = (
        f"{percent(share)} of the field within {limit_um:g} µm (good from {GOOD_SHARE:.0%}, "
        f"poor below {POOR_SHARE:.0%})"
    )
    return judged(
        "Is the coat measured?",
        f"{figures['z_rmse_um']:.1f}\N{NO-BREAK SPACE}µm RMS in z",
        [JudgedTarget(words, grade_of_share(share))],
        (
            f"a point on {percent(figures['completeness'])}",
            f"by the decoder {decoder_name(measured.colours.own)}",
        ),
    )


def _of_scale(measured: Measurement) -> Verdict:
    scale, question = measured.figures["height_scale"], "Is the height scale correct?"
    if scale is None:
        return Verdict(question, NONE, "check", ("the true coat is flat: it has no scale",))
    worst = abs(scale - 1)
    otherwise: Grade = "poor" if worst > POOR_SCALE_ERROR else "check"
    words = f"good within {GOOD_SCALE_ERROR:.0%} of 1, poor beyond {POOR_SCALE_ERROR:.0%}"
    others = [
        (decoder_name(decoder), number(decoder.errors.height_scale, ".3f"))
        for decoder in measured.colours.decoded
    ]
    return judged(
        question,
        f"{scale:.3f} of the true height",
        [target(words, worst <= GOOD_SCALE_ERROR, otherwise)],
        [f"{name}: {text}" for name, text in others],
    )


def _on_the_scale(measured: Measurement) -> str:
    scales = {
        decoder.integration: number(decoder.errors.height_scale, ".2f")
        for decoder in measured.colours.decoded
        if decoder.colour_map == measured.colours.own.colour_map
    }
    return (
        "The vendor's programs integrate with a wrong scale that depends on the width of the shape "
        "and on the program version. From the same slopes the ratio of integrated to true height "
        f"of this specimen is {scales['sdk_2025']} (2025), {scales['sdk_2024']} (2024), and "
        f"{scales['corrected']} with the exact eigenvalues."
    )


def _figure(measured: Measurement, name: str, **values: str) -> Figure:
    title, caption, alt, draw = _FIGURES[name]
    return Figure(name, title, caption.format(**values), alt, lambda path: draw(path, measured))


_FIGURES: dict[str, tuple[str, str, str, Callable[[Path, Measurement], None]]] = {
    "sensor": (
        "Sensor",
        "Lamps with the direction of their strongest light, and the layers that the camera looks "
        "through; lengths in mm, to scale.",
        "lamps, gel and window of the sensor",
        draw_sensor,
    ),
    "images": (
        "Tactile image",
        "Image of the sensor's driver: 8-bit colours after gamma, crop and resize. The dashed "
        "outline is the evaluated field. The red lamp is at the top, the green one on the right, "
        "the blue one at the bottom; there is no lamp on the left.",
        "tactile image, background and their difference",
        draw_images,
    ),
    "slopes": (
        "Slopes",
        "Slopes in mm/mm by the {colour_map} map against the true "
        "coat at the same pixels. Next to a contact the coat is in the shadow of a lamp, for which "
        "the reference presses contain no data. Heights are computed by integrating these slopes.",
        "measured and true slopes of the coat, and their difference",
        draw_slopes,
    ),
    "heights": (
        "True heights and those of every decoder",
        "True height z and the heights that each decoder computes from the same image, all on the "
        "scale of the true coat{shading}; white: no measurement. Lengths in mm.",
        "true heights and those of every decoder",
        draw_heights,
    ),
    "sections": (
        "Section",
        "Heights (mm) and height errors (µm) of every decoder along the line through the apexes. "
        "The vendor's integration flattens wide shapes more than narrow ones.",
        "heights and height errors along the section",
        draw_sections,
    ),
    "errors": (
        "Error of z by decoder",
        "Measured minus true z (µm) in the evaluated field, the same clipped scale for all "
        "decoders. Heights are compared without shift or scaling.",
        "height error of every decoder",
        draw_errors,
    ),
}
"""Title, caption, alternative text and drawing of the figures by name."""
