"""Colour map of polynomials in colour and position, fitted by ridge regression.

q = level / background - 1 for each colour channel, a quantity in which vignetting and albedo
cancel. t = slope / sqrt(1 + |slope|^2) is the tilt, the horizontal part of the unit normal. Then

    t = sum over a of q^a (sum over b of c_ab position^b),   1 <= |a| <= 3, |b| <= 3

with multi-indices a over the three channels and b over row and column. For Lambert's law and levels
proportional to the light, the tilt is linear in q (Woodham 1980, Optical Engineering 19, 139). The
higher terms model display gamma, soft shadows and crosstalk. The terms of the position model the
finite distance of the lamps. There is no term |a| = 0, so undeformed gel is flat for any
coefficients. The fit is in closed form, without random numbers: the same samples give the same
bytes.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from reconstruction.arrays import BoolImage, FloatArray, FloatImage
from reconstruction.colour_maps import COLOUR_MAPS, ColourMap, Samples, require_explained
from reconstruction.errors import CaptureError, FitError

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
# Margin around the calibrated range of colours, as a share of it.
SLACK = 0.1
RANGE_PERCENT = (0.05, 99.95)
# Largest horizontal part of a unit normal: slope 3.
LARGEST_TILT = 0.95


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


@COLOUR_MAPS.register
@dataclass(frozen=True, eq=False)
class ColourPolynomial(ColourMap):
    """Colour map of fitted polynomials, see the module docstring.

    Parameters
    ----------
    coefficients : (2, colour term, place term) float, c_ab of the tilt downwards and to
        the right
    lowest, highest : (3,) float, range of q that the calibration covered
    """

    name: ClassVar[str] = "polynomial"
    title: ClassVar[str] = "polynomial"
    summary: ClassVar[str] = "ridge regression in colour and place"
    rank: ClassVar[int] = 0

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

    @classmethod
    def fit(cls, samples: Samples, background: FloatImage) -> "ColourPolynomial":
        """Fit the polynomial map to the tilts of all samples.

        Parameters
        ----------
        samples : pixels of the calibration images
        background : (row, col, 3) smoothed levels of the undeformed gel; only its shape is used

        Raises
        ------
        FitError : there are fewer than two samples per coefficient, or the colours do not determine
            the slopes
        """
        unknowns = len(COLOUR_TERMS) * len(PLACE_TERMS)
        if len(samples.slopes) < 2 * unknowns:
            raise FitError(
                f"{len(samples.slopes)} calibration pixels for {unknowns} coefficients; give more "
                "or deeper presses, spread over the field"
            )
        q = samples.levels / np.maximum(samples.background, 1.0) - 1.0
        places = _scaled(samples.places_px, (background.shape[0], background.shape[1]))
        coefficients = _fitted(q.astype(np.float64), places, _tilt_of_slopes(samples.slopes))
        low, high = np.percentile(q, RANGE_PERCENT, axis=0)
        slack = SLACK * (high - low)
        return cls(coefficients, low - slack, high + slack)

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


def _fitted(q: FloatArray, places: FloatArray, tilt: FloatArray) -> FloatArray:
    """Return the coefficients (2, colour term, place term) of the tilt.

    Parameters
    ----------
    q : (n, 3) colours
    places : (2, n) rows and columns, scaled to -1 to 1
    tilt : (n, 2)

    Raises
    ------
    FitError : the colours do not determine the tilts
    """
    shape = (2, len(COLOUR_TERMS), len(PLACE_TERMS))
    coefficients = _ridge(q, places, tilt).T.reshape(shape)
    terms = _products(q.T, COLOUR_TERMS), _products(places, PLACE_TERMS)
    fitted = [np.sum(terms[0] * (own @ terms[1]), axis=0) for own in coefficients]
    require_explained(tilt, np.stack(fitted, axis=-1))
    return coefficients


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


def _tilt_of_slopes(slopes: FloatArray) -> FloatArray:
    square = np.sum(slopes**2, axis=1, keepdims=True)
    return np.asarray(slopes / np.sqrt(1.0 + square))


def _slopes_of_tilt(tilt: FloatImage) -> FloatImage:
    square = np.minimum(np.sum(tilt**2, axis=0), np.float32(LARGEST_TILT**2))
    return np.asarray(tilt / np.sqrt(np.float32(1.0) - square))
