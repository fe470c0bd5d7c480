"""Colour points by height deviation or intensity, for viewers that read vertex colours."""

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import BoolImage, FloatImage, Levels

UNKNOWN = 128
"""Grey level of points whose deviation is not known."""


class Deviation:
    """Deviation of each pixel, measured minus true height, and the colour that shows it.

    Attributes
    ----------
    um : (row, col) float32, deviation in um; 0 where it is unknown
    known : (row, col) bool, whether the deviation of the pixel is known
    limit_um : smallest |deviation| with the full colour: the 99th percentile of |deviation|, or 1
        if all known deviations are 0
    """

    def __init__(self, um: NDArray[Any], known: BoolImage) -> None:
        self.known = np.asarray(known)
        self.um: FloatImage = np.where(self.known, um, 0.0).astype(np.float32)
        magnitude = np.abs(self.um[self.known])
        self.limit_um = float(np.percentile(magnitude, 99.0)) if magnitude.any() else 1.0

    @cached_property
    def rgb(self) -> Levels:
        """Colours (row, col, rgb) uint8: blue below 0, white at 0, red above 0, grey if unknown."""
        share = np.clip(self.um / self.limit_um, -1.0, 1.0)
        levels = np.stack(
            (1.0 + np.minimum(share, 0.0), 1.0 - np.abs(share), 1.0 - np.maximum(share, 0.0)),
            axis=-1,
        )
        coloured = np.rint(255.0 * levels).astype(np.uint8)
        return np.where(self.known[..., np.newaxis], coloured, np.uint8(UNKNOWN))

    @property
    def legend(self) -> str:
        """One line of text that explains the colours, for the header of a file."""
        limit = f"{self.limit_um:.3g} um"
        return f"colour is deviation_um: blue -{limit}, white 0, red +{limit}, grey unknown"


class Intensity:
    """Mean pixel value of each pixel, and the grey level that shows it.

    Attributes
    ----------
    dn : (row, col) float32, mean pixel value, DN; read at the pixels with a point only
    white_dn : smallest value that is shown white: the 99th percentile over the pixels with a point
    """

    def __init__(self, dn: NDArray[Any], known: BoolImage) -> None:
        self.dn: FloatImage = np.asarray(dn, np.float32)
        values = self.dn[known]
        self.white_dn = max(float(np.percentile(values, 99.0)), 1e-6) if len(values) else 1.0

    @cached_property
    def rgb(self) -> Levels:
        """Grey levels (row, col, rgb) uint8, three equal ones per pixel, proportional to `dn`."""
        share = np.clip(self.dn / self.white_dn, 0.0, 1.0)
        grey = np.rint(255.0 * share).astype(np.uint8)
        return np.repeat(grey[..., np.newaxis], 3, axis=-1)

    @property
    def legend(self) -> str:
        """One line of text that explains the colours, for the header of a file."""
        return f"colour is intensity_dn: black 0, white {self.white_dn:.4g} DN"
