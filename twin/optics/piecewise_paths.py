"""Camera rays that cross an edge during a sequence: linear in time between their crossings.

The rays are traced at equal steps of the sequence. A second difference of three neighbouring values
is 8 times the error of linear interpolation between two of them; across an edge it is large. An
interval is interpolated if the second difference at one of its ends is small, which then contains
no edge. In all other intervals the rays have to be traced at the time of the frame.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import BoolImage, FloatArray, FloatImage
from twin.optics.moving_rig import LanePaths
from twin.optics.time_paths import COORDINATE_PX, WEIGHT_SHARE

INTERVALS = 16
"""Number of equal steps of a sequence."""

_NAMES = ("column_px", "row_px", "axial_mm", "weight")
_SECOND_OVER_ERROR = 8.0


@dataclass(frozen=True, eq=False)
class PiecewisePaths:
    """Lanes at several relative times, from -1 to 1.

    Attributes
    ----------
    places : (step,) ascending relative times
    values : by quantity, (step, lane)
    holds : (interval, lane) True where the lanes are interpolated
    """

    places: FloatArray
    values: dict[str, FloatImage]
    holds: BoolImage

    @classmethod
    def of(cls, trace: Callable[[float], LanePaths], white: float) -> "PiecewisePaths":
        """Return lanes traced at equal steps.

        Parameters
        ----------
        trace : returns the lanes at a relative time
        white : mean weight of all lit rays
        """
        places = np.linspace(-1.0, 1.0, INTERVALS + 1)
        values = _stacked([trace(float(place)) for place in places])
        lit = values["weight"] > 0.0
        limits = {"column_px": COORDINATE_PX, "row_px": COORDINATE_PX}
        limits["weight"] = WEIGHT_SHARE * white
        linear = np.all([_linear(values[name], limit) for name, limit in limits.items()], axis=0)
        holds = (lit[:-1] & lit[1:] & linear) | ~(lit[:-1] | lit[1:])
        return cls(places, values, holds)

    @classmethod
    def between(cls, places: FloatArray, paths: list[LanePaths]) -> "PiecewisePaths":
        """Return lanes that are interpolated everywhere between their traces at given times."""
        values = _stacked(paths)
        return cls(places, values, np.ones((len(places) - 1, values["weight"].shape[1]), bool))

    def held_at(self, places: FloatArray) -> BoolImage:
        """Return True for the lanes that are interpolated at relative times, (..., lane)."""
        return np.asarray(self.holds[self._interval(places), np.arange(self.holds.shape[1])])

    def at(self, places: FloatArray, lanes: NDArray[np.intp]) -> LanePaths:
        """Return some lanes, interpolated linearly at a relative time of each."""
        step = self._interval(places)
        start, end = self.places[step], self.places[step + 1]
        share = ((places - start) / (end - start)).astype(np.float32)
        return LanePaths(
            *(
                values[step, lanes] * (1.0 - share) + values[step + 1, lanes] * share
                for values in (self.values[name] for name in _NAMES)
            )
        )

    def _interval(self, places: FloatArray) -> NDArray[np.intp]:
        return np.searchsorted(self.places[1:-1], places, side="right")


def _stacked(paths: list[LanePaths]) -> dict[str, FloatImage]:
    return {name: np.stack([getattr(path, name) for path in paths]) for name in _NAMES}


def _linear(values: FloatImage, limit: float) -> BoolImage:
    """Return True for the intervals (interval, lane) in which values (step, lane) are linear.

    Parameters
    ----------
    limit : largest error of linear interpolation
    """
    second = np.abs(np.diff(values, n=2, axis=0)) / _SECOND_OVER_ERROR
    ends = np.full((1, values.shape[1]), np.inf, np.float32)
    at_step = np.concatenate([ends, second, ends])
    return np.asarray(np.minimum(at_step[:-1], at_step[1:]) <= limit)
