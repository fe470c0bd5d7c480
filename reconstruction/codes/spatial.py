"""Spatial unwrapping: one fringe period, whose orders follow from neighbouring pixels.

The orders are relative to an island of continuous phase. One reference for each island makes them
absolute: a marked pixel, a plane of known depth, or the epipolar line. See `spatial_unwrapping`.
"""

import numpy as np
from scipy import ndimage

from reconstruction.arrays import FloatArray
from reconstruction.codes import CODES, Expected, Ordered, PatternCode, Wrapped
from reconstruction.errors import InputError
from reconstruction.spatial_unwrapping import Labels, SpatialOrders, unwrap_spatially

# Least sigma of a reference, turns, so that the probability is finite.
LEAST_SIGMA = 1e-3


class SpatialCode(PatternCode):
    """Pattern code without words: fringe orders by quality-guided spatial unwrapping."""

    name = "spatial"
    title = "spatial unwrapping"
    summary = "one period, continuous surfaces; orders are relative without [decode] reference"
    numbers_pixels = False

    def unwrap(self, wrapped: Wrapped) -> Ordered:
        """Return coordinates, probability of a wrong order, and islands.

        Raises
        ------
        InputError : there is no reference, no pixel of an island is known, or two marked pixels of
            one island contradict each other
        """
        if wrapped.expected is None:
            raise InputError(
                "patterns code 'spatial' numbers fringes relative to their neighbours; give"
                " [decode] reference_pixels, or reference_z_mm for a calibrated capture"
            )
        sigma = wrapped.sigma_rad[0] / (2.0 * np.pi)
        join = wrapped.expected.islands == "join"
        relative = unwrap_spatially(wrapped.turns[0], sigma, wrapped.usable, join=join)
        offset, error = _offsets(wrapped, relative, wrapped.expected)
        order = relative.orders + offset[relative.islands]
        order = np.where(relative.consistent, order, np.nan)
        return Ordered(wrapped.coordinate_px(order), error[relative.islands], relative.islands)


def _offsets(
    wrapped: Wrapped, relative: SpatialOrders, expected: Expected
) -> tuple[FloatArray, FloatArray]:
    """Return the order to add for each island number, NaN if unknown, and its error probability."""
    period_px = wrapped.fringes.period_px
    rest = expected.coordinate_px / period_px - wrapped.turns[0] - relative.orders
    known = np.isfinite(rest) & relative.consistent
    labels = np.where(known, relative.islands, 0)
    count = int(relative.islands.max())
    offset, error = np.full(count + 1, np.nan), np.ones(count + 1)
    numbers = _numbered(labels, expected)
    if not numbers.size:
        raise InputError(
            "decode reference: no pixel with a known coordinate is in an island of continuous"
            " phase; give another reference pixel"
        )
    if expected.is_exact:
        _require_agreement(rest, labels, numbers)
    middle = np.asarray(ndimage.median(rest, labels, numbers))
    sigma = np.asarray(ndimage.median(expected.sigma_px / period_px, labels, numbers))
    offset[numbers] = np.rint(middle)
    error[numbers] = _wrong(np.abs(middle - np.rint(middle)), np.maximum(sigma, LEAST_SIGMA))
    return offset, error


def _numbered(labels: Labels, expected: Expected) -> Labels:
    """Return the numbers of the islands that the reference applies to."""
    numbers = np.unique(labels[labels > 0])
    return numbers[:1] if expected.islands == "mask" and not expected.is_exact else numbers


def _require_agreement(rest: FloatArray, labels: Labels, numbers: Labels) -> None:
    spread = np.asarray(ndimage.maximum(rest, labels, numbers)) - ndimage.minimum(
        rest, labels, numbers
    )
    if np.max(spread) > 0.5:
        raise InputError(
            f"decode reference_pixels: two pixels of one island differ by {np.max(spread):.3g}"
            " periods from its phase; correct one, or the surface has a jump between them"
        )


def _wrong(off: FloatArray, sigma: FloatArray) -> FloatArray:
    """Return the probability that not the nearest whole number is correct but a neighbour of it.

    off, sigma : distance from the nearest whole number, and its standard deviation; both in turns
    """
    below, above = (1.0 - 2.0 * off) / (2.0 * sigma**2), (1.0 + 2.0 * off) / (2.0 * sigma**2)
    wrong = np.exp(-below) + np.exp(-above)
    return np.asarray(wrong / (1.0 + wrong))


CODES.register(SpatialCode())
