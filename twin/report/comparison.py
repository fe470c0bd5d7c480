"""Report of a comparison of methods: every specimen by every method, as HTML page and as text."""

from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import mean

from markupsafe import Markup

from twin.config.methods import TRAITS, Method
from twin.pipeline.comparison import Outcome, read_outcomes
from twin.pipeline.progress import ProgressCallback, no_progress
from twin.report.comparison_figures import ComparisonSummary, quantities_table
from twin.report.comparison_panels import overview, panels_of
from twin.report.experiment import result_in_words
from twin.report.object import object_rows, object_sentence
from twin.report.page import (
    REPORT_FILE,
    STAGE,
    Block,
    Figure,
    Gallery,
    Note,
    Page,
    Section,
    Shares,
    figures_folder,
    write_page,
)
from twin.report.pixel_panels import draw_small
from twin.report.study_figures import Row
from twin.report.table import Column, Table
from twin.report.words import NONE, number, percent, printed_sentence
from twin.results.decoders import decoder_name
from twin.results.figures import Figures, Metrics
from twin.results.folder import read_measurement
from twin.results.record import Colours, Measurement

_COAT: Method = "contact_fpp"
_GEL: Method = "photometric_stereo"
_RATIOS = (
    Column("name", "method, decoder"),
    Column("rmse_um", "sphere-fit RMSE", 2, "µm"),
    Column("ratio", "RMSE over that of contact-FPP", 1),
    Column("z_rmse_um", "z error, RMS", 1, "µm"),
)


def write_comparison(
    folder: Path, watch: ProgressCallback = no_progress, into: Path | None = None
) -> Path:
    """Write `report.html` and `figures/*.png` into the folder of a finished comparison.

    Parameters
    ----------
    folder : result folder of `twin compare`; no other file is read
    into : existing folder for the page and its figures; None: `folder`

    Raises
    ------
    InputError : the folder is no finished comparison, a file is missing or damaged, or the page
        cannot be written
    """
    watch(STAGE, 0.0)
    outcomes = read_outcomes(folder)
    path = (into or folder) / REPORT_FILE
    figures = figures_folder(path.parent)
    methods = tuple(dict.fromkeys(outcome.method for outcome in outcomes))
    by_name: dict[str, list[Outcome]] = {}
    for outcome in outcomes:
        by_name.setdefault(outcome.name, []).append(outcome)
    sections = []
    with overview(figures / "overview.png", methods, tuple(by_name)) as fill:
        for done, cases in enumerate(by_name.values(), start=1):
            sections.append(_specimen(folder, figures, cases, fill))
            watch(STAGE, done / (len(by_name) + 1))
    return write_page(path, _page(methods, list(by_name), sections))


def comparison_table(outcomes: Sequence[Outcome]) -> str:
    """Return the result of a comparison as a short plain-text table, at most 100 columns."""
    table = Table(
        "comparison",
        "",
        "",
        (
            Column("specimen", "specimen"),
            Column("method", "method"),
            Column("object", "object RMS um", 2),
            Column("covered", "of it", kind="number"),
            Column("points", "with a point", kind="number"),
            Column("rms", "z RMS um", 2),
            Column("orders", "wrong orders"),
        ),
        tuple(
            {"specimen": outcome.name[:16], "method": outcome.method, **_short(outcome.figures)}
            for outcome in outcomes
        ),
    )
    failed = [
        f"{outcome.name}, {outcome.method}: {outcome.failure}"
        for outcome in outcomes
        if outcome.failure
    ]
    return "\n".join([table.as_text().replace(NONE, "-"), *failed])


def summary_of(measured: Measurement) -> ComparisonSummary:
    """Return the data of a measurement that are compared across methods."""
    images = measured.images
    decoded = images.decoded if isinstance(images, Colours) else []
    of_object = object_rows(measured)
    return ComparisonSummary(
        measured.experiment, measured.figures, measured.score.spheres, decoded, of_object
    )


