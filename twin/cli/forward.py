"""Commands of the forward model: from an experiment to images and points."""

import shlex
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from reconstruction.errors import InputError
from twin.cli.app import (
    BAD_INPUT,
    ExperimentFile,
    Out,
    Report,
    Settings,
    app,
    load,
    print_metrics,
    progress_bars,
    say,
    settings_of,
)

if TYPE_CHECKING:
    from twin.config import Experiment
    from twin.mechanics import PressedElastomer
    from twin.pipeline.memory import Memory
    from twin.pipeline.progress import ProgressCallback
    from twin.results.figures import Metric
    from twin.results.press_derivatives import PressDerivative
    from twin.results.record import Measurement


@app.command
def press(
    experiment: ExperimentFile,
    /,
    *,
    out: Out,
    settings: Settings = None,
    transfer: bool = False,
    solid: bool = False,
    by: list[str] | None = None,
    wait_um: float | None = None,
    wait_percent: float | None = None,
    report: Report = True,
) -> None:
    """Press the specimen into the elastomer: pressure, heights, force, coated face as a mesh.

    Parameters
    ----------
    transfer
        Also report the contact transfer: the share of a groove's depth that the coat shows, by
        pitch. For a thin sheet, the share of the height of ridges under the back pressure.
    solid
        Also write the pressed slab as a watertight body, slab.stl and slab.ply.
    by
        Number of elastomer, press or specimen, for example elastomer.thickness_mm: also compute the
        derivatives of face, force and travel of a thin sheet; repeat it for several numbers.
    wait_um
        Change of the coat's height, um: also compute the time after the press from which the coat
        of a relaxing elastomer changes by less.
    wait_percent
        Change of the force, percent: the same for the force of a press to a depth.
    """
    from twin.mechanics import write_in_plane
    from twin.mechanics.models import model_of
    from twin.output import output_folder
    from twin.results.parts import press_metrics, write_pressed, write_result, write_solid

    loaded = load(experiment, settings)
    with output_folder(out, [experiment]) as folder:
        with progress_bars() as watch:
            watch("press", 0.0)
            pressed, derivatives = _pressed(loaded, by or (), partial(watch, "press"))
            watch("press", 1.0)
        write_pressed(folder, pressed)
        if report:
            from twin.report.press import draw_press

            draw_press(folder / "press.png", loaded, pressed)
        figures = press_metrics(pressed)
        if model_of(pressed.model).is_linear_slab:
            write_in_plane(folder / "in_plane.nc", pressed, loaded.elastomer, loaded.press)
        if solid:
            write_solid(folder, loaded, pressed)
        if transfer:
            figures |= _write_transfer(folder, loaded, pressed)
        if derivatives:
            figures |= _write_derivatives(folder, pressed, derivatives, report)
        figures |= _waiting_times(loaded, wait_um, wait_percent)
        write_result(folder, "press", loaded, figures)
    print_metrics(figures)
    say(f"wrote {out}")


def _waiting_times(
    experiment: "Experiment", wait_um: float | None, wait_percent: float | None
) -> dict[str, float]:
    """Return the times after the press from which coat and force change by less; None: omitted.

    A change of the coat is in um, a change of the force in percent of its final value.
    """
    from twin.pipeline.press import force_waiting_time, waiting_time

    figures = {}
    if wait_um is not None:
        figures["waiting_time_s"] = waiting_time(experiment, wait_um)
    if wait_percent is not None:
        figures["force_waiting_time_s"] = force_waiting_time(experiment, wait_percent)
    return figures


def _write_transfer(
    folder: Path, experiment: "Experiment", pressed: "PressedElastomer"
) -> "dict[str, Metric]":
    """Write and draw the contact transfer of a press; return its figures.

    The contact transfer is the share of a groove's depth that the coat shows, by the groove's
    pitch.
    """
    from twin.pipeline.press import transfer_of
    from twin.report.press import draw_transfer
    from twin.results.parts import transfer_metrics, write_transfer

    transfer = transfer_of(experiment, pressed)
    write_transfer(folder / "transfer.csv", transfer)
    draw_transfer(folder / "transfer.png", transfer)
    return dict(transfer_metrics(transfer))


def _pressed(
    experiment: "Experiment", by: Sequence[str], progress: "Callable[[float], None]"
) -> "tuple[PressedElastomer, list[PressDerivative]]":
    from twin.pipeline.press import press_specimen

    if not by:
        return press_specimen(experiment, progress), []
    from twin.pipeline.sensitivity import press_derivatives

    return press_derivatives(experiment, by, progress)


