"""Steppings: the phase shifts of the frames of one fringe period, for scenes at rest and in motion.

All shifts are in turns. n is the number of the frame, N the number of frames of the period.

| name | shift of frame n | how the phase follows |
|---|---|---|
| equal | n / N | least squares of N equal steps |
| quarter_pairs | k / (N / 2) for n = 2 k, and 1/4 more for n = 2 k + 1 | least squares |
| cyclic | n / 4 | weighted means of frames of equal shift, see `reduction.binomial` |
| windowed | n / 4 | the same with other weights, for light that changes |
| single | 0 | Fourier transform of the image, see `reduction.fourier` |
"""

from collections.abc import Callable
from dataclasses import dataclass

from reconstruction.errors import InputError

STEPS_RANGE = (3, 1000)
# The weights of more frames than this are below one grey level in 16 bits at both ends.
MOST_CYCLIC = 24
CYCLE = 4


@dataclass(frozen=True)
class Stepping:
    """Phase shifts of the frames of one fringe period.

    Parameters
    ----------
    summary : one line of documentation
    shifts : function that returns the shifts (frame,), turns, from the number of frames
    least, most : allowed numbers of frames
    multiple : the number of frames must be a multiple of this
    is_reduced : whether the decoder first computes equal steps from the frames
    """

    summary: str
    shifts: Callable[[int], tuple[float, ...]]
    least: int = STEPS_RANGE[0]
    most: int = STEPS_RANGE[1]
    multiple: int = 1
    is_reduced: bool = False

    def check(self, name: str, steps: int) -> None:
        """Raise InputError unless the number of frames is allowed."""
        if not self.least <= steps <= self.most or steps % self.multiple:
            even = f", a multiple of {self.multiple}" if self.multiple > 1 else ""
            raise InputError(
                f"patterns steps is {steps} with stepping {name!r}; allowed are {self.least} to"
                f" {self.most}{even}"
            )


def _equal(steps: int) -> tuple[float, ...]:
    return tuple(step / steps for step in range(steps))


def _quarter_pairs(steps: int) -> tuple[float, ...]:
    return tuple(shift + more for shift in _equal(steps // 2) for more in (0.0, 0.25))


def _cyclic(steps: int) -> tuple[float, ...]:
    return tuple(step / CYCLE for step in range(steps))


STEPPINGS = {
    "equal": Stepping("N equal steps over one period", _equal),
    "quarter_pairs": Stepping(
        "N / 2 equal steps, each followed by one that is displaced by a quarter of the period",
        _quarter_pairs,
        least=6,
        multiple=2,
    ),
    "cyclic": Stepping(
        "steps of a quarter of the period, repeated; frames of equal shift are averaged with"
        " binomial weights",
        _cyclic,
        least=CYCLE,
        most=MOST_CYCLIC,
        is_reduced=True,
    ),
    "windowed": Stepping(
        "cyclic steps with weights that also cancel a linear change of the light",
        _cyclic,
        least=CYCLE + 2,
        most=MOST_CYCLIC,
        is_reduced=True,
    ),
    "single": Stepping(
        "one frame, the phase by Fourier transform", _equal, least=1, most=1, is_reduced=True
    ),
}


def stepping_of(name: object) -> Stepping:
    """Return the stepping with this name.

    Raises
    ------
    InputError : there is no such stepping; the message lists the allowed names
    """
    if not isinstance(name, str) or name not in STEPPINGS:
        raise InputError(f"patterns stepping is {name!r}; allowed are {', '.join(STEPPINGS)}")
    return STEPPINGS[name]
