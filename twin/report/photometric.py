"""The report of a measurement by photometric stereo: judgements, tables, sentences, sections."""

from collections.abc import Callable
from pathlib import Path

from twin.report.experiment import GOOD_SHARE, POOR_SHARE, glance, grade_of_share, result_in_words
from twin.report.page import (
    Beside,
    Figure,
    Grade,
    JudgedTarget,
    Note,
    Section,
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
from twin.report.spheres import ball_sections, fit_tables
from twin.report.surfaces import relief_figure
from twin.report.table import Column, Table, pairs
from twin.report.words import NONE, number, percent, signed
from twin.results.decoders import MAP_NAMES, decoder_name
from twin.results.record import Measurement

METHOD = "photometric stereo"
WARNED = "The press leaves the range of its model, or not everything could be fitted"
GOOD_SCALE_ERROR, POOR_SCALE_ERROR = 0.05, 0.2
_DECODERS = (
    Column("name", "colour map, integration"),
    Column("scale", "height scale", 3),
    Column("rms", "z error, RMS", 1, "µm"),
    Column("mean", "z error, mean", 1, "µm"),
    Column("p95", "z error, P95", 1, "µm"),
    Column("good", "good points", kind="number"),
)


def sections(seen: Measurement) -> list[Section]:
    """Return the page of a measurement by photometric stereo."""
    own, tables = seen.colours.own, (field_table(seen), decoder_table(seen), *fit_tables(seen))
    seen_in = (
        _figure(seen, "images"),
        _figure(seen, "slopes", colour_map=MAP_NAMES[own.colour_map]),
    )
    by_decoder = (
        relief_figure(seen),
        Note(f"Decoded by: {decoder_name(own)}."),
        _figure(seen, "heights", shading=shading_words(seen)),
        _figure(seen, "sections"),
    )
    return [
        Section("glance", "Experiment", (Beside((glance(seen),), (_figure(seen, "sensor"),)),)),
        Section("result", "Result", (*tables, *discussion(seen))),
        Section("recorded", "Camera image, and the slopes in it", seen_in),
        Section("surface", "Heights by decoder", by_decoder),
        Section("error", "Error against the true coat", (_figure(seen, "errors"),)),
        *ball_sections(seen),
        Section("pressed", "Specimen and gel", (press_figure(seen),)),
    ]


def verdicts(seen: Measurement) -> list[Verdict]:
    """Judge heights, their scale and the press, in this order."""
    return [_of_heights(seen), _of_scale(seen), judge_press(seen)]


def decoder_table(seen: Measurement) -> Table:
    """Return the figures of every decoder of this image."""
    decoded = seen.colours.decoded
    return Table(
        "decoders",
        "Heights by decoder",
        "",
        _DECODERS,
        tuple(
            {
                "name": decoder_name(one),
                "scale": one.errors.height_scale,
                "rms": one.errors.z_rmse_um,
                "mean": one.errors.z_bias_um,
                "p95": one.errors.z_p95_um,
                "good": percent(one.errors.good_share),
            }
            for one in decoded
        ),
        (
            "All decoders have the same image and the same reference presses; bold: the one that "
            "the experiment names. Height scale: slope of measured over true height. Look-up "
            "table: binned colours, empty bins filled from their neighbours. Vendor 2025 and 2024: "
            "the behaviour of the published kits with their error of scale; corrected: the exact "
            "eigenvalues. P95: 95th percentile of the size of the error.",
        ),
        kinds=tuple("measured" if one is seen.colours.own else "" for one in decoded),
    )


def field_table(seen: Measurement) -> Table:
    """Return the figures of the evaluated field."""
    figures, limit_um = seen.figures, seen.experiment.score.good_within_um
    rows = [
        ("pixels of the coat in the evaluated field", str(figures["wanted_pixels"]), ""),
        ("of these with a point", percent(figures["completeness"]), ""),
        (f"with a point within {limit_um:g} µm", percent(figures["good_share"]), ""),
    ]
    return pairs("field", "In the evaluated field", rows)


def discussion(seen: Measurement) -> list[str]:
    """Return the paragraphs of the result."""
    own = seen.score.against_truth
    mean = NONE if own.z_bias_um is None else signed(own.z_bias_um, 1)
    found = [
        f"{result_in_words(seen)} Error of z against the true coat: "
        f"{number(own.z_rmse_um, '.1f')} µm RMS, mean {mean} µm. Photometric stereo measures "
        "slopes; slope errors too small to see in any pixel add up to a bow over the field when "
        "they are integrated.",
        _on_the_scale(seen),
    ]
    if seen.score.spheres:
        found.append(
            "A sphere fit with a free radius does not see a wrong height scale: a flattened cap is "
            "nearly a sphere too, of a larger radius. Read its RMSE together with the radius and "
            "with the z error of the table above."
        )
    return found


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


def _of_heights(seen: Measurement) -> Verdict:
    figures, limit_um = seen.figures, seen.experiment.score.good_within_um
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
            f"by the decoder {decoder_name(seen.colours.own)}",
        ),
    )


def _of_scale(seen: Measurement) -> Verdict:
    scale, question = seen.figures["height_scale"], "Is the scale of the heights right?"
    if scale is None:
        return Verdict(question, NONE, "check", ("the true coat is flat: it has no scale",))
    worst = abs(scale - 1)
    otherwise: Grade = "poor" if worst > POOR_SCALE_ERROR else "check"
    words = f"good within {GOOD_SCALE_ERROR:.0%} of 1, poor beyond {POOR_SCALE_ERROR:.0%}"
    others = [
        (decoder_name(one), number(one.errors.height_scale, ".3f")) for one in seen.colours.decoded
    ]
    return judged(
        question,
        f"{scale:.3f} of the true height",
        [target(words, worst <= GOOD_SCALE_ERROR, otherwise)],
        [f"{name}: {text}" for name, text in others],
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
        f"and {scales['corrected']} with the exact eigenvalues."
    )


def _figure(seen: Measurement, name: str, **told: str) -> Figure:
    title, caption, alt, draw = _FIGURES[name]
    return Figure(name, title, caption.format(**told), alt, lambda path: draw(path, seen))


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
        "What the sensor's driver delivers: 8-bit colours after gamma, crop and resize. The dashed "
        "outline is the evaluated field. Red light comes from the top, green from the right, blue "
        "from the bottom; there is no lamp on the left.",
        "tactile image, background and their difference",
        draw_images,
    ),
    "slopes": (
        "Slopes",
        "Slopes in mm/mm by the {colour_map} map against the true "
        "coat at the same pixels. Beside a contact the coat lies in the shadow of a lamp, which no "
        "reference press taught. Everything after this figure is integration.",
        "measured and true slopes of the coat, and their difference",
        draw_slopes,
    ),
    "heights": (
        "True heights and those of every decoder",
        "The same image by every decoder, all on the scale of the true coat{shading}; white: no "
        "measurement. Lengths in mm.",
        "true heights and those of every decoder",
        draw_heights,
    ),
    "sections": (
        "Section",
        "Along the line through the apexes. The wider a shape, the more the vendor's integration "
        "flattens it.",
        "heights and height errors along the section",
        draw_sections,
    ),
    "errors": (
        "Error of z by decoder",
        "Measured minus true z in the evaluated field, all on one scale, clipped at its ends. "
        "Nothing is shifted or scaled before comparing.",
        "height error of every decoder",
        draw_errors,
    ),
}
"""Title, caption, alternative text and drawing of the figures by name."""
