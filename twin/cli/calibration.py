"""Commands for calibrations: from captures of a board, and from files of other programs."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, get_args

from cyclopts import Parameter

from twin.cli.app import (
    Out,
    Settings,
    app,
    load,
    print_metrics,
    progress_bars,
    say,
)

if TYPE_CHECKING:
    from twin.config import Experiment

Coefficient = Literal["k1", "k2", "p1", "p2", "k3"]
_KEY_HELP = (
    "QUANTITY=NAME in the file, repeatable, for names that are not known; for example "
    "camera_matrix=Kc; QUANTITY: camera_matrix, camera_distortion (NAME none: no distortion), "
    "camera_size, camera_shape, camera_width, camera_height, the same of projector, rotation, "
    "translation, motion (4 x 4)"
)
_TAKING_COEFFICIENTS = ("--camera-distortion", "--projector-distortion")


def with_repeated_options(words: Sequence[str]) -> list[str]:
    """Return the words of a command line with one `--camera-distortion` per coefficient.

    The same is done for `--projector-distortion`: `k1 k2`, `k1,k2` or `=k1 k2` after the option
    becomes two options.

    Without this, Cyclopts assigns to an option either one word or all following words, including
    the source.
    """
    written: list[str] = []
    option = ""
    for word in words:
        name, _, assigned = word.partition("=")
        if name in _TAKING_COEFFICIENTS:
            option = name
        coefficients = (assigned if name == option else word).split(",")
        if option and set(coefficients) <= set(get_args(Coefficient)):
            for coefficient in coefficients:
                written += [coefficient] if written[-1:] == [option] else [option, coefficient]
            continue
        option = option if word == option else ""
        written.append(word)
    return written


@app.command
def calibrate(
    source: Path,
    /,
    *,
    out: Out,
    board: str = "boards/paper_dots",
    settings: Settings = None,
    camera_distortion: tuple[Coefficient, ...] = ("k1",),
    projector_distortion: tuple[Coefficient, ...] = (),
    camera_pixel_ratio: float = 1.0,
    projector_pixel_ratio: float = 1.0,
    keep_captures: bool = False,
    as_images: bool = False,
) -> None:
    """Calibrate camera and projector on captures of a board, or on rendered ones.

    Parameters
    ----------
    source
        Folder with one capture folder per board pose; or an experiment, to render its rig.
    board
        Board file, or the name of a shipped board.
    camera_distortion, projector_distortion
        Coefficients to estimate, for example k1 k2.
    camera_pixel_ratio, projector_pixel_ratio
        Width of a pixel over its height; 2 for a diamond chip such as 912 x 1140.
    keep_captures
        Keep the rendered captures as captures/pose_NN.
    as_images
        Keep the rendered captures as PNG images, as a real camera gives them; camera.bit_depth=8
        makes 8-bit images.
    """
    from reconstruction.calibration import AdjustOptions, Freedom
    from twin.config.board import load_board
    from twin.output import output_folder
    from twin.pipeline import board_calibration, calibration
    from twin.report.calibration import draw_calibration

    shown = load_board(board)
    freedom = Freedom(
        camera_distortion,
        projector_distortion,
        camera_pixel_ratio=camera_pixel_ratio,
        projector_pixel_ratio=projector_pixel_ratio,
    )
    options = AdjustOptions(freedom)
    with output_folder(out, [source, Path(board)]) as folder:
        with progress_bars() as watch:
            if source.is_dir():
                done = calibration.calibrate_captures(source, shown, options, watch=watch)
            else:
                keep = folder / "captures" if keep_captures or as_images else None
                rig = _rig(source, settings)
                done = calibration.calibrate_rendered(
                    rig, shown, options, keep=keep, as_images=as_images, watch=watch
                )
        figures = board_calibration.write_board_calibration(folder, done)
        draw_calibration(folder, done)
    print_metrics(figures)
    say(f"wrote {out}")


@app.command(name="import-calibration")
def import_calibration(
    *files: Path,
    out: Out,
    camera_size: tuple[int, int] | None = None,
    projector_size: tuple[int, int] | None = None,
    unit: Literal["mm", "cm", "m"] | None = None,
    baseline_mm: float | None = None,
    pose: Literal["forward", "inverse", "transposed", "position"] | None = None,
    check: Path | None = None,
    key: Annotated[list[str] | None, Parameter(help=_KEY_HELP)] = None,
    projector_first: bool = False,
    standoff_mm: float | None = None,
) -> None:
    """Take over a calibration of OpenCV, MATLAB or a scanner program; see docs/calibration.md.

    Parameters
    ----------
    files
        Files that together hold both camera matrices, distortions, R and T.
    camera_size, projector_size
        Width and height, px, if no file contains them.
    unit
        Unit of the lengths in the files. Default: that of the format (ROS, Kalibr: m), else mm.
    baseline_mm
        Distance between camera and projector, for files without a scale (COLMAP).
    pose
        Convention of R and T. forward: x_projector = R x_camera + T; inverse: x_camera = R
        x_projector + T; transposed: R^T for R; position: T is the projector's position. Default:
        forward, or the one that the capture of --check confirms.
    check
        Capture of any object, fringes along both axes; its points must be on epipolar lines.
    projector_first
        The first (left) device in the files is the projector.
    standoff_mm
        Distance from the camera to the origin of the world frame. Default: the origin is where the
        optical axes of camera and projector come nearest.
    """
    from reconstruction.calibration.correspondences import corresponding_points
    from reconstruction.rig.importing import Importing
    from reconstruction.rig.importing import import_calibration as read
    from reconstruction.rig.named_numbers import parsed_keys
    from twin.output import output_folder
    from twin.pipeline.board_calibration import CALIBRATION_FILE, write_imported

    options = Importing(camera_size, projector_size, unit, projector_first, standoff_mm)
    options = replace(options, keys=parsed_keys(key or ()), pose=pose, baseline_mm=baseline_mm)
    imported = read(files, options, None if check is None else corresponding_points(check))
    with output_folder(out, files) as folder:
        figures = write_imported(folder, imported)
    for line in imported.summary():
        say(line)
    print_metrics(figures)
    say(f"wrote {out / CALIBRATION_FILE}")


def _rig(source: Path, settings: Settings) -> "Experiment":
    from reconstruction.errors import InputError
    from twin.assets import AssetError

    try:
        return load(source, settings)
    except AssetError:
        if source.suffix == ".toml":
            raise
        raise InputError(
            f"{source}: no such folder of captures and no such experiment; give the folder that "
            "holds one capture folder per board pose, or an experiment such as paper/two_balls"
        ) from None
