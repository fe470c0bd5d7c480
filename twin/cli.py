"""Command line of the twin. Heavy packages are imported inside the commands."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import App, CycloptsError, Parameter

from reconstruction.errors import InputError

if TYPE_CHECKING:
    from twin.config import Experiment
    from twin.modalities.progress import Watcher

BAD_INPUT, MISSING_BACKEND, FAILURE = 2, 3, 1

app = App(
    name="twin",
    help="Digital twin of a contact fringe-projection sensor: press, render, reconstruct, score.",
    version_flags=["--version"],
    help_flags=["--help", "-h"],
)

Out = Annotated[Path, Parameter(name=["--out", "-o"], help="folder for the result")]
Settings = Annotated[
    list[str] | None,
    Parameter(name=["--set", "-s"], help="KEY=VALUE by dotted path, for example camera.binning=2"),
]


@app.command
def doctor() -> int:
    """Check this machine: packages, Dr.Jit backend, LLVM or CUDA, data files, disk."""
    from rich.console import Console
    from rich.table import Table

    from twin.doctor import diagnose

    findings = diagnose()
    table = Table("", "check", "found", "what to do")
    for finding in findings:
        mark = "[green]ok[/]" if finding.ok else "[red]no[/]"
        table.add_row(mark, finding.name, finding.detail, "" if finding.ok else finding.advice)
    Console().print(table)
    if all(finding.ok for finding in findings):
        return 0
    return (
        MISSING_BACKEND
        if any(f.name == "renderer backend" and not f.ok for f in findings)
        else FAILURE
    )


@app.command
def init(
    file: Annotated[Path, Parameter(help="experiment file to write")] = Path("experiment.toml"),
) -> None:
    """Write a commented starter experiment.

    Parameters
    ----------
    file
        Where to write it; an existing file is never overwritten.
    """
    from twin.assets import asset_path

    starter = asset_path("scenes", "examples/starter").read_text(encoding="utf-8")
    try:
        with file.open("x", encoding="utf-8") as target:
            target.write(starter)
    except FileExistsError:
        raise InputError(f"{file}: exists already; give another name") from None
    except OSError as error:
        raise InputError(f"{file}: cannot be written ({error.strerror})") from None
    _say(f"wrote {file}; next: twin measure {file} -o out")


@app.command
def keys() -> None:
    """List every key of an experiment file: type, allowed values, default, meaning."""
    from rich.console import Console
    from rich.table import Table

    from twin.config.reference import experiment_keys

    table = Table("key", "allowed", "default", "meaning")
    table.columns[0].no_wrap = True
    for key in experiment_keys():
        table.add_row(key.path, key.allowed, key.default, key.meaning)
    Console().print(table)


@app.command
def press(
    experiment: Path,
    /,
    *,
    out: Out,
    settings: Settings = None,
    transfer: bool = False,
    solid: bool = False,
) -> None:
    """Press the specimen into the elastomer: fields, force, coated face as a mesh.

    Parameters
    ----------
    experiment
        TOML file, or the name of a shipped experiment such as paper/two_balls.
    transfer
        Also report how much of a groove of each pitch the slab keeps.
    solid
        Also write the pressed slab as a watertight body, slab.stl and slab.ply.
    """
    from twin.mechanics import contact_transfer, write_in_plane
    from twin.modalities.contact_fpp import press_specimen
    from twin.modalities.storage import (
        press_metrics,
        transfer_metrics,
        write_pressed,
        write_result,
        write_solid,
        write_transfer,
    )
    from twin.output import output_folder
    from twin.report.press import draw_press
    from twin.report.transfer import draw_transfer

    loaded = _load(experiment, settings)
    with output_folder(out) as folder:
        with _progress() as watch:
            watch("press", 0.0)
            pressed = press_specimen(loaded)
            watch("press", 1.0)
        write_pressed(folder, pressed)
        draw_press(folder / "press.png", loaded, pressed)
        figures = press_metrics(pressed)
        if pressed.model == "spectral":
            write_in_plane(folder / "in_plane.nc", pressed, loaded.elastomer)
        if solid:
            write_solid(folder, loaded, pressed)
        if transfer:
            kept = contact_transfer(loaded.elastomer)
            write_transfer(folder / "transfer.csv", kept)
            draw_transfer(folder / "transfer.png", kept)
            figures |= transfer_metrics(kept)
        write_result(folder, "press", loaded, figures)
    _print_metrics(figures)
    _say(f"wrote {out}")


@app.command
def render(
    experiment: Path,
    /,
    *,
    out: Out,
    settings: Settings = None,
    frames: tuple[Literal["exr", "png"], ...] = (),
) -> None:
    """Press, render the fringe stack and expose the camera: a capture as a rig delivers it.

    Parameters
    ----------
    experiment
        TOML file, or the name of a shipped experiment such as paper/two_balls.
    frames
        Write each frame as an image too: exr (linear radiance), png (16-bit digital numbers).
    """
    from twin.modalities.measurement import take
    from twin.modalities.progress import Stopwatch
    from twin.modalities.storage import write_frames, write_result, write_taken, write_timings
    from twin.output import output_folder
    from twin.report.frames import draw_frames

    loaded = _load(experiment, settings)
    with output_folder(out) as folder:
        with _progress() as watch:
            clock = Stopwatch(watch)
            pressed, recording = take(loaded, clock)
            for kind in frames:
                with clock.stage(f"write {kind}") as progress:
                    write_frames(folder, recording, kind, progress)
        figures = write_taken(folder, pressed, recording)
        draw_frames(folder / "frames.png", recording.capture)
        write_result(folder, "render", loaded, figures)
        write_timings(folder, clock.seconds)
    _print_metrics(figures)
    _say(f"rendered at {clock.frames_per_s['render']:.1f} frames/s")
    _say(f"wrote {out}")


@app.command
def measure(experiment: Path, /, *, out: Out, settings: Settings = None) -> None:
    """Run the whole way: press, render, expose, reconstruct, score, report.

    Parameters
    ----------
    experiment
        TOML file, or the name of a shipped experiment such as paper/two_balls.
    """
    _measure(_load(experiment, settings), out, "measure")


@app.command
def compare(
    *experiments: Path,
    out: Out,
    settings: Settings = None,
    methods: str = "direct_fpp,contact_fpp",
) -> int:
    """Measure each specimen by each method and set the results side by side.

    A measurement that OUT holds already is not made again; delete its folder to have it anew.

    Parameters
    ----------
    experiments
        TOML files, or names of shipped experiments such as paper/nut paper/brick.
    methods
        Which, and in which order they are shown: direct_fpp, contact_fpp.
    """
    from twin.modalities.comparison import compare as run_all
    from twin.modalities.comparison import methods_named
    from twin.report import comparison_table, write_comparison, write_report

    chosen = methods_named(methods)
    if not experiments:
        raise InputError("EXPERIMENT: found none; name at least one, e.g. twin compare paper/nut")
    loaded = [_load(experiment, settings) for experiment in experiments]
    with _progress() as watch:
        outcomes = run_all(loaded, chosen, out, write_report, watch)
        page = write_comparison(out, watch)
    _say(comparison_table(outcomes))
    _say(f"wrote {page}")
    return BAD_INPUT if all(outcome.failure for outcome in outcomes) else 0


@app.command
def demo(*, out: Out = Path("out/demo"), full: bool = False) -> None:
    """Run the main job on the shipped defaults: two joined balls, contact-FPP.

    Parameters
    ----------
    full
        Use all 1936 x 1464 camera pixels instead of 2 x 2 binning.
    """
    _measure(_load(Path("paper/two_balls"), [f"camera.binning={1 if full else 2}"]), out, "demo")


@app.command
def reconstruct(
    capture: Path,
    /,
    *,
    out: Out,
    use: Literal["column", "row", "both"] = "column",
    filter_taps: int = 8,
    filter_sigma_px: float = 1.5,
) -> None:
    """Decode and triangulate a capture, rendered or real; needs no renderer.

    Parameters
    ----------
    capture
        Folder with capture.toml, or a result folder that holds one as capture/.
    use
        Projector coordinate that gives the depth.
    filter_taps
        Width of the Gaussian on the phase, px; 0 switches it off.
    filter_sigma_px
        Standard deviation of that Gaussian, px.
    """
    from twin.config import decode_settings
    from twin.modalities.captures import reconstruct_capture

    chosen = decode_settings(use=use, filter_taps=filter_taps, filter_sigma_px=filter_sigma_px)
    with _progress() as watch:
        figures = reconstruct_capture(capture, out, chosen, watch)
    _print_metrics(figures)
    _say(f"wrote {out}")


@app.command
def calibrate(
    source: Path,
    /,
    *,
    out: Out,
    board: str = "boards/paper_dots",
    settings: Settings = None,
    camera_distortion: tuple[Literal["k1", "k2", "p1", "p2", "k3"], ...] = ("k1",),
    projector_distortion: tuple[Literal["k1", "k2", "p1", "p2", "k3"], ...] = (),
    keep_captures: bool = False,
) -> None:
    """Calibrate camera and projector on captures of a board, or on rendered ones.

    Parameters
    ----------
    source
        Folder with one capture folder per board pose; or an experiment, whose rig is rendered.
    board
        Board file, or the name of a shipped board.
    camera_distortion, projector_distortion
        Coefficients to estimate.
    keep_captures
        Keep the rendered captures as captures/pose_NN.
    """
    from reconstruction.calibrating import AdjustOptions, Freedom
    from twin.config.board import load_board
    from twin.modalities.calibration import calibrate_captures, calibrate_rendered
    from twin.modalities.calibration_storage import write_board_calibration
    from twin.output import output_folder
    from twin.report.calibration import draw_calibration

    shown = load_board(board)
    options = AdjustOptions(Freedom(camera_distortion, projector_distortion))
    with output_folder(out) as folder:
        with _progress() as watch:
            if source.is_dir():
                done = calibrate_captures(source, shown, options, watch=watch)
            else:
                keep = folder / "captures" if keep_captures else None
                done = calibrate_rendered(
                    _load(source, settings), shown, options, keep=keep, watch=watch
                )
        figures = write_board_calibration(folder, done)
        draw_calibration(folder, done)
    _print_metrics(figures)
    _say(f"wrote {out}")


@app.command
def export(experiment: Path, /, *, out: Out, settings: Settings = None) -> None:
    """Press, then write a stock Mitsuba scene: XML, mesh and one texture per frame.

    Parameters
    ----------
    experiment
        TOML file, or the name of a shipped experiment such as paper/two_balls.
    """
    from twin.mechanics import face_mesh
    from twin.modalities.contact_fpp import press_specimen
    from twin.modalities.storage import press_metrics, write_result
    from twin.optics.export import export_stock
    from twin.output import output_folder

    loaded = _load(experiment, settings)
    with output_folder(out) as folder, _progress() as watch:
        face, figures = None, {}
        if loaded.modality == "contact_fpp":
            watch("press", 0.0)
            pressed = press_specimen(loaded)
            watch("press", 1.0)
            face, figures = face_mesh(pressed), press_metrics(pressed)
        left_out = export_stock(loaded, face, folder, lambda fraction: watch("export", fraction))
        write_result(folder, "export", loaded, figures | {"not_in_the_scene": left_out})
    for line in left_out:
        sys.stderr.write(f"twin: warning: {line}\n")
    _say(f"wrote {out / 'scene.xml'}")


@app.command
def patterns(
    experiment: Path = Path("paper/two_balls"), /, *, out: Out, settings: Settings = None
) -> None:
    """Write the projected sequence for a real projector: 8-bit PNG images and a manifest.

    Parameters
    ----------
    experiment
        TOML file, or the name of a shipped experiment such as paper/two_balls.
    """
    from reconstruction.pattern_files import MANIFEST_FILE, write_patterns
    from twin.optics.light import pattern_set
    from twin.output import output_folder

    loaded = _load(experiment, settings)
    sequence = pattern_set(loaded.projector, loaded.patterns)
    with output_folder(out) as folder:
        write_patterns(folder, sequence)
    _say(f"wrote {len(sequence.frames)} images and {out / MANIFEST_FILE}")


@app.command
def report(folder: Path, /) -> None:
    """Draw the HTML report of a finished measurement or comparison anew.

    Parameters
    ----------
    folder
        Result folder of `twin measure`, `twin demo` or `twin compare`.
    """
    from twin.modalities.comparison import is_comparison
    from twin.report import write_comparison, write_report

    draw = write_comparison if is_comparison(folder) else write_report
    with _progress() as watch:
        path = draw(folder, watch)
    _say(f"wrote {path}")


def _measure(experiment: "Experiment", out: Path, command: str) -> None:
    from twin.modalities import measure as run
    from twin.modalities.storage import write_measurement
    from twin.output import output_folder
    from twin.report import summary_table, write_report

    with output_folder(out) as folder, _progress() as watch:
        done = run(experiment, watch)
        watch("write", 0.0)
        write_measurement(folder, command, experiment, done)
        watch("write", 1.0)
        write_report(folder, watch)
    _say(summary_table(out))
    _say(f"wrote {out / 'report.html'}")


def _load(file: Path, settings: list[str] | None) -> "Experiment":
    from twin.config import load_experiment

    return load_experiment(str(file), dict(_setting(text) for text in settings or []))


def _setting(text: str) -> tuple[str, Any]:
    """Split KEY=VALUE; the value is read as TOML, and as a plain string if it is none."""
    import tomllib

    key, found, value = text.partition("=")
    if not found or not key.strip():
        raise InputError(f"--set {text}: found no '='; write KEY=VALUE, e.g. camera.binning=2")
    try:
        return key.strip(), tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return key.strip(), value.strip()


@contextmanager
def _progress() -> "Iterator[Watcher]":
    """Show one bar per stage on stderr; quiet when nobody watches."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description:<12}"), BarColumn(), TimeElapsedColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        bars: dict[str, Any] = {}

        def watch(stage: str, fraction: float) -> None:
            if stage not in bars:
                bars[stage] = progress.add_task(stage, total=1.0)
                if not console.is_terminal:
                    sys.stderr.write(f"{stage} ...\n")
            progress.update(bars[stage], completed=fraction)

        yield watch


