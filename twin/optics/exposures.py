"""Exposures of a sequence in relative time: -1 at the start of the sequence, 1 at its end.

A scene that only vibrates is at each time as it is at one time of half a period, from its lowest
to its highest displacement. In such a sequence the displacement, from -1 to 1, is the relative
time, so that any number of periods needs no more moments than half a period.
"""

from dataclasses import dataclass
from typing import TypeVar, cast

import numpy as np

from reconstruction.arrays import FloatArray, IntArray
from twin.config.motion import Vibration
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


@dataclass(frozen=True, eq=False)
class VibratingSequence(ExposureSequence):
    """Exposures of a scene that only vibrates; all rows are exposed at the same time.

    The relative time is sin(2 pi f t + phase). `duration` is its path during an exposure, at most
    that of a period, which is 4.

    Attributes
    ----------
    start_s, exposure_s : (frame,) start of each exposure, and duration of all
    frequency_hz, phase_rad : of the vibration; the phase at time 0
    """

    start_s: FloatArray
    exposure_s: float
    frequency_hz: float
    phase_rad: float

    @classmethod
    def vibrating(cls, times: FrameTimes, vibration: Vibration) -> "VibratingSequence":
        """Return the exposures of a scene with this vibration and no other motion."""
        frequency_hz, phase_rad = vibration.frequency_hz, float(np.deg2rad(vibration.phase_deg))
        exposure_s = float(times.duration_s[0])
        place = np.sin(2.0 * np.pi * frequency_hz * times.start_s + phase_rad)
        path = np.full(len(place), 4.0 * min(1.0, frequency_hz * exposure_s))
        middle_s = -phase_rad / (2.0 * np.pi * frequency_hz)
        of_vibration = times.start_s, exposure_s, frequency_hz, phase_rad
        return cls(middle_s, 0.25 / frequency_hz, place, path, 0.0, *of_vibration)

    def time_s(self, places: Places) -> Places:
        """Return the times, s, of displacements, in the half period around `middle_s`."""
        angle = np.arcsin(np.clip(places, -1.0, 1.0))
        return self.middle_s + cast(Places, angle) / (2.0 * np.pi * self.frequency_hz)

    def nodes(self, frames: int | IntArray, count: int) -> ExposureNodes:
        """Return nodes of one period, for all whole periods of an exposure, and of the rest.

        The mean over a period is that of `count` equal steps: its error is the Bessel function of
        this order of the phase amplitude. The rest has `count` Gauss nodes.
        """
        periods = self.frequency_hz * self.exposure_s
        # Whole periods in spite of rounding errors.
        whole = np.floor(periods + 1e-9)
        rest, steps = max(0.0, periods - whole), max(2, count)
        nodes, weights = np.polynomial.legendre.leggauss(count)
        turns = np.concatenate([(np.arange(steps) + 0.5) / steps, rest * (nodes + 1.0) / 2.0])
        shares = np.concatenate([np.full(steps, whole / steps), rest * weights / 2.0])
        turns, shares = turns[shares > 0.0], shares[shares > 0.0]
        phase = 2.0 * np.pi * self.frequency_hz * self.start_s[frames] + self.phase_rad
        angle = np.asarray(phase)[..., None] + 2.0 * np.pi * turns
        return ExposureNodes(np.sin(angle), shares / shares.sum())
