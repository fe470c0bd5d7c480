"""Write a measurement by photometric stereo into a folder.

| file | content |
|---|---|
| result.json, experiment.toml | figures, and the resolved experiment |
| press.nc, coated_face.ply | fields of the pressed gel and its coat |
| image.png, background.png | what the sensor's driver delivers, 8-bit RGB |
| sensor_calibration.npz | the sensor's colour map (see `read_sensor_calibration`) |
| other_calibration.npz | the other kind of colour map, on the same reference images |
| height.nc, points.ply | height, slopes and reason codes; valid points in the world |
| decoders.csv | figures of this image by every colour map and every integration |
| truth.nc | point and normal behind every pixel of the image |
"""

from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np

from reconstruction.photometric import (
    write_height_map,
    write_height_points,
    write_sensor_calibration,
)
from twin.config import Experiment
from twin.optics.storage import write_truth
from twin.pipeline.colours import PhotometricMeasurement
from twin.pipeline.photometric_decoders import write_decoders
from twin.pipeline.photometric_score import photometric_metrics
from twin.pipeline.storage import press_metrics, write_pressed, write_result, write_timings

IMAGE_FILE, BACKGROUND_FILE, DECODERS_FILE = "image.png", "background.png", "decoders.csv"
CALIBRATION_FILE, OTHER_CALIBRATION_FILE = "sensor_calibration.npz", "other_calibration.npz"


def write_photometric(
    folder: Path, command: str, experiment: Experiment, done: PhotometricMeasurement
) -> None:
    """Write everything of one measurement."""
    write_pressed(folder, done.pressed)
    write_seen(folder, done)
    for kind, calibration in done.calibrations.items():
        own = kind == done.own.colour_map
        file = CALIBRATION_FILE if own else OTHER_CALIBRATION_FILE
        write_sensor_calibration(folder / file, calibration)
    write_decoders(folder / DECODERS_FILE, done.decoded)
    write_heights(folder, done)
    write_truth(folder / "truth.nc", done.truth)
    write_result(folder, command, experiment, photometric_figures(done))
    write_timings(folder, done.seconds)


def photometric_figures(done: PhotometricMeasurement) -> dict[str, Any]:
    """Metrics of result.json: those of the press and of the heights."""
    return press_metrics(done.pressed) | photometric_metrics(done.score)


def write_seen(folder: Path, done: PhotometricMeasurement) -> None:
    """Write what the sensor's driver delivers, of the specimen and of the untouched gel."""
    imageio.imwrite(folder / IMAGE_FILE, done.image)
    background = np.rint(done.calibration.background).astype(np.uint8)
    imageio.imwrite(folder / BACKGROUND_FILE, background)


def write_heights(folder: Path, done: PhotometricMeasurement) -> None:
    """Write the heights as maps and as points."""
    write_height_map(folder / "height.nc", done.heights)
    write_height_points(folder / "points.ply", done.heights)
