"""Tables on the two joined balls, as in the paper: sphere fit, repeated fit, uncertainty budget."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from twin.paper.plan import (
    CONTACT_FPP,
    FIT,
    FOOTPRINT_MM,
    GELSIGHT,
    NOMINAL_RADIUS_MM,
    rows_of,
)
from twin.paper.statistics import Budget, root_mean_square, spread_of, values_of
from twin.paper.trials import Trial, rigid_ball
from twin.report.table import PAPER, TWIN, Cell, Column, Table
from twin.results.balls import region_name

PAPER_TRIALS = 5
BALLS = (1, 2)
# Standard uncertainty of a uniform distribution over the tolerance of +-0.01 mm. It is used for the
# radius, as in the paper.
U_REF_MM = 0.01 / np.sqrt(3.0)

_KEYS = (
    Column("method", "method"),
    Column("sphere", "ball"),
    Column("source", "source"),
    Column("region", "region of the fit"),
)
_TRIALS = Column("trials", "n")
_COMPENSATED = (
    Column("compensated", "rigid ball"),
    Column("compensated_sd", "its SD"),
)
_OBJECT = (
    "'rigid ball' is the radius by `twin compensate` from the measured coat, with thickness, "
    "modulus and pressure of the nominal sheet; of a single press with its predicted standard "
    "deviation. The true radius is 4 mm. The paper does not compensate."
)

Trials = Mapping[str, Sequence[Trial]]


@dataclass(frozen=True)
class Reading:
    """Evaluation of the balls measured by a method: region and kind of the sphere fit.

    Attributes
    ----------
    method : method of measurement
    region : region of the fitted points, in words
    kind : part of the names of measured values between the ball's number and the quantity
    """

    method: str
    region: str
    kind: str

    def named(self, ball: int, figure: str) -> str:
        """Return the name of a measured value of one ball, for example of `radius_mm`."""
        return f"sphere_{ball}_{self.kind}{figure}"

    @property
    def key(self) -> dict[str, Cell]:
        """Table cells that identify the evaluation: method, source and region."""
        return {"method": self.method, "source": TWIN, "region": self.region}


# The paper states neither region: the identified region, and the largest possible one.
IDENTIFIED, OWN = "as identified", "the balls' footprint"
READINGS = (
    Reading(GELSIGHT, OWN, region_name(FOOTPRINT_MM)),
    Reading(GELSIGHT, IDENTIFIED, FIT),
    Reading(CONTACT_FPP, IDENTIFIED, FIT),
)
_REGIONS = (
    "The paper states no region. As identified: the region that explains contact-FPP's rows, the "
    f"same for both methods. The balls' footprint, {FOOTPRINT_MM:g} mm: all of the balls' points "
    "by GelSight, which explains its RMSE."
)


def _readings(trials: Trials) -> Iterator[tuple[Reading, Sequence[Trial]]]:
    for reading in READINGS:
        if repeated := trials.get(reading.method):
            yield reading, repeated


def sphere_fit_table(trials: Trials) -> Table:
    """Return the table of sphere fits to one press by each method.

    The press is the nominal trial 0, evaluated with the true rig.
    """
    rows: list[dict[str, Cell]] = [
        {"source": PAPER, **{key: row[key] for key in ("method", "sphere", *_FIT)}}
        for row in rows_of("sphere_fit")
    ]
    for reading, repeated in _readings(trials):
        rows += [_fit_row(reading, ball, repeated[0]) for ball in BALLS]
    return Table(
        "sphere_fit",
        "Sphere fit on two joined 8 mm balls, mm",
        "Table: sphere fitting",
        (
            *_KEYS,
            *_COMPENSATED,
            Column("radius", "coat: radius"),
            Column("abs_radius_error", "|error|"),
            Column("rmse", "RMSE", 4),
            Column("mae", "MAE", 4),
            Column("p95", "P95", 4),
            Column("face_radius", "true coat: radius"),
            Column("face_rmse", "true coat: RMSE", 4),
        ),
        _sorted(rows),
        (
            "The twin's rows are its nominal press with the true rig; the next table has spreads.",
            "'true coat' is the same fit to the true coat at the same pixels: the effect of the "
            "elastomer without errors of measurement.",
            _OBJECT,
            _REGIONS,
        ),
    )


_FIT = ("radius", "abs_radius_error", "rmse", "mae", "p95")


def _fit_row(reading: Reading, ball: int, trial: Trial) -> dict[str, Cell]:
    figures = trial.figures
    row = reading.key | {"sphere": ball}
    row |= {key: figures.get(reading.named(ball, f"{key}_mm")) for key in _FIT}
    if row["radius"] is not None:
        row["abs_radius_error"] = abs(float(str(row["radius"])) - NOMINAL_RADIUS_MM)
    true = f"sphere_{ball}_true_face_{reading.kind}"
    row |= {f"face_{key}": figures.get(f"{true}{key}_mm") for key in ("radius", "rmse")}
    if reading.method != CONTACT_FPP:
        return row
    sigma_um = figures.get(f"{rigid_ball(ball)}_sigma_um")
    spread = None if sigma_um is None else 1e-3 * float(sigma_um)
    return row | {
        "compensated": figures.get(f"{rigid_ball(ball)}_mm"),
        "compensated_sd": spread,
    }


def repeated_fit_table(trials: Trials) -> Table:
    """Return the table of fitted radius and RMSE over the first five presses and over all."""
    rows: list[dict[str, Cell]] = [
        {
            "method": row["method"],
            "sphere": row["sphere"],
            "source": PAPER,
            "trials": PAPER_TRIALS,
            "mean_radius": row["mean_radius"],
            "error": row["error"],
            "sd": row["sd"],
        }
        for row in rows_of("repeated_fit")
    ]
    for reading, repeated in _readings(trials):
        rows += [row for ball in BALLS for row in _repeated_rows(reading, ball, repeated)]
    return Table(
        "repeated_fit",
        "Repeated sphere fit on two joined 8 mm balls, mm",
        "Table: repeated sphere fitting",
        (
            *_KEYS,
            _TRIALS,
            *_COMPENSATED,
            Column("mean_radius", "coat: mean radius"),
            Column("error", "error"),
            Column("sd", "SD"),
            Column("low", "2.5 %"),
            Column("high", "97.5 %"),
            Column("rmse", "mean RMSE", 4),
            Column("rmse_sd", "SD of RMSE", 4),
        ),
        _sorted(rows),
        (
            "In every trial the specimen is placed and pressed again, with new noise and another "
            "calibration; spreads of the inputs are in scenes/paper/trials.toml.",
            _OBJECT,
            _REGIONS,
        ),
    )


def _repeated_rows(
    reading: Reading, ball: int, trials: Sequence[Trial]
) -> Iterator[dict[str, Cell]]:
    for some in subsets(trials):
        radius = spread_of(values_of(some, reading.named(ball, "radius_mm")))
        rmse = spread_of(values_of(some, reading.named(ball, "rmse_mm")))
        if radius is None or rmse is None:
            continue
        rigid = spread_of(values_of(some, f"{rigid_ball(ball)}_mm"))
        yield reading.key | {
            "sphere": ball,
            "compensated": None if rigid is None else rigid.mean,
            "compensated_sd": None if rigid is None else rigid.sd,
            "trials": radius.n,
            "mean_radius": radius.mean,
            "error": radius.mean - NOMINAL_RADIUS_MM,
            "sd": radius.sd,
            "low": radius.low,
            "high": radius.high,
            "rmse": rmse.mean,
            "rmse_sd": rmse.sd,
        }


def subsets(trials: Sequence[Trial]) -> list[Sequence[Trial]]:
    """Return the first five trials (the paper has five) and all trials, without trial 0.

    If there are at most five trials, only one list is returned.
    """
    repeated = [trial for trial in trials if trial.number]
    first = repeated[:PAPER_TRIALS]
    return [first] if len(first) == len(repeated) else [first, repeated]


def uncertainty_table(trials: Trials) -> Table:
    """Return the table of uncertainty budgets of the mean fitted radius, as in the paper.

    Contributions are u_rep (repetition), u_ref (reference) and u_cal (calibration); u_c is their
    root sum of squares, and U = 2 u_c.
    """
    rows: list[dict[str, Cell]] = [
        {"source": PAPER, "trials": PAPER_TRIALS, **row} for row in rows_of("uncertainty")
    ]
    for reading, repeated in _readings(trials):
        for ball in BALLS:
            for some in subsets(repeated):
                # Trial 0 has the figures under each calibration.
                budget = budget_of([*repeated[:1], *some], reading.named(ball, "radius_mm"))
                if budget is not None:
                    rows.append(_budget_row(reading, ball, len(some), budget))
    return Table(
        "uncertainty",
        "Uncertainty budget of the fitted radius, mm",
        "Table: uncertainty budget",
        (
            *_KEYS,
            _TRIALS,
            Column("u_rep", "u_rep", 4),
            Column("u_ref", "u_ref", 4),
            Column("u_cal", "u_cal", 4),
            Column("U", "U (k = 2)", 4),
        ),
        _sorted(rows),
        (
            "u_rep = SD / sqrt(n) as in the paper: it decreases with n, the SD does not.",
            "u_cal is measured: root mean square over the trials of the radius change by the drawn "
            "calibration. contact-FPP: rigs drawn from the covariance of the rendered 12-pose "
            "calibration. GelSight: five calibrations, each with its own reference presses.",
        ),
    )


def budget_of(trials: Sequence[Trial], name: str) -> Budget | None:
    """Return the uncertainty budget of the fitted radius `name`, mm.

    Returns None if there are fewer than two trials, or if u_cal is unknown.
    """
    repeated = [trial for trial in trials if trial.number]
    radius = spread_of(values_of(repeated, name))
    u_cal = calibration_uncertainty(trials, name)
    if radius is None or radius.u_rep is None or u_cal is None:
        return None
    return Budget(radius.u_rep, U_REF_MM, u_cal)


def calibration_uncertainty(trials: Sequence[Trial], name: str) -> float | None:
    """Return the standard uncertainty of the fitted radius `name` due to calibration, mm.

    With fringes, each trial except trial 0 is evaluated with a drawn rig and with the true rig. The
    result is the root mean square of the difference over these trials. Photometric stereo has no
    true calibration. The result is then the standard deviation over several calibrations, all
    applied to the image of trial 0; None with fewer than two calibrations.
    """
    changes = [
        float(trial.figures[name]) - float(trial.figures[f"true_rig_{name}"])
        for trial in trials
        if trial.number
        and None not in (trial.figures.get(name), trial.figures.get(f"true_rig_{name}"))
    ]
    redone = [
        value
        for trial in trials
        for key, value in trial.figures.items()
        if key.startswith("calibration_") and key.endswith(name) and value is not None
    ]
    return root_mean_square(np.array(changes)) if changes else _sd(redone)


def _sd(values: Sequence[float]) -> float | None:
    spread = spread_of(values)
    return None if spread is None else spread.sd


def _budget_row(reading: Reading, ball: int, n: int, budget: Budget) -> dict[str, Cell]:
    return reading.key | {
        "sphere": ball,
        "trials": n,
        "u_rep": budget.u_rep,
        "u_ref": budget.u_ref,
        "u_cal": budget.u_cal,
        "U": budget.expanded,
    }


def _sorted(rows: list[dict[str, Cell]]) -> tuple[dict[str, Cell], ...]:
    methods = list(dict.fromkeys(row["method"] for row in rows))
    return tuple(sorted(rows, key=lambda row: (methods.index(row["method"]), str(row["sphere"]))))
