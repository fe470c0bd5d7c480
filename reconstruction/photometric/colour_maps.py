"""Maps from colour to slope: smooth polynomials, or the classic look-up table.

Polynomials in colour and place are fitted by ridge regression. With q = level / background - 1 per
channel (vignetting and albedo cancel) and the tilt t = slope / sqrt(1 + |slope|^2), the horizontal
part of the unit normal:

    t = sum over a of q^a (sum over b of c_ab place^b),   1 <= |a| <= 3, |b| <= 3

For Lambert's law and linear light the tilt is linear in q (Woodham 1980, Optical Engineering 19,
139). The higher terms model display gamma, soft shadows and crosstalk; the place models the finite
distance of the lamps. Without a term |a| = 0 undeformed gel is flat for any coefficients.
The fit is in closed form: the same samples give the same bytes, without tuning.

The RGB look-up table has a mean slope for every bin of colour difference. As described for the
published comparisons: colours minus the background are put in bins, the slopes of calibration
pixels in a bin are averaged, empty bins get those of the nearest filled bin. The table depends on
the place in the image only by the flat-field factor.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.ndimage import distance_transform_edt

from reconstruction.arrays import BoolImage, FloatArray, FloatImage
from reconstruction.errors import CaptureError, FitError
from reconstruction.photometric.calibration_ball import Samples

COLOUR_DEGREE = 3
PLACE_DEGREE = 3
# Relative to features of unit RMS. The penalty of terms in colour only is far below the noise of
# 8-bit levels. That of their variation over the image is larger, so that only variation shown by
# the presses is fitted. Chosen on held-out halves of 67 real presses: slope error 0.056 and 0.066;
# a perceptron with two hidden layers of 32 has 0.058 and 0.067.
RIDGE = 1e-5
RIDGE_OF_PLACE = 1e-2
CHUNK = 8192
# Residual of a map for the slopes it was fitted to, over their RMS: 0.02 to 0.15 for shaded
# balls; 0.6 and more for grey images, which show the steepness of gel but not its direction.
MOST_UNEXPLAINED = 0.5
# Margin around the calibrated range of colours, as a share of it.
SLACK = 0.1
RANGE_PERCENT = (0.05, 99.95)
# Largest horizontal part of a unit normal: slope 3.
LARGEST_TILT = 0.95
# Published practice: 90 bins per channel over differences of [-90, 90) levels; an empty bin counts
# as calibrated within a squared distance of 20 bins from a filled one.
BINS = 90
LOWEST_LEVELS = -90.0
LEVELS_PER_BIN = 2.0
FILL_DISTANCE = np.sqrt(20.0)
# Weak background is amplified by 1 + 2 (mean / background - 1), published practice, here with the
# median, which printed dots do not shift; the limit prevents noise in a dark corner.
LARGEST_FACTOR = 4.0


def _exponents(variables: int, lowest: int, highest: int) -> tuple[tuple[int, ...], ...]:
    """Return factor lists: (0, 0, 2) means q0 q0 q2; each extends an earlier one."""
    return tuple(
        factors
        for degree in range(lowest, highest + 1)
        for factors in combinations_with_replacement(range(variables), degree)
    )


COLOUR_TERMS = _exponents(3, 1, COLOUR_DEGREE)
PLACE_TERMS = _exponents(2, 0, PLACE_DEGREE)


@dataclass(frozen=True, eq=False)
class ColourPolynomial:
    """Fitted polynomials.

    Parameters
    ----------
    coefficients : (2, colour term, place term) float, of the tilt along rows and along columns
    lowest, highest : (3,) float, range of q that the calibration covered
    """

    coefficients: FloatArray
    lowest: FloatArray
    highest: FloatArray

    def __post_init__(self) -> None:
        shape = (2, len(COLOUR_TERMS), len(PLACE_TERMS))
        if self.coefficients.shape != shape:
            raise CaptureError(
                f"colour polynomial has coefficients {self.coefficients.shape}; it needs {shape}"
            )
        values = (self.coefficients, self.lowest, self.highest)
        if self.lowest.shape != (3,) or self.highest.shape != (3,):
            raise CaptureError("colour polynomial needs the range of three channels")
        if not all(bool(np.all(np.isfinite(value))) for value in values):
            raise CaptureError("colour polynomial holds numbers that are not finite")
        if not bool(np.all(self.lowest < self.highest)):
            raise CaptureError("colour polynomial has an empty range of colours")

    def bound_to(self, background: FloatImage) -> "BoundPolynomial":
        """Return the polynomial with the factors that depend on the background only."""
        rows, cols = background.shape[:2]
        places = np.indices((rows, cols), dtype=np.float64).reshape(2, -1).T
        terms = _products(_scaled(places, (rows, cols)), PLACE_TERMS)
        maps = np.einsum("oab,bn->oan", self.coefficients, terms).astype(np.float32)
        inverse = (1.0 / np.maximum(background, 1.0)).astype(np.float32)
        return BoundPolynomial(self, inverse, maps.reshape(2, -1, rows, cols))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays to store."""
        return {
            "coefficients": self.coefficients,
            "lowest": self.lowest,
            "highest": self.highest,
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> "ColourPolynomial":
        """Rebuild from stored arrays; KeyError if one is missing."""
        names = ("coefficients", "lowest", "highest")
        return cls(*(arrays[name].astype(np.float64) for name in names))


@dataclass(frozen=True, eq=False)
class BoundPolynomial:
    """Polynomial, 1 / background (row, col, 3), coefficients per pixel (2, term, row, col)."""

    polynomial: ColourPolynomial
    inverse_background: FloatImage
    maps: FloatImage

    def slopes(self, levels: FloatImage) -> tuple[FloatImage, BoolImage]:
        """Return slopes (2, row, col) of smoothed levels (row, col, 3), and whether known."""
        q = np.moveaxis(levels * self.inverse_background - np.float32(1.0), -1, 0)
        lowest, highest = (
            bound.astype(np.float32)[:, np.newaxis, np.newaxis]
            for bound in (self.polynomial.lowest, self.polynomial.highest)
        )
        clipped = np.clip(q, lowest, highest)
        known = np.all(clipped == q, axis=0)
        terms = _products(clipped, COLOUR_TERMS)
        tilt = np.einsum("arc,oarc->orc", terms, self.maps)
        return _slopes_of_tilt(tilt), known


def fit_polynomial(samples: Samples, shape: tuple[int, int]) -> ColourPolynomial:
    """Fit the tilts of all samples; `shape` is that of the images, (row, col).

    Raises
    ------
    FitError : fewer samples than coefficients, or the colours do not determine the slopes
    """
    unknowns = len(COLOUR_TERMS) * len(PLACE_TERMS)
    if len(samples.slopes) < 2 * unknowns:
        raise FitError(
            f"{len(samples.slopes)} calibration pixels for {unknowns} coefficients; give more "
            "or deeper presses, spread over the field"
        )
    q = samples.levels / np.maximum(samples.background, 1.0) - 1.0
    square = np.sum(samples.slopes**2, axis=1, keepdims=True)
    tilt = samples.slopes / np.sqrt(1.0 + square)
    colours, places = q.astype(np.float64), _scaled(samples.places_px, shape)
    solution = _ridge(colours, places, tilt)
    low, high = np.percentile(q, RANGE_PERCENT, axis=0)
    slack = SLACK * (high - low)
    coefficients = solution.T.reshape(2, len(COLOUR_TERMS), len(PLACE_TERMS))
    terms = _products(colours.T, COLOUR_TERMS), _products(places, PLACE_TERMS)
    fitted = [np.sum(terms[0] * (own @ terms[1]), axis=0) for own in coefficients]
    _require_explained(tilt, np.stack(fitted, axis=-1))
    return ColourPolynomial(coefficients, low - slack, high + slack)


def _require_explained(slopes: FloatArray, fitted: FloatArray) -> None:
    """Raise FitError if a map's residual exceeds 50 % of the slopes (n, 2) it was fitted to."""
    residual, whole = (np.sqrt(np.mean(part**2)) for part in (slopes - fitted, slopes))
    if not residual <= MOST_UNEXPLAINED * whole:
        raise FitError(
            f"the colours do not determine the slopes: {residual / whole:.0%} remain (RMS), "
            f"allowed {MOST_UNEXPLAINED:.0%}; give colour images under lamps of three colours from "
            "three sides, presses of the balls that are named, and the background of this sensor"
        )


def _ridge(q: FloatArray, places: FloatArray, tilt: FloatArray) -> FloatArray:
    """Return the ridge solution, (feature, 2), from normal equations summed in chunks."""
    size = len(COLOUR_TERMS) * len(PLACE_TERMS)
    normal, right = np.zeros((size, size)), np.zeros((size, 2))
    for first in range(0, len(q), CHUNK):
        part = slice(first, first + CHUNK)
        colour = _products(q[part].T, COLOUR_TERMS)
        place = _products(places[:, part], PLACE_TERMS)
        features = (colour[:, np.newaxis] * place).reshape(size, -1)
        normal += features @ features.T
        right += features @ tilt[part]
    scale = np.sqrt(np.diag(normal) / len(q))
    of_place = [RIDGE if not place else RIDGE_OF_PLACE for place in PLACE_TERMS]
    penalties = np.tile(of_place, len(COLOUR_TERMS))
    system = normal / np.outer(scale, scale) / len(q) + np.diag(penalties)
    solved = cho_solve(cho_factor(system), right / scale[:, np.newaxis] / len(q))
    return np.asarray(solved / scale[:, np.newaxis])


def _scaled(places_px: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Return rows and columns as numbers from -1 to 1, (2, n)."""
    size = np.array(shape, dtype=np.float64) - 1.0
    return np.asarray((2.0 * places_px / size - 1.0).T)


def _products(variables: NDArray[Any], terms: tuple[tuple[int, ...], ...]) -> NDArray[Any]:
    """Return the product of each list of factors, (term, ...) from (variable, ...)."""
    values: dict[tuple[int, ...], NDArray[Any]] = {(): np.ones_like(variables[0])}
    for factors in terms:
        if factors:
            before = values.get(factors[:-1])
            values[factors] = variables[factors[-1]] * (1.0 if before is None else before)
    return np.stack([values[factors] for factors in terms])


def _slopes_of_tilt(tilt: FloatImage) -> FloatImage:
    square = np.minimum(np.sum(tilt**2, axis=0), np.float32(LARGEST_TILT**2))
    return np.asarray(tilt / np.sqrt(np.float32(1.0) - square))


@dataclass(frozen=True, eq=False)
class ColourTable:
    """Look-up table.

    Parameters
    ----------
    slopes : (red, green, blue, 2) float32, 90 bins each, mm/mm along rows and along columns
    known : (red, green, blue) bool, bins that calibration pixels reached or nearly reached
    """

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

    def bound_to(self, background: FloatImage) -> "BoundTable":
        """Return the table with the factors that depend on the background only."""
        return BoundTable(self, background, _flat_field(background))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays to store."""
        return {"slopes": self.slopes, "known": self.known}

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


def fit_table(samples: Samples, background: FloatImage) -> ColourTable:
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
    _require_explained(samples.slopes, mean[bins])
    empty = (count == 0).reshape(BINS, BINS, BINS)
    distance, nearest = distance_transform_edt(empty, return_indices=True)
    filled = mean.reshape(BINS, BINS, BINS, 2)[tuple(nearest)]
    return ColourTable(filled.astype(np.float32), distance <= FILL_DISTANCE)


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
