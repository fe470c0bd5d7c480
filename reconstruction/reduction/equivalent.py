"""Equal steps that are equivalent to the phase frames of another stepping.

The decoder computes phases, masks and noise from N equal steps. A stepping that is reduced first
becomes a stack with equal steps; all other frames remain as they are.
"""

from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import BoolImage, FloatImage, Stack
from reconstruction.patterns import PatternSet
from reconstruction.rig.sensor import SensorNoise


@dataclass(frozen=True, eq=False)
class Equivalent:
    """Frames with equal steps, and their noise.

    Parameters
    ----------
    stack : (frame, row, col) DN, in the order of `patterns.frames`
    patterns : pattern sequence with the stepping "equal"
    equal_steps : number of frames of the camera's noise that give the same sigma of the phase:
        sigma_phi^2 = 2 sigma_I^2 / (equal_steps B^2)
    is_reduced : whether the phase frames are not those of the camera
    is_smooth : whether the noise is equal over many pixels, so that no filter reduces it
    """

    stack: Stack
    patterns: PatternSet
    equal_steps: float
    is_reduced: bool = True
    is_smooth: bool = False

    @property
    def noise_share(self) -> float:
        """Mean noise variance of the equal steps, as a share of that of a frame of the camera."""
        return self.patterns.steps / self.equal_steps if self.patterns.steps else 1.0


def lost_pixels(
    frames: Stack, sensor: SensorNoise, scale: FloatImage | None
) -> tuple[BoolImage, FloatImage]:
    """Return pixels without a usable level in some frame (row, col), and the level to mark them.

    A level is not usable if it is clipped, not finite, or that of a lost frame. The decoder omits
    a frame with the returned level, DN, from the fit of the pixel.

    Parameters
    ----------
    frames : (frame, row, col), DN
    scale : as in `decode`
    """
    black_dn, factor = sensor.black_level_dn, np.ones(frames.shape[1:], np.float32)
    factor = factor if scale is None else scale
    limit_dn = black_dn + (sensor.clipped_from_dn - black_dn) * factor
    lost: BoolImage = np.zeros(frames.shape[1:], np.bool_)
    for frame in frames:
        lost |= ~(frame < limit_dn)
        if black_dn > 0.0 or not frame.any():
            lost |= ~(frame > 0.0)
    return lost, np.asarray(black_dn + (sensor.saturation_dn - black_dn) * factor, np.float32)


def with_equal_steps(stack: Stack, patterns: PatternSet, sets: list[FloatImage]) -> FloatImage:
    """Return the stack (frame, row, col) float32 with other frames in place of the phase frames.

    Parameters
    ----------
    patterns : sequence of `stack`
    sets : new frames (step, row, col) of every fringe set, in the order of projection
    """
    # All phase frames precede the other frames.
    after = len(patterns.axes) * patterns.sets * patterns.steps
    return np.concatenate([*sets, stack[after:].astype(np.float32)])


def fringe_sets(stack: Stack, patterns: PatternSet) -> list[Stack]:
    """Return the phase frames (step, row, col) of every fringe set, in the order of projection."""
    return [stack[frames] for axis in patterns.axes for frames in patterns.step_sets(axis)]
