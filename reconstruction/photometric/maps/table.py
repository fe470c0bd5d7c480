"""The classic RGB look-up table: a mean slope for every bin of colour difference.

As described for the published comparisons: colours minus the background are put in bins, the
slopes of calibration pixels in a bin are averaged, empty bins get those of the nearest filled bin.
The table depends on the place in the image only by the flat-field factor.
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
# Weak background is amplified by 1 + 2 (mean / background - 1), published practice, here with the
# median, which printed dots do not shift; the limit prevents noise in a dark corner.
LARGEST_FACTOR = 4.0


@COLOUR_MAPS.register
@dataclass(frozen=True, eq=False)
class ColourTable(ColourMap):
    """Look-up table.

    Parameters
    ----------
    slopes : (red, green, blue, 2) float32, 90 bins each, mm/mm along rows and along columns
    known : (red, green, blue) bool, bins that calibration pixels reached or nearly reached
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
        """Average the slopes of each bin and fill the empty ones from the nearest filled bin.

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
        """Return the table with the factors that depend on the background only."""
        return BoundTable(self, background, _flat_field(background))

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> "ColourTable":
        """Rebuild from stored arrays; KeyError if one is missing."""
        return cls(arrays["slopes"].astype(np.float32), arrays["known"])


@dataclass(frozen=True, eq=False)
class BoundTable:
    """Table, background and its flat-field factor, (row, col, 3)."""

    table: ColourTable
    background: FloatImage
    factor: FloatImage

    def slopes(self, levels: FloatImage) -> tuple[FloatImage, BoolImage]:
        """Return slopes (2, row, col) of smoothed levels (row, col, 3), and whether known."""
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
    """Return the index of each colour in the flattened table, (...,) from (..., 3)."""
    index = ((difference - LOWEST_LEVELS) * (1.0 / LEVELS_PER_BIN)).astype(np.int32)
    np.clip(index, 0, BINS - 1, out=index)
    flat: NDArray[np.int32] = (index[..., 0] * BINS + index[..., 1]) * BINS + index[..., 2]
    return flat
