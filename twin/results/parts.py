"""Files of single stages of a measurement, and the figures of press and recording.

`face_figures` evaluates the coated face itself, without light, noise or calibration. Sensitivities
and explanations need hundreds of evaluations: a press of a slab takes 0.1 s, a measurement takes
seconds.
"""

import csv
import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from reconstruction.arrays import FloatArray, FloatImage
from reconstruction.capture.folder import Capture, write_capture
from reconstruction.errors import InputError
from reconstruction.evaluate.fit import SphereFit, fit_sphere
from reconstruction.netcdf import (
    PIXELS,
    Labelled,
    LabelledArrays,
    pixel_coordinates,
    read_arrays,
    write_arrays,
)
from reconstruction.writing import write_exr_channels, write_png, write_text
from twin.config import Experiment, digest, to_toml
from twin.mechanics import (
    ContactTransfer,
    PressedElastomer,
    face_mesh,
    slab_mesh,
    texture_figures,
    write_mesh,
    write_press,
)
from twin.optics.stack import Truth
from twin.output import EXPERIMENT_FILE, write_json, write_outcome
from twin.results.figures import Metric, Metrics
from twin.results.motion import motion_figures
from twin.results.nuts import nut_figures
from twin.results.record import Recording
from twin.results.rods import rod_figures
from twin.results.sequence import sequence_ms
from twin.shape import Sphere
from twin.specimens import shape_of

Progress = Callable[[float], None]

CAPTURE_FOLDER = "capture"
TIMINGS_FILE = "timings.json"
_FRAME = "world: z = 0 is the undeformed coated face, z up; row 0 at the top"
_TRUTH = {
    "x_mm": ("mm", "world x of the surface point behind the pixel centre"),
    "y_mm": ("mm", "world y of the surface point behind the pixel centre"),
    "z_mm": ("mm", "world z of the surface point behind the pixel centre"),
    "normal_x": ("1", "world x of the surface normal there"),
    "normal_y": ("1", "world y of the surface normal there"),
    "normal_z": ("1", "world z of the surface normal there"),
    "depth_mm": ("mm", "distance from the camera along its optical axis"),
    "column_px": ("px", "projector column of that point"),
    "row_px": ("px", "projector row of that point"),
    "lit": ("1", "1 where camera and projector both see the point"),
    "measured": ("1", "1 on the coat or the specimen, 0 on the stage and where nothing is"),
}


def write_result(folder: Path, command: str, experiment: Experiment, figures: Metrics) -> None:
    """Write `result.json` and the resolved experiment, `experiment.toml`.

    Equal experiments give equal bytes. Therefore wall-clock times are not included (see
    `write_timings`).
    """
    write_text(folder / EXPERIMENT_FILE, to_toml(experiment))
    write_outcome(folder, command, figures, name=experiment.name, digest=digest(experiment))


def write_rows(path: Path, rows: Sequence[Metrics], digits: int) -> None:
    """Write rows as CSV with `digits` significant digits; a missing value is an empty cell."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    write_text(path, csv_text(names, rows, digits))


def csv_text(names: Sequence[str], rows: Iterable[Metrics], digits: int | None = None) -> str:
    """Return rows as CSV text (RFC 4180) with the columns `names`.

    `digits` is the number of significant digits; None: all. An apostrophe is put before a text
    that a spreadsheet would run as a formula.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([_as_text(name) for name in names])
    for row in rows:
        writer.writerow([_cell(row.get(name), digits) for name in names])
    return text.getvalue()


def _cell(value: Metric, digits: int | None) -> str:
    if value is None:
        return ""
    if isinstance(value, float):
        return repr(value) if digits is None else f"{value:.{digits}g}"
    return str(value) if isinstance(value, int) else _as_text(str(value))


_FORMULA = ("=", "+", "-", "@", "\t")


def _as_text(text: str) -> str:
    text = text.replace("\r", " ")  # the CSV writer would not quote it
    return f"'{text}" if text.startswith(_FORMULA) else text


def write_timings(folder: Path, seconds: Mapping[str, float]) -> None:
    """Write the wall-clock time, s, of each stage; only this file differs between equal runs."""
    write_json(folder / TIMINGS_FILE, {name: round(s, 3) for name, s in seconds.items()})


def write_pressed(folder: Path, pressed: PressedElastomer) -> None:
    """Write the pressed elastomer (`press.nc`) and its coated face (`coated_face.ply`)."""
    write_press(folder / "press.nc", pressed)
    write_mesh(folder / "coated_face.ply", face_mesh(pressed))


def write_solid(folder: Path, experiment: Experiment, pressed: PressedElastomer) -> None:
    """Write the pressed slab as a watertight mesh, `slab.stl` and `slab.ply`."""
    body = slab_mesh(pressed, experiment.elastomer)
    write_mesh(folder / "slab.stl", body)
    write_mesh(folder / "slab.ply", body)


