"""The report of a comparison: every specimen by every method, as one HTML page and as text."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from statistics import mean

from markupsafe import Markup

from twin.config.methods import TRAITS, Method
from twin.config.models import Experiment
from twin.pipeline.comparison import Outcome, read_outcomes
from twin.pipeline.progress import ProgressCallback, no_progress
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
from twin.results.decoders import DecodedImage, decoder_name
from twin.results.figures import Figures, Metrics
from twin.results.folder import read_measurement
from twin.results.record import Colours, Measurement
from twin.results.score import SphereScore

_COAT: Method = "contact_fpp"
_GEL: Method = "photometric_stereo"
_RATIOS = (
    Column("name", "method, decoder"),
    Column("rmse_um", "sphere-fit RMSE", 2, "µm"),
    Column("ratio", "RMSE over that of contact-FPP", 1),
    Column("z_rmse_um", "z error, RMS", 1, "µm"),
)


@dataclass(frozen=True, eq=False)
class Gist:
    """What is compared across methods; without the frames, which take 600 MB at full size."""

    experiment: Experiment
    figures: Figures
    spheres: tuple[SphereScore, ...]
    decoded: list[DecodedImage]
    measurands: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Quantity:
    """One row of the table under each specimen."""

    label: str
    of: Callable[[Gist], str]


def write_comparison(
    folder: Path, watch: ProgressCallback = no_progress, into: Path | None = None
) -> Path:
    """Write `report.html` and `figures/*.png` into the folder of a finished comparison.

    Parameters
    ----------
    folder : result folder of `twin compare`; nothing else is read
    into : existing folder to write into instead

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
            {"specimen": one.name[:16], "method": one.method, **_short(one.figures)}
            for one in outcomes
        ),
    )
    failed = [f"{one.name}, {one.method}: {one.failure}" for one in outcomes if one.failure]
    return "\n".join([table.as_text().replace(NONE, "-"), *failed])


def gist_of(measured: Measurement) -> Gist:
    """Return what is compared across methods."""
    images = measured.images
    decoded = images.decoded if isinstance(images, Colours) else []
    of_object = object_rows(measured)
    return Gist(measured.experiment, measured.figures, measured.score.spheres, decoded, of_object)


def press_in_words(methods: dict[str, Gist | None]) -> str:
    """Say how the presses of coat and gel compare; empty where only one is pressed.

    Parameters
    ----------
    methods : measurement by method, None where it failed
    """
    if not {_COAT, _GEL} <= set(methods):
        return ""
    coat, gel = methods[_COAT], methods[_GEL]
    if coat is None or gel is None:
        return (
            "The two elastomers could not be brought to one press: the failure is stated below, "
            "and the other measurement is shown alone."
        )
    (force_coat, force_gel), (depth_coat, depth_gel) = (
        (coat.figures.known(name), gel.figures.known(name)) for name in ("force_n", "depth_mm")
    )
    if coat.experiment.elastomer == gel.experiment.elastomer:
        return f"One elastomer, one press: {depth_coat:.3g} mm deep with {force_coat:.3g} N."
    told = (
        f"contact-FPP is pressed {depth_coat:.3g} mm deep with {force_coat:.3g} N, photometric "
        f"stereo {depth_gel:.3g} mm with {force_gel:.3g} N."
    )
    if _alike(force_coat, force_gel):
        moduli = " and ".join(f"{one.figures['young_modulus_kpa']:.3g}" for one in (coat, gel))
        return (
            f"The same force, two elastomers: {told} At one force the depth follows from layout, "
            f"thickness and Young's modulus ({moduli} kPa)."
        )
    shared = "The same depth, two elastomers" if _alike(depth_coat, depth_gel) else "Not one press"
    return f"{shared}: {told}"


