"""Merge the same sequence taken at several exposures into one stack, before decoding.

Per pixel the brightest exposure whose whole set of frames is unsaturated (Zhang and Yau, Opt. Eng.
48, 033604 (2009)); its DN above the black level are scaled to the longest exposure by
s = t_max / t. The variance is then (s K sigma_d)^2 + s K (mean - black) + s^2 / 12: `decode` uses
it when given s.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import FloatImage, ReasonImage, Stack
from reconstruction.checks import require_number
from reconstruction.errors import InputError
from reconstruction.rig.sensor import SensorNoise


@dataclass(frozen=True, eq=False)
class MergedExposures:
    """One stack out of several.

    Parameters
    ----------
    stack : (frame, row, col) float32, DN of the longest exposure; may exceed `saturation_dn`
    scale : (row, col) float32, s >= 1, for `decode`
    chosen : (row, col) uint8, index of the exposure taken
    exposure_ms : that of the stack
    """

    stack: Stack
    scale: FloatImage
    chosen: ReasonImage
    exposure_ms: float


def merge_exposures(
    stacks: Sequence[Stack], exposures_ms: Sequence[float], sensor: SensorNoise
) -> MergedExposures:
    """Take every pixel from its brightest exposure without a saturated frame.

    Where all saturate, the shortest one is taken: `decode` leaves out its clipped frames.

    Parameters
    ----------
    stacks : equal shapes (frame, row, col), DN, one per exposure
    exposures_ms : their exposure times, all different
    sensor : common to all; DN grow in proportion to the exposure above its black level

    Raises
    ------
    InputError : stacks and exposures do not fit each other
    """
    _check(stacks, exposures_ms)
    order = sorted(range(len(stacks)), key=lambda i: exposures_ms[i])
    longest_ms = float(exposures_ms[order[-1]])
    black = np.float32(sensor.black_level_dn)
    merged = np.zeros(stacks[0].shape, np.float32)
    scale = np.ones(merged.shape[1:], np.float32)
    chosen = np.zeros(merged.shape[1:], np.uint8)
    for rank, i in enumerate(order):
        # This way round NaN counts as saturated.
        takes = np.asarray(stacks[i].max(axis=0) < sensor.clipped_from_dn) | (rank == 0)
        s = np.float32(longest_ms / exposures_ms[i])
        scale[takes], chosen[takes] = s, i
        for target, frame in zip(merged, stacks[i], strict=True):
            target[takes] = black + s * (frame[takes].astype(np.float32) - black)
    return MergedExposures(merged, scale, chosen, longest_ms)


def _check(stacks: Sequence[Stack], exposures_ms: Sequence[float]) -> None:
    if not stacks or len(stacks) != len(exposures_ms) or len(stacks) > 255:
        raise InputError(
            f"there are {len(stacks)} stacks and {len(exposures_ms)} exposures; give one of each,"
            " 1 to 255"
        )
    for value in exposures_ms:
        require_number("exposures_ms", value, 0.0, open_low=True)
    if len(set(exposures_ms)) != len(exposures_ms):
        raise InputError(f"exposures_ms are {list(exposures_ms)}; each may occur once")
    shapes = {stack.shape for stack in stacks}
    if len(shapes) != 1 or stacks[0].ndim != 3:
        raise InputError(f"stacks have the shapes {sorted(shapes)}; all must be (frame, row, col)")
