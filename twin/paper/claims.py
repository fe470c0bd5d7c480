"""Compare the tables of the reproduction with its targets; each missed target has a reason."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from twin.paper.identified import problem
from twin.paper.plan import CONTACT_FPP, GELSIGHT, NUT, mean_of, rows_of
from twin.paper.sphere_tables import IDENTIFIED, OWN
from twin.report.table import TWIN, Cell, Column, Table

RMSE_FACTOR = 2.0
LEAST_RATIO = 5.0
DIRECT_AT_MOST, CONTACT_AT_LEAST = 0.60, 0.99
# Allowed ratio of the SD of the smaller sample to the SD of the larger sample. With 4 degrees of
# freedom (chi square), 95 % of sample SDs are between 0.35 and 1.67 x the true SD.
SD_LOW, SD_HIGH = 0.35, 1.67
MOST_STEPS = 2.0
# Of the paper's mean radius from the prediction with any coat, and from the mean of the trials.
RADIUS_WITHIN_MM = 0.10
_RADII = ("radius_1", "radius_2")
FITTED, LIMIT, STEERED, PREDICTED = "fitted", "limit", "steered", "predicted"
"""Uses of a row of the paper: in the identification of the sensor, for a choice, or none."""


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
        limit (assumed from the paper's text), steered (a choice of model, evaluation or pose was
        made after a comparison with the row), predicted, or "" if it is compared with no row
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
        claims += _chain_radius_claims(tables["repeated_fit"])
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
        "Paper's row: fitted (the sensor was identified from this row), limit (assumed "
        "from the paper's text, also used in the identification), steered (a choice of model, "
        "evaluation or pose was made after a comparison with it), or predicted (not used)."
    )
    return Table("claims", "Targets of this reproduction", "", heads, rows, (note,))


def _use_of(*rows: str) -> str:
    """Return fitted if one of these rows was, else steered if one was, else predicted."""
    known = problem().rows
    uses = {known[row].use for row in rows if row in known}
    return next(use for use in (FITTED, STEERED, PREDICTED) if use in uses)


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
    (CONTACT_FPP, IDENTIFIED): ("rmse_1", "rmse_2"),
    (GELSIGHT, IDENTIFIED): ("gelsight_rmse_1", "gelsight_rmse_2"),
    (GELSIGHT, OWN): ("gelsight_rmse_1_footprint", "gelsight_rmse_2_footprint"),
}
_AS_EVALUATED = ((CONTACT_FPP, IDENTIFIED), (GELSIGHT, OWN))
"""Methods, each with the region of its sphere fit that explains the paper's rows."""
_REFERENCE = (CONTACT_FPP, IDENTIFIED)


def _rmse_claims(table: Table) -> list[Claim]:
    """Return comparisons of RMSE, of GelSight over both regions: the paper states neither."""
    claims, means = [], {}
    for (method, region), rows in _RMSE_ROWS.items():
        published = mean_of("sphere_fit", method, "rmse")
        rmse_mm = _mean_rmse_mm(table, method, region)
        if rmse_mm is None:
            continue
        means[method, region] = rmse_mm
        low, high = published / RMSE_FACTOR, published * RMSE_FACTOR
        met = low <= rmse_mm <= high
        allowed = f"{low:.4f} to {high:.4f} mm"
        name = f"{method}: RMSE of the sphere fit, region {region}"
        why = _WHY_REGION if (method, region) == (GELSIGHT, IDENTIFIED) else _WHY_RMSE
        claims.append(Claim(name, allowed, rmse_mm, met, "" if met else why, _use_of(*rows)))
    return claims + _ratio_claims(means)


def _ratio_claims(means: Mapping[tuple[str, str], float]) -> list[Claim]:
    claims = []
    for of, mean_mm in means.items():
        if of == _REFERENCE or _REFERENCE not in means:
            continue
        ratio = mean_mm / means[_REFERENCE]
        met = ratio >= LEAST_RATIO
        name = f"RMSE, {GELSIGHT} over {CONTACT_FPP}, {GELSIGHT} with region {of[1]}"
        use = _use_of(*_RMSE_ROWS[_REFERENCE], *_RMSE_ROWS[of])
        why = _WHY_REGION if of[1] == IDENTIFIED else _WHY_RMSE
        claims.append(Claim(name, f"at least {LEAST_RATIO:g}", ratio, met, "" if met else why, use))
    return claims