def press_in_words(methods: dict[str, ComparisonSummary | None]) -> str:
    """Return a sentence with force and depth of the presses on coat and gel.

    The text is empty unless contact-FPP and photometric stereo are compared.

    Parameters
    ----------
    methods : data of the measurement by method; None for a failed measurement
    """
    if not {_COAT, _GEL} <= set(methods):
        return ""
    coat, gel = methods[_COAT], methods[_GEL]
    if coat is None or gel is None:
        return (
            "The presses of the two elastomers cannot be compared, because one of them failed: the "
            "reason is stated below, and only the other measurement is shown."
        )
    (force_coat, force_gel), (depth_coat, depth_gel) = (
        (coat.figures.known(name), gel.figures.known(name)) for name in ("force_n", "depth_mm")
    )
    if coat.experiment.elastomer == gel.experiment.elastomer:
        return f"Same elastomer and same press: {depth_coat:.3g} mm deep with {force_coat:.3g} N."
    presses = (
        f"contact-FPP is pressed {depth_coat:.3g} mm deep with {force_coat:.3g} N, photometric "
        f"stereo {depth_gel:.3g} mm with {force_gel:.3g} N."
    )
    if _alike(force_coat, force_gel):
        moduli = " and ".join(
            f"{summary.figures['young_modulus_kpa']:.3g}" for summary in (coat, gel)
        )
        return (
            f"Two elastomers, same force: {presses} At equal force the depth depends on layout, "
            f"thickness and Young's modulus ({moduli} kPa)."
        )
    alike = _alike(depth_coat, depth_gel)
    shared = "Two elastomers, same depth" if alike else "Two different presses"
    return f"{shared}: {presses}"


def ratio_table(methods: dict[str, ComparisonSummary | None]) -> Table | None:
    """Return the table of sphere-fit RMSE by contact-FPP and by every decoder of the gel's image.

    Returns None if one of the two methods has no measurement, or if contact-FPP has no sphere fit.
    """
    coat, gel = methods.get(_COAT), methods.get(_GEL)
    if coat is None or gel is None or not gel.decoded or not coat.spheres:
        return None
    base_mm = mean(ball.measured.stats.rmse_mm for ball in coat.spheres)
    of_coat: Row = {"name": TRAITS[_COAT].title, "rmse_um": 1e3 * base_mm, "ratio": 1.0}
    rows = [{**of_coat, "z_rmse_um": coat.figures["z_rmse_um"]}]
    for decoder in gel.decoded:
        decoder_rmse_mm = decoder.sphere_rmse_mm
        if decoder_rmse_mm is not None:
            cells = {"rmse_um": 1e3 * decoder_rmse_mm, "ratio": decoder_rmse_mm / base_mm}
            rows.append(
                {"name": decoder_name(decoder), "z_rmse_um": decoder.errors.z_rmse_um, **cells}
            )
    return Table(
        "ratios",
        "Sphere fits by decoder",
        "",
        _RATIOS,
        tuple(rows),
        (
            "Mean over the balls of the radial RMSE (µm) from a sphere with a fitted radius. If "
            "the region of the fit extends beyond the contact, the true coat is not spherical "
            "there: compare with the RMSE of the true coat in the table above. The fitted radius "
            "compensates a wrong height scale; the z error shows it.",
        ),
        look="compared",
    )


def _page(methods: Sequence[Method], names: list[str], sections: list[Section]) -> Page:
    title = ", ".join(names).replace("_", " ")
    rigs = "the same rig and patterns"
    if _GEL in methods:
        rigs = "fringes by the same rig and patterns, photometric stereo by a sensor of its own"
    return Page(
        kind="comparison of methods",
        title=title,
        lead=f"All methods measure the same specimens; {rigs}; each method has its own automatic "
        "or stated exposure.",
        sections=[
            Section("at_a_glance", "At a glance", (_overview(methods),)),
            *sections,
            Section(
                "reading", "Definitions", tuple(Note(paragraph) for paragraph in _reading(methods))
            ),
        ],
        wide=True,
    )


def _overview(methods: Sequence[Method]) -> Figure:
    colour = ", or the tactile image in colour," if _GEL in methods else ""
    return Figure(
        "overview",
        "Recorded images and measured heights",
        f"For each specimen a recorded fringe image (digital numbers: black is 0, white is "
        f"saturation){colour} and the measured heights z as a shaded surface. Pixels without a "
        "measured point are white.",
        "camera image and measured heights of every specimen, a row per method",
    )


