"""Compare the tables of the reproduction with its targets; each missed target has a reason."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from twin.paper.plan import CONTACT_FPP, GELSIGHT, identified, mean_of, rows_of
from twin.paper.sphere_tables import IDENTIFIED, OWN
from twin.report.table import TWIN, Cell, Column, Table

RMSE_FACTOR = 2.0
LEAST_RATIO = 5.0
DIRECT_AT_MOST, CONTACT_AT_LEAST = 0.60, 0.99
# Allowed ratio of the SD of the smaller sample to the SD of the larger sample. With 4 degrees of
# freedom (chi square), 95 % of sample SDs are between 0.35 and 1.67 x the true SD.
SD_LOW, SD_HIGH = 0.35, 1.67
MOST_STEPS = 2.0
# Each trial here has its own coat; all trials of the paper had the same coat.
RADIUS_WITHIN_MM = 0.10
_RADII = ("radius_1", "radius_2")
FITTED, LIMIT, PREDICTED = "fitted", "limit", "predicted"
"""Uses of a row of the paper in the identification of the sensor."""


@dataclass(frozen=True)
class Claim:
    """Comparison of one value with its target.

    Attributes
    ----------
    name : description of the value
    allowed : target range, as text with its unit
    value : value of the twin; None if it was not measured
    met : True if the value is within the target range
    use : use of the compared rows of the paper in the identification of the sensor: fitted,
        limit (a limit read from a picture), predicted, or "" if the value is compared with no row
    why : reason if the target is missed; else empty
    """

    name: str
    allowed: str
    value: float | None
    met: bool
    why: str = ""
    use: str = ""


def claims_of(tables: dict[str, Table]) -> list[Claim]:
    """Return the comparisons with all targets for which `tables` (by name) contains the table."""
    claims: list[Claim] = []
    if "repeated_fit" in tables:
        claims += _rmse_claims(tables["repeated_fit"])
        claims += _consistency(tables["repeated_fit"])
    if "identified" in tables:
        claims += _radius_claims(tables["identified"])
    if "rods" in tables:
        claims += _rod_claims(tables["rods"])
    if "completeness" in tables:
        claims += _completeness_claims(tables["completeness"])
    if "pictures" in tables:
        claims += _picture_claims(tables["pictures"])
    return claims


def claims_table(claims: Sequence[Claim]) -> Table:
    """Return a table with one row per compared target."""
    rows = tuple(
        {
            "claim": claim.name,
            "allowed": claim.allowed,
            "found": claim.value,
            "met": "yes" if claim.met else "NO",
            "use": claim.use,
            "why": claim.why,
        }
        for claim in claims
    )
    heads = (
        Column("claim", "figure"),
        Column("allowed", "target"),
        Column("found", "measured", 4),
        Column("met", "target met"),
        Column("use", "paper's row"),
        Column("why", "reason where it is not met"),
    )
    note = (
        "Paper's row: fitted (the sensor was identified from this row), limit (read from a "
        "picture, also used in the identification), or predicted (not used)."
    )
    return Table("claims", "Targets of this reproduction", "", heads, rows, (note,))


def _use_of(*rows: str) -> str:
    """Return fitted, or predicted if none of these rows was used to identify the sensor."""
    known = identified()["rows"]
    return FITTED if any(known[row]["fitted"] for row in rows) else PREDICTED


def _mean_rmse_mm(table: Table, method: str, region: str) -> float | None:
    by_ball = {
        row["sphere"]: rmse  # the last row of a ball is of all trials
        for row in table.rows
        if (row["method"], row.get("region")) == (method, region)
        and row["source"] == TWIN
        and isinstance(rmse := row.get("rmse"), float)
    }
    return float(np.mean(list(by_ball.values()))) if by_ball else None


_RMSE_ROWS = {
    CONTACT_FPP: ("rmse_1", "rmse_2"),
    GELSIGHT: ("gelsight_rmse_1_footprint", "gelsight_rmse_2_footprint"),
}
_AS_EVALUATED = ((CONTACT_FPP, IDENTIFIED), (GELSIGHT, OWN))
"""Methods, each with the region of its sphere fit that explains the paper's rows."""


def _rmse_claims(table: Table) -> list[Claim]:
    claims, means = [], {}
    for method, region in _AS_EVALUATED:
        published = mean_of("sphere_fit", method, "rmse")
        rmse_mm = _mean_rmse_mm(table, method, region)
        if rmse_mm is None:
            continue
        means[method] = rmse_mm
        low, high = published / RMSE_FACTOR, published * RMSE_FACTOR
        met = low <= rmse_mm <= high
        allowed = f"{low:.4f} to {high:.4f} mm"
        name = f"{method}: RMSE of the sphere fit, region {region}"
        use = _use_of(*_RMSE_ROWS[method])
        claims.append(Claim(name, allowed, rmse_mm, met, "" if met else _WHY_RMSE, use))
    if len(means) == 2:
        ratio = means[GELSIGHT] / means[CONTACT_FPP]
        met = ratio >= LEAST_RATIO
        name = f"RMSE, {GELSIGHT} over {CONTACT_FPP}, each with its region"
        allowed = f"at least {LEAST_RATIO:g}"
        use = _use_of(*(row for rows in _RMSE_ROWS.values() for row in rows))
        claims.append(Claim(name, allowed, ratio, met, "" if met else _WHY_RMSE, use))
    return claims


