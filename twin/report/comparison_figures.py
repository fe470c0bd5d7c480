"""Table of the measured values of a specimen by every method of a comparison."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

from twin.config.methods import TRAITS
from twin.config.models import Experiment
from twin.report.table import Column, Table
from twin.report.words import NONE, number, percent
from twin.results.balls import SphereScore
from twin.results.decoders import DecodedImage
from twin.results.figures import Figures


@dataclass(frozen=True, eq=False)
class ComparisonSummary:
    """Data of one measurement that are compared across methods.

    Frames are not included, because they take 600 MB at full size.

    Attributes
    ----------
    figures : measured values by name
    spheres : sphere fits of the balls; empty if the specimen has none
    decoded : heights by every decoder of photometric stereo; empty for other methods
    measurands : formatted values of the object's measurands, by label
    """

    experiment: Experiment
    figures: Figures
    spheres: tuple[SphereScore, ...]
    decoded: list[DecodedImage]
    measurands: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Quantity:
    """One row of the table below each specimen: label, and function that formats the value."""

    label: str
    of: Callable[[ComparisonSummary], str]


def quantities_table(name: str, summaries: dict[str, ComparisonSummary | None]) -> Table:
    """Return a table of the values of a specimen: one row per quantity, one column per method."""
    methods = [
        Column(method, TRAITS[method].title, kind="number")
        for method in TRAITS
        if method in summaries
    ]
    rows = tuple(
        {"quantity": quantity.label}
        | {
            method: NONE if summary is None else quantity.of(summary)
            for method, summary in summaries.items()
        }
        for quantity in (*QUANTITIES, *_measurands(summaries))
    )
    columns = (Column("quantity", "quantity"), *methods)
    return Table(f"{name}_figures", "", "", columns, rows, look="compared")


def _measurands(summaries: dict[str, ComparisonSummary | None]) -> list[Quantity]:
    """Return a table row for each measurand of the object that at least one method measured."""
    names = dict.fromkeys(
        name for summary in summaries.values() if summary for name in summary.measurands
    )
    return [Quantity(name, partial(_measurand, name)) for name in names]


def _measurand(name: str, summary: ComparisonSummary) -> str:
    return summary.measurands.get(name, NONE)


def _figure(name: str, form: str) -> Callable[[ComparisonSummary], str]:
    """Return a function that formats the measured value `name`, or a dash if it does not exist."""
    return lambda summary: number(summary.figures.get(name), form)


def _exposure(summary: ComparisonSummary) -> str:
    exposure_ms = summary.figures.get("exposure_ms", summary.experiment.camera.exposure_ms)
    return f"{exposure_ms:.3g}" if isinstance(exposure_ms, float) else str(exposure_ms)


def _of_balls(figure: Callable[[SphereScore], str]) -> Callable[[ComparisonSummary], str]:
    return lambda summary: ", ".join(figure(ball) for ball in summary.spheres) or NONE


QUANTITIES = (
    Quantity("object: deviation, RMS (µm)", _figure("object_rms_um", ".2f")),
    Quantity("object: the same, offset taken off (µm)", _figure("object_offset_rms_um", ".2f")),
    Quantity("object: form, band of 95 % after a best fit (µm)", _figure("object_form_um", ".2f")),
    Quantity(
        "object: share that is touched or seen, and has a point",
        lambda summary: percent(summary.figures.get("object_coverage_share")),
    ),
    Quantity("force of the press (N)", _figure("force_n", ".3g")),
    Quantity("depth of the press (mm)", _figure("depth_mm", ".3g")),
    Quantity("highest point of the coat (mm)", _figure("relief_peak_mm", ".3g")),
    Quantity("pixels with a point", lambda summary: percent(summary.figures["completeness"])),
    Quantity(
        "pixels with a good point (limit)",
        lambda summary: (
            f"{percent(summary.figures['good_share'])} "
            f"({summary.experiment.score.good_within_um:g} µm)"
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
"""Rows of the table below each specimen; a further measured value needs one more entry."""
