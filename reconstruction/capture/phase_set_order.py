"""Do the frames of an N-step set belong together? From sums over many pixels.

Symbols: x_np light of pixel p in step n, of unit standard deviation over the steps; G = x x^T the
(N, N) matrix of sums over pixels; H the projection on 1, cos, sin of 2 pi n / N. The residual of an
order P of the frames is tr((1 - H) P G P^T), so that all exchanges are tried without the images.
"""

from itertools import combinations

import numpy as np

from reconstruction.arrays import Doubles
from reconstruction.errors import CaptureError
from reconstruction.patterns import AXES, PatternSet

# One frame brighter or darker by more than this, measured against the cosine through all sums.
LEVEL_TOLERANCE = 0.15
# An exchange must leave less than this share of the residual: noise and harmonics do not profit.
EXCHANGE_GAIN = 0.5
# A single strange frame: its RMS deviation in units of the modulation, and its share of all.
STRANGE_DEVIATION, STRANGE_SHARE = 0.2, 0.5
# Share of the variance no cosine explains; a gamma of 2.2 leaves 0.08, frames at random 0.8.
CHAOTIC = 0.35
# Fewer steps leave no or one degree of freedom, in which no frame can be told from another.
LEAST_STEPS = 5


def check_phase_sets(pixels: Doubles, patterns: PatternSet) -> None:
    """Check each set of N phase frames by itself.

    Parameters
    ----------
    pixels : (frame, pixel), DN, unsaturated and lit

    Raises
    ------
    CaptureError : one frame has another exposure, two are exchanged, one does not belong
    """
    for axis in AXES:
        span = patterns.index("phase", axis)
        for first in range(span.start, span.stop, patterns.steps):
            names = [patterns.frames[first + n].name for n in range(patterns.steps)]
            _check_set(pixels[first : first + patterns.steps], first, names)


def _check_set(x: Doubles, first: int, names: list[str]) -> None:
    steps = len(x)
    if steps < LEAST_STEPS:
        return
    remainder = np.eye(steps) - _projection(steps)
    _check_levels(remainder @ x.mean(axis=1), x.mean(), first, names)
    deviation = x.std(axis=0)
    unit = ((x - x.mean(axis=0)) / np.where(deviation > 0.0, deviation, 1.0))[:, deviation > 0.0]
    gram = unit @ unit.T / max(unit.shape[1], 1)
    _check_exchange(gram, remainder, first, names)
    _check_stranger(np.diag(remainder @ gram @ remainder), first, names)


def _projection(steps: int) -> Doubles:
    angle = 2.0 * np.pi * np.arange(steps) / steps
    basis = np.stack([np.full(steps, np.sqrt(0.5)), np.cos(angle), np.sin(angle)])
    product: Doubles = basis.T @ basis * (2.0 / steps)
    return product


def _check_levels(missed_dn: Doubles, mean_dn: float, first: int, names: list[str]) -> None:
    """Compare each frame's mean with the cosine that the means of all frames must follow."""
    worst = int(np.argmax(np.abs(missed_dn)))
    # What the frame misses of the cosine through the others; its own weight in the fit is 3 / N.
    excess = float(missed_dn[worst] / (1.0 - 3.0 / len(names)))
    if abs(excess) > LEVEL_TOLERANCE * mean_dn:
        ratio = 1.0 + excess / max(mean_dn - excess / len(names), 1e-9)
        raise CaptureError(
            f"mixed exposures: frame {first + worst} ({names[worst]}) is {ratio:.2g} times as "
            "bright as the frames beside it; record with fixed exposure, gain and light"
        )


def _check_exchange(gram: Doubles, remainder: Doubles, first: int, names: list[str]) -> None:
    stated = float(np.sum(remainder * gram))
    best, pair = stated, (0, 0)
    for i, j in combinations(range(len(names)), 2):
        order = np.arange(len(names))
        order[[i, j]] = j, i
        residual = float(np.sum(remainder * gram[np.ix_(order, order)]))
        if residual < best:
            best, pair = residual, (i, j)
    if best < EXCHANGE_GAIN * stated and _is_real(stated - best, pair, len(names)):
        i, j = pair
        raise CaptureError(
            f"frames {first + i} ({names[i]}) and {first + j} ({names[j]}) look exchanged: "
            f"the other way round they fit the {len(names)} phase steps"
        )


def _is_real(gain: float, pair: tuple[int, int], steps: int) -> bool:
    """Tell whether exchanging the frames changes the residual as much as their steps demand."""
    # Two unit cosines apart by the angle a differ by 2 (1 - cos a) in square, twice for two frames;
    # the fit through N frames takes up a part of it.
    angle = 2.0 * np.pi * (pair[1] - pair[0]) / steps
    return bool(gain > 0.3 * 4.0 * (1.0 - np.cos(angle)) * (1.0 - 3.0 / steps))


def _check_stranger(power: Doubles, first: int, names: list[str]) -> None:
    steps = len(names)
    worst, total = int(np.argmax(power)), float(power.sum())
    # Unit standard deviation means a modulation of sqrt 2.
    deviation = float(np.sqrt(power[worst] / 2.0)) / (1.0 - 3.0 / steps)
    if deviation > STRANGE_DEVIATION and power[worst] > STRANGE_SHARE * total and steps > 6:
        raise CaptureError(
            f"frame {first + worst} ({names[worst]}) does not belong to its {steps} phase steps "
            f"(it misses them by {deviation:.0%} of the modulation): shown twice, late, or another "
            "picture; record the sequence again"
        )
    if total > CHAOTIC * steps:
        raise CaptureError(
            f"frames {first} to {first + steps - 1} ({names[0]} ...) are no {steps} equal phase "
            f"steps ({total / steps:.0%} of their variance is no cosine); check order and steps"
        )
