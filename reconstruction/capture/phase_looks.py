"""Phase sets among the images of an unknown set.

- Four or more images that follow one another by their names, and of which every pixel shows equal
  steps of a turn, are a set, however little of a fringe the view shows.
- Three or more striped images of one axis and one frequency whose phases are equal steps of a turn
  are a set; the phase of each is its cross spectrum with the first.
- Where a set is known, so are mean A and modulation B of every pixel. Further images that follow
  one another by their names are steps of a coarser period, of which the view may show a small
  part, if A and B of every pixel are the same: bits never have that mean.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from reconstruction.arrays import BoolImage, FloatArray
from reconstruction.capture.image_looks import EXTREME, PADDED, FrameGroup, Look, spectrum
from reconstruction.patterns import AXES, Axis

# Frequencies that differ by less are one, cycles per line: with few fringes the phase moves the
# peak of the spectrum.
SAME_CYCLES, SAME_OF_FEW, FEW_CYCLES = 0.4, 0.8, 3.0
# Least share of neither dark nor bright pixels of a cosine: with three steps and nothing else a
# pixel is darkest in one, brightest in another.
SMOOTH = 0.12
# How far phases may be from equal steps, of a step.
EVEN = 0.2
# Two steps of one period may be half a turn from each other.
COMPLEMENTARY = -0.8
# A coarser period: how far mean and modulation may be from those of the known set, in units of the
# modulation, at this share of the pixels; and the number of its steps.
SAME_MEAN, SAME_MODULATION, SAME_SHARE = 0.2, 0.35, 0.8
# Of steps that follow one another: least modulation, u; RMS of what they leave, in modulations;
# share of pixels neither dark nor bright; pixels looked at.
LEAST_MODULATION, MOST_REST, LEAST_SMOOTH, MOST_PIXELS = 0.08, 0.25, 0.25, 4000
MOST_STEPS = 18
# Mean of the unit phasors from which a view shows too little of a fringe to measure the steps.
MOST_ONE_PHASE, ROUNDS = 0.5, 6
# Ratios of two frequencies from here on are tried as whole numbers, within this share of what the
# slopes say; the mean of unit phasors from which one fits.
WHOLE_FROM, RATIO_ERROR, WHOLE_AGREE = 1.5, 0.2, 0.6
# By how much more the phase of a coarse period grows along its axis than across.
ACROSS = 2.0


class Phasor(NamedTuple):
    """What the frames of a set say at the pixels of some lines, (line, sample) each."""

    mean: FloatArray  # of u - 1/2
    z: FloatArray  # complex, its amount is the modulation
    is_lit: BoolImage


def phase_sets(looks: Sequence[Look], axis: Axis) -> tuple[list[FrameGroup], list[Look]]:
    """Return the phase sets among striped images of one axis, and the other images."""
    rest, sets = list(looks), []
    for first in looks:
        if first not in rest:
            continue
        for one in _even_sets([other for other in rest if is_same(other, first)]):
            rest = [other for other in rest if other.file not in one.files]
            sets.append(one)
    return sets, rest


def _even_sets(same: list[Look]) -> Iterator[FrameGroup]:
    """Yield images of one frequency as a set, or as equal blocks of them that are sets."""
    shifts = even_steps(same)
    if shifts is not None:
        yield _group(same, shifts)
        return
    for count in range(len(same) // 2, 2, -1):
        blocks = [same[k : k + count] for k in range(0, len(same), count)]
        found = [even_steps(block) for block in blocks]
        if len(same) % count == 0 and all(one is not None for one in found):
            yield from (_group(a, b) for a, b in zip(blocks, found, strict=True) if b is not None)
            return


def _group(looks: Sequence[Look], shifts: tuple[float, ...]) -> FrameGroup:
    axis = looks[0].axis
    turns = abs(_turns_per_px(phasor(looks, shifts, axis)))
    return FrameGroup("phase", axis, tuple(one.file for one in looks), shifts, turns)


def phasor(looks: Sequence[Look], shifts_deg: Sequence[float] | FloatArray, axis: Axis) -> Phasor:
    """Return mean and complex modulation of a set along the lines of an axis."""
    frames = np.stack([one.along[axis] for one in looks])
    z = np.tensordot(np.exp(-1j * np.radians(shifts_deg)), frames, axes=1) * 2.0 / len(looks)
    return Phasor(frames.mean(axis=0), z, looks[0].lit[axis])


def _turns_per_px(one: Phasor) -> float:
    """Return by how much the phase of a set grows from pixel to pixel, turns.

    Unlike the peak of a spectrum it is right for a single fringe as well.
    """
    both = one.is_lit[:, 1:] & one.is_lit[:, :-1]
    return float(np.angle(np.sum((one.z[:, 1:] * np.conj(one.z[:, :-1]))[both]))) / (2.0 * np.pi)


def is_same(one: Look, other: Look) -> bool:
    """Whether two images have stripes of one frequency."""
    length = one.lines.shape[1]
    is_few = other.frequency * length < FEW_CYCLES
    difference = abs(one.frequency - other.frequency) * length
    return bool(difference < (SAME_OF_FEW if is_few else SAME_CYCLES))


def even_steps(looks: Sequence[Look]) -> tuple[float, ...] | None:
    """Return the shifts, degrees, if the phases of these images are equal steps of a turn."""
    count = len(looks)
    if count < 3 or np.median([one.smooth for one in looks]) < SMOOTH:
        return None
    at = round(
        float(np.median([one.frequency for one in looks])) * PADDED * looks[0].lines.shape[1]
    )
    values = [spectrum(one.lines)[:, max(at - PADDED, 1) : at + PADDED + 1] for one in looks]
    phases = [float(np.angle(np.sum(value * np.conj(values[0])))) for value in values]
    steps = np.array(phases) * count / (2.0 * np.pi)
    whole = np.rint(steps)
    is_even = bool(np.all(np.abs(steps - whole) < EVEN)) and len(set(whole % count)) == count
    return tuple(float(k % count) * 360.0 / count for k in whole) if is_even else None


def stepped_sets(looks: Sequence[Look]) -> list[FrameGroup]:
    """Return sets of four or more images that follow one another by name, in equal steps."""
    pixels = _pixels(looks)
    sets: list[FrameGroup] = []
    first = 0
    while first < len(looks):
        left = {n: _stepped_rest(pixels, first, n) for n in range(4, MOST_STEPS + 1)}
        # Where the view shows little of a fringe, a wrong number of steps fits as well, but worse.
        count = min(left, key=lambda n: left[n])
        count = count if left[count] < MOST_REST else 0
        if count:
            sets.append(_along_its_axis(looks[first : first + count])[0])
        first += count or 1
    return sets


def _pixels(looks: Sequence[Look]) -> FloatArray:
    """Return u - 1/2 at some lit pixels, (image, pixel)."""
    values = [np.stack([one.along[axis] for one in looks])[:, looks[0].lit[axis]] for axis in AXES]
    both = np.concatenate(values, axis=1)
    return np.asarray(both[:, :: max(both.shape[1] // MOST_PIXELS, 1)], np.float64)


def _stepped_rest(pixels: FloatArray, first: int, count: int) -> float:
    """Return what A + B cos(phi + 2 pi n / N) leaves of nearly all pixels, RMS over B; or infinity.

    Infinity where other pixels than nearly all show it, and where the steps are not equal.
    """
    frames = pixels[first : first + count]
    if len(frames) < count or not frames.size:
        return np.inf
    angles = 2.0 * np.pi * np.arange(count) / count
    mean, z = frames.mean(axis=0), np.exp(-1j * angles) @ frames * 2.0 / count
    size = np.abs(z)
    fit = mean + np.real(z * np.exp(1j * angles)[:, np.newaxis])
    rest = np.sqrt(np.sum((frames - fit) ** 2, axis=0) / (count - 3))
    is_clear = (size > LEAST_MODULATION) & (rest < MOST_REST * size)
    # Of three bits of four frames the middle ones would do as well: but bits are dark or bright.
    low, high = (frames - mean)[:, is_clear].min(axis=0), (frames - mean)[:, is_clear].max(axis=0)
    u = ((frames - mean)[:, is_clear] - low) / np.maximum(high - low, 1e-9)
    smooth = np.mean((u > EXTREME) & (u < 1.0 - EXTREME)) if u.size else 0.0
    if np.mean(is_clear) <= SAME_SHARE or smooth <= LEAST_SMOOTH:
        return np.inf
    if not _has_equal_steps(frames[:, is_clear], z[is_clear]):
        return np.inf
    return float(np.median(rest[is_clear] / size[is_clear]))


def _has_equal_steps(frames: FloatArray, z: FloatArray) -> bool:
    """Whether the phase of each frame (step, pixel) is its step: 11 steps of 12 fit nearly as well.

    Least squares over the pixels for the phase of each frame and over the frames for mean and
    modulation of each pixel, in turns (Wang and Han, Opt. Lett. 29, 1671 (2004)). In a view of a
    small part of a fringe these are not independent: equal steps are not put in question there.

    Parameters
    ----------
    z : (pixel,) complex modulation as measured with equal steps
    """
    if abs(np.mean(z / np.abs(z))) > MOST_ONE_PHASE:
        return True
    stated = 2.0 * np.pi * np.arange(len(frames)) / len(frames)
    steps = stated
    for _ in range(ROUNDS):
        design = np.stack([np.ones_like(steps), np.cos(steps), -np.sin(steps)], axis=1)
        mean, real, imaginary = np.linalg.lstsq(design, frames)[0]
        cosine, sine = np.linalg.lstsq(np.stack([real, -imaginary], axis=1), (frames - mean).T)[0]
        steps = np.arctan2(sine, cosine)
    difference = np.exp(1j * (steps - stated))
    off = np.angle(difference / np.mean(difference))
    return bool(np.max(np.abs(off)) * len(frames) / (2.0 * np.pi) < EVEN)


def coarse_sets(
    looks: Sequence[Look], known: Sequence[FrameGroup], taken: set[str]
) -> tuple[list[FrameGroup], list[str]]:
    """Return sets whose period is too coarse to be seen as stripes, and doubts about them.

    Parameters
    ----------
    looks : all images, in the order of their names
    known : sets of finer periods
    taken : files of these
    """
    by_file = {one.file: one for one in looks}
    references = [
        (len(fine.files), _reference([by_file[name] for name in fine.files], fine.shifts_deg))
        for fine in known
    ]
    # Three steps and nothing else but white and black.
    is_three = sum(one.kind not in ("white", "black") for one in looks) <= 3
    plain = [
        k for k in range(len(looks) - 1) if {looks[k].kind, looks[k + 1].kind} == {"white", "black"}
    ]
    if not known and plain and is_three:
        # Half a turn from each other, white and black have mean and modulation of all fringes.
        references.append((3, _reference(looks[plain[-1] : plain[-1] + 2], (0.0, 180.0))))
    sets: list[FrameGroup] = []
    doubts: list[str] = []
    names = [one.file for one in looks]
    places = [sorted(names.index(name) for name in fine.files) for fine in known]
    in_row = all(some[-1] - some[0] == len(some) - 1 for some in places)
    for count, reference in references:
        for first in range(len(looks) - count + 1):
            block = looks[first : first + count]
            is_free = not any(one.file in taken for one in block)
            if is_free and _has_same_light(block, reference):
                one, doubt = _along_its_axis(block)
                if not in_row:
                    doubt = [
                        *doubt,
                        f"{one.files[0]} ...: taken for steps of a coarse fringe by the"
                        " order of their names, which is not that of the fine fringes",
                    ]
                sets.append(one)
                doubts += doubt
                taken = taken | set(one.files)
    return sets, doubts


def _reference(looks: Sequence[Look], shifts_deg: Sequence[float]) -> dict[Axis, Phasor]:
    scale = 0.5 if len(looks) == 2 else 1.0  # of two frames the sum counts the modulation twice
    found = {axis: phasor(looks, shifts_deg, axis) for axis in AXES}
    return {axis: one._replace(z=scale * one.z) for axis, one in found.items()}


def _has_same_light(block: Sequence[Look], reference: dict[Axis, Phasor]) -> bool:
    """Whether images have mean and modulation of a known set at nearly all pixels."""
    agree, total = 0, 0
    for axis, fine in reference.items():
        coarse = phasor(block, 360.0 * np.arange(len(block)) / len(block), axis)
        size, known = np.abs(coarse.z), np.maximum(np.abs(fine.z), 1e-3)
        is_same_light = (np.abs(coarse.mean - fine.mean) < SAME_MEAN * known) & (
            np.abs(size / known - 1.0) < SAME_MODULATION
        )
        agree += int(np.count_nonzero(is_same_light & fine.is_lit))
        total += int(np.count_nonzero(fine.is_lit))
    return agree > SAME_SHARE * total > 0


def _along_its_axis(block: Sequence[Look]) -> tuple[FrameGroup, list[str]]:
    """Return a set of steps in the order of the names, with a phase that grows along the lines."""
    shifts = 360.0 * np.arange(len(block)) / len(block)
    turns = {axis: _turns_per_px(phasor(block, shifts, axis)) for axis in AXES}
    axis = max(AXES, key=lambda one: abs(turns[one]))
    files = tuple(one.file for one in block)
    across = turns[AXES[1 - AXES.index(axis)]]
    doubts = []
    if abs(turns[axis]) < ACROSS * abs(across):
        doubts.append(f"{files[0]} ...: fringes along {axis} are hardly clearer than across")
    if turns[axis] < 0.0:
        shifts = -shifts % 360.0
    return FrameGroup("phase", axis, files, tuple(shifts.tolist()), abs(turns[axis])), doubts


def with_whole_ratios(looks: Sequence[Look], sets: Sequence[FrameGroup]) -> list[FrameGroup]:
    """Return the sets with frequencies that are whole multiples of the coarsest where they fit.

    Then R phi_coarse - phi_fine is the same for all pixels, and R is exact, which slopes are not.
    """
    by_file = {one.file: one for one in looks}
    result = []
    for one in sets:
        same = [other for other in sets if other.axis == one.axis]
        coarsest = min(same, key=lambda other: other.frequency)
        ratio = one.frequency / max(coarsest.frequency, 1e-9)
        whole = _whole_ratio(by_file, coarsest, one, ratio) if ratio > WHOLE_FROM else None
        result.append(replace(one, frequency=whole * coarsest.frequency) if whole else one)
    return result


def _whole_ratio(
    by_file: dict[str, Look], coarsest: FrameGroup, fine: FrameGroup, ratio: float
) -> int | None:
    axis = fine.axis or "column"
    slow, fast = (
        phasor([by_file[name] for name in one.files], one.shifts_deg, axis)
        for one in (coarsest, fine)
    )
    phase, step = np.angle(slow.z[slow.is_lit]), np.angle(fast.z[slow.is_lit])
    low, high = (round(ratio * (1.0 + sign * RATIO_ERROR)) for sign in (-1.0, 1.0))
    # A coarsest set that was found growing against the fine one would need a negative ratio.
    agree = {n: abs(np.mean(np.exp(1j * (step - n * phase)))) for n in range(max(low, 2), high + 1)}
    best = max(agree, key=lambda n: agree[n], default=0)
    return best if best and agree[best] > WHOLE_AGREE else None


def lone_fringes(looks: Sequence[Look]) -> list[Look]:
    """Return smooth images that share a frequency, but are no equal steps: one may be missing.

    Two that are each other's complement are rather a bit and its inverse.
    """
    found = []
    for one in looks:
        same = [other for other in looks if is_same(other, one) and other.smooth > SMOOTH]
        is_pair = len(same) == 2 and are_opposite(same[0], same[1])
        if one in same and len(same) > 1 and not is_pair:
            found.append(one)
    return found


def are_opposite(one: Look, other: Look) -> bool:
    """Whether two images are each other's complement."""
    both = one.is_lit & other.is_lit if one.axis == other.axis else np.zeros_like(one.is_lit)
    if not both.any():
        return False
    a, b = one.lines[both], other.lines[both]
    size = float(np.sqrt(np.sum(a * a) * np.sum(b * b)))
    return bool(float(np.sum(a * b)) < COMPLEMENTARY * size)
