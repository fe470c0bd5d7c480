"""Deviations as colours of points, for viewers that read vertex colours."""

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import BoolImage, FloatImage, Levels

UNKNOWN = 128
"""Grey level of points whose deviation is not known."""


class Deviation:
    """Measured minus true height, where the true height is known, and its colour.

    Attributes
    ----------
    um : (row, col) float32; 0 where the deviation is unknown
    known : (row, col) bool
    limit_um : deviations as large as this or larger have the full colour
    """

    def __init__(self, um: NDArray[Any], known: BoolImage) -> None:
        self.known = np.asarray(known)
        self.um: FloatImage = np.where(self.known, um, 0.0).astype(np.float32)
        magnitude = np.abs(self.um[self.known])
        self.limit_um = float(np.percentile(magnitude, 99.0)) if magnitude.any() else 1.0

    @cached_property
    def rgb(self) -> Levels:
        """(row, col, 3) uint8: blue below, white at 0, red above, grey where it is unknown."""
        share = np.clip(self.um / self.limit_um, -1.0, 1.0)
        levels = np.stack(
            (1.0 + np.minimum(share, 0.0), 1.0 - np.abs(share), 1.0 - np.maximum(share, 0.0)),
            axis=-1,
        )
        coloured = np.rint(255.0 * levels).astype(np.uint8)
        return np.where(self.known[..., np.newaxis], coloured, np.uint8(UNKNOWN))

    @property
    def legend(self) -> str:
        """Meaning of the colours, for the header of a file."""
        limit = f"{self.limit_um:.3g} um"
        return f"colour is deviation_um: blue -{limit}, white 0, red +{limit}, grey unknown"
