"""A colour map as a plug-in: mean slope of the nearest colours (Cover and Hart 1967)."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from reconstruction.colour_maps import COLOUR_MAPS, ColourMap, require_explained
from reconstruction.errors import FitError

NEIGHBOURS = 8
LARGEST_DISTANCE = 0.1  # of a calibrated colour from the nearest sample, in level / background


@COLOUR_MAPS.register
@dataclass(frozen=True, eq=False)
class NearestColours(ColourMap):
    """Colours (n, 3), level / background, and slopes (n, 2) of the calibration pixels."""

    name, title = "nearest", "nearest colours"
    summary = "mean slope of the eight nearest calibration colours, the same for all pixels"

    colours: np.ndarray
    slopes: np.ndarray

    def __post_init__(self):
        count = max(NEIGHBOURS, len(self.colours))
        if self.colours.shape != (count, 3) or self.slopes.shape != (count, 2):
            shapes = f"{self.colours.shape} and {self.slopes.shape}"
            raise FitError(f"nearest colours: found {shapes}, allowed (n, 3) and (n, 2), n > 7")

    @classmethod
    def fit(cls, samples, background):
        """Return the map of all samples."""
        own = cls(samples.levels / np.maximum(samples.background, 1.0), samples.slopes)
        require_explained(own.slopes, own.nearest(own.colours)[0])
        return own

    def nearest(self, colours):
        """Return slopes (..., 2) of colours (..., 3), and whether these are calibrated."""
        distance, number = KDTree(self.colours).query(colours, NEIGHBOURS)
        return self.slopes[number].mean(axis=-2), distance[..., 0] < LARGEST_DISTANCE

    def bound_to(self, background):
        """Return the map for images of one background."""
        return BoundColours(self, background)


@dataclass(frozen=True)
class BoundColours:
    """Map and background (row, col, 3)."""

    colour_map: NearestColours
    background: np.ndarray

    def slopes(self, levels):
        """Return slopes (2, row, col) of smoothed levels (row, col, 3), and whether calibrated."""
        slopes, known = self.colour_map.nearest(levels / np.maximum(self.background, 1.0))
        return np.moveaxis(slopes, -1, 0), known
