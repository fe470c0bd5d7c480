"""Commands for captures, rendered or real: patterns, decoding, reconstruction, merging."""

import shutil
import sys
from functools import partial
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from reconstruction.errors import counted
from twin.cli.app import (
    ExperimentFile,
    Out,
    Settings,
    app,
    load,
    print_metrics,
    progress_bars,
    say,
    settings_of,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

Pixel = tuple[float, float, float, float]


@app.command
def reconstruct(
    capture: Path,
    /,
    *,
    out: Out,
    use: Literal["column", "row", "both"] = "column",
    filter_taps: int | None = None,
    filter_sigma_px: float | None = None,
    weights: Literal["equal", "modulation"] | None = None,
    reference_pixels: tuple[Pixel, ...] | None = None,
    reference_z_mm: float | None = None,
    reference_sigma_mm: float | None = None,
    islands: Literal["mask", "join", "all"] | None = None,
    photometric: bool = False,
) -> None:
    """Decode and triangulate a capture, rendered or real; needs no renderer.

    Parameters
    ----------
    capture
        Folder with capture.toml, or a result folder that contains one as capture/.
    use
        Projector coordinate that gives the depth.
    filter_taps
        Width of the Gaussian filter on the projector coordinate, camera px; 0 switches the filter
        off; default: see twin keys.
    filter_sigma_px
        Standard deviation of that filter, camera px; default: see twin keys.
    weights
        Weights of the pixels in that filter; default: see twin keys.
    reference_pixels
        Code spatial: camera column and row, and projector column and row, of pixels with a known
        projector coordinate; nan: unknown row.
    reference_z_mm
        Code spatial: world z of the largest continuous surface.
    reference_sigma_mm
        Standard deviation of reference_z_mm, including the relief of the surface.
    islands
        Code spatial: mask islands without a reference, join them, or number all by reference_z_mm.
    photometric
        CAPTURE is a TOML file that describes one or many presses seen by a photometric-stereo
        sensor; see docs/photometric.md.
    """
    if photometric:
        _reconstruct_presses(capture, out)
        return
    from twin.output import end_exchange
    from twin.pipeline.captures import reconstruct_capture

    end_exchange(capture)
    settings: dict[str, Any] = {"use": use, "weights": weights}
    settings |= {"filter_taps": filter_taps, "filter_sigma_px": filter_sigma_px}
    settings |= {"reference_pixels": _known_of(reference_pixels), "reference_z_mm": reference_z_mm}
    settings |= {"reference_sigma_mm": reference_sigma_mm, "islands": islands}
    _decode_by(reconstruct_capture, capture, out, settings)


@app.command
def merge(
    *captures: Path,
    out: Out,
    baseline: Literal["projector", "cameras"] = "projector",
    use: Literal["column", "row", "both"] = "column",
    weights: Literal["equal", "modulation"] | None = None,
) -> None:
    """Reconstruct captures of one scene by several cameras with one projector; merge the points.

    Parameters
    ----------
    captures
        Folders with capture.toml, one per camera, each with the calibration of its camera and the
        projector. The points are in the world of the first one.
    baseline
        Partner of the cameras. projector: each camera is triangulated with the projector, and the
        points are merged. cameras: the first of two cameras is triangulated with the second one,
        and the projector only marks the surface; needs fringes along both axes.
    use
        Projector coordinate that gives the depth.
    weights
        Weights of the pixels in the filter; default: see twin keys.
    """
    from twin.output import end_exchange
    from twin.pipeline.merging import merge_captures, merging_doubts, triangulate_captures

    for capture in captures:
        end_exchange(capture)
    compute = merge_captures if baseline == "projector" else triangulate_captures
    _decode_by(compute, captures, out, {"use": use, "weights": weights}, merging_doubts)


@app.command
def decode(
    capture: Path,
    /,
    *,
    out: Out,
    filter_taps: int | None = None,
    filter_sigma_px: float | None = None,
    weights: Literal["equal", "modulation"] | None = None,
    reference_pixels: tuple[Pixel, ...] | None = None,
    islands: Literal["mask", "join", "all"] | None = None,
) -> None:
    """Turn the frames of a capture into projector coordinates; needs no calibration.

    Parameters
    ----------
    capture
        Folder with capture.toml; see docs/real_rig.md on how to list the frames of any set.
    filter_taps
        Width of the Gaussian filter on the projector coordinate, camera px; 0 switches the filter
        off; default: see twin keys.
    filter_sigma_px
        Standard deviation of that filter, camera px; default: see twin keys.
    weights
        Weights of the pixels in that filter; default: see twin keys.
    reference_pixels
        Code spatial: camera column and row, and projector column and row, of pixels with a known
        projector coordinate; nan: unknown row.
    islands
        Code spatial: mask islands without a reference, join them, or number all by reference_z_mm.
    """
    from twin.pipeline.captures import decode_capture

    settings: dict[str, Any] = {
        "filter_taps": filter_taps,
        "filter_sigma_px": filter_sigma_px,
        "weights": weights,
    }
    settings |= {"reference_pixels": _known_of(reference_pixels), "islands": islands}
    _decode_by(decode_capture, capture, out, settings)


def _known_of(pixels: tuple[Pixel, ...] | None) -> list[tuple[float, ...]] | None:
    """Return marked pixels without their projector row where it is unknown."""
    if pixels is None:
        return None
    return [pixel[:3] if isnan(pixel[3]) else pixel for pixel in pixels]


def _decode_by(
    compute: "Callable[..., dict[str, Any]]",
    source: Any,
    out: Path,
    settings: dict[str, Any],
    doubts_of: "Callable[[dict[str, Any]], Iterable[str]] | None" = None,
) -> None:
    """Write the result of captures and print its figures; settings that are None keep defaults.

    Parameters
    ----------
    source : folder, or folders, of `compute`
    doubts_of : returns warnings for the figures; None: those of the fringe orders
    """
    from twin.config import decode_settings
    from twin.pipeline.captures import order_doubts

    chosen = {key: value for key, value in settings.items() if value is not None}
    with progress_bars() as watch:
        figures = compute(source, out, decode_settings(**chosen), watch)
    _print_figures(figures, (doubts_of or order_doubts)(figures), out)


def _print_figures(figures: dict[str, Any], doubts: "Iterable[str]", out: Path) -> None:
    print_metrics(figures)
    for doubt in doubts:
        sys.stderr.write(f"twin: warning: {doubt}\n")
    say(f"wrote {out}")


@app.command
def describe(
    folder: Path,
    /,
    *,
    out: Annotated[Path | None, Parameter(name=["--out", "-o"])] = None,
    projector: tuple[int, int] | None = None,
) -> None:
    """Guess the patterns in the images of a folder, and write capture.toml for you to correct.

    Parameters
    ----------
    folder
        Folder with images of fringes or bits that another program recorded, also in subfolders.
    out
        File to write; default: capture.toml in FOLDER; an existing file is never overwritten.
    projector
        Width and height of the projector, px, which images do not show; default: 1280 720, marked
        as unsure.
    """
    from reconstruction.capture.description import DESCRIPTION_FILE
    from reconstruction.capture.guess import guess
    from reconstruction.capture.guess_check import describe_and_test
    from reconstruction.capture.guess_file import require_groups
    from reconstruction.writing import write_text
    from twin.files import creating

    size = projector or (1280, 720)
    with progress_bars() as watch:
        watch("describe", 0.0)
        guessed = guess(folder, size)
        watch("describe", 1.0)
        require_groups(guessed, folder)
        target = out or folder / DESCRIPTION_FILE
        with creating(target) as part:
            watch("decode", 0.0)
            described = describe_and_test(guessed, folder, size, is_known=projector is not None)
            watch("decode", 1.0)
            write_text(part, described.text)
    for group in guessed.groups:
        along = f" along {group.axis}" if group.axis else ""
        say(f"{group.kind}{along}: {counted(len(group.files), 'image')}, {group.files[0]} ...")
    for text in described.guess.unsure:
        say(f"unsure: {text}")
    for text in described.lines:
        say(text)
    say("unsure: the values that the file marks, such as periods in projector pixels and [sensor]")
    say(f"wrote {target}; correct it, then: twin decode {folder} -o decoded")


def _reconstruct_presses(description: Path, out: Path) -> None:
    from twin.pipeline.colour_presses import reconstruct_presses
    from twin.report.page import REPORT_FILE
    from twin.report.presses import write_presses_page

    with progress_bars() as watch:
        outcome = reconstruct_presses(
            description, out, watch, partial(write_presses_page, name=description.stem)
        )
    _print_figures(outcome.figures, outcome.doubts, out / REPORT_FILE)


@app.command
def patterns(
    experiment: ExperimentFile = Path("paper/two_balls"), /, *, out: Out, settings: Settings = None
) -> None:
    """Write the projected sequence for a real projector: 8-bit PNG images and a manifest.

    Parameters
    ----------
    experiment
        Experiment with the projector; or a TOML file with [patterns] only, such as a manifest: any
        sequence that can be decoded, see docs/decoding.md.
    """
    from reconstruction.capture.description import (
        MANIFEST_FILE,
        is_sequence,
        read_sequence,
        write_patterns,
    )
    from twin.config.digest import content_digest
    from twin.optics.light import pattern_set
    from twin.output import EXPERIMENT_FILE, output_folder, write_outcome
    from twin.results.parts import write_result

    loaded = None if is_sequence(experiment) else load(experiment, settings)
    if loaded is None:
        sequence = read_sequence(experiment, settings_of(settings))
    else:
        sequence = pattern_set(loaded.projector, loaded.patterns)
    figures = {
        "images": len(sequence.frames),
        "width_px": sequence.width_px,
        "height_px": sequence.height_px,
    }
    with output_folder(out, [experiment]) as folder:
        with progress_bars() as watch:
            watch("patterns", 0.0)
            write_patterns(folder, sequence, partial(watch, "patterns"))
        if loaded is None:  # the manifest contains all settings
            shutil.copy(folder / MANIFEST_FILE, folder / EXPERIMENT_FILE)
            write_outcome(folder, "patterns", figures, digest=content_digest(sequence))
        else:
            write_result(folder, "patterns", loaded, figures)
    say(f"wrote {counted(len(sequence.frames), 'image')} and {out / MANIFEST_FILE}")
