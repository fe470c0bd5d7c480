"""One photometric image decoded by every colour map and every integration, with scores.

A decoder is a colour map (the paper's look-up table, or the polynomial) with one of three
integrations of slopes. The decoders share image, reference presses and truth, so that only the
decoding differs.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from reconstruction.arrays import BoolImage, Levels
from reconstruction.colour_maps import COLOUR_MAPS, maps_in_order
from reconstruction.integration_schemes import SCHEMES, schemes_in_order
from reconstruction.photometric import (
    HeightMap,
    PhotometricDecoder,
    PhotometricOptions,
    SensorCalibration,
)
from twin.config.models import Experiment
from twin.optics.stack import Truth
from twin.results.score import HeightScore, Scores, score_heights


@dataclass(frozen=True, eq=False)
class DecodedImage:
    """Heights and score of one image, decoded by one colour map and one integration."""

    colour_map: str
    integration: str
    heights: HeightMap
    score: Scores[HeightScore]

    @property
    def errors(self) -> HeightScore:
        """Errors of the heights against the true surface."""
        return self.score.against_truth

    @property
    def sphere_rmse_mm(self) -> float | None:
        """Mean over the balls of the RMSE of the sphere fit, mm; None without a fit.

        The paper compares decoders by this figure.
        """
        errors_mm = [ball.measured.stats.rmse_mm for ball in self.score.spheres]
        return sum(errors_mm) / len(errors_mm) if errors_mm else None


def decode_all(
    experiment: Experiment,
    image: Levels,
    calibrations: Mapping[str, SensorCalibration],
    truth: Truth,
    dots: BoolImage | None = None,
) -> list[DecodedImage]:
    """Decode and score an image by every given colour map and every integration.

    Parameters
    ----------
    dots : (row, col) bool, pixels of printed dots, see `PhotometricDecoder.decode`

    Returns
    -------
    list of DecodedImage
        One result per decoder, sorted by colour map, then by integration.

    Raises
    ------
    FitError : no pixel within `photometric.field` has a height
    """
    return [
        decode_one(experiment, image, calibrations[kind.name], scheme.name, truth, dots=dots)
        for kind in maps_in_order()
        if kind.name in calibrations
        for scheme in schemes_in_order()
    ]


def decode_one(
    experiment: Experiment,
    image: Levels,
    calibration: SensorCalibration,
    integration: str,
    truth: Truth,
    *,
    dots: BoolImage | None = None,
) -> DecodedImage:
    """Decode and score an image by the calibration's colour map and a named integration.

    Parameters
    ----------
    dots : (row, col) bool, pixels of printed dots, see `PhotometricDecoder.decode`

    Raises
    ------
    FitError : no pixel within `photometric.field` has a height
    """
    options = PhotometricOptions(integration=integration)
    heights = PhotometricDecoder(calibration, options).decode(image, dots)
    kind = calibration.colour_map.name
    return DecodedImage(kind, integration, heights, score_heights(experiment, heights, truth))


def chosen(experiment: Experiment, decoded: list[DecodedImage]) -> DecodedImage:
    """Return the image as decoded by the decoder that the experiment selects."""
    scheme = experiment.photometric.colour_map, experiment.photometric.integration
    return next(image for image in decoded if (image.colour_map, image.integration) == scheme)


def decoder_name(image: DecodedImage) -> str:
    """Return the name of a decoder for plots and tables."""
    return f"{COLOUR_MAPS[image.colour_map].title}, {SCHEMES[image.integration].title}"