def _write_derivatives(
    folder: Path,
    pressed: "PressedElastomer",
    derivatives: "Sequence[PressDerivative]",
    report: bool,
) -> dict[str, float]:
    """Write the derivatives of a press with respect to fields; return those of its figures."""
    from twin.results.press_derivatives import derivative_metrics, write_derivatives

    write_derivatives(folder / "derivatives.nc", pressed, derivatives)
    if report:
        from twin.report.press import draw_derivatives

        draw_derivatives(folder / "derivatives.png", pressed, derivatives)
    return derivative_metrics(derivatives)


@app.command
def render(
    experiment: ExperimentFile,
    /,
    *,
    out: Out,
    settings: Settings = None,
    frames: tuple[Literal["exr", "png"], ...] = (),
    report: Report = True,
) -> None:
    """Press, render the fringe stack and expose the camera: a capture as a rig delivers it.

    Parameters
    ----------
    frames
        Write each frame as an image too: exr (linear radiance), png (16-bit digital numbers).
    """
    from twin.output import output_folder
    from twin.pipeline.fringes import take
    from twin.pipeline.progress import Stopwatch
    from twin.results.parts import write_frames, write_result, write_taken, write_timings

    loaded = load(experiment, settings)
    with output_folder(out, [experiment]) as folder:
        with progress_bars() as watch:
            clock = Stopwatch(watch)
            pressed, recording = take(loaded, clock)
            for kind in frames:
                with clock.stage(f"write {kind}") as progress:
                    write_frames(folder, recording, kind, progress)
        figures = write_taken(folder, loaded, pressed, recording)
        if report:
            from twin.report.camera_images import draw_frames

            draw_frames(folder / "frames.png", recording.capture)
        write_result(folder, "render", loaded, figures)
        write_timings(folder, clock.seconds)
    print_metrics(figures)
    say(f"rendered at {clock.frames_per_s['render']:.1f} frames/s")
    say(f"wrote {out}")


@app.command
def measure(
    experiment: ExperimentFile,
    /,
    *,
    out: Out,
    settings: Settings = None,
    report: Report = True,
    remedies: bool = False,
) -> None:
    """Measure virtually: press, render, expose, reconstruct, score against the truth, report.

    If a thin sheet touches too little of the object to measure it, a load with which it does is
    computed by further presses and printed as a line of TOML.

    Parameters
    ----------
    remedies
        Then print the smallest air pressure, load and tack; about ten presses instead of one.
    """
    from twin.output import RESULT_FILE
    from twin.report.page import REPORT_FILE

    loaded = load(experiment, settings, warn=False)  # the result lists its warnings
    done = _measure(loaded, out, "measure", [experiment], report)
    changes = [word for text in settings or () for word in ("-s", text)]
    again = shlex.join([str(experiment), *changes])
    _print_contact_remedies(done, again, thorough=remedies)
    say(f"wrote {out / (REPORT_FILE if report else RESULT_FILE)}")


def _print_contact_remedies(done: "Measurement", measured: str, thorough: bool) -> None:
    """Print the loads with which a thin sheet touches enough of the object, if it does not.

    `measured` are file and settings of the command, as the user enters them.
    """
    from twin.report.object import is_touched_too_little

    if not is_touched_too_little(done):
        return
    from twin.pipeline.contact_remedies import contact_remedies, first_remedy

    with progress_bars() as watch:
        watch("remedies", 0.0)
        if thorough:
            remedies = contact_remedies(done.experiment, partial(watch, "remedies"))
        else:
            remedies = list(filter(None, [first_remedy(done.experiment)]))
        watch("remedies", 1.0)
    if not remedies:
        say("remedy: none of the tried air pressures, loads and tacks is sufficient by itself")
        return
    say(
        "remedy: add one of these lines to the table named in its comment "
        "(each was computed by a press)"
    )
    for remedy in remedies:
        say(f"    {remedy.toml}")
    if not thorough:
        say(f"smallest air pressure, load and tack: twin measure {measured} -o OUT --remedies")


@app.command
def demo(*, out: Out = Path("out/demo"), full: bool = False) -> None:
    """Measure the paper's two balls, nut and brick with the sensor that was identified for it.

    The result is one page with true object, paper and twin side by side, then press, images and
    measurement.

    Parameters
    ----------
    full
        Use all 1936 x 1464 camera pixels instead of 2 x 2 binning.
    """
    from twin.output import output_folder
    from twin.paper.demo import measure_demo, write_demo
    from twin.paper.plan import COARSE, FINE
    from twin.report.measurement import summary_table
    from twin.report.page import REPORT_FILE

    with output_folder(out) as folder, progress_bars() as watch:
        balls, further = measure_demo(folder, FINE if full else COARSE, watch)
        write_demo(folder, watch, measured=(balls, further))
    for measured in (balls, *further):
        say(summary_table(measured))
    say(f"wrote {out / REPORT_FILE}")


