"""Exposures of a sequence in relative time: -1 at the start of the sequence, 1 at its end."""

from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from reconstruction.arrays import FloatArray, IntArray
from twin.optics.frame_times import FrameTimes

Places = TypeVar("Places", float, FloatArray)


@dataclass(frozen=True, eq=False)
class ExposureNodes:
    """Gauss nodes of exposures in row 0.

    Attributes
    ----------
    places : (..., node) relative times
    shares : (node,) shares of the light, which sum to 1
    """

    places: FloatArray
    shares: FloatArray


@dataclass(frozen=True, eq=False)
class ExposureSequence:
    """Times of all frames, relative to half of the sequence: 0 in its middle.

    Attributes
    ----------
    middle_s : time of the middle of the sequence; 0 unless the pose is that of another time
    half_s : half of the time from the first exposure to the end of the last one, in all rows
    start, duration : (frame,) relative start and duration of the exposures in row 0
    row_delay : relative time from one row to the next
    """

    middle_s: float
    half_s: float
    start: FloatArray
    duration: FloatArray
    row_delay: float

    @classmethod
    def of(
        cls, times: FrameTimes, ends_s: tuple[float, float], row_delay_s: float
    ) -> "ExposureSequence":
        """Return the relative times of exposures in row 0, between both ends of the sequence."""
        middle_s, half_s = (ends_s[0] + ends_s[1]) / 2.0, (ends_s[1] - ends_s[0]) / 2.0
        start = (times.start_s - middle_s) / half_s
        return cls(middle_s, half_s, start, times.duration_s / half_s, row_delay_s / half_s)

    def time_s(self, places: Places) -> Places:
        """Return the times, s after time 0, of relative times."""
        return self.middle_s + places * self.half_s

    def nodes(self, frames: int | IntArray, count: int) -> ExposureNodes:
        """Return `count` Gauss nodes of one frame, or of each of several frames."""
        nodes, weights = np.polynomial.legendre.leggauss(count)
        start, duration = (np.asarray(of[frames])[..., None] for of in (self.start, self.duration))
        return ExposureNodes(start + duration * (nodes + 1.0) / 2.0, weights / 2.0)
