"""Check the order of phase steps, the first step, and the order of Gray frames.

**Phase steps.** x_np is the light of pixel p in step n, with unit standard deviation over the N
steps. G = x x^T is the (N, N) matrix of sums over pixels. H is the projection on 1, cos and sin of
2 pi n / N. With the permutation matrix P of an order of the frames, the squared residual is
tr((1 - H) P G P^T). It needs only G, so that all exchanges of two frames can be tried.

**First step.** The phase must agree with the half-periods of the Gray code. A set that starts k
steps late is a perfect phase set in which all coordinates are shifted by k period / N. The shift is
visible by comparison with the Gray code only. The bits of an edge-safe code have even parity in the
first half of every period. The mean of +-exp(i phi), + for even and - for odd parity, therefore has
the argument pi / 2. Half a pixel is subtracted, because stripes start earlier by it. A set that was
recorded in reverse order has the phase 2 pi / N - phi.

**Borders.** Plain Gray words change at the ends of a period only. Between neighbouring pixels with
words that differ by one, the phase passes 0 and increases towards the larger word. With shifts of
the wrong sign it decreases there.

**Gray words.** The words of neighbouring pixels differ by at most one. An exchange of two Gray
frames does not change the parity of a word. Neighbouring words still differ in one bit then, but
their numbers may differ by more than one. Bits that do not change within the view are not checked.
"""

from itertools import combinations

import numpy as np

from reconstruction.arrays import BoolImage, FloatArray, FloatImage, Stack
from reconstruction.codes import Rule
from reconstruction.errors import CaptureError
from reconstruction.patterns import AXES, Axis, PatternSet
from reconstruction.rig.sensor import SensorNoise

# Largest deviation of the mean of a frame from the cosine through the means, relative to the mean.
LEVEL_TOLERANCE = 0.15
# An exchange is reported if it reduces the squared residual below this share, which exchanges do
# not if noise or harmonics cause the residual.
EXCHANGE_GAIN = 0.5
# A frame does not belong to its set if its RMS deviation exceeds the first value, in units of the
# modulation, and the second share of the squared residual of all frames.
STRANGE_DEVIATION, STRANGE_SHARE = 0.2, 0.5
# Largest share of the variance that no cosine explains: it is 0.08 at a gamma of 2.2, 0.8 for
# random frames.
CHAOTIC = 0.35
# Least number of steps that is checked. Fewer steps have at most one degree of freedom, which
# identifies no frame.
LEAST_STEPS = 5
# Least error of the first shift that is reported, in steps and in rad. Blur, noise and a view of
# few fringes may cause smaller angles.
LEAST_STEPS_OFF, LEAST_ANGLE_OFF = 0.7, 0.2
# A larger error, in steps, is reported as a reversed set if that explains it.
MOST_STEPS_OFF = 2.0
# Phase and Gray code agree if the mean phasor exceeds the first share of that of ideal frames. They
# are independent if it is below the second share.
AGREES, DISAGREES = 0.6, 0.3
# Points per projector pixel at which the expected mean phasor is computed.
FINE = 16
# Rules of codes in which the number of bright bits is odd in every other half period.
ALTERNATING = (Rule.WORD_PER_HALF_PERIOD, Rule.TWO_WORDS)

POSITIONS = 8_000
LEAST_CHANGES = 30
# Least predominance, from 0 to 1, of decreases over increases of the phase with the word at which
# the phase frames are reported as reversed.
BACKWARDS = 0.5
# A pixel is used if its frames differ by more than this many standard deviations of its noise.
LIT_SIGMAS = 20.0
# Exchanges are tried if more than the first share of the changes is by more than one. Steep edges
# and light between parts cause up to 0.6 without a mistake. Therefore an exchange is reported only
# if it reduces the share below EXPLAINED times it.
MANY_JUMPS, EXPLAINED = 0.02, 1.0 / 3.0


def exchanged(count: int, i: int, j: int) -> list[int]:
    """Return the indices 0 to `count` - 1 with i and j exchanged."""
    order = list(range(count))
    order[i], order[j] = j, i
    return order


def check_phase_sets(pixels: FloatArray, patterns: PatternSet) -> None:
    """Raise CaptureError if a set of N phase frames does not have N equal steps in order.

    Parameters
    ----------
    pixels : (frame, pixel), DN, of pixels that are lit and not saturated

    Raises
    ------
    CaptureError : in a set one frame has another exposure, two frames are exchanged, or a frame
        does not belong to the set
    """
    for axis in patterns.axes:
        for span in patterns.step_sets(axis):
            names = [frame.name for frame in patterns.frames[span]]
            _check_set(pixels[span], span.start, names)