def _radius_claims(table: Table) -> list[Claim]:
    """Return comparisons of the mean radii with their prediction for any coat.

    The prediction conditioned on the radii themselves is not judged: it cannot fail.
    """
    claims = []
    for row in table.rows:
        paper, twin, sd = row["paper"], row["any_coat"], row["any_coat_sd"]
        if row["row"] in _RADII and isinstance(paper, float) and isinstance(twin, float):
            ball = str(row["row"]).removeprefix("radius_")
            name = f"{CONTACT_FPP}: mean radius of ball {ball}, predicted for any coat"
            claims.append(_radius_claim(name, ball, paper, twin, f"SD {float(str(sd)):.2f} mm"))
    return claims


def _chain_radius_claims(table: Table) -> list[Claim]:
    """Return comparisons of the mean radii with the mean over all trials of the whole chain."""
    claims = []
    for published in rows_of("repeated_fit"):
        key = (CONTACT_FPP, IDENTIFIED, TWIN, published["sphere"])
        rows = [r for r in table.rows if _key_of(r) == key]
        if published["method"] != CONTACT_FPP or not rows:
            continue
        twin, sd = float(str(rows[-1]["mean_radius"])), rows[-1]["sd"]
        spread = "one trial" if sd is None else f"SD {float(str(sd)):.2f} mm between trials"
        name = f"{CONTACT_FPP}: mean radius of ball {published['sphere']} over the trials"
        ball, paper = str(published["sphere"]), float(published["mean_radius"])
        claims.append(_radius_claim(name, ball, paper, twin, spread))
    return claims


def _key_of(row: Mapping[str, Cell]) -> tuple[Cell, ...]:
    return row["method"], row.get("region"), row["source"], row["sphere"]


def _radius_claim(name: str, ball: str, paper: float, twin: float, spread: str) -> Claim:
    low, high = paper - RADIUS_WITHIN_MM, paper + RADIUS_WITHIN_MM
    met = abs(twin - paper) <= RADIUS_WITHIN_MM
    why = "" if met else _WHY_RADIUS.format(spread=spread)
    return Claim(name, f"{low:.3f} to {high:.3f} mm", twin, met, why, _use_of(f"radius_{ball}"))


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
        use = STEERED if direct and row["specimen_name"] == NUT else ""  # the pose: ADR 7
        claims.append(Claim(name, allowed, share, met, "" if met else why, use))
    return claims


def _picture_claims(table: Table) -> list[Claim]:
    claims = []
    for row in table.rows:
        figure, met = row["measured"], row["met"] == "yes"
        measured = float(figure) if isinstance(figure, (int, float)) else None
        name = f"{row['figure']}: limit assumed from the paper's text"
        why = "" if met else _WHY_PICTURE
        claims.append(Claim(name, str(row["known"]), measured, met, why, LIMIT))
    return claims


_WHY_PICTURE = "the sheet spans a recess that it should follow: wrong pressure or sheet thickness"
_WHY_FEW = "the first trials are among the 5 % of samples outside the limits"
_WHY_RMSE = (
    "the residual is the coat's texture where the sheet wraps the ball, and form error outside; "
    "for GelSight it is the form error over the whole ball: see the identified rows"
)
_WHY_REGION = (
    "the paper states 'the same evaluation procedure' for both sensors; over the region of "
    "contact-FPP the form error of GelSight is small: see the identified rows"
)
_WHY_RADIUS = (
    "another coat, fit region or sheet gives another radius ({spread}); the paper's trials have "
    "one coat"
)
_WHY_RODS = (
    "the coat is wider than the rod by up to two local thicknesses; the identification selects "
    "the definition of the width that the paper uses"
)
_WHY_DIRECT = (
    "direct FPP measures more of the rendered surface than in the paper: see the section on "
    "differences"
)
_WHY_CONTACT_REGION = "see the figure of pixels without a measurement"
