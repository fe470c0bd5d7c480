"""Folder of a measurement: write and read its files. Users may rely on the names of the files.

| file | content |
|---|---|
| result.json | metrics (units in their names), digest, versions |
| experiment.toml | the resolved experiment |
| press.nc, coated_face.ply | fields of the pressed elastomer and the coated face |
| press_start.nc, press_end.nc | of a moving press: at the first and the last time of the sequence |
| truth.nc | point, normal, depth, projector pixel behind every pixel |
| points.ply | point cloud |

With fringes:

| file | content |
|---|---|
| capture/ | recorded frames in the format of a real rig: stack, description, calibration |
| white.exr | white frame as linear radiance |
| reconstruction.nc | maps of the decoder |
| height_map.*, surface.ply | heights on a regular grid, triangle mesh |

By photometric stereo:

| file | content |
|---|---|
| image.png, background.png | images as the sensor's driver delivers them, 8-bit RGB |
| sensor_calibration.npz | the sensor's colour map (see `read_sensor_calibration`) |
| other_calibration.npz | another colour map, on the same reference images |
| other_calibration_2.npz, ... | further colour maps, with plug-ins |
| height.nc | height, slopes and reason codes |
| decoders.csv | figures of this image by every colour map and every integration |
| markers.nc, markers.png | of a gel with printed dots: displacements, and their picture |

When a measurement is read, it is scored again from the stored maps; a photometric image is decoded
again.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from reconstruction.arrays import Levels
from reconstruction.colouring import Deviation, Intensity
from reconstruction.errors import InputError
from reconstruction.evaluate.surface import write_surface
from reconstruction.machine import run_side_by_side
from reconstruction.photometric import (
    read_sensor_calibration,
    write_height_map,
    write_height_points,
    write_sensor_calibration,
)
from reconstruction.pipeline import Reconstruction, read_reconstruction, write_reconstruction
from reconstruction.reading import is_regular, read_json, read_pixels
from reconstruction.writing import write_png
from twin.config import Experiment, load_experiment
from twin.mechanics import PressedElastomer, read_press, write_press
from twin.optics.stack import Truth
from twin.output import EXPERIMENT_FILE, RESULT_FILE
from twin.results.colours import decode_colours
from twin.results.decoders import DecodedImage
from twin.results.dot_figures import write_motion
from twin.results.figures import Figures, Metrics
from twin.results.parts import (
    CAPTURE_FOLDER,
    TIMINGS_FILE,
    read_truth,
    write_captured,
    write_exr,
    write_pressed,
    write_result,
    write_rows,
    write_timings,
    write_truth,
)
from twin.results.record import Colours, Fringes, Measurement
from twin.results.score import Scores, TruthScore, metrics, score
from twin.results.under_sheet import SheetCompensation, sheet_compensation

IMAGE_FILE, BACKGROUND_FILE, DECODERS_FILE = "image.png", "background.png", "decoders.csv"
CALIBRATION_FILE, OTHER_CALIBRATION_FILE = "sensor_calibration.npz", "other_calibration.npz"
_FURTHER_FILES = "other_calibration_{}.npz"
ENDS_FILES = "press_start.nc", "press_end.nc"
TRUTH_FILE, MAPS_FILE, HEIGHTS_FILE = "truth.nc", "reconstruction.nc", "height.nc"

_MEASURING_COMMANDS = ("measure", "demo")
_NEEDED = ("completeness", "good_share", "warnings", "z_bias_um", "z_p95_um", "z_rmse_um")
_NEEDED_OF_FRINGES = (
    "error_over_sigma",
    "exposure_ms",
    "filter_bias_share",
    "filter_bias_um",
    "saturated_share",
    "sigma_z_median_um",
    "wrong_order_pixels",
)
_NEEDED_OF_COLOURS = ("height_scale",)
_NEEDED_OF_A_PRESS = (
    "depth_mm",
    "force_n",
    "height_error_estimate_mm",
    "relief_peak_mm",
    "young_modulus_kpa",
)


def write_measurement(folder: Path, command: str, done: Measurement) -> None:
    """Write all files of a measurement into an empty folder; `command` is the calling command."""
    write_figures(folder, command, done)
    write_maps(folder, done)


def write_figures(folder: Path, command: str, done: Measurement) -> None:
    """Write the small files of a measurement: figures, experiment, run times.

    `command` is the name of the calling command.
    """
    figures = {**done.metrics, "warnings": list(done.warnings)}
    write_result(folder, command, done.experiment, figures)
    write_timings(folder, done.seconds)


def write_maps(folder: Path, done: Measurement) -> None:
    """Write the arrays of a measurement: all files that `write_figures` does not write."""
    run_side_by_side(
        [
            lambda: write_kept(folder, done, ("points",)),
            lambda: write_kept(folder, done, ("press", "capture")),
            lambda: write_truth(folder / TRUTH_FILE, done.truth),
        ]
    )
    if isinstance(done.images, Fringes):
        _write_white(folder / "white.exr", done.images)
    else:
        _write_decoding(folder, done.images)


def write_kept(folder: Path, done: Measurement, keep: tuple[str, ...]) -> None:
    """Write the arrays that `keep` names: "press", "capture" (images), "points" (and maps)."""
    if "press" in keep and done.pressed is not None:
        write_pressed(folder, done.pressed)
        for name, pressed in zip(ENDS_FILES, done.pressed_at_ends, strict=False):
            write_press(folder / name, pressed)
    images = done.images
    if isinstance(images, Fringes):
        if "capture" in keep:
            write_captured(folder, images.capture)
        if "points" in keep:
            maps = images.reconstruction
            run_side_by_side(
                [
                    lambda: write_reconstruction(
                        folder / MAPS_FILE, maps.decoded, maps.point_map, maps.motion
                    ),
                    lambda: _write_points(folder, done, maps),
                ]
            )
        return
    if "capture" in keep:
        write_png(folder / IMAGE_FILE, images.picture)
        background = np.rint(images.calibration.background).astype(np.uint8)
        write_png(folder / BACKGROUND_FILE, background)
    if "points" in keep:
        write_height_map(folder / HEIGHTS_FILE, images.heights)
        write_height_points(folder / "points.ply", images.heights)


def _write_points(folder: Path, done: Measurement, maps: Reconstruction) -> None:
    points = maps.point_map
    intensity = Intensity(maps.decoded.intensity_dn, points.valid)
    write_surface(folder, points, deviation_of(done), intensity)


def deviation_of(done: Measurement) -> Deviation:
    """Return measured minus true world z, um, (row, col), and a mask of the compared pixels."""
    points, true = done.points, done.truth
    error_um = 1e3 * (points.world_mm[..., 2] - true.points_world_mm[..., 2])
    return Deviation(error_um, points.valid & true.measured)


def read_measurement(folder: Path) -> Measurement:
    """Read all files of a finished measurement.

    Raises
    ------
    InputError : the folder is not a finished measurement, or a file is missing or damaged
    """
    result = _read_result(folder)
    experiment = _read_experiment(folder / EXPERIMENT_FILE)
    method, figures = experiment.method, result["metrics"]
    needed = _NEEDED + (_NEEDED_OF_FRINGES if method.fringes else _NEEDED_OF_COLOURS)
    _require(folder, figures, needed + (_NEEDED_OF_A_PRESS if method.presses else ()))
    truth = read_truth(folder / TRUTH_FILE)
    pressed = read_press(folder / "press.nc") if method.presses else None
    images: Fringes | Colours
    scored: Scores[TruthScore]
    if method.fringes:
        images, scored = _read_fringes(folder, experiment, truth)
    else:
        assert pressed is not None  # photometric stereo presses
        images = _read_colours(folder, experiment, truth, pressed)
        scored = images.own.score
    return Measurement(
        experiment=experiment,
        images=images,
        truth=truth,
        score=scored,
        metrics=figures,
        pressed=pressed,
        compensation=_compensation_of(experiment, images),
        pressed_at_ends=_read_ends(folder, experiment),
        digest=str(result.get("digest", "")),
        versions=result.get("versions", {}),
        seconds=_read_seconds(folder),
    )


def _read_ends(folder: Path, experiment: Experiment) -> tuple[PressedElastomer, ...]:
    """Return the elastomer at both ends of a moving press; empty without one or without files."""
    paths = [folder / name for name in ENDS_FILES]
    if not experiment.motion.moves or not all(path.exists() for path in paths):
        return ()
    return tuple(map(read_press, paths))


def _compensation_of(experiment: Experiment, images: Fringes | Colours) -> SheetCompensation | None:
    if not isinstance(images, Fringes):
        return None
    return sheet_compensation(experiment, images.reconstruction.point_map)


def as_stored(folder: Path, done: Measurement) -> Measurement:
    """Return a measurement as `read_measurement` would return it, after `write_figures`.

    Only the small files are read; the arrays are those of `done`.
    """
    result = _read_result(folder)
    return done.with_same_object(
        experiment=_read_experiment(folder / EXPERIMENT_FILE),
        metrics=result["metrics"],
        digest=str(result["digest"]),
        versions=result["versions"],
        seconds=_read_seconds(folder),
    )


def _write_white(path: Path, images: Fringes) -> None:
    patterns = images.capture.patterns
    if images.frames is not None and patterns.uniform:
        write_exr(path, images.frames[patterns.index("white").start])


def _write_decoding(folder: Path, images: Colours) -> None:
    others = [kind for kind in images.calibrations if kind != images.own.colour_map]
    numbered = [_FURTHER_FILES.format(number) for number in range(2, len(others) + 1)]
    files = dict(zip(others, [OTHER_CALIBRATION_FILE, *numbered], strict=False))
    for kind, calibration in images.calibrations.items():
        write_sensor_calibration(folder / files.get(kind, CALIBRATION_FILE), calibration)
    write_decoders(folder / DECODERS_FILE, images.decoded)
    if images.dots is not None and images.dots.motion is not None:
        write_motion(folder, images.picture, images.dots.motion)


def write_decoders(path: Path, decoded: Sequence[DecodedImage]) -> None:
    """Write the figures of every decoder as CSV, one line each; missing values are empty."""
    write_rows(path, [_decoder_row(image) for image in decoded], 6)


def _decoder_row(image: DecodedImage) -> Metrics:
    figures = metrics(image.score)
    figures.pop("unfitted_balls")
    return {"colour_map": image.colour_map, "integration": image.integration, **figures}


def _read_fringes(
    folder: Path, experiment: Experiment, truth: Truth
) -> tuple[Fringes, Scores[TruthScore]]:
    reconstruction = read_reconstruction(folder / MAPS_FILE)
    measured_shape, true_shape = reconstruction.point_map.mask_reason.shape, truth.lit.shape
    if measured_shape != true_shape:
        raise InputError(
            f"{folder}: {MAPS_FILE} is {measured_shape}, {TRUTH_FILE} {true_shape} (row, col); "
            "measure again"
        )
    images = Fringes(folder / CAPTURE_FOLDER, reconstruction)
    return images, score(experiment, reconstruction, truth)


def _read_colours(
    folder: Path, experiment: Experiment, truth: Truth, pressed: PressedElastomer
) -> Colours:
    image = _read_image(folder / IMAGE_FILE)
    further = sorted(folder.glob(_FURTHER_FILES.format("*")))
    files = [folder / CALIBRATION_FILE, folder / OTHER_CALIBRATION_FILE, *further]
    read = [read_sensor_calibration(file) for file in files]
    calibrations = {calibration.colour_map.name: calibration for calibration in read}
    return decode_colours(experiment, image, calibrations, truth, pressed)


def _read_image(path: Path) -> Levels:
    try:
        return read_pixels(path)
    except InputError as error:
        raise InputError(f"{error}; measure again") from None


def _read_result(folder: Path) -> dict[str, Any]:
    """Read `result.json` of a measurement; raise InputError for another kind of result."""
    if not is_regular(folder / RESULT_FILE):
        raise InputError(f"{folder}: no finished result (no {RESULT_FILE}); run twin measure first")
    result = read_json(folder / RESULT_FILE)
    command, figures = result.get("command"), result.get("metrics")
    if command not in _MEASURING_COMMANDS or not isinstance(figures, dict):
        raise InputError(
            f"{folder}: result of command {command!r}; "
            f"a report needs one of {', '.join(_MEASURING_COMMANDS)}"
        )
    return result


def _require(folder: Path, figures: Metrics, names: tuple[str, ...]) -> None:
    """Raise InputError if a result lacks one of the named figures, or has a text in its place."""
    missing = sorted(set(names) - set(Figures(figures)) - ({"warnings"} & set(figures)))
    if missing:
        raise InputError(f"{folder / RESULT_FILE}: no {', '.join(missing)}; measure again")


def _read_experiment(path: Path) -> Experiment:
    # If the file is missing, load_experiment would take its path for the name of a shipped
    # experiment.
    if not is_regular(path):
        raise InputError(f"{path}: no such file; measure again")
    return load_experiment(path)


def _read_seconds(folder: Path) -> dict[str, float]:
    """Read the run time, s, of each stage; empty if the file is missing."""
    path = folder / TIMINGS_FILE
    return read_json(path) if is_regular(path) else {}
