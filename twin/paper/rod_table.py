"""Tables of the widths of the acrylic rods, and of the hardness of the three silicone mixes."""

from collections.abc import Iterator, Mapping, Sequence

from twin.paper.hardness import mixes
from twin.paper.plan import WIDTH, rows_of
from twin.paper.sphere_tables import PAPER_TRIALS, subsets
from twin.paper.statistics import spread_of, values_of
from twin.paper.trials import REFUSED, RIGID_BAR, Trial
from twin.report.table import PAPER, TWIN, Cell, Column, Table

_WIDTHS = {
    "rod_width_mm": "at 50 % of its height above the flanking valleys",
    "rod_break_width_mm": "between the breaks of its slope",
    "rod_slope_change_width_mm": "between the places where its slope changes fastest",
}


def rods_table(trials: Mapping[str, Sequence[Trial]]) -> Table:
    """Return the table of rod widths (mm) over repeated presses.

    Parameters
    ----------
    trials : repeated measurements by the letter of the rod: A, B, C
    """
    rows: list[dict[str, Cell]] = []
    for published in rows_of("rods"):
        rod = {"rod": published["name"], "reference": published["reference"]}
        keys = ("mean", "abs_error", "sd", "cv_percent")
        paper: dict[str, Cell] = {key: published[key] for key in keys}
        rows.append(rod | {"source": PAPER, "trials": PAPER_TRIALS} | paper)
        repeated = trials.get(published["name"], ())
        rows += [rod | row for row in _rod_rows(repeated, published["reference"])]
    return Table(
        "rods",
        "Width of acrylic rods, mm",
        "Table: dimensional evaluation of acrylic rods",
        (
            Column("rod", "rod"),
            Column("source", "source"),
            Column("trials", "n"),
            Column("reference", "reference", 2),
            Column("compensated", "rigid bar"),
            Column("compensated_sd", "its SD"),
            Column("mean", "coat: mean"),
            Column("abs_error", "|error|"),
            Column("sd", "SD"),
            Column("cv_percent", "CV %", 2),
            Column("face_mean", "true coat: mean"),
            Column("failed", "not measurable"),
        ),
        tuple(rows),
        (
            f"Width of the coat's crest, {_WIDTHS[WIDTH]}, over the mean section of 2 mm in the "
            "middle of the rod.",
            "'true coat' is the same width of the true coat: the elastomer's share of the error.",
            "'rigid bar' is the width by `twin compensate` from the measured coat, with the "
            "nominal sheet, back pressure and edge rounding instead of the drawn ones: the SD "
            "includes the effect of their deviations. The paper does not compensate.",
        ),
    )


def _rod_rows(trials: Sequence[Trial], reference_mm: float) -> Iterator[dict[str, Cell]]:
    for some in subsets(trials):
        width = spread_of(values_of(some, WIDTH))
        failed = sum(not {"rod_failure", REFUSED}.isdisjoint(trial.figures) for trial in some)
        row: dict[str, Cell] = {"source": TWIN, "trials": len(some), "failed": failed}
        if width is not None:
            face = spread_of(values_of(some, f"true_face_{WIDTH}"))
            row |= {
                "mean": width.mean,
                "abs_error": abs(width.mean - reference_mm),
                "sd": width.sd,
                "cv_percent": None if width.sd is None else 100.0 * width.sd / width.mean,
                "face_mean": None if face is None else face.mean,
            }
        rigid = spread_of(values_of(some, RIGID_BAR))
        if rigid is not None:
            row |= {"compensated": rigid.mean, "compensated_sd": rigid.sd}
        yield row


def hardness_table() -> Table:
    """Return the table of Shore A hardness and Young's modulus of the three silicone mixes.

    The paper states one of the three hardness values; its graph has no numbers.
    """
    rows: list[dict[str, Cell]] = [
        {
            "mix": mix.letter,
            "ratio": mix.ratio,
            "shore_a": mix.shore_a,
            "shore_low": mix.low_shore_a,
            "shore_high": mix.high_shore_a,
            "modulus_kpa": mix.modulus.best_kpa,
            "modulus_low_kpa": mix.modulus.low_kpa,
            "modulus_high_kpa": mix.modulus.high_kpa,
            "source": mix.source,
        }
        for mix in mixes()
    ]
    return Table(
        "hardness",
        "Hardness against mixing ratio",
        "Figure: silicone shore graph",
        (
            Column("mix", "mix"),
            Column("ratio", "base : curing agent", 1),
            Column("shore_a", "Shore A", 0),
            Column("shore_low", "from", 0),
            Column("shore_high", "to", 0),
            Column("modulus_kpa", "E, kPa", 0),
            Column("modulus_low_kpa", "from", 0),
            Column("modulus_high_kpa", "to", 0),
            Column("source", "source of the hardness"),
        ),
        tuple(rows),
        ("Of the three hardnesses the paper states only mix A's, 20; its graph has no numbers.",),
    )
