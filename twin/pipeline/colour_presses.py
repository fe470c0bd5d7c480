"""Measure one or several presses of a photometric sensor from their images, rendered or real.

For one press the result folder contains height.nc and points.ply, and for a gel with printed dots
markers.nc and markers.png. For several presses these files are in presses/NUMBER_NAME for each
press, and presses.csv has the figures of each press, heights.png the height maps. In both cases
experiment.toml is the description, and sensor_calibration.npz the calibration for later
measurements.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.errors import CaptureError, InputError
from reconstruction.photometric import (
    DescribedPresses,
    HeightMap,
    PhotometricReason,
    PhotometricResult,
    SensorCalibration,
    described_presses,
    write_height_map,
    write_height_points,
    write_sensor_calibration,
)
from reconstruction.photometric.pictures import draw_heights
from reconstruction.photometric.press_doubts import untouched_drift_mm
from reconstruction.reading import MOST_IMAGE_BYTES, read_bytes, read_text
from reconstruction.writing import write_text
from twin.config.digest import content_digest
from twin.output import EXPERIMENT_FILE, output_folder, write_outcome
from twin.pipeline.captures import masked_by_reason
from twin.pipeline.progress import ProgressCallback, no_progress
from twin.results.dot_figures import dot_figures, write_motion
from twin.results.parts import write_rows

HEIGHT_FILE, POINTS_FILE, CALIBRATION_FILE = "height.nc", "points.ply", "sensor_calibration.npz"
PRESSES_FOLDER, PRESSES_FILE, HEIGHTS_FILE = "presses", "presses.csv", "heights.png"
_DIGITS = 6
# Figures of several presses that are reported by their median.
_MEDIANS = (
    "valid_share",
    "highest_mm",
    "untouched_share",
    "untouched_drift_um",
    "dots_tracked",
    "dots_moved_most_um",
)


@dataclass(frozen=True, eq=False)
class ColourOutcome:
    """Results of measured presses.

    Attributes
    ----------
    figures : figures for result.json
    doubts : warnings that results may be wrong
    rows : figures of each press, or the reason why it could not be measured (`refused`)
    heights : height maps by name, of the presses that could be measured
    """

    figures: dict[str, Any]
    doubts: tuple[str, ...]
    rows: list[dict[str, Any]]
    heights: dict[str, HeightMap]


Draw = Callable[[Path, ColourOutcome], object]
"""Function that draws the page of presses into their folder."""


def reconstruct_presses(
    description: Path,
    out: Path,
    watch: ProgressCallback = no_progress,
    draw: Draw | None = None,
) -> ColourOutcome:
    """Measure the presses of a description, and write the result folder `out`.

    The module docstring lists the files. If the description has several presses, those that cannot
    be measured are listed with the reason, and the others are measured.

    Parameters
    ----------
    description : TOML file, see `reconstruction.photometric.press_description`
    draw : called at the end, with the folder

    Raises
    ------
    InputError : the description or its only image is missing or damaged, no press can be measured,
        no contact is found on a calibration image, or `out` cannot be written
    """
    with output_folder(out, [description]) as folder:
        watch("calibrate", 0.0)
        presses = described_presses(description)
        watch("calibrate", 1.0)
        if len(presses.files) == 1:
            outcome = _one(presses, folder)
        else:
            outcome = _several(presses, folder, watch)
        text = read_text(description)
        write_text(folder / EXPERIMENT_FILE, text)
        write_sensor_calibration(folder / CALIBRATION_FILE, presses.decoder.calibration)
        files = [_content(file) for file in presses.files if file.is_file()]
        named = content_digest(text, files, _arrays_of(presses.decoder.calibration))
        write_outcome(folder, "reconstruct", outcome.figures, digest=named)
        if draw is not None:
            draw(folder, outcome)
    return outcome


def _arrays_of(calibration: SensorCalibration) -> list[Any]:
    """Return the values of a calibration, for its digest; that of a flat gel has no rest."""
    values = [getattr(calibration, of.name) for of in fields(calibration) if of.name != "rest"]
    return values if calibration.rest is None else [*values, calibration.rest]


def _content(file: Path) -> NDArray[np.uint8]:
    return np.frombuffer(read_bytes(file, MOST_IMAGE_BYTES), np.uint8)


def _one(presses: DescribedPresses, folder: Path) -> ColourOutcome:
    file = presses.files[0]
    result = presses.measure(file)
    _write(folder, result)
    figures = press_figures(result)
    row = {"press": file.stem} | figures
    return ColourOutcome(figures, result.doubts, [row], {file.stem: result.height_map})


def _several(presses: DescribedPresses, folder: Path, watch: ProgressCallback) -> ColourOutcome:
    rows: list[dict[str, Any]] = []
    heights: dict[str, HeightMap] = {}
    doubts, motion = list(presses.doubts), None
    for number, file in enumerate(presses.files):
        name = f"{number:03d}_{file.stem}"
        try:
            result = presses.measure(file, motion)
        except InputError as error:
            rows.append({"press": name, "refused": str(error)})
            doubts.append(str(error))
            continue
        motion = result.motion or motion
        own = [doubt for doubt in result.doubts if doubt not in presses.doubts]
        doubts += [f"{file.name}: {doubt}" for doubt in own]
        rows.append({"press": name} | press_figures(result) | {"doubt": " ".join(own)})
        heights[name] = result.height_map
        _write(folder / PRESSES_FOLDER / name, result)
        watch("reconstruct", (number + 1) / len(presses.files))
    write_rows(folder / PRESSES_FILE, rows, _DIGITS)
    refused = [row["refused"] for row in rows if "refused" in row]
    if not heights:
        raise CaptureError(f"no press can be measured; the first: {refused[0]}")
    draw_heights(folder / HEIGHTS_FILE, heights)
    figures: dict[str, Any] = {
        "presses": len(heights),
        "presses_refused": len(refused),
        "presses_in_doubt": sum(1 for row in rows if row.get("doubt")),
        "refused": refused,
    }
    return ColourOutcome(figures | _medians(rows), tuple(doubts), rows, heights)


def _write(folder: Path, result: PhotometricResult) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    write_height_map(folder / HEIGHT_FILE, result.height_map)
    write_height_points(folder / POINTS_FILE, result.height_map)
    if result.motion is not None:
        write_motion(folder, result.image, result.motion)


def _medians(rows: list[dict[str, Any]]) -> dict[str, float]:
    columns = {name: [row[name] for row in rows if name in row] for name in _MEDIANS}
    return {f"{name}_median": float(np.median(them)) for name, them in columns.items() if them}


def press_figures(result: PhotometricResult) -> dict[str, Any]:
    """Return the figures of one press by name, units in the names.

    They are the range of the valid heights, share, light and RMS height of the undeformed gel, and
    the number of masked pixels per reason.
    """
    height_map = result.height_map
    heights_mm = height_map.height_mm[height_map.valid]
    figures: dict[str, Any] = {
        "points": int(height_map.valid.sum()),
        "valid_share": float(height_map.valid.mean()),
        "untouched_share": float(result.untouched.where.mean()),
        "light_change_rel": result.untouched.light_change,
    }
    drift_mm = untouched_drift_mm(height_map, result.untouched.where)
    if drift_mm is not None:
        figures["untouched_drift_um"] = 1e3 * drift_mm
    if figures["points"]:
        figures["highest_mm"] = float(np.max(heights_mm))
        figures["lowest_mm"] = float(np.min(heights_mm))
    figures |= masked_by_reason(height_map.mask_reason, PhotometricReason)
    return figures if result.motion is None else figures | dot_figures(result.motion)