def _reading(methods: Sequence[Method]) -> list[str]:
    gel = (
        [
            "Photometric stereo is scored on the coat of its own gel within its evaluated field, "
            "against that coat's true surface; specimen, region of the sphere fits and limit of a "
            "good point are the same."
        ]
        if _GEL in methods
        else []
    )
    return [
        "Direct FPP is scored on every pixel that shows the specimen, shadows and dark flanks "
        "included, against its true surface. Contact-FPP is scored on the coat that camera and "
        "projector both see, against the true coat. Details of the specimen that the elastomer "
        "conceals are no error of the optics and are not counted in the z error.",
        "Rows that start with 'object' compare all methods with the surface of the specimen "
        "itself. Direct FPP is compared where the specimen is visible, the other methods where the "
        "elastomer touches it. Under a thin sheet the local thickness, estimated from the coat, is "
        "subtracted. A separate row gives the share of the specimen that has such points.",
        *gel,
        "Errors are along z. A point is good if its z error does not exceed the limit, which is "
        "given in brackets after the share; the error scale ends at this limit. Pixels without a "
        "point have no error. Each method has its own colour scale of heights, that of the true "
        "surface in its field of view. P95: 95th percentile of the absolute error.",
    ]


def _specimen(
    folder: Path,
    figures: Path,
    outcomes: list[Outcome],
    fill: Callable[[str, Method, Measurement | None], None],
) -> Section:
    """Return the section on one specimen; draw the pictures of each method.

    Measurements are read one at a time. `fill` draws each of them into the overview.
    """
    summaries: dict[str, ComparisonSummary | None] = {}
    cells = []
    for outcome in outcomes:
        measured = None
        if not outcome.failure:
            measured = read_measurement(folder / outcome.name / outcome.method)
        fill(outcome.name, outcome.method, measured)
        cells.append(_cell(figures, outcome, measured))
        summaries[outcome.method] = None if measured is None else summary_of(measured)
    first, press, ratios = outcomes[0], press_in_words(summaries), ratio_table(summaries)
    return Section(
        first.name,
        first.name.replace("_", " "),
        (
            *([Note(first.description)] if first.description else []),
            *([press] if press else []),
            *cells,
            quantities_table(first.name, summaries),
            *([ratios] if ratios else []),
        ),
    )


def _cell(figures: Path, outcome: Outcome, measured: Measurement | None) -> Section:
    """Return the section on one specimen by one method; only the reason if it was not measured."""
    name, method = f"{outcome.name}_{outcome.method}", TRAITS[outcome.method]
    title = f"{method.title}: {method.explanation}"
    if measured is None:
        return Section(name, title, (Note(f"Could not be measured: {outcome.failure}", "failure"),))
    link = Markup('{} <a href="{}">Report of this measurement</a>').format(
        result_in_words(measured), f"{outcome.name}/{outcome.method}/{REPORT_FILE}"
    )
    blocks: list[Block] = [
        Note(link, "verdict"),
        Note(printed_sentence(object_sentence(measured))),
        *_shares(measured),
    ]
    drawn = []
    for panel in panels_of(measured):
        draw_small(
            figures / f"{name}_{panel.name}.png", panel.show, measured.truth.lit.shape, panel.bar
        )
        alt = f"{outcome.name}, {method.title}: {panel.caption}"
        drawn.append(Figure(f"{name}_{panel.name}", "", panel.caption, alt))
    return Section(name, title, (*blocks, Gallery(tuple(drawn), 4)))


def _shares(measured: Measurement) -> list[Shares]:
    """Return the shares of the scored pixels with a good point, with a wrong point and without."""
    good, measured_share = measured.figures["good_share"], measured.figures["completeness"]
    if good is None or measured_share is None:
        return []
    limit_um = measured.experiment.score.good_within_um
    return [
        Shares(
            (
                ("good", f"within {limit_um:g} µm: {percent(good)}", good),
                ("wrong", f"larger error: {percent(measured_share - good)}", measured_share - good),
                ("none", f"no point: {percent(1 - measured_share)}", 1 - measured_share),
            )
        )
    ]


def _short(metrics: Metrics | None) -> Row:
    if not metrics:
        return {"points": "failed"}
    figures = Figures(metrics)
    return {
        "object": figures.get("object_rms_um"),
        "covered": number(figures.get("object_coverage_share"), ".0%"),
        "points": number(figures["completeness"], ".1%"),
        "rms": figures["z_rmse_um"],
        "orders": figures.get("wrong_order_pixels"),
    }


def _alike(first: float, second: float) -> bool:
    # The transferred force is rounded to four digits; solvers match it to better than 0.1 %.
    return abs(first - second) <= 2e-3 * max(abs(first), abs(second))
