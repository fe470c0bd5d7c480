"""Do the Gray frames stand in their order? The words of neighbouring pixels differ by one.

Exchanged Gray frames change neither the parity of a word nor that it differs from its neighbours in
one bit, but by how much its number differs. Bits that nowhere change within the view tell nothing.
"""

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import Stack
from reconstruction.errors import CaptureError
from reconstruction.patterns import AXES, Axis, PatternSet
from reconstruction.rig.sensor import SensorNoise

POSITIONS = 8_000
LEAST_CHANGES = 30
# A pixel is used when its frames differ by this many sigmas of its noise.
LIT_SIGMAS = 20.0
# Share of jumps by more than one: steep edges and light between parts give up to 0.6 without any
# mistake, which no exchange lowers: it is blamed only if it explains most. Coarse bits jump seldom.
MANY_JUMPS, EXPLAINED = 0.02, 1.0 / 3.0

Bits = NDArray[np.bool_]


def check_words(stack: Stack, patterns: PatternSet, sensor: SensorNoise) -> None:
    """Compare the Gray words of neighbouring pixels of the frames (frame, row, col), DN.

    Raises
    ------
    CaptureError : two Gray frames of an axis are clearly exchanged
    """
    if not any(patterns.word_bits(axis) for axis in AXES) or min(stack.shape[1:]) < 2:
        return
    corners_dn = _corners(stack, sensor)
    for axis in AXES:
        _check_axis(corners_dn, patterns, axis)


def _corners(stack: Stack, sensor: SensorNoise) -> NDArray[np.float32]:
    """Return lit, unsaturated pixels with right and lower neighbour, (frame, pixel, 3) DN."""
    _, rows, cols = stack.shape
    # Drawn, always alike, since a regular raster could beat with the fringes.
    rng = np.random.default_rng(0)
    row = rng.integers(0, rows - 1, POSITIONS)[:, np.newaxis] + np.array([0, 0, 1])
    col = rng.integers(0, cols - 1, POSITIONS)[:, np.newaxis] + np.array([0, 1, 0])
    values_dn = np.stack([frame[row, col] for frame in stack]).astype(np.float32)
    low_dn, high_dn = values_dn.min(axis=0), values_dn.max(axis=0)
    noise_dn = np.sqrt(sensor.variance_dn2(high_dn.astype(np.float64)))
    usable = (high_dn < sensor.clipped_from_dn) & (high_dn - low_dn > LIT_SIGMAS * noise_dn)
    return values_dn[:, usable.all(axis=1)]


def _check_axis(corners_dn: NDArray[np.float32], patterns: PatternSet, axis: Axis) -> None:
    gray = patterns.index("gray", axis)
    phase_dn = corners_dn[patterns.index("phase", axis)]
    bits = corners_dn[gray] > phase_dn.mean(axis=0)
    if patterns.code == "shifted_gray":
        bits = bits[: patterns.gray_bits(axis)]
    stated = _share_of_jumps(bits)
    if stated <= MANY_JUMPS:
        return
    found = {}
    for i, j in combinations(range(len(bits)), 2):
        order = np.arange(len(bits))
        order[[i, j]] = j, i
        found[i, j] = _share_of_jumps(bits[order])
    # Where several explain it alike, the nearest frames.
    i, j = min(found, key=lambda pair: (round(found[pair], 2), pair[1] - pair[0]))
    if found[i, j] < EXPLAINED * stated:
        first, second = (patterns.frames[gray.start + bit].name for bit in (i, j))
        raise CaptureError(
            f"frames {gray.start + i} ({first}) and {gray.start + j} ({second}) look exchanged: "
            f"{stated:.0%} of the changes between neighbouring pixels jump over words, the other "
            f"way round {found[i, j]:.0%}"
        )


def _share_of_jumps(bits: Bits) -> float:
    """Return the share of changes between neighbours by more than one; 0 if there are few."""
    # Words of up to 16 bits are exact in single precision.
    weights = np.float32(2) ** np.arange(len(bits) - 1, -1, -1, dtype=np.float32)
    words = np.tensordot(weights, np.logical_xor.accumulate(bits).astype(np.float32), axes=1)
    steps = np.abs(words[:, 1:] - words[:, :1])
    changes = int(np.count_nonzero(steps))
    return float(np.count_nonzero(steps > 1)) / changes if changes >= LEAST_CHANGES else 0.0