def _check_set(x: FloatArray, first: int, names: list[str]) -> None:
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


def _projection(steps: int) -> FloatArray:
    angle = 2.0 * np.pi * np.arange(steps) / steps
    basis = np.stack([np.full(steps, np.sqrt(0.5)), np.cos(angle), np.sin(angle)])
    return np.asarray(basis.T @ basis * (2.0 / steps))


def _check_levels(missed_dn: FloatArray, mean_dn: float, first: int, names: list[str]) -> None:
    """Raise CaptureError if the mean of a frame deviates from a cosine through all means.

    Parameters
    ----------
    missed_dn : (step,) deviation of the mean of each frame from the cosine, DN
    first : stack index of the first frame of the set
    """
    worst = int(np.argmax(np.abs(missed_dn)))
    # Deviation of the frame from a cosine through the other frames: the weight of the frame in the
    # fit to all frames is 3 / N.
    excess = float(missed_dn[worst] / (1.0 - 3.0 / len(names)))
    if abs(excess) > LEVEL_TOLERANCE * mean_dn:
        ratio = 1.0 + excess / max(mean_dn - excess / len(names), 1e-9)
        raise CaptureError(
            f"mixed exposures: frame {first + worst} ({names[worst]}) is {ratio:.2g} times as "
            "bright as the neighbouring frames; record with fixed exposure, gain and light"
        )


def _check_exchange(gram: FloatArray, remainder: FloatArray, first: int, names: list[str]) -> None:
    stated = float(np.sum(remainder * gram))
    best, pair = stated, (0, 0)
    for i, j in combinations(range(len(names)), 2):
        order = exchanged(len(names), i, j)
        residual = float(np.sum(remainder * gram[np.ix_(order, order)]))
        if residual < best:
            best, pair = residual, (i, j)
    if best < EXCHANGE_GAIN * stated and _is_real(stated - best, pair, len(names)):
        i, j = pair
        raise CaptureError(
            f"frames {first + i} ({names[i]}) and {first + j} ({names[j]}) look exchanged: "
            f"in exchanged order they fit the {len(names)} phase steps"
        )


def _is_real(gain: float, pair: tuple[int, int], steps: int) -> bool:
    """Return True if the gain of an exchange is as large as the phases of the two frames demand."""
    # The squared difference of two unit cosines with a phase difference a is 2 (1 - cos a), that of
    # two exchanged frames 4 (1 - cos a). The fit through N frames absorbs a part of it.
    angle = 2.0 * np.pi * (pair[1] - pair[0]) / steps
    return bool(gain > 0.3 * 4.0 * (1.0 - np.cos(angle)) * (1.0 - 3.0 / steps))


def _check_stranger(power: FloatArray, first: int, names: list[str]) -> None:
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


def check_first_step(pixels: FloatArray, patterns: PatternSet) -> None:
    """Raise CaptureError if the phase does not agree with an edge-safe Gray code along an axis.

    Pattern sets with another code are not checked.

    Parameters
    ----------
    pixels : (frame, pixel), DN, of pixels that are lit and not saturated

    Raises
    ------
    CaptureError : the phase frames along an axis start at another step, are in reverse order, or
        are those of the other axis
    """
    if patterns.kind.rule not in ALTERNATING:
        return
    measured = {axis: _measured(pixels, patterns, axis, axis) for axis in patterns.axes}
    expected = {axis: _expected(patterns, axis) for axis in patterns.axes}
    is_strange = all(abs(measured[axis]) < DISAGREES * abs(expected[axis]) for axis in measured)
    if is_strange and patterns.axes == AXES:
        _check_exchanged_axes(pixels, patterns)
    for axis in patterns.axes:
        if abs(measured[axis]) > AGREES * abs(expected[axis]):
            _check_start(measured[axis], expected[axis], patterns, axis)


def _check_exchanged_axes(pixels: FloatArray, patterns: PatternSet) -> None:
    crossed = [_measured(pixels, patterns, axis, coded) for axis, coded in (AXES, AXES[::-1])]
    if min(abs(mean) for mean in crossed) > AGREES * abs(_expected(patterns, "column")):
        raise CaptureError(
            "the phase frames of columns and rows look exchanged: each fits the Gray frames "
            "of the other axis"
        )