def write_recording(folder: Path, recording: Recording) -> None:
    """Write the capture as a rig would deliver it, and the truth and white frame of the twin."""
    write_captured(folder, recording.capture)
    write_truth(folder / "truth.nc", recording.truth)
    patterns = recording.capture.patterns
    if patterns.uniform:
        white = patterns.index("white").start
        write_exr(folder / "white.exr", recording.radiance.frames[white])


def write_truth(path: Path, truth: Truth) -> None:
    """Write the true geometry at every camera pixel as netCDF-4."""
    write_arrays(path, truth_arrays(truth))


def truth_arrays(truth: Truth) -> LabelledArrays:
    """Return the true geometry as labelled maps (row, col) over camera pixels, with units."""
    maps = (
        *np.moveaxis(truth.points_world_mm, -1, 0),
        *np.moveaxis(truth.normals_world, -1, 0),
        truth.depth_mm,
        truth.column_px,
        truth.row_px,
        truth.lit.astype(np.uint8),
        truth.measured.astype(np.uint8),
    )
    variables: dict[str, Labelled] = {
        name: (PIXELS, values, {"units": units, "long_name": long_name})
        for (name, (units, long_name)), values in zip(_TRUTH.items(), maps, strict=True)
    }
    return LabelledArrays(variables, pixel_coordinates(*truth.lit.shape), {"frame": _FRAME})


def read_truth(path: Path) -> Truth:
    """Read the file that `write_truth` writes.

    Raises
    ------
    InputError : the file is missing, damaged or not a truth file
    """
    try:
        arrays = read_arrays(path)
        maps = [arrays[name] for name in _TRUTH]
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; render or measure first") from None
    except (OSError, KeyError) as error:
        raise InputError(f"{path}: damaged or no truth file ({error}); render again") from None
    points, normals = np.stack(maps[:3], axis=-1), np.stack(maps[3:6], axis=-1)
    depth_mm, column_px, row_px, lit, measured = maps[6:]
    masks = lit.astype(bool), measured.astype(bool)
    return Truth(points, normals, depth_mm, column_px, row_px, *masks)


def write_exr(path: Path, image: FloatImage) -> None:
    """Write a (row, col) float32 image as a one-channel EXR."""
    write_exr_channels(path, {"Y": image})


def write_captured(folder: Path, capture: Capture) -> None:
    """Write the capture as a rig would deliver it, into the subfolder `capture`."""
    (folder / CAPTURE_FOLDER).mkdir()
    write_capture(folder / CAPTURE_FOLDER, capture)


def write_frames(
    folder: Path, recording: Recording, kind: Literal["exr", "png"], progress: Progress
) -> None:
    """Write every frame as a separate image file, for other decoders.

    Kind `exr` contains the linear radiance, mW / (mm^2 sr), as float32. Kind `png` contains the
    digital numbers of the camera, unscaled, in 16 bits.
    """
    frames = recording.capture.patterns.frames
    (folder / f"frames_{kind}").mkdir()
    for number, frame in enumerate(frames):
        path = folder / f"frames_{kind}" / f"{number:02d}_{frame.name}.{kind}"
        if kind == "exr":
            write_exr(path, recording.radiance.frames[number])
        else:
            write_png(path, np.rint(recording.capture.stack[number]).astype(np.uint16))
        progress((number + 1) / len(frames))


def taken_figures(
    experiment: Experiment, pressed: PressedElastomer | None, recording: Recording
) -> dict[str, Metric]:
    """Return the figures of press (None: no press) and recording by name."""
    figures: dict[str, Metric] = {"warnings": []} if pressed is None else press_metrics(pressed)
    sequence = {"sequence_ms": sequence_ms(experiment, recording.exposure_ms)}
    return figures | recording_metrics(recording) | sequence | motion_figures(recording.radiance)


def write_taken(
    folder: Path, experiment: Experiment, pressed: PressedElastomer | None, recording: Recording
) -> dict[str, Metric]:
    """Write press and recording into a folder; return the figures of both."""
    if pressed is not None:
        write_pressed(folder, pressed)
    write_recording(folder, recording)
    return taken_figures(experiment, pressed, recording)


def press_metrics(pressed: PressedElastomer) -> dict[str, Metric]:
    """Return the figures of a press by name, for example `force_n`, and its warnings."""
    return {
        "mechanics_model": pressed.model,
        "force_n": pressed.force_n,
        "depth_mm": pressed.depth_mm,
        "young_modulus_kpa": pressed.young_modulus_kpa,
        "relief_peak_mm": float(pressed.face_z_mm.max()),
        "peak_pressure_kpa": float(pressed.pressure_kpa.max()),
        "height_error_estimate_mm": pressed.validity.height_error_mm,
        **sheet_figures(pressed),
        **slide_figures(pressed),
        **hold_figures(pressed),
        **texture_figures(pressed),
        "warnings": list(pressed.validity.warnings),
    }