def ratio_table(methods: dict[str, Gist | None]) -> Table | None:
    """Return every decoder's sphere-fit RMSE beside contact-FPP's; None without both."""
    coat, gel = methods.get(_COAT), methods.get(_GEL)
    if coat is None or gel is None or not gel.decoded or not coat.spheres:
        return None
    base_mm = mean(ball.measured.stats.rmse_mm for ball in coat.spheres)
    of_coat: Row = {"name": TRAITS[_COAT].title, "rmse_um": 1e3 * base_mm, "ratio": 1.0}
    rows = [{**of_coat, "z_rmse_um": coat.figures["z_rmse_um"]}]
    for one in gel.decoded:
        found_mm = one.sphere_rmse_mm
        if found_mm is not None:
            found = {"rmse_um": 1e3 * found_mm, "ratio": found_mm / base_mm}
            rows.append({"name": decoder_name(one), "z_rmse_um": one.errors.z_rmse_um, **found})
    return Table(
        "ratios",
        "Sphere fits by decoder",
        "",
        _RATIOS,
        tuple(rows),
        (
            "Mean over the balls of the radial RMSE from a sphere with a free radius. Where the "
            "region of the fit reaches beyond the contact, the true coat is no sphere either: "
            "compare with its own RMSE in the table above. The free radius hides a wrong height "
            "scale; the z error does not.",
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
        lead=f"The same specimens; {rigs}; each method with its own automatic or stated exposure.",
        sections=[
            Section("at_a_glance", "At a glance", (_overview(methods),)),
            *sections,
            Section("reading", "How to read it", tuple(Note(one) for one in _reading(methods))),
        ],
        wide=True,
    )


def _overview(methods: Sequence[Method]) -> Figure:
    colour = ", or the tactile image in colour," if _GEL in methods else ""
    return Figure(
        "overview",
        "What was recorded and what was measured",
        f"For each specimen a fringe image as the camera records it (black is 0, white is "
        f"saturation){colour} and the measured heights, shaded. Pixels without a measurement are "
        "white.",
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
        "projector both see, against the true coat: what the elastomer hides of the specimen is no "
        "error of the optics and is not counted there.",
        "The rows of the object have one reference for all methods: the specimen itself. Direct "
        "FPP is compared where the specimen is seen, the others where the elastomer touches it; "
        "under a thin sheet its local thickness, found from the coat, is subtracted. The column "
        "next to it is the share of the specimen that this covers.",
        *gel,
        "Errors are along z. A point counts as good when its height errs by no more than the limit "
        "beside its share; the error scale ends there. A pixel without a measurement has no error. "
        "The heights of a method share a scale with the true surface that this method sees, not "
        "with the other methods. P95: 95th percentile of the size of the error.",
    ]


def _specimen(
    folder: Path,
    figures: Path,
    outcomes: list[Outcome],
    fill: Callable[[str, Method, Measurement | None], None],
) -> Section:
    """Draw one specimen by every method, one after the other."""
    found: dict[str, Gist | None] = {}
    cells = []
    for outcome in outcomes:
        measured = None
        if not outcome.failure:
            measured = read_measurement(folder / outcome.name / outcome.method)
        fill(outcome.name, outcome.method, measured)
        cells.append(_cell(figures, outcome, measured))
        found[outcome.method] = None if measured is None else gist_of(measured)
    first, press, ratios = outcomes[0], press_in_words(found), ratio_table(found)
    return Section(
        first.name,
        first.name.replace("_", " "),
        (
            *([Note(first.description)] if first.description else []),
            *([press] if press else []),
            *cells,
            _quantities_table(first.name, found),
            *([ratios] if ratios else []),
        ),
    )


def _cell(figures: Path, outcome: Outcome, measured: Measurement | None) -> Section:
    """Return one specimen by one method; without a measurement only why."""
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
    """Return the wanted pixels in three parts: good, wrong, without a point."""
    good, found = measured.figures["good_share"], measured.figures["completeness"]
    if good is None or found is None:
        return []
    limit_um = measured.experiment.score.good_within_um
    return [
        Shares(
            (
                ("good", f"within {limit_um:g} µm: {percent(good)}", good),
                ("wrong", f"larger error: {percent(found - good)}", found - good),
                ("none", f"no point: {percent(1 - found)}", 1 - found),
            )
        )
    ]


def _quantities_table(name: str, found: dict[str, Gist | None]) -> Table:
    methods = [
        Column(method, TRAITS[method].title, kind="number") for method in TRAITS if method in found
    ]
    rows = tuple(
        {"quantity": one.label}
        | {method: NONE if gist is None else one.of(gist) for method, gist in found.items()}
        for one in (*QUANTITIES, *_measurands(found))
    )
    columns = (Column("quantity", "quantity"), *methods)
    return Table(f"{name}_figures", "", "", columns, rows, look="compared")


def _measurands(found: dict[str, Gist | None]) -> list[Quantity]:
    """Return a row for each measurand of the object that any method has."""
    names = dict.fromkeys(name for gist in found.values() if gist for name in gist.measurands)
    return [Quantity(name, partial(_measurand, name)) for name in names]


def _measurand(name: str, gist: Gist) -> str:
    return gist.measurands.get(name, NONE)


def _figure(name: str, form: str) -> Callable[[Gist], str]:
    """Return what writes a figure; a dash where a method does not have it."""
    return lambda gist: number(gist.figures.get(name), form)


def _exposure(gist: Gist) -> str:
    exposure_ms = gist.figures.get("exposure_ms", gist.experiment.camera.exposure_ms)
    return f"{exposure_ms:.3g}" if isinstance(exposure_ms, float) else str(exposure_ms)


def _of_balls(figure: Callable[[SphereScore], str]) -> Callable[[Gist], str]:
    return lambda gist: ", ".join(figure(ball) for ball in gist.spheres) or NONE


QUANTITIES = (
    Quantity("object: deviation, RMS (µm)", _figure("object_rms_um", ".2f")),
    Quantity("object: the same, offset taken off (µm)", _figure("object_offset_rms_um", ".2f")),
    Quantity("object: form, band of 95 % after a best fit (µm)", _figure("object_form_um", ".2f")),
    Quantity(
        "object: share that is touched or seen, and has a point",
        lambda gist: percent(gist.figures.get("object_coverage_share")),
    ),
    Quantity("force of the press (N)", _figure("force_n", ".3g")),
    Quantity("depth of the press (mm)", _figure("depth_mm", ".3g")),
    Quantity("highest point of the coat (mm)", _figure("relief_peak_mm", ".3g")),
    Quantity("pixels with a point", lambda gist: percent(gist.figures["completeness"])),
    Quantity(
        "pixels with a good point (limit)",
        lambda gist: (
            f"{percent(gist.figures['good_share'])} ({gist.experiment.score.good_within_um:g} µm)"
        ),
    ),
    Quantity("z error, RMS (µm)", _figure("z_rmse_um", ".2f")),
    Quantity("z error, mean (µm)", _figure("z_bias_um", ".2f")),
    Quantity("z error, P95 of its size (µm)", _figure("z_p95_um", ".2f")),
    Quantity("pixels with a wrong fringe order", _figure("wrong_order_pixels", "d")),
    Quantity("saturated pixel values", _figure("saturated_share", ".2%")),
    Quantity("exposure (ms)", _exposure),
    Quantity(
        "coat or surface seen: fitted sphere radii (mm)",
        _of_balls(lambda b: f"{b.measured.radius_mm:.3f}"),
    ),
    Quantity("the same on the true surface", _of_balls(lambda b: f"{b.true_face.radius_mm:.3f}")),
    Quantity("sphere-fit RMSE (µm)", _of_balls(lambda b: f"{1e3 * b.measured.stats.rmse_mm:.2f}")),
    Quantity(
        "the same on the true surface",
        _of_balls(lambda b: f"{1e3 * b.true_face.stats.rmse_mm:.2f}"),
    ),
)
"""What the table under each specimen compares: a new figure is one more line here."""


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
    # A force carried over is rounded to four digits; solvers meet it to better than 0.1 %.
    return abs(first - second) <= 2e-3 * max(abs(first), abs(second))
