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
    from twin.modalities.contact_fpp import press_specimen, record
    from twin.modalities.progress import Stopwatch
    from twin.modalities.storage import (
        press_metrics,
        recording_metrics,
        write_frames,
        write_pressed,
        write_recording,
        write_result,
        write_timings,
    )
    from twin.output import output_folder
    from twin.report.frames import draw_frames

    loaded = _load(experiment, settings)
    with output_folder(out) as folder:
        with _progress() as watch:
            clock = Stopwatch(watch)
            with clock.stage("press"):
                pressed = press_specimen(loaded)
            recording = record(loaded, pressed, clock)
            for kind in frames:
                with clock.stage(f"write {kind}") as progress:
                    write_frames(folder, recording, kind, progress)
        write_pressed(folder, pressed)
        write_recording(folder, recording)
        draw_frames(folder / "frames.png", recording.capture)
        figures = press_metrics(pressed) | recording_metrics(recording)
        write_result(folder, "render", loaded, figures)
        write_timings(folder, clock.seconds)
    _print_metrics(figures)
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
        watch("press", 0.0)
        pressed = press_specimen(loaded)
        watch("press", 1.0)
        left_out = export_stock(
            loaded, face_mesh(pressed), folder, lambda fraction: watch("export", fraction)
        )
        write_result(
            folder, "export", loaded, press_metrics(pressed) | {"not_in_the_scene": left_out}
        )
    for line in left_out:
        sys.stderr.write(f"twin: warning: {line}\n")
    _say(f"wrote {out / 'scene.xml'}")


@app.command
def report(folder: Path, /) -> None:
    """Draw the HTML report of a finished measurement anew.

    Parameters
    ----------
    folder
        Result folder of `twin measure` or `twin demo`.
    """
    from twin.report import write_report

    with _progress() as watch:
        path = write_report(folder, watch)
    _say(f"wrote {path}")


def _measure(experiment: "Experiment", out: Path, command: str) -> None:
    from twin.modalities.contact_fpp import measure as run
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
