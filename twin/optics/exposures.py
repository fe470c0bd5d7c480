"""Exposures of a sequence in relative time: -1 at the start of the sequence, 1 at its end."""

from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from reconstruction.arrays import FloatArray
from twin.optics.frame_times import FrameTimes

Places = TypeVar("Places", float, FloatArray)


@dataclass(frozen=True, eq=False)
class ExposureNodes:
    """Gauss nodes of one exposure: relative times, and shares of the light, which sum to 1."""

    places: FloatArray
    shares: FloatArray

    @classmethod
    def of(cls, start: float, duration: float, count: int) -> "ExposureNodes":
        """Return `count` nodes of an exposure with a relative start and duration."""
        nodes, weights = np.polynomial.legendre.leggauss(count)
        return cls(start + duration * (nodes + 1.0) / 2.0, weights / 2.0)


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

    def nodes(self, frame: int, count: int) -> ExposureNodes:
        """Return the Gauss nodes of a frame in row 0."""
        return ExposureNodes.of(float(self.start[frame]), float(self.duration[frame]), count)