@app.command
def compare(
    *experiments: Path,
    out: Out,
    settings: Settings = None,
    methods: str = "direct_fpp,contact_fpp",
    photometric_rig: str = "rigs/gelsight_mini",
    photometric_set: list[str] | None = None,
    match: Literal["force", "depth"] = "force",
    report: Report = True,
) -> int:
    """Measure each specimen by each method, and compare the results in one report.

    A measurement that is in OUT already is not repeated; delete its folder to repeat it.

    Parameters
    ----------
    experiments
        TOML files, or names of shipped experiments such as paper/nut paper/brick.
    methods
        Methods, in the order shown: direct_fpp, contact_fpp, photometric_stereo.
    photometric_rig
        Sensor of photometric_stereo: TOML file without specimen, or name of a shipped rig.
        Specimen, load and scoring come from EXPERIMENT.
    photometric_set
        KEY=VALUE that replaces a value of that rig, as --set does for EXPERIMENT.
    match
        Quantity of the load that is equal for contact_fpp and photometric_stereo: force or depth.
    """
    from twin.output import adding
    from twin.pipeline.comparison import (
        PhotometricPlan,
        methods_named,
    )
    from twin.pipeline.comparison import compare as run_all
    from twin.report import REPORT_FILE, REPORT_NAMES
    from twin.report.comparison import comparison_table, write_comparison

    chosen = methods_named(methods)
    if not experiments:
        raise InputError("EXPERIMENT: found none; name at least one, e.g. twin compare paper/nut")
    loaded = [load(experiment, settings) for experiment in experiments]
    plan = PhotometricPlan(photometric_rig, settings_of(photometric_set), match)
    read = [*experiments, Path(photometric_rig)]
    with progress_bars() as watch:
        measure_case = _with_report if report else _without_report
        outcomes = run_all(loaded, chosen, out, measure_case, watch=watch, plan=plan, inputs=read)
        if report:
            with adding(out, *REPORT_NAMES) as drawn:
                write_comparison(out, watch, drawn)
    say(comparison_table(outcomes))
    say(f"wrote {out / REPORT_FILE if report else out}")
    return BAD_INPUT if all(outcome.failure for outcome in outcomes) else 0


@app.command
def export(experiment: ExperimentFile, /, *, out: Out, settings: Settings = None) -> None:
    """Press, then write a stock Mitsuba scene: XML, mesh and one texture per frame."""
    from twin.optics.backed_coat import material_face
    from twin.optics.export import export_stock
    from twin.output import output_folder
    from twin.pipeline.press import press_specimen
    from twin.results.parts import press_metrics, write_result

    loaded = load(experiment, settings)
    with output_folder(out, [experiment]) as folder, progress_bars() as watch:
        face, figures = None, {}
        if loaded.method.presses and loaded.method.fringes:
            watch("press", 0.0)
            pressed = press_specimen(loaded, partial(watch, "press"))
            watch("press", 1.0)
            face, figures = material_face(loaded, pressed), press_metrics(pressed)
        left_out = export_stock(loaded, face, folder, lambda fraction: watch("export", fraction))
        write_result(folder, "export", loaded, figures | {"not_in_the_scene": left_out})
    for line in left_out:
        sys.stderr.write(f"twin: warning: {line}\n")
    say(f"wrote {out / 'scene.xml'}")


def _measure(
    experiment: "Experiment",
    out: Path,
    command: str,
    inputs: Sequence[Path] = (),
    report: bool = True,
) -> "Measurement":
    from twin.output import output_folder
    from twin.pipeline.methods import measure_into, measure_whole
    from twin.report.measurement import summary_table

    with output_folder(out, inputs) as folder, progress_bars() as watch:
        if report:
            done = _write_with_report(folder, command, measure_whole(experiment, watch), watch)
        else:
            done = measure_into(folder, command, experiment, watch)
    say(summary_table(done))
    return done


def _write_with_report(
    folder: Path, command: str, done: "Measurement", watch: "ProgressCallback"
) -> "Measurement":
    """Write a measurement and its report; figures are drawn while the arrays are written."""
    from twin.report.measurement import write_report
    from twin.report.side_by_side import draw_side_by_side
    from twin.results.folder import as_stored, write_figures, write_maps

    def write() -> None:
        watch("write", 0.0)
        write_maps(folder, done)
        watch("write", 1.0)

    write_figures(folder, command, done)
    stored = as_stored(folder, done)
    write_report(folder, watch, measured=stored, draw=partial(draw_side_by_side, first_task=write))
    return stored


def _with_report(
    folder: Path, case: "Experiment", watch: "ProgressCallback", memory: "Memory"
) -> None:
    from twin.pipeline.methods import measure_into
    from twin.report.measurement import write_report

    write_report(folder, measured=measure_into(folder, "measure", case, watch, memory))


def _without_report(
    folder: Path, case: "Experiment", watch: "ProgressCallback", memory: "Memory"
) -> None:
    from twin.pipeline.methods import measure_into

    measure_into(folder, "measure", case, watch, memory)