def _radius_claims(table: Table) -> list[Claim]:
    claims = []
    for row in table.rows:
        paper, twin = row["paper"], row["twin"]
        if row["row"] not in _RADII or not isinstance(paper, float) or not isinstance(twin, float):
            continue
        met = abs(twin - paper) <= RADIUS_WITHIN_MM
        low, high = paper - RADIUS_WITHIN_MM, paper + RADIUS_WITHIN_MM
        allowed, name = f"{low:.3f} to {high:.3f} mm", str(row["row"]).replace("_", " of ball ")
        name = f"{CONTACT_FPP}: mean {name}, given the coat common to all trials, as identified"
        use = _use_of(str(row["row"]))
        claims.append(Claim(name, allowed, twin, met, "" if met else _WHY_RADIUS, use))
    return claims


def _consistency(table: Table) -> list[Claim]:
    """Return comparisons of the first five trials with all trials: SD and mean of the radius.

    The target ranges are the sampling limits for five trials.
    """
    claims = []
    for method, region in _AS_EVALUATED:
        key = (method, region, TWIN)
        rows = [r for r in table.rows if (r["method"], r.get("region"), r["source"]) == key]
        for ball in (1, 2):
            some = [r for r in rows if r["sphere"] == ball]
            if len(some) >= 2 and all(isinstance(r["sd"], float) and r["sd"] for r in some):
                claims += _consistent(f"{method}, ball {ball}", some[0], some[1])
    return claims


def _consistent(name: str, few: Mapping[str, Cell], every: Mapping[str, Cell]) -> list[Claim]:
    sd, sd_of_all = float(str(few["sd"])), float(str(every["sd"]))
    n, n_of_all = int(str(few["trials"])), int(str(every["trials"]))
    difference = float(str(few["mean_radius"])) - float(str(every["mean_radius"]))
    # The n trials are among the N: the standard deviation of their means' difference is
    # sd sqrt(1/n - 1/N).
    steps = abs(difference) / (sd_of_all * np.sqrt(1.0 / n - 1.0 / n_of_all))
    spread = SD_LOW <= sd / sd_of_all <= SD_HIGH
    return [
        Claim(
            f"{name}: SD of {n} trials over SD of all",
            f"{SD_LOW} to {SD_HIGH}",
            sd / sd_of_all,
            spread,
            "" if spread else _WHY_FEW,
        ),
        Claim(
            f"{name}: mean of {n} trials from that of all, in its standard deviations",
            f"at most {MOST_STEPS:g}",
            steps,
            steps <= MOST_STEPS,
            "" if steps <= MOST_STEPS else _WHY_FEW,
        ),
    ]


def _rod_claims(table: Table) -> list[Claim]:
    claims = []
    for published in rows_of("rods"):
        rows = [r for r in table.rows if r["rod"] == published["name"] and r["source"] == TWIN]
        if not rows:
            continue
        error = rows[-1].get("abs_error")
        error_mm = error if isinstance(error, float) else None
        most = published["abs_error"] + published["sd"]
        met = error_mm is not None and error_mm <= most
        allowed = f"at most {most:.3g} mm, the paper's error and one SD"
        name = f"rod {published['name']}: error of the mean width"
        use = _use_of(f"rod_{published['name'].lower()}")
        claims.append(Claim(name, allowed, error_mm, met, "" if met else _WHY_RODS, use))
    return claims


def _completeness_claims(table: Table) -> list[Claim]:
    claims = []
    for row in table.rows:
        direct = row["method"] == "direct_fpp"
        share = row["specimen"] if direct else row["contact"]
        if not isinstance(share, float) or row["method"] == "photometric_stereo":
            continue
        met = share <= DIRECT_AT_MOST if direct else share >= CONTACT_AT_LEAST
        allowed = f"at most {DIRECT_AT_MOST:g}" if direct else f"at least {CONTACT_AT_LEAST:g}"
        part = "specimen, direct FPP" if direct else "contact region, contact-FPP"
        name = f"{row['specimen_name']}: good points on the {part}"
        why = _WHY_DIRECT if direct else _WHY_CONTACT_REGION
        claims.append(Claim(name, allowed, share, met, "" if met else why))
    return claims


def _picture_claims(table: Table) -> list[Claim]:
    claims = []
    for row in table.rows:
        figure, met = row["measured"], row["met"] == "yes"
        measured = float(figure) if isinstance(figure, (int, float)) else None
        name = f"{row['figure']}: as in the paper's picture"
        why = "" if met else _WHY_PICTURE
        claims.append(Claim(name, str(row["known"]), measured, met, why, LIMIT))
    return claims


_WHY_PICTURE = "the sheet spans a recess that it should follow: wrong pressure or sheet thickness"
_WHY_FEW = "the first trials are among the 5 % of samples outside the limits"
_WHY_RMSE = (
    "the residual is the coat's texture where the sheet wraps the ball, and form error outside; "
    "for GelSight it is the form error over the whole ball: see the identified rows"
)
_WHY_RADIUS = "fit region, texture and sheet thickness together give another radius"
_WHY_RODS = (
    "the coat is wider than the rod by up to two local thicknesses; the identification selects "
    "the definition of the width that the paper uses"
)
_WHY_DIRECT = (
    "direct FPP measures more of the rendered surface than in the paper: see the section on "
    "differences"
)
_WHY_CONTACT_REGION = "see the figure of pixels without a measurement"