def _check_start(measured: complex, expected: complex, patterns: PatternSet, axis: Axis) -> None:
    per_step = 2.0 * np.pi / patterns.steps
    turns = float(np.angle(measured / expected))
    backwards = float(np.angle(np.conj(measured) * np.exp(1j * per_step) / expected))
    steps = turns / per_step
    if abs(steps) <= LEAST_STEPS_OFF or abs(turns) <= LEAST_ANGLE_OFF:
        return
    first = patterns.index("phase", axis).start
    subject = f"the {patterns.steps} phase frames along {axis} (from frame {first}) look"
    if abs(steps) > MOST_STEPS_OFF and abs(backwards) < LEAST_STEPS_OFF * per_step:
        raise CaptureError(
            f"{subject} recorded backwards: against the Gray code the phase decreases"
        )
    late = "late" if steps > 0 else "early"
    raise CaptureError(
        f"{subject} shifted by {abs(round(steps)) or 1}: against the Gray frames they start that "
        f"many steps {late}; start the recording with step 00"
    )


def _measured(pixels: FloatArray, patterns: PatternSet, axis: Axis, coded: Axis) -> complex:
    """Return the mean of +-exp(i phi), phi along `axis`, sign by the Gray word along `coded`."""
    phase = pixels[patterns.index("phase", axis)][: patterns.steps]
    phasor = np.exp(-2j * np.pi * np.array(patterns.shifts(axis, 0))) @ phase
    bits = read_bits(pixels, patterns, coded)
    sign = 1.0 - 2.0 * (bits.sum(axis=0) % 2)
    return complex(np.mean(sign * phasor / np.maximum(np.abs(phasor), 1e-12)))


def _expected(patterns: PatternSet, axis: Axis) -> complex:
    length, period_px = patterns.length_px(axis), patterns.period_along(axis)
    x_px = (np.arange(length * FINE) + 0.5) / FINE - 0.5
    half = np.floor(2.0 * np.arange(length) / period_px)
    sign = 1.0 - 2.0 * (np.repeat(half, FINE) % 2)
    return complex(np.mean(sign * np.exp(2j * np.pi * x_px / period_px)))


def read_bits(pixels: FloatImage | FloatArray, patterns: PatternSet, axis: Axis) -> BoolImage:
    """Return the projected bits along `axis`, (bit, ...) bool, from frames (frame, ...), DN."""
    gray = pixels[patterns.index("gray", axis)]
    if patterns.inverse:
        return np.asarray(gray > pixels[patterns.index("inverse", axis)])
    if patterns.steps:
        # The phase frames of the same axis are used: those of the other axis have another mean.
        return np.asarray(gray > pixels[patterns.index("phase", axis)].mean(axis=0))
    white, black = (pixels[patterns.index(kind)].mean(axis=0) for kind in ("white", "black"))
    return np.asarray(gray > 0.5 * (white + black))


def check_borders(stack: Stack, patterns: PatternSet, sensor: SensorNoise) -> None:
    """Raise CaptureError if the phase does not pass 0 where a plain Gray word ends.

    Parameters
    ----------
    stack : (frame, row, col), DN

    Raises
    ------
    CaptureError : along an axis the phase decreases with the word, or does not pass 0 between words
    """
    is_plain = patterns.kind.rule is Rule.WORD_PER_PERIOD
    if not is_plain or not patterns.steps or min(stack.shape[1:]) < 2:
        return
    corners_dn = _corners(stack, sensor)
    for axis in patterns.axes:
        _check_axis_borders(corners_dn, patterns, axis)


def _check_axis_borders(corners_dn: FloatImage, patterns: PatternSet, axis: Axis) -> None:
    bits = read_bits(corners_dn, patterns, axis)
    words = np.tensordot(2 ** np.arange(len(bits))[::-1], patterns.binary(bits), axes=1)
    shifts = np.array(patterns.shifts(axis, 0))
    phase = corners_dn[patterns.index("phase", axis)]
    z = np.tensordot(np.exp(-2j * np.pi * shifts), phase, axes=1)
    # Displaced words end where the phase is minus the displacement.
    z *= np.exp(2j * np.pi * patterns.kind.displacement) / np.maximum(np.abs(z), 1e-12)
    step = words[:, 1:] - words[:, :1]
    turn = np.imag(z[:, 1:] * np.conj(z[:, :1])) * np.sign(step)
    ends = np.abs(step) == 1
    if np.count_nonzero(ends) < LEAST_CHANGES:
        return
    first = patterns.index("phase", axis).start
    subject = f"the {patterns.steps} phase frames along {axis} (from frame {first}) look"
    if np.sum(turn[ends]) < -BACKWARDS * np.sum(np.abs(turn[ends])):
        raise CaptureError(
            f"{subject} recorded backwards: the phase decreases with the Gray word; correct "
            "their order, or the sign of their shifts"
        )
    passed = np.mean((z[:, 1:] + z[:, :1])[ends]) * 0.5
    turns = float(np.angle(passed * np.exp(1j * np.pi / patterns.period_along(axis))))
    steps = turns * patterns.steps / (2.0 * np.pi)
    if abs(passed) > AGREES and abs(steps) > LEAST_STEPS_OFF and abs(turns) > LEAST_ANGLE_OFF:
        late = "late" if steps > 0 else "early"
        is_half = np.pi - abs(turns) < LEAST_STEPS_OFF * 2.0 * np.pi / patterns.steps
        remedy = "shifted = false" if patterns.kind.displacement else "shifted = true"
        half = f", or list the Gray frames with {remedy}" * bool(is_half)
        raise CaptureError(
            f"{subject} shifted by {abs(round(steps)) or 1}: against the Gray frames they start "
            f"that many steps {late}; start with step 00, or correct the first shift{half}"
        )


