"""Fit and apply maps from colour to slope: smooth polynomials, or the classic look-up table.

Polynomials in colour and position are fitted by ridge regression. q = level / background - 1 for
each colour channel, a quantity in which vignetting and albedo cancel. t = slope /
sqrt(1 + |slope|^2) is the tilt, the horizontal part of the unit normal. Then

    t = sum over a of q^a (sum over b of c_ab position^b),   1 <= |a| <= 3, |b| <= 3

with multi-indices a over the three channels and b over row and column. For Lambert's law and levels
proportional to the light, the tilt is linear in q (Woodham 1980, Optical Engineering 19, 139). The
higher terms model display gamma, soft shadows and crosstalk. The terms of the position model the
finite distance of the lamps. There is no term |a| = 0, so undeformed gel is flat for any
coefficients. The fit is in closed form, without random numbers: the same samples give the same
bytes.

The RGB look-up table has a mean slope for every bin of colour difference. It is built as described
for the published comparisons. Colours minus the background are assigned to bins, and the slopes of
the calibration pixels in a bin are averaged. Empty bins get the slope of the nearest filled bin.
The table depends on the position in the image only by the flat-field factor.
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
# Penalties of the ridge regression, for features of unit RMS. The penalty of terms in colour only
# is far below the noise of 8-bit levels. That of terms with the position is larger, so that a
# variation over the image is fitted only if the presses show it. Both were selected on held-out
# halves of 67 real presses: slope error 0.056 and 0.066; a perceptron with two hidden layers of
# 32 neurons has 0.058 and 0.067.
RIDGE = 1e-5
RIDGE_OF_PLACE = 1e-2
CHUNK = 8192
# Largest RMS residual of a map over the RMS of the fitted slopes. It is 0.02 to 0.15 for coloured
# images of balls; 0.6 and more for grey images, which show the steepness but not its direction.
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
# Colour differences are multiplied by 1 + 2 (mean / background - 1), published practice, here with
# the median, which printed dots do not change. The limit prevents large noise in dark corners.
LARGEST_FACTOR = 4.0


def _exponents(variables: int, lowest: int, highest: int) -> tuple[tuple[int, ...], ...]:
    """Return the terms of a polynomial in some variables, with total degrees lowest to highest.

    A term is the tuple of its factors: (0, 0, 2) means q0 q0 q2. A term without its last factor is
    an earlier term.
    """
    return tuple(
        factors
        for degree in range(lowest, highest + 1)
        for factors in combinations_with_replacement(range(variables), degree)
    )


COLOUR_TERMS = _exponents(3, 1, COLOUR_DEGREE)
PLACE_TERMS = _exponents(2, 0, PLACE_DEGREE)


@dataclass(frozen=True, eq=False)
class ColourPolynomial:
    """Colour map of fitted polynomials, see the module docstring.

    Parameters
    ----------
    coefficients : (2, colour term, place term) float, c_ab of the tilt downwards and to
        the right
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
        """Return the map with precomputed factors for images that have this background.

        Parameters
        ----------
        background : (row, col, 3) smoothed levels of the undeformed gel
        """
        rows, cols = background.shape[:2]
        places = np.indices((rows, cols), dtype=np.float64).reshape(2, -1).T
        terms = _products(_scaled(places, (rows, cols)), PLACE_TERMS)
        maps = np.einsum("oab,bn->oan", self.coefficients, terms).astype(np.float32)
        inverse = (1.0 / np.maximum(background, 1.0)).astype(np.float32)
        return BoundPolynomial(self, inverse, maps.reshape(2, -1, rows, cols))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays that a calibration file stores, by name."""
        return {
            "coefficients": self.coefficients,
            "lowest": self.lowest,
            "highest": self.highest,
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> "ColourPolynomial":
        """Return the map from stored arrays, see `arrays`; KeyError if an array is missing."""
        names = ("coefficients", "lowest", "highest")
        return cls(*(arrays[name].astype(np.float64) for name in names))


@dataclass(frozen=True, eq=False)
class BoundPolynomial:
    """Polynomial map with precomputed factors for one background.

    Attributes
    ----------
    polynomial : the map
    inverse_background : (row, col, 3) 1 / level of the background
    maps : (2, colour term, row, col) coefficients of the colour terms at each pixel
    """

    polynomial: ColourPolynomial
    inverse_background: FloatImage
    maps: FloatImage

    def slopes(self, levels: FloatImage) -> tuple[FloatImage, BoolImage]:
        """Return slopes (2, row, col), mm/mm, and a mask (row, col) of calibrated pixels.

        The mask is False for colours outside the range that the calibration covered.

        Parameters
        ----------
        levels : (row, col, 3) smoothed levels of an image
        """
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
    """Fit the polynomial map to the tilts of all samples.

    Parameters
    ----------
    shape : (row, col) shape of the images

    Raises
    ------
    FitError : there are fewer than two samples per coefficient, or the colours do not determine the
        slopes
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
    """Raise FitError if the RMS residual of a map exceeds 50 % of the RMS of the fitted slopes.

    Parameters
    ----------
    slopes, fitted : (n, 2) slopes or tilts of the samples, and those by the map
    """
    residual, whole = (np.sqrt(np.mean(part**2)) for part in (slopes - fitted, slopes))
    if not residual <= MOST_UNEXPLAINED * whole:
        raise FitError(
            f"the colours do not determine the slopes: {residual / whole:.0%} remain (RMS), "
            f"allowed {MOST_UNEXPLAINED:.0%}; give colour images under lamps of three colours from "
            "three sides, presses of the balls that are named, and the background of this sensor"
        )


def _ridge(q: FloatArray, places: FloatArray, tilt: FloatArray) -> FloatArray:
    """Return the coefficients of the ridge regression, (feature, 2), by normal equations.

    A feature is a product of a colour term and a place term. The sums are computed in chunks of
    samples to limit the memory.

    Parameters
    ----------
    q : (n, 3) colours
    places : (2, n) rows and columns, scaled to -1 to 1
    tilt : (n, 2)
    """
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
    """Return rows and columns of pixels (n, 2), scaled to -1 to 1 over the image, as (2, n)."""
    size = np.array(shape, dtype=np.float64) - 1.0
    return np.asarray((2.0 * places_px / size - 1.0).T)


def _products(variables: NDArray[Any], terms: tuple[tuple[int, ...], ...]) -> NDArray[Any]:
    """Return the values of polynomial terms, (term, ...), for variables (variable, ...)."""
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
    """Colour map as a look-up table over bins of colour difference, see the module docstring.

    Parameters
    ----------
    slopes : (red, green, blue, 2) float32, 90 bins per colour; slopes downwards and to
        the right, mm/mm
    known : (red, green, blue) bool, True for bins with calibration pixels or near such bins
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
        """Return the map with precomputed factors for images that have this background.

        Parameters
        ----------
        background : (row, col, 3) smoothed levels of the undeformed gel
        """
        return BoundTable(self, background, _flat_field(background))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays that a calibration file stores, by name."""
        return {"slopes": self.slopes, "known": self.known}

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


def fit_table(samples: Samples, background: FloatImage) -> ColourTable:
    """Return a look-up table: mean slopes per bin; empty bins get those of the nearest filled bin.

    Parameters
    ----------
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
    """Return the index in the flattened table, (...,), of colour differences, (..., 3) levels."""
    index = ((difference - LOWEST_LEVELS) * (1.0 / LEVELS_PER_BIN)).astype(np.int32)
    np.clip(index, 0, BINS - 1, out=index)
    flat: NDArray[np.int32] = (index[..., 0] * BINS + index[..., 1]) * BINS + index[..., 2]
    return flat