def sheet_figures(pressed: PressedElastomer) -> dict[str, float]:
    """Return the figures of a thin sheet by name; empty if the elastomer is not a thin sheet."""
    if pressed.sheet is None:
        return {}
    return {
        "thinnest_mm": float(pressed.sheet.thickness_mm.min()),
        "largest_stretch": float(pressed.sheet.stretch.max()),
        "steepest_deg": pressed.validity.max_slope_deg,
    }


def slide_figures(pressed: PressedElastomer) -> dict[str, float]:
    """Return the figures of a slide by name: force, N, and share of the contact that sticks."""
    if pressed.shear is None:
        return {}
    return {
        "shear_force_n": pressed.shear.force_n,
        "stick_area_share": pressed.stick_area_share,
        "largest_slip_mm": float(np.hypot(pressed.shear.slip_x_mm, pressed.shear.slip_y_mm).max()),
    }


def hold_figures(pressed: PressedElastomer) -> dict[str, float]:
    """Return the figures of a relaxing elastomer by name: its state when the press ended."""
    figures = {
        "initial_force_n": pressed.initial_force_n,
        "relief_change_um": pressed.relief_change_um,
    }
    return {name: value for name, value in figures.items() if value is not None}


def write_transfer(path: Path, transfer: ContactTransfer) -> None:
    """Write the contact transfer as CSV: pitch, mm, transfer in closed form, computed transfer."""
    names = ("pitch_mm", "closed_form", "computed")
    write_rows(path, [dict(zip(names, row, strict=True)) for row in transfer.rows()], 6)


def transfer_metrics(transfer: ContactTransfer) -> Metrics:
    """Return the figures of the contact transfer by name.

    A pitch of 0 mm means that the coat shows relief of every pitch with its full height. This is
    so if the coat is on the contact face.
    """
    pitches = {
        "half_contrast_pitch_mm": transfer.half_pitch_mm,
        "tenth_contrast_pitch_mm": transfer.tenth_pitch_mm,
    }
    if transfer.pressure_kpa is not None:
        under = {"contact_pressure_kpa": transfer.pressure_kpa, "ridge_mm": transfer.ridge_mm}
        return pitches | under
    difference = np.abs(transfer.closed_form - transfer.computed)
    return pitches | {"transfer_computed_minus_closed_form": float(difference.max())}


def recording_metrics(recording: Recording) -> dict[str, float]:
    """Return exposure time, number of frames and share of clipped values of a recording."""
    stack, clipped_from_dn = recording.capture.stack, recording.capture.sensor.clipped_from_dn
    # Values are counted only in frames with a clipped largest value; most frames have none.
    bright = (frame for frame in stack if frame.max() >= clipped_from_dn)
    clipped = sum(int(np.count_nonzero(frame >= clipped_from_dn)) for frame in bright)
    return {
        "exposure_ms": recording.exposure_ms,
        "frames": len(recording.capture.patterns.frames),
        "saturated_share": clipped / stack.size,
    }


def face_figures(experiment: Experiment, pressed: PressedElastomer) -> dict[str, Metric]:
    """Return the figures of a press, and those of its coated face with the names of a measurement.

    The figures of the face are radius and RMSE of each ball over the scored region, width and
    height of a single rod, and hole depth and hexagon share of a nut.

    Raises
    ------
    FitError : the region of a ball contains too few nodes of the face
    """
    points = face_points_mm(pressed)
    figures = press_metrics(pressed) | rod_figures(experiment, points)
    figures |= nut_figures(experiment, points)
    for number, ball in enumerate(shape_of(experiment.specimen).spheres(), start=1):
        fit = cap_fit(points, ball, experiment.score.roi_radius_mm)
        figures[f"sphere_{number}_radius_mm"] = fit.radius_mm
        figures[f"sphere_{number}_rmse_mm"] = fit.stats.rmse_mm
    return figures


def face_points_mm(pressed: PressedElastomer) -> FloatArray:
    """Return the nodes of the coated face, (n, xyz) float, world frame, mm."""
    x, y = np.meshgrid(pressed.face_x_mm, pressed.face_y_mm)
    return np.column_stack([x.ravel(), y.ravel(), pressed.face_z_mm.ravel()])


def cap_fit(points_mm: FloatArray, ball: Sphere, roi_radius_mm: float) -> SphereFit:
    """Fit a sphere to the points (n, xyz) of the coated face in the region of one ball.

    The region contains the points at a lateral distance of at most `roi_radius_mm` from the centre.

    Raises
    ------
    FitError : the region contains too few points
    """
    lateral = np.hypot(points_mm[:, 0] - ball.x_mm, points_mm[:, 1] - ball.y_mm)
    return fit_sphere(points_mm[lateral <= roi_radius_mm])
