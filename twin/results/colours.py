"""Decode the image of a rendered photometric sensor: heights by every decoder, printed dots."""

from collections.abc import Mapping

from reconstruction.arrays import Levels
from reconstruction.photometric import PhotometricDecoder, PhotometricOptions, SensorCalibration
from twin.config import Experiment
from twin.mechanics import PressedElastomer
from twin.optics.stack import Truth
from twin.results.decoders import chosen, decode_all
from twin.results.printed_dots import measured_dots, sensor_dots
from twin.results.record import Colours


def decode_colours(
    experiment: Experiment,
    image: Levels,
    calibrations: Mapping[str, SensorCalibration],
    truth: Truth,
    pressed: PressedElastomer,
) -> Colours:
    """Return an image (row, col, 3) uint8 with its heights, scores, and displacements of dots.

    Parameters
    ----------
    calibrations : by kind of colour map, the sensor's calibration

    Raises
    ------
    FitError : no pixel within `photometric.field` has a height
    """
    calibration = calibrations[experiment.photometric.colour_map]
    dots = sensor_dots(experiment, calibration.background, calibration.smoothing_px)
    hidden = None if dots is None else dots.covered(image)
    decoded = decode_all(experiment, image, calibrations, truth, hidden)
    own = chosen(experiment, decoded)
    if experiment.photometric.markers is None:
        return Colours(image, calibrations, decoded, own)
    options = PhotometricOptions(experiment.photometric.integration)
    untouched = PhotometricDecoder(calibration, options).untouched(image, hidden)
    motion = None if dots is None else dots.tracked(image, own.heights, untouched.where)
    measured = measured_dots(experiment, motion, truth, pressed)
    return Colours(image, calibrations, decoded, own, measured)