def check_words(stack: Stack, patterns: PatternSet, sensor: SensorNoise) -> None:
    """Raise CaptureError if the Gray words of neighbouring pixels show that frames are exchanged.

    Only code words with the encoding "reflected" or "binary" are checked.

    Parameters
    ----------
    stack : (frame, row, col), DN

    Raises
    ------
    CaptureError : two Gray frames of an axis are clearly exchanged
    """
    is_checked = patterns.encoding.is_order_checked
    has_levels = any(patterns.kind.has_levels(patterns.fringes(axis)) for axis in patterns.axes)
    if has_levels or not is_checked or not any(map(patterns.word_bits, patterns.axes)):
        return
    if min(stack.shape[1:]) < 2:
        return
    corners_dn = _corners(stack, sensor)
    for axis in patterns.axes:
        _check_axis_words(corners_dn, patterns, axis)


def _corners(stack: Stack, sensor: SensorNoise) -> FloatImage:
    """Return sampled pixels with their right and lower neighbours, (frame, pixel, 3) DN.

    All three are lit and not saturated.
    """
    _, rows, cols = stack.shape
    # The positions are random (fixed seed), because a regular grid could beat with the fringes.
    rng = np.random.default_rng(0)
    row = rng.integers(0, rows - 1, POSITIONS)[:, np.newaxis] + np.array([0, 0, 1])
    col = rng.integers(0, cols - 1, POSITIONS)[:, np.newaxis] + np.array([0, 1, 0])
    values_dn = np.stack([frame[row, col] for frame in stack]).astype(np.float32)
    low_dn, high_dn = values_dn.min(axis=0), values_dn.max(axis=0)
    noise_dn = np.sqrt(sensor.variance_dn2(high_dn.astype(np.float64)))
    usable = (high_dn < sensor.clipped_from_dn) & (high_dn - low_dn > LIT_SIGMAS * noise_dn)
    return values_dn[:, usable.all(axis=1)]


def _check_axis_words(corners_dn: FloatImage, patterns: PatternSet, axis: Axis) -> None:
    gray = patterns.index("gray", axis)
    bits = read_bits(corners_dn, patterns, axis)
    bits = bits[: patterns.words(axis)[0].bits]
    stated = _share_of_jumps(bits, patterns)
    if stated <= MANY_JUMPS:
        return
    shares = {
        (i, j): _share_of_jumps(bits[exchanged(len(bits), i, j)], patterns)
        for i, j in combinations(range(len(bits)), 2)
    }
    # Of several exchanges that explain the jumps equally well, that of the nearest frames is used.
    i, j = min(shares, key=lambda pair: (round(shares[pair], 2), pair[1] - pair[0]))
    if shares[i, j] < EXPLAINED * stated:
        first, second = (patterns.frames[gray.start + bit].name for bit in (i, j))
        raise CaptureError(
            f"frames {gray.start + i} ({first}) and {gray.start + j} ({second}) look exchanged: "
            f"{stated:.0%} of the changes between neighbouring pixels jump over words, in "
            f"exchanged order {shares[i, j]:.0%}"
        )


def _share_of_jumps(bits: BoolImage, patterns: PatternSet) -> float:
    """Return the share of word changes by more than one, between neighbours; 0 if few change."""
    # Words of up to 16 bits are exact in single precision.
    weights = np.float32(2) ** np.arange(len(bits) - 1, -1, -1, dtype=np.float32)
    words = np.tensordot(weights, patterns.binary(bits).astype(np.float32), axes=1)
    steps = np.abs(words[:, 1:] - words[:, :1])
    changes = int(np.count_nonzero(steps))
    return float(np.count_nonzero(steps > 1)) / changes if changes >= LEAST_CHANGES else 0.0
