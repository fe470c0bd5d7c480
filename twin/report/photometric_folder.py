"""Read a finished measurement by photometric stereo back from its folder.

The stored image is decoded anew by every decoder: image and calibrations are what was measured.
"""

from dataclasses import dataclass
from pathlib import Path

import imageio.v3 as imageio
import numpy as np

from reconstruction.arrays import Levels
from reconstruction.errors import InputError
from reconstruction.photometric import SensorCalibration, read_sensor_calibration
from reconstruction.photometric.colour_table import ColourTable
from reconstruction.photometric.sensor_calibration import MapKind
from twin.mechanics import PressedElastomer, read_press
from twin.optics.stack import Truth
from twin.optics.storage import read_truth
from twin.pipeline.photometric_decoders import Decoded, chosen, decode_all
from twin.pipeline.photometric_storage import (
    CALIBRATION_FILE,
    IMAGE_FILE,
    OTHER_CALIBRATION_FILE,
)
from twin.report.result_folder import Result, read_seconds, result_parts

_NEEDED_FIGURES = (
    "completeness",
    "good_share",
    "height_scale",
    "warnings",
    "z_bias_um",
    "z_p95_um",
    "z_rmse_um",
)


@dataclass(frozen=True, eq=False)
class Photographed(Result):
    """One measurement by photometric stereo, whole.

    Attributes
    ----------
    image : (row, col, 3) uint8, red first
    background : (row, col, 3) float32, mean untouched image
    decoded : list of Decoded
        The image by every decoder.
    own : Decoded
        That of the experiment's own decoder.
    """

    pressed: PressedElastomer
    image: Levels
    calibration: SensorCalibration
    decoded: list[Decoded]
    own: Decoded
    truth: Truth
    seconds: dict[str, float]


def read_photographed(folder: Path) -> Photographed:
    """Read a whole result folder.

    Raises
    ------
    InputError
        The folder is no finished measurement, or a file is missing or damaged.
    """
    parts = result_parts(folder, _NEEDED_FIGURES)
    image, truth = _read_image(folder / IMAGE_FILE), read_truth(folder / "truth.nc")
    files = (CALIBRATION_FILE, OTHER_CALIBRATION_FILE)
    calibrations = {
        _kind(one): one for one in (read_sensor_calibration(folder / file) for file in files)
    }
    decoded = decode_all(parts["experiment"], image, calibrations, truth)
    own = chosen(parts["experiment"], decoded)
    return Photographed(
        **parts,
        pressed=read_press(folder / "press.nc"),
        image=image,
        calibration=calibrations[own.colour_map],
        decoded=decoded,
        own=own,
        truth=truth,
        seconds=read_seconds(folder),
    )


def _kind(calibration: SensorCalibration) -> MapKind:
    return "table" if isinstance(calibration.colour_map, ColourTable) else "polynomial"


def _read_image(path: Path) -> Levels:
    try:
        return np.asarray(imageio.imread(path))
    except (OSError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: cannot be read as an image ({reason}); measure again") from None
