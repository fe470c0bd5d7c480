"""Commands that determine values from measurements: the twin of a real rig, unknown fields."""

from pathlib import Path
from typing import TYPE_CHECKING

from twin.cli.app import (
    Cluster,
    Out,
    Report,
    WorkerCount,
    app,
    print_table,
    progress_bars,
    say,
    workers_of,
)

if TYPE_CHECKING:
    from reconstruction.characterise import UncertainValue
    from twin.adoption.adopt import Adopted
    from twin.adoption.elastomer import KnownBallPress


@app.command
def adopt(
    *captures: Path,
    out: Out,
    like: str = "rigs/slab",
    dark: Path | None = None,
    flat: Path | None = None,
    reference: Path | None = None,
    reference_albedo: float | None = None,
    reference_uncertainty: float = 0.01,
    ball: Path | None = None,
    ball_diameter_mm: float | None = None,
    layer: Path | None = None,
    report: Report = True,
) -> None:
    """Make the twin of a real rig: a rig file with value, range and source of every field.

    Poses and lenses are those of the captures' calibration; noise, gamma and blur are fitted. All
    other fields have the value of --like and the source "assumed"; see docs/adopt.md.

    Parameters
    ----------
    captures
        Folders with capture.toml, calibration, white and black frames; first the coat at rest. Two
        captures of the same scene give the noise; with another fringe period, they are a check.
    like
        Rig that gives every value that the captures do not determine.
    dark
        Folder of two or more images without light, which give black level, read noise and DSNU.
    flat
        Folder of two or more images of an evenly lit surface, which give PRNU.
    reference
        Capture of a flat matte surface of known albedo in the coat's place, at the same exposure.
    reference_albedo
        Albedo of the reference, 0 to 1.
    reference_uncertainty
        Standard uncertainty of the albedo of the reference.
    ball
        Capture of a known ball pressed into a thin sheet, for its thickness and modulus.
    ball_diameter_mm
        Diameter of that ball, mm.
    layer
        TOML file with the assumed values of sheet and load; see docs/compensation.md.
    """
    from twin.adoption.adopt import Given
    from twin.adoption.adopt import adopt as make
    from twin.adoption.write import write_adopted
    from twin.output import output_folder
    from twin.report.adopted import write_adopted_page

    known = _known_albedo(reference_albedo, reference_uncertainty)
    press = _ball_press(ball, ball_diameter_mm, layer)
    given = Given(captures, like, dark, flat, reference, known, press)
    inputs = [p for p in (*captures, dark, flat, reference, ball, layer) if p is not None]
    with output_folder(out, inputs) as folder, progress_bars() as watch:
        adopted = make(given, watch)
        write_adopted(folder, adopted, given)
        if report:
            write_adopted_page(folder, adopted, given, watch)
    _print_summary(adopted, out)


def _print_summary(adopted: "Adopted", out: Path) -> None:
    from twin.adoption.summary import summary_of
    from twin.adoption.write import FIELDS_FILE, RIG_FILE

    for line in summary_of(adopted):
        say(line)
    say(f"wrote {out / RIG_FILE}; every field with range and source: {out / FIELDS_FILE}")


@app.command
def identify(
    problem: Path,
    /,
    *,
    out: Out,
    quick: bool = False,
    workers: WorkerCount = None,
    cluster: Cluster = None,
) -> None:
    """Estimate unknown fields from measurements, with intervals and undetermined combinations.

    The problem names experiments, free fields with priors, discrete choices and measured rows. The
    twin simulates the experiments over the space of the fields, fits emulators to the figures, and
    samples the posterior distribution. Run it again to continue after an interruption.

    Parameters
    ----------
    problem
        TOML file, or the name of a shipped problem such as problems/slab.
    quick
        Use only 25 % of the simulations, with 50 % of the repeats, without refinement: a preview
        with wider intervals.
    """
    from twin.config.problem import load_problem
    from twin.identification.record import COMMAND, WRITTEN, write_identified
    from twin.identification.run import identify as find
    from twin.identification.summary import SUMMARY_FILE, write_summary
    from twin.output import adding, claimed
    from twin.report import REPORT_NAMES
    from twin.report.identified import write_identified as draw

    loaded, experiments = load_problem(problem)
    problem_to_solve = loaded.quick() if quick else loaded
    who = workers_of(workers, cluster)
    names = (*WRITTEN, SUMMARY_FILE, *REPORT_NAMES)
    with claimed(out, COMMAND, names, [problem]), progress_bars() as watch:
        posterior = find(problem_to_solve, experiments, out, who, watch=watch, inputs=[problem])
        with adding(out, *names) as folder:
            write_identified(folder, posterior, experiments)
            write_summary(folder, posterior)
            draw(folder, posterior, watch)
    rows = [
        [
            name,
            f"{marginal.mean:.4g}",
            f"{marginal.sd:.2g}",
            f"{marginal.low_95:.4g} to {marginal.high_95:.4g}",
        ]
        for name, marginal in posterior.intervals().items()
    ]
    print_table(("field", "mean", "standard deviation", "95 % interval"), rows)
    say(f"wrote {out / 'report.html'}")


def _ball_press(
    ball: Path | None, diameter_mm: float | None, layer: Path | None
) -> "KnownBallPress | None":
    from reconstruction.errors import InputError, require_number
    from twin.adoption.elastomer import KnownBallPress

    if ball is None and diameter_mm is None and layer is None:
        return None
    if ball is None or diameter_mm is None or layer is None:
        raise InputError(
            "adopt: --ball, --ball-diameter-mm and --layer go together; give all three"
        )
    require_number("--ball-diameter-mm", diameter_mm, 0.0, open_low=True)
    return KnownBallPress(ball, layer, diameter_mm)


def _known_albedo(albedo: float | None, uncertainty: float) -> "UncertainValue | None":
    from reconstruction.characterise import UncertainValue
    from reconstruction.errors import require_number

    if albedo is None:
        return None
    require_number("--reference-albedo", albedo, 0.0, 1.0, open_low=True)
    require_number("--reference-uncertainty", uncertainty, 0.0, 1.0)
    return UncertainValue(albedo, uncertainty)
