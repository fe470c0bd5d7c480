"""Colour map as the classic RGB look-up table: a mean slope for every bin of colour difference.

It is built as described for the published comparisons. Colours minus the background are assigned to
bins, and the slopes of the calibration pixels in a bin are averaged. Empty bins get the slope of
the nearest filled bin. The table depends on the position in the image only by the flat-field
factor.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from reconstruction.arrays import BoolImage, FloatImage
from reconstruction.colour_maps import COLOUR_MAPS, ColourMap, Samples, require_explained
from reconstruction.errors import CaptureError

# Published practice: 90 bins per channel over differences of [-90, 90) levels; an empty bin counts
# as calibrated within a squared distance of 20 bins from a filled one.
BINS = 90
LOWEST_LEVELS = -90.0
LEVELS_PER_BIN = 2.0
FILL_DISTANCE = np.sqrt(20.0)
# Colour differences are multiplied by 1 + 2 (mean / background - 1), published practice, here with
# the median, which printed dots do not change. The limit prevents large noise in dark corners.
LARGEST_FACTOR = 4.0


@COLOUR_MAPS.register
@dataclass(frozen=True, eq=False)
class ColourTable(ColourMap):
    """Colour map as a look-up table over bins of colour difference, see the module docstring.

    Parameters
    ----------
    slopes : (red, green, blue, 2) float32, 90 bins per colour; slopes downwards and to
        the right, mm/mm
    known : (red, green, blue) bool, True for bins with calibration pixels or near such bins
    """

    name: ClassVar[str] = "table"
    title: ClassVar[str] = "look-up table"
    summary: ClassVar[str] = "mean slope per bin of colour difference, the same for all pixels"
    rank: ClassVar[int] = 1

    slopes: FloatImage
    known: BoolImage

    def __post_init__(self) -> None:
        shape = (BINS, BINS, BINS)
        if self.slopes.shape != (*shape, 2) or self.known.shape != shape:
            raise CaptureError(
                f"colour table has shapes {self.slopes.shape} and {self.known.shape}; it needs "
                f"{(*shape, 2)} and {shape}"
            )
        if not bool(np.all(np.isfinite(self.slopes))) or self.known.dtype != np.bool_:
            raise CaptureError("colour table holds slopes that are not finite or no flags")

    @classmethod
    def fit(cls, samples: Samples, background: FloatImage) -> "ColourTable":
        """Return a look-up table of mean slopes per bin of colour difference.

        Empty bins get the slopes of the nearest filled bin.

        Parameters
        ----------
        samples : pixels of the calibration images
        background : (row, col, 3) smoothed levels of the undeformed gel

        Raises
        ------
        FitError : the colours do not determine the slopes
        """
        row, col = samples.places_px.astype(np.intp).T
        factor = _flat_field(background)[row, col]
        bins = _flat_bins((samples.levels - samples.background) * factor)
        count = np.bincount(bins, minlength=BINS**3)
        sums = [np.bincount(bins, weights=s, minlength=BINS**3) for s in samples.slopes.T]
        mean = np.stack(sums, axis=-1) / np.maximum(count, 1)[:, np.newaxis]
        require_explained(samples.slopes, mean[bins])
        empty = (count == 0).reshape(BINS, BINS, BINS)
        distance, nearest = distance_transform_edt(empty, return_indices=True)
        filled = mean.reshape(BINS, BINS, BINS, 2)[tuple(nearest)]
        return cls(filled.astype(np.float32), distance <= FILL_DISTANCE)

    def bound_to(self, background: FloatImage) -> "BoundTable":
        """Return the map with precomputed factors for images that have this background.

        Parameters
        ----------
        background : (row, col, 3) smoothed levels of the undeformed gel
        """
        return BoundTable(self, background, _flat_field(background))

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> "ColourTable":
        """Return the map from stored arrays, see `arrays`; KeyError if an array is missing."""
        return cls(arrays["slopes"].astype(np.float32), arrays["known"])


@dataclass(frozen=True, eq=False)
class BoundTable:
    """Look-up table with the flat-field factor for one background.

    Attributes
    ----------
    table : the map
    background : (row, col, 3) smoothed levels of the undeformed gel
    factor : (row, col, 3) factor of the colour difference, larger where the background is dark
    """

    table: ColourTable
    background: FloatImage
    factor: FloatImage

    def slopes(self, levels: FloatImage) -> tuple[FloatImage, BoolImage]:
        """Return slopes (2, row, col), mm/mm, and a mask (row, col) of calibrated pixels.

        The mask is False for colours in bins that are not near any calibration pixel.

        Parameters
        ----------
        levels : (row, col, 3) smoothed levels of an image
        """
        bins = _flat_bins((levels - self.background) * self.factor)
        slopes = self.table.slopes.reshape(-1, 2)[bins]
        known: BoolImage = self.table.known.ravel()[bins]
        return np.moveaxis(slopes, -1, 0), known


def _flat_field(background: FloatImage) -> FloatImage:
    typical = np.median(background, axis=(0, 1), keepdims=True)
    factor = 1.0 + 2.0 * (typical / np.maximum(background, 1.0) - 1.0)
    clipped: FloatImage = np.clip(factor, 1.0 / LARGEST_FACTOR, LARGEST_FACTOR)
    return clipped.astype(np.float32)


def _flat_bins(difference: FloatImage) -> NDArray[np.int32]:
    """Return the index in the flattened table, (...,), of colour differences, (..., 3) levels."""
    index = ((difference - LOWEST_LEVELS) * (1.0 / LEVELS_PER_BIN)).astype(np.int32)
    np.clip(index, 0, BINS - 1, out=index)
    flat: NDArray[np.int32] = (index[..., 0] * BINS + index[..., 1]) * BINS + index[..., 2]
    return flat
