"""Colour maps of photometric stereo: from the colours of a pixel to its slopes. One map per module.

A map is a file of `reconstruction.photometric.maps`, of an installed package (entry points of the
group `fringe_twin.colour_maps`) or of the user (`--plugin`): a class whose instances are fitted to
the calibration presses of one sensor. Minimal example, linear in the colour difference:

    @COLOUR_MAPS.register
    @dataclass(frozen=True, eq=False)
    class Linear(ColourMap):
        matrix: FloatArray
        name, title, summary = "linear", "linear", "least squares, the same for all pixels"

        @classmethod
        def fit(cls, samples, background):
            difference = samples.levels - samples.background
            return cls(np.linalg.lstsq(difference, samples.slopes)[0])

        def bound_to(self, background):
            return BoundLinear(self.matrix, background)  # has the method `slopes`

Frame: row 0 is at the top. The two slopes are downwards and to the right, mm/mm.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import BoolImage, FloatArray, FloatImage
from reconstruction.errors import FitError, InputError
from reconstruction.registry import Registry

DEFAULT_MAP = "polynomial"
# Largest RMS residual of a map over the RMS of the fitted slopes. It is 0.02 to 0.15 for coloured
# images of balls; 0.6 and more for grey images, which show the steepness but not its direction.
MOST_UNEXPLAINED = 0.5


@dataclass(frozen=True, eq=False)
class Samples:
    """Colours and slopes of n pixels of the calibration images, to which a colour map is fitted.

    Parameters
    ----------
    levels : (n, 3) float32, smoothed 8-bit levels, red first
    background : (n, 3) float32, levels of the undeformed gel at the same pixels
    places_px : (n, 2) float, row and column
    slopes : (n, 2) float, mm/mm, downwards and to the right
    """

    levels: FloatImage
    background: FloatImage
    places_px: FloatArray
    slopes: FloatArray


class BoundMap(Protocol):
    """A colour map with precomputed factors for images that have one background."""

    def slopes(self, levels: FloatImage) -> tuple[FloatImage, BoolImage]:
        """Return slopes (2, row, col), mm/mm, and a mask (row, col) of calibrated pixels.

        Parameters
        ----------
        levels : (row, col, 3) smoothed levels of an image
        """
        ...


class ColourMap(Protocol):
    """A colour map that was fitted to the calibration presses of one sensor.

    A kind of map is a dataclass that sets `name`, `title` and `summary`.

    The fields of the dataclass are the arrays to store, unless the class replaces `arrays`.

    Attributes
    ----------
    name : value of the key `colour_map`, and kind in the file of a calibration
    title : name in reports
    summary : one line of documentation
    rank : position in tables and figures, the smallest first; equal ranks by name
    """

    name: ClassVar[str]
    title: ClassVar[str]
    summary: ClassVar[str]
    rank: ClassVar[int] = 100

    @classmethod
    def fit(cls, samples: Samples, background: FloatImage) -> "ColourMap":
        """Fit the map to the calibration presses of a sensor.

        Parameters
        ----------
        samples : pixels of all calibration presses, in contact and undeformed
        background : (row, col, 3) float32, smoothed levels of the undeformed gel

        Raises
        ------
        FitError : too few samples, or colours that do not determine the slopes
        """
        raise NotImplementedError(f"colour map {cls.name!r} has no function fit")

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> "ColourMap":
        """Return the map from stored arrays, which may be those of an untrusted file.

        Raises
        ------
        KeyError : an array is missing
        InputError, ValueError, TypeError : an array does not fit
        """
        return cls(*(arrays[name] for name in _field_names(cls)))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays to store: numbers, flags or texts, no objects."""
        return {name: getattr(self, name) for name in _field_names(type(self))}

    def bound_to(self, background: FloatImage) -> BoundMap:
        """Return the map with precomputed factors for images that have this background.

        Parameters
        ----------
        background : (row, col, 3) float32, smoothed levels of the undeformed gel
        """
        raise NotImplementedError(f"colour map {self.name!r} has no function bound_to")


def _field_names(kind: type[ColourMap]) -> list[str]:
    return [field.name for field in fields(kind)]  # type: ignore[arg-type]


COLOUR_MAPS: Registry[type[ColourMap]] = Registry(
    "colour_maps", "reconstruction.photometric.maps", lambda kind: kind.name
)
"""Registry of the kinds of colour maps, by name."""


def maps_in_order() -> list[type[ColourMap]]:
    """Return the kinds of all maps, in the order of tables and figures."""
    return sorted(COLOUR_MAPS, key=lambda kind: (kind.rank, kind.name))


def map_named(name: str) -> type[ColourMap]:
    """Return the kind of map with this name.

    Raises
    ------
    InputError : there is no map of this name
    """
    if name not in COLOUR_MAPS:
        raise InputError(f"map is {name!r}; give one of {', '.join(COLOUR_MAPS.names())}")
    return COLOUR_MAPS[name]


def require_explained(slopes: FloatArray, fitted: FloatArray) -> None:
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
