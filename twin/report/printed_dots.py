"""Section of a report on printed dots: displacements as arrows and as a table, with errors."""

from collections.abc import Sequence

from reconstruction.photometric.pictures import draw_dots
from twin.report.page import Block, Figure, Gallery, Note, Section
from twin.report.table import Column, Table, pairs
from twin.report.words import number
from twin.results.printed_dots import NO_DOTS, MeasuredDots
from twin.results.record import Measurement

DOT_COLUMNS = (
    Column("press", "press"),
    Column("dots_tracked", "tracked", 0),
    Column("dots_lost", "lost", 0),
    Column("dots_doubtful", "doubtful", 0),
    Column("dots_moved_most_um", "largest displacement, µm", 1),
    Column("dots_sigma_median_um", "median u, µm", 2),
    Column("dots_mean_x_um", "mean x, µm", 1),
    Column("dots_mean_y_um", "mean y, µm", 1),
    Column("dots_divergence_permille", "divergence, ‰", 2),
    Column("dots_shear_permille", "shear, ‰", 2),
    Column("dots_rotation_mrad", "rotation, mrad", 2),
)
_HOW = (
    "Displacements between the image without contact and the image of the press, in the plane "
    "of the gel: x right, y up. Mean, divergence, shear and rotation are those of an affine "
    "function fitted to the tracked dots; rotation is counter-clockwise. u: standard "
    "uncertainty of one displacement. Lost and doubtful dots have no displacement."
)
_ERRORS = (
    ("displacement of the tracked dots by the model, RMS", "dots_true_displacement_rms_um", "µm"),
    ("error of the measured displacement, RMS", "dots_displacement_error_rms_um", "µm"),
    ("this error over its standard uncertainty, RMS", "dots_error_over_sigma", ""),
    ("dots with a wrong partner", "dots_assigned_wrongly", ""),
    ("error of the smooth field between the dots, RMS", "dots_field_error_rms_um", "µm"),
    ("this error over its standard uncertainty, RMS", "dots_field_error_over_sigma", ""),
)


def dots_section(pictures: Sequence[Figure], table: Table, *more: Block) -> Section:
    """Return the section of printed dots: pictures, two to a line, and the table of figures."""
    gallery = Gallery(tuple(pictures), min(2, len(pictures)))
    return Section("dots", "Printed dots", (Note(_HOW), gallery, table, *more))


def rendered_dots_section(measured: Measurement) -> list[Section]:
    """Return the section of the dots of a rendered sensor; empty if it has none."""
    dots = measured.colours.dots
    if dots is None:
        return []
    if dots.motion is None:
        return [Section("dots", "Printed dots", (Note(NO_DOTS),))]
    motion, picture = dots.motion, measured.picture
    arrows = Figure(
        "dot_arrows",
        "Displacement of the printed dots",
        "Image of the press; the arrows start at the places without contact.",
        "Displacements of the printed dots as arrows over the image.",
        lambda path: draw_dots(path, picture, motion),
    )
    figures = dots.figures
    row: dict[str, str | float | None] = {of.key: figures.get(of.key) for of in DOT_COLUMNS}
    row["press"] = measured.experiment.name
    table = Table("dots", "", "", DOT_COLUMNS, (row,))
    return [dots_section([arrows], table, _error_table(dots))]


def _error_table(dots: MeasuredDots) -> Table:
    """Return the table of the errors against the displacement by the model of the elastomer."""
    figures = dots.figures
    rows = [("dots that the image shows as a whole", str(dots.in_image), "")]
    rows += [
        (label, number(figures[name], ".3g"), unit)
        for label, name, unit in _ERRORS
        if name in figures
    ]
    return pairs("dots_errors", "Errors against the model's displacement", rows)