def _print_metrics(figures: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table("figure", "value")
    for name, value in figures.items():
        shown = f"{value:.6g}" if isinstance(value, float) else str(value)
        table.add_row(name, "\n".join(value) if isinstance(value, list) else shown)
    Console().print(table)


def _say(text: str) -> None:
    sys.stdout.write(f"{text}\n")


def _guarded(run: Callable[[], Any]) -> int:
    """Run a command; turn expected failures into one line and an exit code."""
    try:
        return int(run() or 0)
    except InputError as error:
        sys.stderr.write(f"twin: {error}\n")
        return BAD_INPUT
    except CycloptsError as error:
        sys.stderr.write(f"twin: {' '.join(str(error).split())} See twin --help.\n")
        return BAD_INPUT
    except KeyboardInterrupt:
        sys.stderr.write("twin: interrupted; nothing was written\n")
        return FAILURE
    except RuntimeError as error:
        if type(error).__name__ != "MissingBackend":
            raise
        sys.stderr.write(f"twin: {error}\n")
        return MISSING_BACKEND


def run(arguments: list[str] | None = None) -> int:
    """Run one command line (default: the process' own arguments) and return its exit code."""
    return _guarded(
        lambda: app(arguments, exit_on_error=False, print_error=False, result_action="return_value")
    )


def main() -> None:
    """Entry point of the `twin` command."""
    sys.exit(run())
