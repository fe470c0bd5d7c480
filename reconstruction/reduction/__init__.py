"""Phase frames of other steppings, reduced to the equal steps that the decoder takes.

| module | stepping |
|---|---|
| equivalent | result of a reduction: frames with equal steps, and their noise |
| binomial | "cyclic" and "windowed": weighted means of the frames of equal shift |
| fourier | "single": phase of one fringe image by Fourier transform |
"""

from reconstruction.arrays import FloatImage, Stack
from reconstruction.patterns import PatternSet
from reconstruction.reduction.binomial import CYCLIC_WEIGHTS, average_cyclic
from reconstruction.reduction.equivalent import Equivalent
from reconstruction.rig.sensor import SensorNoise

__all__ = ["Equivalent", "reduced"]


def reduced(
    stack: Stack, patterns: PatternSet, sensor: SensorNoise, scale: FloatImage | None = None
) -> Equivalent:
    """Return the stack with equal steps; it is unchanged if the decoder takes its stepping.

    Parameters
    ----------
    stack, patterns, sensor, scale : as in `decode`

    Raises
    ------
    InputError : a single fringe image has no carrier, see `fourier.find_carrier`
    """
    if not patterns.steps or not patterns.phase_shifts.is_reduced:
        return Equivalent(stack, patterns, float(patterns.steps or 1), is_reduced=False)
    if patterns.stepping in CYCLIC_WEIGHTS:
        return average_cyclic(stack, patterns, sensor, scale)
    # Imported here: most reconstructions need no Fourier transform.
    from reconstruction.reduction.fourier import transform_single

    return transform_single(stack, patterns, sensor, scale)
